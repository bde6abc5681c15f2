"""Draws the cost of a step against the number of robots, and speed against the number of worlds, from the JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullLocator

from benchmarks import peers
from benchmarks.cases import SENSING, SIZED, STEP
from benchmarks.report import step_seconds
from murmurate.plots.style import (
    INK,
    LEFT,
    MUTED,
    TEXT,
    add_axes,
    add_legend,
    draw_head,
    new_page,
    policy_color,
    style_axes,
)

__all__ = ["figure"]

_CURVES = {STEP: ("world step, all signals", policy_color(0), "o"), SENSING: ("who sees whom", policy_color(3), "s")}
_PEERS = {peers.JAXMARL: ("JaxMARL simple spread", policy_color(2), "^"), peers.VMAS: ("VMAS dispersion", MUTED, "D")}
_SHOWN = (4, 10, 32, 64)
_UNITS = ((1, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns"))


def figure(data: Mapping[str, Any]) -> Figure:
    """Draws both panels.

    Args:
        data: What was measured, as the JSON has it.

    Returns:
        A figure 10 inches wide.
    """
    machine = data["machine"]
    page = new_page(4.75)
    draw_head(page, "Cost of a step", machine["device"] or f"{machine['processor']}, {machine['cores']} cores")
    left = add_axes(page, LEFT + 0.6, 0.5, 5.0, 3.45)
    style_axes(left, "One step of one world, in the largest batch timed", "robots N", "time", pad=8)
    _draw_costs(left, data)
    right = add_axes(page, LEFT + 6.5, 0.5, 2.95, 3.45)
    style_axes(right, "Speed and worlds side by side", "worlds", "world steps a second", pad=8)
    _draw_speeds(right, data["cases"])
    return page


def _draw_costs(ax: Axes, data: Mapping[str, Any]) -> None:
    """Draws every curve's points, and over each range the straight line that fits best."""
    _logarithmic(ax)
    keys, values = [], []
    for name, (label, color, marker) in _CURVES.items():
        robots, seconds = step_seconds(data["cases"], name)
        ax.plot(robots, seconds, linestyle="none", color=color, marker=marker, markersize=5.5, zorder=3)
        values += seconds
        fits = [fit for fit in data["fits"] if fit["name"] == name]
        for fit in fits:
            _draw_fit(ax, robots, seconds, fit, color)
        powers = "".join(f"\n  N = {fit['low']:,} to {fit['high']:,}: $N^{{{fit['exponent']:.2f}}}$" for fit in fits)
        keys.append(Line2D([], [], color=color, marker=marker, markersize=5.5, linewidth=1.0, label=label + powers))
    sizes = sorted({row["robots"] for row in data["cases"] if row["part"] == SIZED})
    ax.set_xticks(sizes, [f"{size:,}" for size in sizes])
    ax.set_xlim(sizes[0] / 1.25, sizes[-1] * 1.25)
    ax.set_ylim(min(values) / 2, max(values) * 2)
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: _duration(value)))
    add_legend(ax, keys, loc="upper left", framealpha=0.85)


def _draw_fit(ax: Axes, robots: Sequence[int], seconds: Sequence[float], fit: Mapping[str, Any], color: str) -> None:
    """Draws a line of the fitted power through the middle of its points."""
    inside = [index for index, size in enumerate(robots) if fit["low"] <= size <= fit["high"]]
    middle = np.log(np.take(robots, inside)).mean(), np.log(np.take(seconds, inside)).mean()
    ends = np.array([fit["low"], fit["high"]], float)
    ax.plot(ends, np.exp(middle[1] + fit["exponent"] * (np.log(ends) - middle[0])), color=color, linewidth=1.0)


def _draw_speeds(ax: Axes, cases: Sequence[Mapping[str, Any]]) -> None:
    """Draws steps a second against the batch, for some swarm sizes, and other projects beside them."""
    _logarithmic(ax)
    keys = []
    stepping = [row for row in cases if (row["part"], row["name"]) == (SIZED, STEP)]
    sizes = [size for size in _SHOWN if size in {row["robots"] for row in stepping}]
    for index, size in enumerate(sizes):
        rows = [row for row in stepping if row["robots"] == size]
        # The same hue, the lighter the larger: ten robots, which the other projects have as well, are drawn boldest.
        style: dict[str, Any] = {"color": policy_color(0), "alpha": 1.0 if size == peers.AGENTS else 0.85 - 0.2 * index}
        xs, ys = ([row[name] for row in rows] for name in ("worlds", "per_second"))
        ax.plot(xs, ys, marker="o", markersize=4, linewidth=1.8 if size == peers.AGENTS else 1.0, **style)
        ax.annotate(f"N = {size}", (xs[-1], ys[-1]), (6, 0), textcoords="offset points", fontsize=TEXT, va="center")
    for name, (label, color, marker) in _PEERS.items():
        rows = [row for row in cases if row["name"] == name]
        if rows:
            points = [row["worlds"] for row in rows], [row["per_second"] for row in rows]
            ax.plot(*points, color=color, marker=marker, markersize=5, linewidth=1.0)
            keys.append(
                Line2D([], [], color=color, marker=marker, markersize=5, linewidth=1.0, label=f"{label}, N = 10")
            )
    for text in ax.texts:
        text.set_color(INK)
    worlds = sorted({row["worlds"] for row in stepping if row["robots"] in sizes})
    ax.set_xticks(worlds, [f"{count:,}" for count in worlds])
    # Room at the right for what the curves are of.
    ax.set_xlim(worlds[0] / 1.4, worlds[-1] * 4.5)
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: _count(value)))
    # And room below for the legend.
    ax.set_ylim(min(row["per_second"] for row in stepping if row["robots"] in sizes) / 12)
    if keys:
        add_legend(ax, keys, loc="lower right", framealpha=0.85)


def _logarithmic(ax: Axes) -> None:
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.xaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_minor_locator(NullLocator())


def _duration(seconds: float) -> str:
    scale, unit = next(((scale, unit) for scale, unit in _UNITS if seconds >= 0.999 * scale), _UNITS[-1])
    return f"{seconds / scale:.3g} {unit}"


def _count(value: float) -> str:
    return f"{value / 1e6:g} M" if value >= 1e6 else f"{value / 1e3:g} k" if value >= 1e3 else f"{value:g}"
