"""How the steps of formation grow with the swarm: measured, bounded from below, and beside the paper's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from murmurate.errors import InputError, check_number
from murmurate.plots.page import LEFT, TEXT, add_axes, add_legend, draw_head, new_page, spread, style_axes
from murmurate.plots.palette import INK, MUTED

__all__ = ["Growth", "PaperPoint", "growth_figure"]

_STARTS = {"distributed": ("#0072B2", "s"), "scattered": ("#E69F00", "o"), "packed": ("#CC79A7", "^")}
_OTHER = (MUTED, "D")
_BOUND = (0, (4, 2))
_HALO = [withStroke(linewidth=2.5, foreground="white")]  # round labels that lines may cross


@dataclass(frozen=True)
class Growth:
    """Mean formation steps of swarms of several sizes, all from one kind of start; sequences of equal length.

    Attributes:
        start: The kind of start, such as "distributed".
        robots: Swarm sizes.
        steps: Mean formation steps.
        bound: Mean kinematic bound, steps.
        valid: Fraction of the episodes that ended in a valid pattern.
    """

    start: str
    robots: Sequence[int]
    steps: Sequence[float]
    bound: Sequence[float]
    valid: Sequence[float]


@dataclass(frozen=True)
class PaperPoint:
    """Mean formation steps that the paper prints.

    Attributes:
        label: The experiment's name.
        robots: Its swarm size.
        steps: Its total steps.
        start: Its kind of start.
    """

    label: str
    robots: int
    steps: float
    start: str


def growth_figure(growths: Sequence[Growth], paper: Sequence[PaperPoint] = ()) -> Figure:
    """Draws formation steps against swarm size, with the straight lines that fit best and the kinematic bounds.

    The paper's points lie many times higher: they have axes of their own, logarithmic, with ours drawn again.

    Args:
        growths: What was measured, one for each kind of start.
        paper: What the paper prints; no second axes where empty.

    Returns:
        A figure 10 inches wide.

    Raises:
        InputError: Nothing was measured, or numbers are missing, not finite or not positive.
    """
    _check(growths, paper)
    figure = new_page(4.6)
    draw_head(figure, "Formation steps and swarm size", "means over fresh starts; straight lines by least squares")
    left, wide, gap, narrow = LEFT + 0.55, 4.95, 0.75, 3.25
    ax = add_axes(figure, left, 0.5, wide if paper else wide + gap + narrow, 3.2)
    style_axes(ax, "Measured", "robots", "steps", pad=8)
    for growth in growths:
        _draw_growth(ax, growth)
    _show_sizes(ax, growths)
    # Room for the legend above all points.
    ax.set_ylim(0, 1.4 * max(max(growth.steps) for growth in growths))
    add_legend(ax, _keys(growths), loc="upper left", framealpha=0.85)
    if paper:
        ax = add_axes(figure, left + wide + gap, 0.5, narrow, 3.2)
        style_axes(ax, "Beside the paper's Table IV", "robots", "steps", pad=8)
        _draw_paper(ax, growths, paper)
    return figure


def _check(growths: Sequence[Growth], paper: Sequence[PaperPoint]) -> None:
    if not growths:
        raise InputError("growths", list(growths), "at least one")
    for growth in growths:
        columns = (growth.robots, growth.steps, growth.bound, growth.valid)
        if len({len(column) for column in columns}) != 1 or not len(growth.robots):
            raise InputError("growth", growth, "of at least one swarm size, each with steps, bound and valid fraction")
        for steps, bound, valid in zip(*columns[1:], strict=True):
            check_number("steps", steps, 0, exclusive_low=True)
            check_number("bound", bound, 0)
            check_number("valid", valid, 0, 1)
    for swarm in (*growths, *paper):
        for size in np.atleast_1d(swarm.robots):
            check_number("robots", size, 1, integer=True)
    for point in paper:
        check_number("steps", point.steps, 0, exclusive_low=True)


def _style(start: str) -> tuple[str, str]:
    return _STARTS.get(start, _OTHER)


def _fit(growth: Growth) -> tuple[float, float, float]:
    """Returns slope, intercept and R^2 of the straight line that fits best by least squares."""
    x, y = np.asarray(growth.robots, dtype=float), np.asarray(growth.steps, dtype=float)
    dx, dy = x - x.mean(), y - y.mean()
    slope = float(dx @ dy / (dx @ dx))
    whole = float(dy @ dy)
    left_over = float(((dy - slope * dx) ** 2).sum())
    return slope, float(y.mean() - slope * x.mean()), 1 - left_over / whole if whole > 0 else 1.0


def _draw_growth(ax: Axes, growth: Growth) -> None:
    """Draws one start's points, hollow where not all episodes ended in a valid pattern, its line and its bound."""
    color, marker = _style(growth.start)
    order = np.argsort(growth.robots)
    ax.plot(np.take(growth.robots, order), np.take(growth.bound, order), color=color, linewidth=1.1, linestyle=_BOUND)
    if len(set(growth.robots)) > 1:
        ends = np.array([min(growth.robots), max(growth.robots)])
        slope, intercept, _ = _fit(growth)
        ax.plot(ends, intercept + slope * ends, color=color, linewidth=1.0, alpha=0.7)
    for size, steps, valid in zip(growth.robots, growth.steps, growth.valid, strict=True):
        point: dict[str, Any] = {"marker": marker, "markersize": 6.5, "color": color, "markeredgewidth": 1.5}
        ax.plot(size, steps, markerfacecolor=color if valid == 1 else "white", zorder=3, **point)
        if valid < 1:
            offset: dict[str, Any] = {"xytext": (0, 6), "textcoords": "offset points", "ha": "center", "va": "bottom"}
            ax.annotate(f"{100 * valid:.3g}%", (size, steps), fontsize=TEXT, color=MUTED, path_effects=_HALO, **offset)


def _keys(growths: Sequence[Growth]) -> list[Line2D]:
    keys = []
    for growth in growths:
        color, marker = _style(growth.start)
        label = growth.start
        if len(set(growth.robots)) > 1:
            slope, _, determination = _fit(growth)
            label += f": {slope:+.1f} steps a robot, R² = {determination:.2f}"
        keys.append(Line2D([], [], color=color, marker=marker, markersize=6, linewidth=1.0, label=label))
    keys.append(Line2D([], [], color=MUTED, linewidth=1.1, linestyle=_BOUND, label="kinematic bound"))
    if any(valid < 1 for growth in growths for valid in growth.valid):
        hollow = {"marker": "o", "markersize": 6, "markerfacecolor": "white", "markeredgewidth": 1.5}
        keys.append(
            Line2D([], [], color=MUTED, linestyle="none", label="not always valid: the valid fraction", **hollow)
        )
    return keys


def _show_sizes(ax: Axes, swarms: Sequence[Growth | PaperPoint]) -> None:
    sizes = np.concatenate([np.atleast_1d(swarm.robots) for swarm in swarms])
    ax.set_xlim(sizes.min() - 0.5, sizes.max() + 0.5)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_paper(ax: Axes, growths: Sequence[Growth], paper: Sequence[PaperPoint]) -> None:
    """Draws the paper's points over ours on a logarithmic scale."""
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    ax.minorticks_off()
    for growth in growths:
        color, marker = _style(growth.start)
        ax.plot(growth.robots, growth.steps, color=color, marker=marker, markersize=3.5, linewidth=1.0)
    for point in paper:
        color, marker = _style(point.start)
        ax.plot(point.robots, point.steps, color=color, marker=marker, markersize=7, markeredgecolor="white")
    _show_sizes(ax, [*growths, *paper])
    values = [*(point.steps for point in paper), *(steps for growth in growths for steps in growth.steps)]
    ax.set_ylim(min(values) / 1.6, max(values) * 4)
    _label_paper(ax, growths, paper)
    keys = []
    for start in dict.fromkeys(swarm.start for swarm in (*growths, *paper)):
        color, marker = _style(start)
        keys.append(Line2D([], [], color=color, marker=marker, linestyle="none", label=start))
    keys.append(Line2D([], [], color=MUTED, marker=".", linewidth=1.0, label="measured"))
    add_legend(ax, keys, loc="upper left", framealpha=0.0, ncols=2, columnspacing=1.0)


def _label_paper(ax: Axes, growths: Sequence[Growth], paper: Sequence[PaperPoint]) -> None:
    """Names the paper's points, and says how many times our steps each is; labels of one size keep apart."""
    ours = {(g.start, size): steps for g in growths for size, steps in zip(g.robots, g.steps, strict=True)}
    height = ax.get_window_extent().height / ax.figure.dpi
    for size in sorted({point.robots for point in paper}):
        points = sorted((point for point in paper if point.robots == size), key=lambda point: point.steps)
        places = [ax.transAxes.inverted().transform(ax.transData.transform((size, point.steps))) for point in points]
        levels = spread([place[1] for place in places], [0.15 / height] * len(points), gap=0.0)
        left = size > np.mean(ax.get_xlim())
        for point, place, level in zip(points, places, levels, strict=True):
            label = point.label
            if (point.start, size) in ours:
                label += f": {point.steps / ours[point.start, size]:.0f} times ours"
            x = place[0] + (-0.035 if left else 0.035)
            style: dict[str, Any] = {"ha": "right" if left else "left", "va": "center", "parse_math": False}
            ax.text(x, level, label, transform=ax.transAxes, fontsize=TEXT, color=INK, path_effects=_HALO, **style)
