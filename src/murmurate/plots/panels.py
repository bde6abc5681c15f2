"""The start and the patterns of one run, drawn and put into words the same way in every figure."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from murmurate.plots.drawing import (
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
from murmurate.plots.page import TEXT, TITLE, WIDTH, add_axes, draw_head
from murmurate.plots.palette import INK, MUTED
from murmurate.plots.record import Episode, Record

__all__ = ["draw_panels", "draw_pattern", "draw_run_head", "goal", "pattern_frame", "sight", "swarm"]

_SIDE = 3.0  # inches
_GAP = 0.25
_STARTS = ("scattered", "distributed", "packed", "random")


def swarm(record: Record) -> str:
    """Says how many robots start from what."""
    start = record.experiment.get("start")
    kind = start.get("use", start.get("kind")) if isinstance(start, dict) else None
    return f"{record.sizes.robots} robots" + (f", {kind} start" if kind in _STARTS else "")


def goal(record: Record) -> str:
    """Says what the run's objective asks for."""
    return "gathering at the origin" if record.objective == "C1" else "no predefined point"


def sight(record: Record, positions: np.ndarray) -> tuple[str, bool]:
    """Says how many pairs see each other, and whether all do."""
    sizes = record.sizes
    pairs = sizes.robots * (sizes.robots - 1) // 2
    seen = int(mutual_pairs(positions, sizes.radius, sizes.scan_radius)[0].sum())
    count = f"all {pairs}" if seen == pairs else f"{seen} of {pairs}"
    return f"{count} pairs see each other", seen == pairs


def draw_run_head(figure: Figure, record: Record) -> None:
    """Writes at the top of the page which run it shows, and how many of its starts ended in a valid pattern."""
    name = record.name if len(record.name) <= 24 else record.name[:23] + "…"
    episodes = record.evaluation["episodes"]
    valid = f"valid: {round(record.evaluation['valid'] * episodes)} of {episodes} fresh starts"
    draw_head(figure, f"Experiment {name}", f"{swarm(record)}, {goal(record)}", valid)


def draw_panels(figure: Figure, record: Record, episode: Episode, bottom: float) -> list[Axes]:
    """Draws in one row where an episode starts, the base policy's pattern if others follow, and the final pattern.

    Args:
        figure: The page.
        record: The run.
        episode: One of its episodes.
        bottom: How far above the page's lower edge, inches.
    """
    panels = [("Start", 0), ("Final pattern", episode.steps)]
    if episode.switches:
        panels.insert(1, (f"{record.policies[0].capitalize()} pattern", episode.switches[0]))
    left = (WIDTH - len(panels) * _SIDE - (len(panels) - 1) * _GAP) / 2
    frames = [pattern_frame(record, episode.positions[step]) for _, step in panels]
    half = max(extent for _, extent in frames[1:])
    axes = []
    for place, (title, step) in enumerate(panels):
        ax = add_axes(figure, left + place * (_SIDE + _GAP), bottom, _SIDE, _SIDE)
        _draw_title(ax, record, episode.positions[step], title if step == 0 else f"{title} · step {step}")
        if place == 0:
            _draw_start(ax, record, episode, (frames[-1][0], half))
        else:
            draw_pattern(ax, record, episode, step, (frames[place][0], half))
        axes.append(ax)
    draw_key(axes[0], TEXT)
    return axes


def pattern_frame(record: Record, positions: np.ndarray) -> tuple[np.ndarray, float]:
    """Returns centre and half side of the square that shows a pattern with its safe-distance circles."""
    return window(positions, margin=0.75 * max(record.sizes.safe_distance, 2 * record.sizes.radius))


def draw_pattern(ax: Axes, record: Record, episode: Episode, step: int, frame: tuple[np.ndarray, float]) -> None:
    """Draws one configuration of the episode, near enough to see who sees whom, and how the robots came there."""
    show_window(ax, *frame)
    draw_world(ax, record.sizes)
    add_paths(ax, episode, step)
    _draw_robots(ax, record, episode.positions[step])
    length = record.sizes.safe_distance
    draw_scale(ax, length, f"safe distance {length:g}", TEXT)


def _draw_title(ax: Axes, record: Record, positions: np.ndarray, title: str) -> None:
    ax.text(0, 1.085, title, transform=ax.transAxes, fontsize=TITLE, fontweight="bold", color=INK, parse_math=False)
    ax.text(0, 1.02, sight(record, positions)[0], transform=ax.transAxes, fontsize=TEXT, color=MUTED)


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
    draw_scale(ax, length, f"{length:g} units", TEXT)


def _draw_robots(ax: Axes, record: Record, positions: np.ndarray, weight: float = 1.0) -> Drawing:
    sizes = record.sizes
    args = (sizes.radius, sizes.scan_radius, sizes.safe_distance, record.objective)
    return draw_configuration(ax, positions, *args, weight=weight)


def _round_length(length: float) -> float:
    """Returns the largest of 1, 2, 5 times a power of ten that is at most `length`."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(step * power for step in (1, 2, 5) if step * power <= length * (1 + 1e-9)))
