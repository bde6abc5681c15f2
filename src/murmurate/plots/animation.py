"""One episode as a moving picture: a GIF with nothing but Pillow, or an .mp4 with the `video` extra."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from murmurate.errors import InputError
from murmurate.plots.drawing import (
    draw_configuration,
    draw_world,
    path_colors,
    path_segments,
    show_window,
    window,
)
from murmurate.plots.files import written_aside
from murmurate.plots.palette import INK, MUTED, limited, policy_color
from murmurate.plots.record import Episode, Record

__all__ = ["animate"]

_WIDTH, _HEIGHT, _DPI = 420, 452, 100
_FRAMES = 120  # at most: a longer episode skips steps
_TAIL = 25  # steps of path behind each robot
_LEVELS = 6  # of each colour, towards white: enough for smooth edges
_HOLD = 1.5  # seconds for which the final pattern stands


def animate(record: Record, path: str | os.PathLike[str], episode: int | None = None, fps: int = 20) -> None:
    """Writes one episode as an animation that zooms in as the robots gather.

    Args:
        record: The run.
        path: A name that ends in .gif, or in .mp4 where the `video` extra is installed.
        episode: Which of its evaluation's episodes; the typical one where None.
        fps: Frames a second, 1 to 50.

    Raises:
        InputError: No such episode, another suffix, a rate that players do not keep, or no `video` extra.
        RunError: The file cannot be written.
    """
    if not 1 <= fps <= 50:
        raise InputError("fps", fps, "from 1 to 50")
    writers = {".gif": _write_gif, ".mp4": _write_mp4}
    suffix = Path(path).suffix.lower()
    if suffix not in writers:
        raise InputError("path", str(path), "a name that ends in .gif or .mp4")
    if suffix == ".mp4":
        _ffmpeg(path)  # before anything is made
    frames = _frames(record, record.episode(episode))
    with written_aside(path) as aside:
        writers[suffix](aside, frames, fps)


def _frames(record: Record, episode: Episode) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    """Draws frame after frame on one canvas, moving the artists."""
    figure = Figure(figsize=(_WIDTH / _DPI, _HEIGHT / _DPI), dpi=_DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    side = (_WIDTH - 16) / _WIDTH
    ax = figure.add_axes((8 / _WIDTH, 8 / _HEIGHT, side, side * _WIDTH / _HEIGHT))
    sizes = record.sizes
    draw_world(ax, sizes)
    trail = LineCollection([], linewidths=1.0, zorder=1.5)
    ax.add_collection(trail, autolim=False)
    args = (sizes.radius, sizes.scan_radius, sizes.safe_distance, record.objective)
    drawing = draw_configuration(ax, episode.positions[0], *args)
    y = 1 - 15 / _HEIGHT
    left = figure.text(10 / _WIDTH, y, "", fontsize=9.5, fontweight="bold", va="center", parse_math=False)
    right = figure.text(1 - 10 / _WIDTH, y, "", fontsize=9.5, color=INK, va="center", ha="right")
    centers, halves = _camera(record, episode)
    objective, best = episode.objective, len(episode.signals)
    for step in _steps(episode):
        show_window(ax, centers[step], halves[step])
        drawing.update(episode.positions[step])
        first = max(0, step - _TAIL)
        trail.set_segments(list(path_segments(episode.positions[first : step + 1])))
        trail.set_color(list(path_colors(episode, first, step)))
        place = episode.policy_at(step)
        done = step == episode.steps
        left.set(text=episode.outcome if done else record.policies[place], color=MUTED if done else policy_color(place))
        right.set_text(f"step {step}    objective {objective[step]:.2f} of {best}")
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _steps(episode: Episode) -> list[int]:
    """Returns the steps to show: all of a short episode, evenly chosen ones of a long one, always first and last."""
    count = min(episode.steps + 1, _FRAMES)
    return np.unique(np.linspace(0, episode.steps, count).round().astype(int)).tolist()


def _camera(
    record: Record, episode: Episode
) -> tuple[Float[np.ndarray, "configurations 2"], Float[np.ndarray, " configurations"]]:
    """Returns the square to show at each step: the world at first, nearer as the robots gather, never farther.

    Each square lies between the final one (share 0) and the world (share 1), so that they nest.
    """
    sizes, margin = record.sizes, record.sizes.safe_distance
    world = 1.02 * max(sizes.half_width, sizes.half_height)
    center, final = window(episode.positions[-1], margin)
    shares = np.zeros(len(episode.positions))
    for side in (1, -1):
        excess = side * (episode.positions - center) + margin - final
        room = np.maximum(world - side * center - final, 1e-9)
        shares = np.maximum(shares, (excess / room).max(axis=(1, 2)))
    shares = np.maximum.accumulate(np.clip(shares, 0, 1)[::-1])[::-1]
    # The mean of the shares up to a step is no smaller than what the step needs: smooth, and nobody leaves the picture.
    width = max(1, episode.steps // 6)
    padded = np.concatenate([np.full(width, shares[0]), shares])
    shares = np.convolve(padded, np.full(width + 1, 1 / (width + 1)), mode="valid")
    return np.outer(1 - shares, center), (1 - shares) * final + shares * world


def _write_gif(path: Path, frames: Iterator[UInt8[np.ndarray, "height width 3"]], fps: int) -> None:
    pictures = [limited(frame, levels=_LEVELS) for frame in frames]
    durations = [round(100 / fps) * 10] * len(pictures)  # the format counts hundredths of a second
    durations[-1] += round(_HOLD * 1000)
    pictures[0].save(
        path, format="GIF", save_all=True, append_images=pictures[1:], duration=durations, loop=0, optimize=False
    )


def _ffmpeg(path: str | os.PathLike[str]) -> Any:
    try:
        import imageio_ffmpeg  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        allowed = "a name that ends in .gif, or the video extra installed: pip install 'murmurate[video]'"
        raise InputError("path", str(path), allowed) from error
    return imageio_ffmpeg


def _write_mp4(path: Path, frames: Iterator[UInt8[np.ndarray, "height width 3"]], fps: int) -> None:
    # Both sides are even, which the codec needs; no larger blocks, which would scale the picture.
    writer = _ffmpeg(path).write_frames(str(path), (_WIDTH, _HEIGHT), fps=fps, macro_block_size=2, quality=7)
    writer.send(None)
    try:
        frame = None
        for frame in frames:
            writer.send(np.ascontiguousarray(frame))
        for _ in range(round(_HOLD * fps)):
            writer.send(np.ascontiguousarray(frame))
    finally:
        writer.close()
