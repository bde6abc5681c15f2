"""Method against method: the share of valid patterns by swarm size, and what failures look like."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from murmurate.errors import InputError
from murmurate.geometry import neighbors_and_visible
from murmurate.plots.page import LEFT, TEXT, add_axes, draw_head, new_page, style_axes
from murmurate.plots.palette import FAINT, INK, MUTED, ROBOT, WARNING, policy_color

__all__ = ["comparison_figure", "failures_figure"]

Row = Mapping[str, Any]

_MARKERS = "osD^vPX"
_COLORS = (INK, *(policy_color(place) for place in range(5)), WARNING, MUTED)
_ACROSS = 3

MANY = 30
"""Where there are more failures than these, only the worst of each cell is drawn."""

_WIDE, _HIGH = 2.45, 1.9

MOST_NUMBERS = 12
"""Swarm sizes that a panel has room to name."""


def comparison_figure(rows: Sequence[Row]) -> Figure:
    """Draws the share of valid patterns against the swarm size: a panel for each sensing and scheduler.

    Args:
        rows: Of comparison.json.

    Returns:
        A figure 10 inches wide.

    Raises:
        InputError: There is no row.
    """
    _check(rows)
    sizes = {panel: {row["robots"] for row in rows if _panel(row) == panel} for panel in map(_panel, rows)}
    # A single swarm size is better read in the table, where there is more to draw.
    panels = [panel for panel, own in sizes.items() if len(own) > 1] or list(sizes)
    methods = list(dict.fromkeys(row["method"] for row in rows))
    across = min(_ACROSS, len(panels))
    down = math.ceil(len(panels) / across)
    height = 0.85 + down * (_HIGH + 0.75)
    figure = new_page(height)
    episodes = sorted({row["episodes"] for row in rows})
    count = f"{episodes[0]:,}" if len(episodes) == 1 else f"{episodes[0]:,} to {episodes[-1]:,}"
    draw_head(figure, "Valid patterns by method", f"{count} starts a point, the same for all; 95% Wilson intervals")
    wide = (10 - 2 * LEFT - 0.45 * across) / across - 0.15
    for place, panel in enumerate(panels):
        row, column = divmod(place, across)
        left = LEFT + 0.45 + column * (wide + 0.6)
        ax = add_axes(figure, left, 0.75 + (down - 1 - row) * (_HIGH + 0.75), wide, _HIGH)
        style_axes(ax, panel, "robots", "valid, %" if column == 0 else "", pad=6)
        _draw_panel(ax, [one for one in rows if _panel(one) == panel], methods)
    keys = [_key(place, method) for place, method in enumerate(methods)]
    figure.legend(
        handles=keys, loc="lower center", ncols=len(keys), fontsize=TEXT, frameon=False, bbox_to_anchor=(0.5, 0.0)
    )
    return figure


def failures_figure(rows: Sequence[Row], radius: float, scan_radius: Mapping[int, float]) -> Figure:
    """Draws the worst failures of every cell that has any, how they ended: who could not see whom.

    Args:
        rows: Of comparison.json.
        radius: The paper's R_bot, world units.
        scan_radius: The paper's R_scan by swarm size, world units.

    Returns:
        A figure 10 inches wide.

    Raises:
        InputError: No row has a failure.
    """
    failed = [(row, one) for row in rows for one in row["worst"]]
    if len(failed) > MANY:
        failed = [(row, row["worst"][0]) for row in rows if row["worst"]]
    if not failed:
        raise InputError("rows", len(rows), "some that have failures")
    across, side = 5, 1.7
    down = math.ceil(len(failed) / across)
    figure = new_page(0.55 + down * (side + 0.55))
    draw_head(
        figure, "The worst failures", "lines: sight is blocked; orange outline: a collision, or outside the world"
    )
    for place, (row, one) in enumerate(failed):
        line, column = divmod(place, across)
        ax = add_axes(figure, LEFT + column * (side + 0.2), 0.1 + (down - 1 - line) * (side + 0.55), side, side)
        _draw_failure(ax, np.array(one["positions"], float), radius, scan_radius[row["robots"]], one["free"])
        ax.set_title(f"{row['method']}, N = {row['robots']}", fontsize=TEXT, color=INK, pad=14)
        ax.text(0.5, 1.02, _panel(row), transform=ax.transAxes, ha="center", fontsize=TEXT - 1.5, color=MUTED)
    return figure


def _panel(row: Row) -> str:
    start = "" if row["start"] == "random" else f", {row['start']}"
    return f"{row['sensing']} sight, {row['scheduler']}{start}"


def _check(rows: Sequence[Row]) -> None:
    if not rows:
        raise InputError("rows", list(rows), "at least one")


def _key(place: int, method: str) -> Line2D:
    return Line2D(
        [], [], color=_COLORS[place % len(_COLORS)], marker=_MARKERS[place % len(_MARKERS)], label=method, ms=4.5
    )


def _draw_panel(ax: Axes, rows: Sequence[Row], methods: Sequence[str]) -> None:
    sizes = sorted({row["robots"] for row in rows})
    places = {robots: place for place, robots in enumerate(sizes)}
    here = [method for method in methods if any(row["method"] == method for row in rows)]
    for place, method in enumerate(methods):
        own = sorted((row for row in rows if row["method"] == method), key=lambda row: row["robots"])
        if not own:
            continue
        x = np.array([places[row["robots"]] for row in own]) + 0.06 * (here.index(method) - (len(here) - 1) / 2)
        share = np.array([100 * row["valid"] / row["episodes"] for row in own])
        low, high = 100 * np.array([row["interval"] for row in own]).T
        color = _COLORS[place % len(_COLORS)]
        ax.errorbar(
            x,
            share,
            yerr=np.abs([share - low, high - share]),
            color=color,
            marker=_MARKERS[place % len(_MARKERS)],
            markersize=4,
            linewidth=1.6 if place == 0 else 1.0,
            elinewidth=0.8,
            zorder=4 if place == 0 else 3,
        )
    ax.set_ylim(-4, 104)
    ax.set_xlim(-0.5, len(sizes) - 0.5)
    # Where there is no room for every number, every other one, the last among them.
    apart = -(-len(sizes) // MOST_NUMBERS)
    named = [str(robots) if (len(sizes) - 1 - place) % apart == 0 else "" for place, robots in enumerate(sizes)]
    ax.set_xticks(range(len(sizes)), named)


def _draw_failure(ax: Axes, points: np.ndarray, radius: float, scan_radius: float, free: bool) -> None:
    _, seen = neighbors_and_visible(points, radius, scan_radius)
    for first, second in zip(*np.nonzero(~seen & ~np.eye(len(points), dtype=bool)), strict=True):
        ax.plot(*points[[first, second]].T, color=WARNING, linewidth=0.5, zorder=1)
    # Swarms are drawn as large as their panel; robots no smaller than can be seen.
    extent = max(np.ptp(points, axis=0).max(), 4 * radius)
    for point in points:
        ax.add_patch(Circle(tuple(point), max(radius, extent / 90), facecolor=ROBOT, edgecolor="none", zorder=2))
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    half = extent / 2 + 3 * radius
    ax.set_xlim(middle[0] - half, middle[0] + half)
    ax.set_ylim(middle[1] - half, middle[1] + half)
    ax.set_aspect("equal")
    ax.set_xticks([])
    ax.set_yticks([])
    for spine in ax.spines.values():
        spine.set_visible(True)
        spine.set_color(FAINT if free else "#E69F00")
        spine.set_linewidth(0.8 if free else 1.6)
