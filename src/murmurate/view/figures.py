"""The figures of a run: how it was discovered, and what several runs found."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.text import Text
from PIL import Image

from murmurate.errors import InputError
from murmurate.view.curves import draw_episode, draw_training
from murmurate.view.drawing import (
    INK,
    MUTED,
    ROBOT,
    WARNING,
    Drawing,
    add_paths,
    draw_configuration,
    draw_key,
    draw_scale,
    draw_world,
    mutual_pairs,
    show_window,
    window,
)
from murmurate.view.files import written_aside
from murmurate.view.palette import limited
from murmurate.view.record import Episode, Record

__all__ = ["discovery_figure", "patterns_figure", "save"]

_WIDTH = 10.0  # inches; shown 1000 pixels wide, a point is 1.4 pixels
_LEFT = 0.25
_TEXT = 8.5
_TITLE = 10.0
_HEAD = 13.0
_STARTS = ("scattered", "distributed", "packed", "random")


def discovery_figure(record: Record, episode: int | None = None) -> Figure:
    """Draws a discovery on one page: start, base pattern, final pattern, training, and the signal of that episode.

    Args:
        record: The run.
        episode: Which of its evaluation's episodes; the typical one (median steps of the valid ones) where None.

    Returns:
        A figure 10 inches wide.

    Raises:
        InputError: There is no such episode.
    """
    shown = record.episode(episode)
    figure = Figure(figsize=(_WIDTH, 6.95), facecolor="white")
    _head(figure, record)
    panels = [("Start", 0), ("Final pattern", shown.steps)]
    if shown.switches:
        panels.insert(1, (f"{record.policies[0].capitalize()} pattern", shown.switches[0]))
    side, gap = 3.0, 0.25
    left = (_WIDTH - len(panels) * side - (len(panels) - 1) * gap) / 2
    frames = [_frame(record, shown.positions[step]) for _, step in panels]
    half = max(extent for _, extent in frames[1:])
    for place, (title, step) in enumerate(panels):
        ax = _axes(figure, left + place * (side + gap), 3.05, side, side)
        _pattern_title(ax, record, shown.positions[step], title if step == 0 else f"{title} · step {step}")
        if place == 0:
            _draw_start(ax, record, shown, (frames[-1][0], half))
        else:
            _draw_pattern(ax, record, shown, step, (frames[place][0], half))
    draw_key(figure.axes[0], _TEXT)
    draw_training(_axes(figure, _LEFT + 0.5, 0.47, 3.6, 1.75), record)
    draw_episode(_axes(figure, _LEFT + 4.82, 0.47, 3.5, 1.75), record, shown)
    return figure


def patterns_figure(records: Sequence[Record], labels: Sequence[str]) -> Figure:
    """Draws the final patterns of several runs side by side, each to its own scale, its start beside its name.

    Args:
        records: The runs; of each, its typical episode is drawn.
        labels: What to call them.

    Returns:
        A figure 10 inches wide: one row of up to three runs, two rows of more.

    Raises:
        InputError: There are no runs, or not as many labels as runs.
    """
    if not records or len(records) != len(labels):
        raise InputError("labels", list(labels), f"one for each of at least one run (runs: {len(records)})")
    rows = 1 if len(records) <= 3 else 2
    columns = -(-len(records) // rows)
    gap, head, foot = 0.3, 0.72, 0.3
    side = min(3.0, (_WIDTH - 0.3 - (columns - 1) * gap) / columns)
    left = (_WIDTH - columns * side - (columns - 1) * gap) / 2
    plate = head + side + foot
    figure = Figure(figsize=(_WIDTH, rows * plate + 0.1), facecolor="white")
    for place, (record, label) in enumerate(zip(records, labels, strict=True)):
        row, column = divmod(place, columns)
        x, y = left + column * (side + gap), (rows - 1 - row) * plate + foot
        _draw_plate(figure, record, label, (x, y), side)
    return figure


def save(figure: Figure, path: str | os.PathLike[str], dpi: int = 180) -> None:
    """Writes a figure as a small PNG, aside first and then renamed; the same figure gives the same bytes.

    Args:
        figure: What to write.
        path: A name that ends in .png.
        dpi: Pixels an inch.

    Raises:
        InputError: The name does not end in .png.
        RunError: The file cannot be written.
    """
    if Path(path).suffix.lower() != ".png":
        raise InputError("path", str(path), "a name that ends in .png")
    raw = io.BytesIO()
    figure.savefig(raw, format="png", dpi=dpi, metadata={"Software": None})
    picture = limited(np.asarray(Image.open(raw).convert("RGB")), levels=8, frequent=150)
    with written_aside(path) as aside:
        picture.save(aside, format="PNG", optimize=True)


def _axes(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Adds axes at a place given in inches."""
    across, up = figure.get_size_inches()
    return figure.add_axes((left / across, bottom / up, width / across, height / up))


def _swarm(record: Record) -> str:
    start = record.experiment.get("start")
    kind = start.get("kind") if isinstance(start, dict) else None
    return f"{record.sizes.robots} robots" + (f", {kind} start" if kind in _STARTS else "")


def _goal(record: Record) -> str:
    return "gathering at the origin" if record.objective == "C1" else "no predefined point"


def _head(figure: Figure, record: Record) -> None:
    width, height = figure.get_size_inches()
    y = 1 - 0.32 / height
    name = record.name if len(record.name) <= 24 else record.name[:23] + "…"
    text = figure.text(_LEFT / width, y, f"Experiment {name}", fontsize=_HEAD, fontweight="bold", color=INK)
    text.set_parse_math(False)
    x = text.get_window_extent().x1 / figure.bbox.width + 0.012
    figure.text(x, y, f"{_swarm(record)}, {_goal(record)}", fontsize=_TITLE, color=MUTED)
    episodes = record.evaluation["episodes"]
    words = f"valid: {round(record.evaluation['valid'] * episodes)} of {episodes} fresh starts"
    figure.text(1 - _LEFT / width, y, words, fontsize=_TITLE, color=INK, ha="right")


def _sight(record: Record, positions: np.ndarray) -> tuple[str, bool]:
    """Says how many pairs see each other, and whether all do."""
    sizes = record.sizes
    pairs = sizes.robots * (sizes.robots - 1) // 2
    seen = int(mutual_pairs(positions, sizes.radius, sizes.scan_radius)[0].sum())
    count = f"all {pairs}" if seen == pairs else f"{seen} of {pairs}"
    return f"{count} pairs see each other", seen == pairs


def _pattern_title(ax: Axes, record: Record, positions: np.ndarray, title: str) -> None:
    ax.text(0, 1.085, title, transform=ax.transAxes, fontsize=_TITLE, fontweight="bold", color=INK, parse_math=False)
    ax.text(0, 1.02, _sight(record, positions)[0], transform=ax.transAxes, fontsize=_TEXT, color=MUTED)


def _frame(record: Record, positions: np.ndarray) -> tuple[np.ndarray, float]:
    """Returns the square that shows a pattern with its safe-distance circles."""
    return window(positions, margin=0.75 * max(record.sizes.safe_distance, 2 * record.sizes.radius))


def _draw_start(ax: Axes, record: Record, episode: Episode, zoom: tuple[np.ndarray, float]) -> None:
    """Draws the whole world with the start, where the paths will lead, and the square that the patterns show."""
    sizes = record.sizes
    show_window(ax, np.zeros(2), max(sizes.half_width, sizes.half_height))
    ax.set_frame_on(False)
    draw_world(ax, sizes, whole=True)
    add_paths(ax, episode, episode.steps, oldest=0.35, width=0.7)
    center, half = zoom
    square = Rectangle(tuple(center - half), 2 * half, 2 * half, fill=False, edgecolor=MUTED, linewidth=0.8)
    square.set_linestyle((0, (3, 2)))
    ax.add_patch(square)
    # Robots stand at the very edge of the world with their centres: the axes do not cut them there.
    _draw_robots(ax, record, episode.positions[0], weight=0.5).discs.set_clip_on(False)
    length = _round_length(sizes.half_width / 2)
    draw_scale(ax, length, f"{length:g} units", _TEXT)


def _draw_pattern(ax: Axes, record: Record, episode: Episode, step: int, frame: tuple[np.ndarray, float]) -> None:
    """Draws one configuration of the episode, near enough to see who sees whom, and how the robots came there."""
    show_window(ax, *frame)
    draw_world(ax, record.sizes)
    add_paths(ax, episode, step)
    _draw_robots(ax, record, episode.positions[step])
    length = record.sizes.safe_distance
    draw_scale(ax, length, f"safe distance {length:g}", _TEXT)


def _draw_robots(ax: Axes, record: Record, positions: np.ndarray, weight: float = 1.0) -> Drawing:
    sizes = record.sizes
    args = (sizes.radius, sizes.scan_radius, sizes.safe_distance, record.objective)
    return draw_configuration(ax, positions, *args, weight=weight)


def _draw_plate(figure: Figure, record: Record, label: str, corner: tuple[float, float], side: float) -> None:
    """Draws one run's final pattern, its name above, and its start small beside the name."""
    episode = record.episode()
    final = episode.positions[-1]
    ax = _axes(figure, *corner, side, side)
    _draw_pattern(ax, record, episode, episode.steps, _frame(record, final))
    small = 0.58
    inset = _axes(figure, corner[0] + side - small, corner[1] + side + 0.07, small, small)
    sizes = record.sizes
    show_window(inset, np.zeros(2), max(sizes.half_width, sizes.half_height))
    inset.set_frame_on(False)
    draw_world(inset, sizes, whole=True, width=0.7)
    add_paths(inset, episode, episode.steps, oldest=0.35, width=0.6)
    # To scale they would be invisible here: dots of a fixed size.
    inset.plot(*episode.positions[0].T, "o", markersize=2.0, color=ROBOT, markeredgewidth=0)
    words, everyone = _sight(record, final)

    def line(inches: float, text: str, **style: Any) -> Text:
        style = {"fontsize": _TEXT, "color": MUTED, "parse_math": False} | style
        return ax.text(style.pop("x", 0), 1 + inches / side, text, transform=ax.transAxes, **style)

    name = line(0.47, label, fontsize=_HEAD, fontweight="bold", color=INK)
    line(0.47, _goal(record), x=name.get_window_extent().width / ax.bbox.width + 0.03)
    line(0.27, _swarm(record))
    line(0.09, words, color=MUTED if everyone else WARNING)
    line(-side - 0.105, f"{episode.steps} steps", x=1, ha="right", va="center")


def _round_length(length: float) -> float:
    """Returns the largest of 1, 2, 5 times a power of ten that is at most `length`."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(step * power for step in (1, 2, 5) if step * power <= length * (1 + 1e-9)))
