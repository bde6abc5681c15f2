"""The figures of a run: how it was discovered, and what several runs found."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Text

from murmurate.errors import InputError
from murmurate.plots.curves import draw_episode, draw_training
from murmurate.plots.drawing import add_paths, draw_world, show_window
from murmurate.plots.page import HEAD, LEFT, TEXT, WIDTH, add_axes, new_page
from murmurate.plots.palette import INK, MUTED, ROBOT, WARNING
from murmurate.plots.panels import draw_panels, draw_pattern, draw_run_head, goal, pattern_frame, sight, swarm
from murmurate.plots.record import Record

__all__ = ["discovery_figure", "patterns_figure"]


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
    figure = new_page(6.95)
    draw_run_head(figure, record)
    draw_panels(figure, record, shown, 3.05)
    draw_training(add_axes(figure, LEFT + 0.5, 0.47, 3.6, 1.75), record)
    draw_episode(add_axes(figure, LEFT + 4.82, 0.47, 3.5, 1.75), record, shown)
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
    side = min(3.0, (WIDTH - 0.3 - (columns - 1) * gap) / columns)
    left = (WIDTH - columns * side - (columns - 1) * gap) / 2
    height = head + side + foot
    figure = new_page(rows * height + 0.1)
    for place, (record, label) in enumerate(zip(records, labels, strict=True)):
        row, column = divmod(place, columns)
        x, y = left + column * (side + gap), (rows - 1 - row) * height + foot
        _draw_final(figure, record, label, (x, y), side)
    return figure


def _draw_final(figure: Figure, record: Record, label: str, corner: tuple[float, float], side: float) -> None:
    """Draws one run's final pattern, its name above, and its start small beside the name."""
    episode = record.episode()
    final = episode.positions[-1]
    ax = add_axes(figure, *corner, side, side)
    draw_pattern(ax, record, episode, episode.steps, pattern_frame(record, final))
    small = 0.58
    inset = add_axes(figure, corner[0] + side - small, corner[1] + side + 0.07, small, small)
    sizes = record.sizes
    show_window(inset, np.zeros(2), max(sizes.half_width, sizes.half_height))
    inset.set_frame_on(False)
    draw_world(inset, sizes, whole=True, width=0.7)
    add_paths(inset, episode, episode.steps, oldest=0.35, width=0.6)
    # To scale they would be invisible here: dots of a fixed size.
    inset.plot(*episode.positions[0].T, "o", markersize=2.0, color=ROBOT, markeredgewidth=0)
    words, everyone = sight(record, final)

    def line(inches: float, text: str, **style: Any) -> Text:
        style = {"fontsize": TEXT, "color": MUTED, "parse_math": False} | style
        return ax.text(style.pop("x", 0), 1 + inches / side, text, transform=ax.transAxes, **style)

    name = line(0.47, label, fontsize=HEAD, fontweight="bold", color=INK)
    line(0.47, goal(record), x=name.get_window_extent().width / ax.bbox.width + 0.03)
    line(0.27, swarm(record))
    line(0.09, words, color=MUTED if everyone else WARNING)
    line(-side - 0.105, f"{episode.steps} steps", x=1, ha="right", va="center")
