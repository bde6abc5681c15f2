"""One episode as a moving picture: WebP or GIF with Pillow alone, mp4 with the `video` extra.

The picture is a dark card, readable on light and on dark pages. A sight line is switched on when the two robots begin
to see each other, and fades out when they lose sight.
"""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from PIL import Image

from murmurate.errors import InputError, check_number, check_path
from murmurate.plots.recording import Episode, Recording, check_recording
from murmurate.plots.style import quantize, write_file
from murmurate.plots.swarm import NIGHT, SwarmArtist, draw_world, path_segments, sight_pairs
from murmurate.world import WorldConfig

__all__ = ["SUFFIXES", "animate", "check_target"]

SUFFIXES = (".gif", ".webp", ".mp4")
WIDTH, HEIGHT = 640, 400
"""Size of a picture, pixels; both even, as video codecs need them."""

MAX_BYTES = 1_000_000
"""Size that a WebP or GIF does not exceed, if fewer colours and frames suffice for that."""

_DPI = 100
_TEXT = "#C9D3DC"
_HEAD = 34  # pixels for the line of text above the swarm
_SECONDS = (4.5, 6.5)  # of motion: long episodes are shown faster than 12 steps a second, short ones slower
_HOLD = 1.5  # seconds for which the final pattern stays
_TRAIL = 25  # steps of path behind each robot
_FADE = 0.25  # seconds in which a sight line appears or disappears


def animate(recording: Recording, path: str | os.PathLike[str], episode: int | None = None, fps: int = 15) -> None:
    """Writes one episode as an animation of about 5 to 8 seconds that zooms in as the robots gather.

    Args:
        recording: The run.
        path: A name that ends in .gif or .webp, or in .mp4 where the `video` extra is installed.
        episode: Which of its episodes; the typical one (median steps of the valid ones) where None.
        fps: Frames a second, 1 to 50.

    Raises:
        InputError: No such episode, another suffix, a rate that players do not keep, or no `video` extra.
        RunError: The file cannot be written.
    """
    check_recording(recording)
    check_number("fps", fps, 1, 50, integer=True)
    check_target(path)
    encode = {".gif": _gif, ".webp": _webp, ".mp4": _mp4}[Path(path).suffix.lower()]
    write_file(path, encode(_frames(recording, recording.episode(episode), fps), fps))


def check_target(path: str | os.PathLike[str], field: str = "path") -> None:
    """Checks that an animation can be written under a name.

    Args:
        path: The name.
        field: What the name is called in an error.

    Raises:
        InputError: The name has another suffix, or it is an .mp4 without the `video` extra.
    """
    check_path(field, path)
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(field, str(path), f"a name that ends in {', '.join(SUFFIXES)}")
    if suffix == ".mp4":
        _ffmpeg(path, field)


# Frames


def _frames(recording: Recording, episode: Episode, fps: int) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    """Draws frame after frame on one canvas by moving the artists; robots move straight from step to step."""
    world, names = recording.experiment.world, recording.policies
    policies = episode.policies
    figure = Figure(figsize=(WIDTH / _DPI, HEIGHT / _DPI), dpi=_DPI, facecolor=NIGHT.background)
    canvas = FigureCanvasAgg(figure)
    ax = figure.add_axes((0, 0, 1, 1 - _HEAD / HEIGHT))
    ax.set_axis_off()
    draw_world(ax, world, color=NIGHT.shell)
    trail = LineCollection([], linewidths=1.2, zorder=1.5)
    ax.add_collection(trail, autolim=False)
    start = episode.positions[0]
    swarm = SwarmArtist(ax, start, world, gathering_point=recording.gathering_point, look=NIGHT, weight=1.2)
    text: dict[str, Any] = {"va": "center", "parse_math": False}
    left = figure.text(14 / WIDTH, 1 - 19 / HEIGHT, "", fontsize=9.5, fontweight="bold", **text)
    right = figure.text(1 - 14 / WIDTH, 1 - 19 / HEIGHT, "", fontsize=9.5, color=_TEXT, ha="right", **text)
    pairs = world.robots * (world.robots - 1) // 2
    centers, halves = _camera(episode.positions, world)
    strength = sight_pairs(start, world)[0].astype(float)
    rate = 1 / (_FADE * fps)
    for time in _times(episode.steps, fps):
        step = min(int(time), max(episode.steps - 1, 0))
        share = time - step
        after = min(step + 1, episode.steps)
        positions = (1 - share) * episode.positions[step] + share * episode.positions[after]
        center, half = ((1 - share) * values[step] + share * values[after] for values in (centers, halves))
        ax.set(xlim=center[0] + half[0] * np.array([-1, 1]), ylim=center[1] + half[1] * np.array([-1, 1]))
        seen = sight_pairs(positions, world)[0]
        done = time >= episode.steps
        # The last frame stays: it shows what holds at the end.
        strength = seen.astype(float) if done else np.clip(strength + rate * np.where(seen, 1, -1), 0, 1)
        swarm.update(positions, strength)
        first = max(0, step - _TRAIL)
        recent = np.concatenate([episode.positions[first : step + 1], positions[None]])
        segments, colors = path_segments(recent, policies[first : step + 1], look=NIGHT)
        trail.set_segments(list(segments))
        trail.set_color(list(colors))
        if done:
            left.set(text=episode.outcome, color=_TEXT)
        else:
            name = names[policies[step]] if len(names) > 1 else f"{world.robots} robots"
            left.set(text=name, color=NIGHT.policies[policies[step] % len(NIGHT.policies)])
        right.set_text(f"{int(seen.sum())} of {pairs} pairs see each other    step {int(time)}")
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _times(steps: int, fps: int) -> Float[np.ndarray, " frames"]:
    """Returns the moment of each frame, in steps from the start: the first is 0, the last the end."""
    seconds = min(np.clip(steps / 12, *_SECONDS), steps / 3)
    return np.linspace(0, steps, round(seconds * fps) + 1)


def _camera(
    positions: Float[np.ndarray, "configurations robots 2"], world: WorldConfig
) -> tuple[Float[np.ndarray, "configurations 2"], Float[np.ndarray, "configurations 2"]]:
    """Returns centre and half sides of the window at each step: the world first, closer as the robots gather.

    Each window lies between the final one (share 0) and the world (share 1), so that they nest and the camera only
    zooms in.
    """
    aspect = np.array([WIDTH / (HEIGHT - _HEAD), 1.0])
    margin = world.safe_distance

    def half_sides(low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Returns the smallest window of the picture's shape with that extent."""
        return aspect * ((high - low) / 2 / aspect).max()

    final_low, final_high = positions[-1].min(axis=0) - margin, positions[-1].max(axis=0) + margin
    center, final = (final_low + final_high) / 2, half_sides(final_low, final_high)
    edge = 1.04 * np.array([world.half_width, world.half_height])
    if not world.bounded:
        edge = np.maximum(edge, np.abs(positions).max(axis=(0, 1)) + margin)
    whole = half_sides(-edge, edge)
    shares = np.zeros(len(positions))
    for side in (1, -1):
        excess = side * (positions - center) + margin - final
        room = np.maximum(whole - side * center - final, 1e-9)
        shares = np.maximum(shares, (excess / room).max(axis=(1, 2)))
    shares = np.maximum.accumulate(np.clip(shares, 0, 1)[::-1])[::-1]
    # A mean over the steps before is never smaller than what a step needs: smooth, and every robot stays in view.
    width = max(1, (len(positions) - 1) // 6)
    padded = np.concatenate([np.full(width, shares[0]), shares])
    shares = np.convolve(padded, np.full(width + 1, 1 / (width + 1)), mode="valid")[:, None]
    return (1 - shares) * center, (1 - shares) * final + shares * whole


# Encoders: WebP and GIF are made of fewer colours, and then of every second frame, until they are small


def _webp(frames: Iterator[UInt8[np.ndarray, "height width 3"]], fps: int) -> bytes:
    pictures, data = [Image.fromarray(frame) for frame in frames], b""
    for quality, stride in ((45, 1), (25, 1), (25, 2)):
        options: dict[str, Any] = {"quality": quality, "method": 4, "minimize_size": True, "kmax": 1000}
        data = _encode(pictures, "WEBP", stride, 1000 / fps, **options)
        if len(data) <= MAX_BYTES:
            break
    return data


def _gif(frames: Iterator[UInt8[np.ndarray, "height width 3"]], fps: int) -> bytes:
    size = (WIDTH * 3 // 4, HEIGHT * 3 // 4)
    pictures, data = [Image.fromarray(frame).resize(size, Image.Resampling.LANCZOS) for frame in frames], b""
    colors = (NIGHT.robot, NIGHT.clear[0], NIGHT.blocked[0], NIGHT.shell, *NIGHT.policies)
    for levels, stride in ((6, 1), (3, 1), (3, 2)):
        few = [quantize(np.asarray(p), levels, colors=colors, background=NIGHT.background) for p in pictures]
        data = _encode(few, "GIF", stride, round(100 / fps) * 10, optimize=False)  # the format counts 10 ms
        if len(data) <= MAX_BYTES:
            break
    return data


def _encode(pictures: Sequence[Image.Image], format: str, stride: int, duration: float, **options: Any) -> bytes:
    """Returns every `stride`-th picture, the last one always, as one file that loops."""
    shown = pictures[::-1][::stride][::-1]
    durations = [round(stride * duration)] * len(shown)
    durations[-1] += round(_HOLD * 1000)
    buffer = io.BytesIO()
    shown[0].save(buffer, format=format, save_all=True, append_images=shown[1:], loop=0, duration=durations, **options)
    return buffer.getvalue()


def _ffmpeg(path: str | os.PathLike[str] = "", field: str = "path") -> Any:
    try:
        import imageio_ffmpeg  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        allowed = "a name that ends in .gif or .webp, or the video extra installed: pip install 'murmurate[video]'"
        raise InputError(field, str(path), allowed) from error
    return imageio_ffmpeg


def _mp4(frames: Iterator[UInt8[np.ndarray, "height width 3"]], fps: int) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "animation.mp4"
        # The codec needs even sides; without larger blocks, which would scale the picture.
        writer = _ffmpeg().write_frames(str(file), (WIDTH, HEIGHT), fps=fps, macro_block_size=2, quality=7)
        writer.send(None)
        try:
            frame = None
            for frame in frames:
                writer.send(np.ascontiguousarray(frame))
            for _ in range(round(_HOLD * fps)):
                writer.send(np.ascontiguousarray(frame))
        finally:
            writer.close()
        return file.read_bytes()
