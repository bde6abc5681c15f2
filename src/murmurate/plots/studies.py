"""Figures of many runs: their patterns side by side, growth with the swarm's size, and method against method."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import ScaledTranslation

from murmurate.analysis.measures import fit_line
from murmurate.errors import InputError, check_all, check_number, check_type, printable
from murmurate.plots.recording import Recording
from murmurate.plots.run import describe_goal, describe_sight, describe_swarm, draw_pattern, pattern_window
from murmurate.plots.style import (
    HEAD,
    INK,
    LEFT,
    MUTED,
    TEXT,
    WARNING,
    WIDTH,
    add_axes,
    add_legend,
    draw_head,
    new_page,
    policy_color,
    separate_labels,
    style_axes,
)
from murmurate.plots.swarm import SwarmArtist, draw_paths, draw_robots, draw_world, show_window, world_half_side
from murmurate.representation import short_repr
from murmurate.world import WorldConfig

__all__ = ["Growth", "PaperPoint", "comparison_figure", "failures_figure", "growth_figure", "patterns_figure"]


# The patterns of several runs


def patterns_figure(
    recordings: Sequence[Recording], labels: Sequence[str], notes: Sequence[str] | None = None
) -> Figure:
    """Draws the final patterns of several runs side by side, each to its own scale, its start beside its name.

    Args:
        recordings: The runs; of each, its typical episode is drawn.
        labels: What to call them.
        notes: What else tells them apart, such as fields that differ; empty where nothing does.

    Returns:
        A figure 10 inches wide: one row of up to three runs, two or more rows of up to four.

    Raises:
        InputError: There are no runs, or not as many labels as runs.
    """
    check_all("recordings", recordings, Recording, "a list of recordings, such as plots.Recording.open(folder)")
    check_type("labels", labels, Sequence, "a list of names")
    if not recordings or len(recordings) != len(labels):
        raise InputError("labels", list(labels), f"one for each of at least one run (runs: {len(recordings)})")
    # Names and counts of narrower panels would be cut.
    rows = 1 if len(recordings) <= 3 else max(2, -(-len(recordings) // 4))
    columns = -(-len(recordings) // rows)
    notes = notes or [""] * len(labels)
    gap, head, foot = 0.3, 0.72, 0.48 if any(notes) else 0.3
    side = min(3.0, (WIDTH - 0.3 - (columns - 1) * gap) / columns)
    left = (WIDTH - columns * side - (columns - 1) * gap) / 2
    height = head + side + foot
    figure = new_page(rows * height + 0.1)
    for index, (recording, label, note) in enumerate(zip(recordings, labels, notes, strict=True)):
        row, column = divmod(index, columns)
        corner = left + column * (side + gap), (rows - 1 - row) * height + foot
        _draw_final_pattern(figure, recording, label, note, corner, side)
    return figure


def _draw_final_pattern(
    figure: Figure, recording: Recording, label: str, note: str, corner: tuple[float, float], side: float
) -> None:
    """Draws one run's final pattern, its name above, and its start small beside the name."""
    episode, world = recording.episode(), recording.experiment.world
    final = episode.positions[-1]
    ax = add_axes(figure, *corner, side, side)
    draw_pattern(ax, recording, episode, episode.steps, pattern_window(recording, final))
    small, half = 0.58, world_half_side(world, episode.positions)
    inset = add_axes(figure, corner[0] + side - small, corner[1] + side + 0.07, small, small)
    show_window(inset, np.zeros(2), half)
    inset.set_frame_on(False)
    draw_world(inset, world, clip=False, width=0.7)
    draw_paths(inset, episode.positions, episode.policies, oldest=0.35, width=0.6)
    draw_robots(inset, episode.positions[0], max(world.radius, 0.05 * half), linewidth=0).set_clip_on(False)
    sight, complete = describe_sight(recording, final)

    def write(inches: float, text: str, **style: Any) -> Text:
        style = {"fontsize": TEXT, "color": MUTED, "parse_math": False} | style
        return ax.text(style.pop("x", 0), 1 + inches / side, text, transform=ax.transAxes, **style)

    def fit(text: Text, right: float) -> float:
        """Cuts a text in the middle until it ends left of a place; returns where it ends, both in panel widths."""
        full = text.get_text()
        length = len(full)
        while (end := (text.get_window_extent().x1 - ax.bbox.x0) / ax.bbox.width) > right and length > 3:
            length -= 1
            text.set_text(f"{full[: length // 2]}…{full[len(full) - (length - length // 2) :]}")
        return end

    room = 1 - (small + 0.05) / side
    end = fit(write(0.47, label, fontsize=HEAD, fontweight="bold", color=INK), room)
    goal = write(0.47, describe_goal(recording), x=end + 0.03)
    if goal.get_window_extent().x1 > ax.bbox.x0 + room * ax.bbox.width:
        goal.remove()
    fit(write(0.27, describe_swarm(recording)), room)
    fit(write(0.09, sight, color=MUTED if complete else WARNING), room)
    write(-side - 0.105, f"{episode.steps} steps", x=1, ha="right", va="center")
    fit(write(-side - 0.285, note, va="center"), 1.0)


# Growth with the swarm's size


_STARTS = {"distributed": ("#0072B2", "s"), "scattered": ("#E69F00", "o"), "packed": ("#CC79A7", "^")}
_OTHER_START = (MUTED, "D")
_DASHED = (0, (4, 2))
_HALO = [withStroke(linewidth=2.5, foreground="white")]  # around labels that lines may cross


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

    __repr__ = short_repr


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

    __repr__ = short_repr


def growth_figure(growths: Sequence[Growth], paper: Sequence[PaperPoint] = ()) -> Figure:
    """Draws formation steps against swarm size, with straight lines by least squares and the kinematic bounds.

    The paper's points lie many times higher: they have logarithmic axes of their own, beside the measured ones.

    Args:
        growths: What was measured, one for each kind of start.
        paper: What the paper prints; no second axes where empty.

    Returns:
        A figure 10 inches wide.

    Raises:
        InputError: Nothing was measured, or numbers are missing, not finite or not positive.
    """
    _check_growths(growths, paper)
    figure = new_page(4.6)
    draw_head(figure, "Formation steps and swarm size", "means over fresh starts; straight lines by least squares")
    left, wide, gap, narrow = LEFT + 0.55, 4.95, 0.75, 3.25
    ax = add_axes(figure, left, 0.5, wide if paper else wide + gap + narrow, 3.2)
    style_axes(ax, "Measured", "robots", "steps", pad=8)
    handles = [_draw_growth(ax, growth) for growth in growths]
    handles.append(Line2D([], [], color=MUTED, linewidth=1.1, linestyle=_DASHED, label="kinematic bound"))
    if any(valid < 1 for growth in growths for valid in growth.valid):
        hollow: dict[str, Any] = {"marker": "o", "markersize": 6, "markerfacecolor": "white", "markeredgewidth": 1.5}
        label = "not always valid: the valid fraction"
        handles.append(Line2D([], [], color=MUTED, linestyle="none", label=label, **hollow))
    _show_sizes(ax, growths)
    ax.set_ylim(0, 1.4 * max(max(growth.steps) for growth in growths))  # room for the legend above all points
    add_legend(ax, handles, loc="upper left", framealpha=0.85)
    if paper:
        ax = add_axes(figure, left + wide + gap, 0.5, narrow, 3.2)
        style_axes(ax, "Beside the paper's Table IV", "robots", "steps", pad=8)
        _draw_paper(ax, growths, paper)
    return figure


def _check_growths(growths: Sequence[Growth], paper: Sequence[PaperPoint]) -> None:
    check_all("growths", growths, Growth, "a list of Growth")
    check_all("paper", paper, PaperPoint, "a list of PaperPoint")
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


def _draw_growth(ax: Axes, growth: Growth) -> Line2D:
    """Draws the points of one kind of start, hollow where some episodes failed, its line and bound; returns its key."""
    color, marker = _STARTS.get(growth.start, _OTHER_START)
    order = np.argsort(growth.robots)
    ax.plot(np.take(growth.robots, order), np.take(growth.bound, order), color=color, linewidth=1.1, linestyle=_DASHED)
    label, line = growth.start, fit_line(growth.robots, growth.steps)
    if line is not None:
        ends = np.array([min(growth.robots), max(growth.robots)])
        ax.plot(ends, line.intercept + line.slope * ends, color=color, linewidth=1.0, alpha=0.7)
        label += f": {line.slope:+.1f} steps a robot, R² = {line.r_squared:.2f}"
    for size, steps, valid in zip(growth.robots, growth.steps, growth.valid, strict=True):
        point: dict[str, Any] = {"marker": marker, "markersize": 6.5, "color": color, "markeredgewidth": 1.5}
        ax.plot(size, steps, markerfacecolor=color if valid == 1 else "white", zorder=3, **point)
        if valid < 1:
            offset: dict[str, Any] = {"xytext": (0, 6), "textcoords": "offset points", "ha": "center", "va": "bottom"}
            ax.annotate(f"{100 * valid:.3g}%", (size, steps), fontsize=TEXT, color=MUTED, path_effects=_HALO, **offset)
    return Line2D([], [], color=color, marker=marker, markersize=6, linewidth=1.0, label=label)


def _show_sizes(ax: Axes, swarms: Sequence[Growth | PaperPoint]) -> None:
    sizes = np.concatenate([np.atleast_1d(swarm.robots) for swarm in swarms])
    ax.set_xlim(sizes.min() - 0.5, sizes.max() + 0.5)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_paper(ax: Axes, growths: Sequence[Growth], paper: Sequence[PaperPoint]) -> None:
    """Draws the paper's points and the measured ones on a logarithmic scale, and the ratio of the two."""
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    ax.minorticks_off()
    for growth in growths:
        color, marker = _STARTS.get(growth.start, _OTHER_START)
        ax.plot(growth.robots, growth.steps, color=color, marker=marker, markersize=3.5, linewidth=1.0)
    for point in paper:
        color, marker = _STARTS.get(point.start, _OTHER_START)
        ax.plot(point.robots, point.steps, color=color, marker=marker, markersize=7, markeredgecolor="white")
    _show_sizes(ax, [*growths, *paper])
    values = [*(point.steps for point in paper), *(steps for growth in growths for steps in growth.steps)]
    ax.set_ylim(min(values) / 1.6, max(values) * 4)
    measured = {(g.start, size): steps for g in growths for size, steps in zip(g.robots, g.steps, strict=True)}
    height = ax.get_window_extent().height / ax.figure.dpi
    for size in sorted({point.robots for point in paper}):
        points = sorted((point for point in paper if point.robots == size), key=lambda point: point.steps)
        anchors = [ax.transAxes.inverted().transform(ax.transData.transform((size, point.steps))) for point in points]
        levels = separate_labels([anchor[1] for anchor in anchors], [0.15 / height] * len(points), gap=0.0)
        left = size > np.mean(ax.get_xlim())
        for point, anchor, level in zip(points, anchors, levels, strict=True):
            label = point.label
            if (point.start, size) in measured:
                label += f": {point.steps / measured[point.start, size]:.0f} times ours"
            x = anchor[0] + (-0.035 if left else 0.035)
            style: dict[str, Any] = {"ha": "right" if left else "left", "va": "center", "parse_math": False}
            ax.text(x, level, label, transform=ax.transAxes, fontsize=TEXT, color=INK, path_effects=_HALO, **style)
    handles = []
    for start in dict.fromkeys(swarm.start for swarm in (*growths, *paper)):
        color, marker = _STARTS.get(start, _OTHER_START)
        handles.append(Line2D([], [], color=color, marker=marker, linestyle="none", label=start))
    handles.append(Line2D([], [], color=MUTED, marker=".", linewidth=1.0, label="measured"))
    add_legend(ax, handles, loc="upper left", framealpha=0.0, ncols=2, columnspacing=1.0)


# Method against method


Row = Mapping[str, Any]

_MARKERS = "osD^vPX"
_METHOD_COLORS = (INK, *(policy_color(index) for index in range(5)), WARNING, MUTED)
MARKER = 4
DODGE = 2 * MARKER
"""Size of a marker, and width over which methods at the same place are spread, points: half of it on either side."""
MAX_FAILURES = 30
"""Where there are more failures than this, only the worst of each condition is drawn."""
MAX_TICKS = 12
"""Number of swarm sizes that a panel has room to name."""


def comparison_figure(rows: Sequence[Row]) -> Figure:
    """Draws the percentage of valid patterns against the swarm size: a panel for each sensing, scheduler and start.

    Args:
        rows: Of comparison.json.

    Returns:
        A figure 10 inches wide.

    Raises:
        InputError: There is no row.
    """
    check_all("rows", rows, Mapping, "a list of rows, such as runs.comparison.sorted_rows(folder)")
    if not rows:
        raise InputError("rows", list(rows), "at least one")
    sizes = {panel: {row["robots"] for row in rows if _condition(row) == panel} for panel in map(_condition, rows)}
    # A single swarm size is better read in the table: such panels are left out where others have several sizes.
    panels = [panel for panel, robots in sizes.items() if len(robots) > 1] or list(sizes)
    methods = list(dict.fromkeys(row["method"] for row in rows))
    looks: dict[str, dict[str, Any]] = {
        method: {"color": _METHOD_COLORS[i % len(_METHOD_COLORS)], "marker": _MARKERS[i % len(_MARKERS)]}
        for i, method in enumerate(methods)
    }
    columns = min(3, len(panels))
    lines, height = math.ceil(len(panels) / columns), 1.9
    figure = new_page(0.85 + lines * (height + 0.75))
    episodes = sorted({row["episodes"] for row in rows})
    count = f"{episodes[0]:,}" if len(episodes) == 1 else f"{episodes[0]:,} to {episodes[-1]:,}"
    draw_head(figure, "Valid patterns by method", f"{count} starts a point, the same for all; 95% Wilson intervals")
    width = (WIDTH - 2 * LEFT - 0.45 * columns) / columns - 0.15
    for index, panel in enumerate(panels):
        line, column = divmod(index, columns)
        bottom = 0.75 + (lines - 1 - line) * (height + 0.75)
        ax = add_axes(figure, LEFT + 0.45 + column * (width + 0.6), bottom, width, height)
        style_axes(ax, panel, "robots", "valid, %" if column == 0 else "", pad=6)
        _draw_methods(ax, [row for row in rows if _condition(row) == panel], looks)
    # Fonts have no control characters.
    handles = [Line2D([], [], markersize=4.5, label=printable(method), **look) for method, look in looks.items()]
    position: dict[str, Any] = {"loc": "lower center", "bbox_to_anchor": (0.5, 0.0), "ncols": len(handles)}
    legend = figure.legend(handles=handles, fontsize=TEXT, labelcolor=INK, frameon=False, **position)
    for text in legend.get_texts():
        text.set_parse_math(False)  # a method is named after its folder, which may hold a $
    return figure


def failures_figure(rows: Sequence[Row], worlds: Mapping[int, WorldConfig]) -> Figure:
    """Draws the worst failures of every condition that has any, as they ended: the pairs whose sight is blocked.

    Args:
        rows: Of comparison.json.
        worlds: The world of each swarm size.

    Returns:
        A figure 10 inches wide.

    Raises:
        InputError: There is no row.
    """
    check_all("rows", rows, Mapping, "a list of rows, such as runs.comparison.sorted_rows(folder)")
    if not rows:
        raise InputError("rows", list(rows), "at least one")
    failures = [(row, failure) for row in rows for failure in row["worst"]]
    if len(failures) > MAX_FAILURES:
        failures = [(row, row["worst"][0]) for row in rows if row["worst"]]
    if not failures:
        figure = new_page(0.55)
        draw_head(figure, "The worst failures", f"none in {sum(row['episodes'] for row in rows):,} episodes")
        return figure
    columns, side = 5, 1.7
    lines = math.ceil(len(failures) / columns)
    figure = new_page(0.55 + lines * (side + 0.55))
    subtitle = "lines: sight is blocked; orange frame: a contact, or a robot outside the world"
    draw_head(figure, "The worst failures", subtitle)
    for index, (row, failure) in enumerate(failures):
        line, column = divmod(index, columns)
        bottom = 0.1 + (lines - 1 - line) * (side + 0.55)
        ax = add_axes(figure, LEFT + column * (side + 0.2), bottom, side, side)
        points, world = np.array(failure["positions"], float), worlds[row["robots"]]
        # Each swarm is drawn as large as its panel, and its robots no smaller than can be seen.
        extent = max(np.ptp(points, axis=0).max(), 4 * world.radius)
        show_window(ax, (points.max(axis=0) + points.min(axis=0)) / 2, extent / 2 + 3 * world.radius)
        SwarmArtist(ax, points, world, weight=0.5, shells=False, clear=False, min_radius=extent / 90)
        if not failure["free"]:
            for spine in ax.spines.values():
                spine.set(color="#E69F00", linewidth=1.6)
        title = f"{printable(row['method'])}, N = {row['robots']}"
        ax.set_title(title, fontsize=TEXT, color=INK, pad=14, parse_math=False)
        ax.text(0.5, 1.02, _condition(row), transform=ax.transAxes, ha="center", fontsize=TEXT - 1.5, color=MUTED)
    return figure


def _condition(row: Row) -> str:
    start = "" if row["start"] == "random" else f", {row['start']}"
    return f"{row['sensing']} sight, {row['scheduler']}{start}"


def _draw_methods(ax: Axes, rows: Sequence[Row], looks: Mapping[str, Mapping[str, Any]]) -> None:
    """Draws one line for each method, shifted by a marker at most so that intervals do not cover each other."""
    sizes = sorted({row["robots"] for row in rows})
    shown = [method for method in looks if any(row["method"] == method for row in rows)]
    for index, method in enumerate(shown):
        points = sorted((row for row in rows if row["method"] == method), key=lambda row: row["robots"])
        x = np.array([sizes.index(row["robots"]) for row in points])
        # In points, not in robots: however many methods there are, each stays over the number that it has.
        aside = DODGE * (index / (len(shown) - 1) - 0.5) if len(shown) > 1 else 0.0
        shift = ScaledTranslation(aside / 72, 0, ax.figure.dpi_scale_trans)
        share = np.array([100 * row["valid"] / row["episodes"] for row in points])
        low, high = 100 * np.array([row["interval"] for row in points]).T
        leading = method == next(iter(looks))
        weight: dict[str, Any] = {"linewidth": 1.6 if leading else 1.0, "zorder": 4 if leading else 3}
        error = np.abs([share - low, high - share])
        style: dict[str, Any] = {"markersize": MARKER, "elinewidth": 0.8, "transform": ax.transData + shift}
        ax.errorbar(x, share, yerr=error, **style, **weight, **looks[method])
    ax.set(xlim=(-0.5, len(sizes) - 0.5), ylim=(-4, 104))
    # Where there is no room for every number, every other one, the last among them.
    stride = -(-len(sizes) // MAX_TICKS)
    labels = [str(robots) if (len(sizes) - 1 - i) % stride == 0 else "" for i, robots in enumerate(sizes)]
    ax.set_xticks(range(len(sizes)), labels)
