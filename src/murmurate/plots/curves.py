"""Signals against time: a whole training, and one episode. Every curve is 1 at its best, so both share one scale."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from murmurate.plots.page import TEXT, add_legend, spread, style_axes
from murmurate.plots.palette import INK, MUTED, WARNING, policy_color
from murmurate.plots.record import Episode, Record

__all__ = ["draw_episode", "draw_training", "draw_training_signals", "mark_episode", "rest_shown"]

_BEST = "signal (best: 1)"
# Visibility keeps the colour that blocked sight has in the patterns.
_SIGNALS = {
    "close": ("#56B4E9", (0, (5, 1.2))),
    "nclose": ("#56B4E9", (0, (5, 1.2))),
    "safety": ("#CC79A7", (0, (3, 1, 1, 1))),
    "neighbors": ("#B8860B", (0, (1.2, 1))),
    "visible": (WARNING, "-"),
}


def draw_training(ax: Axes, record: Record) -> None:
    """Draws the mean objective and the mean visibility of each policy's rollouts against environment steps."""
    style_axes(ax, "Training", "environment steps", _BEST)
    for place, curve in enumerate(record.training):
        steps, color = curve.environment_steps, policy_color(place)
        ax.plot(steps, curve.objective / len(record.signal_names), color=color, linewidth=1.6)
        if "visible" in curve.signals:
            ax.plot(steps, curve.signals["visible"], color=color, linewidth=1.1, linestyle=(0, (2, 1)))
    _finish_training(ax, record)
    keys = [
        Line2D([], [], color=INK, linewidth=1.6, label=f"objective / {len(record.signal_names)}"),
        Line2D([], [], color=INK, linewidth=1.1, linestyle=(0, (2, 1)), label="visible"),
    ]
    add_legend(ax, keys, loc="lower right", framealpha=0.85)


def draw_training_signals(ax: Axes, record: Record) -> None:
    """Draws the mean of each signal over the rollouts against environment steps, policy after policy."""
    style_axes(ax, "Signals in training", "environment steps", _BEST)
    for place, curve in enumerate(record.training):
        for name, values in curve.signals.items():
            color, dashes = _SIGNALS.get(name, (MUTED, "-"))
            label = name if place == 0 else None
            ax.plot(curve.environment_steps, values, color=color, linestyle=dashes, linewidth=1.3, label=label)
    _finish_training(ax, record)
    handles, _ = ax.get_legend_handles_labels()
    add_legend(ax, handles, loc="lower right", framealpha=0.85)


def draw_episode(ax: Axes, record: Record, episode: Episode) -> None:
    """Draws the objective and each of its signals during one episode, the switches and the rest marked."""
    style_axes(ax, "One episode", "steps", _BEST)
    still = rest_shown(episode)

    def held(values: np.ndarray) -> np.ndarray:
        return np.append(values, np.full(still, values[-1]))

    for name, values in episode.signals.items():
        color, dashes = _SIGNALS.get(name, (MUTED, "-"))
        ax.plot(held(values), color=color, linestyle=dashes, linewidth=1.3, label=name)
    label = f"objective / {len(episode.signals)}"
    ax.plot(held(episode.objective / len(episode.signals)), color=INK, linewidth=2.0, label=label)
    _limit(ax, episode.steps + still)
    mark_episode(ax, record, episode)
    # Beside the axes: five curves leave no corner free. In the order in which they end, as far as they differ.
    handles = sorted(ax.get_legend_handles_labels()[0], key=_end, reverse=True)
    add_legend(ax, handles, loc="center left", bbox_to_anchor=(1.01, 0.5), framealpha=0.0)


def rest_shown(episode: Episode) -> int:
    """Returns how many steps of the rest, in which nothing moves any more, curves of an episode show."""
    return max(3, round(0.09 * episode.steps))


def mark_episode(ax: Axes, record: Record, episode: Episode, *, first: int = 0, named: bool = True) -> None:
    """Marks on axes of steps which policy was in charge when, and the rest after them.

    Args:
        ax: The axes, with their final limits.
        record: The run.
        episode: One of its episodes.
        first: The policy to begin with.
        named: Whether to write the policies' names above the axes.
    """
    ax.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10], integer=True))
    names = (*record.policies[: len(episode.switches) + 1], episode.outcome)
    colors = [*(policy_color(place) for place in range(len(names) - 1)), MUTED]
    edges = [0, *episode.switches, episode.steps, episode.steps + rest_shown(episode)]
    _tint_spans(ax, edges[first:], colors[first:])
    if named:
        _name_spans(ax, edges[first:], names[first:], colors[first:])


def _finish_training(ax: Axes, record: Record) -> None:
    edges = [0.0, *(float(curve.environment_steps[-1]) for curve in record.training)]
    _limit(ax, edges[-1])
    ax.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    ax.xaxis.set_major_formatter(lambda value, _: _count(value))
    colors = [policy_color(place) for place in range(len(edges) - 1)]
    _tint_spans(ax, edges, colors)
    _name_spans(ax, edges, record.policies, colors)


def _limit(ax: Axes, end: float) -> None:
    """Shows all curves, and a little above the best value that a signal can have."""
    values = np.concatenate([[0.9], *(np.asarray(line.get_ydata(), dtype=float) for line in ax.lines)])
    low = float(values[np.isfinite(values)].min())
    ax.set_ylim(1 - 1.06 * (1 - low), 1 + 0.05 * (1 - low))
    ax.set_xlim(0, max(end, 1))


def _tint_spans(ax: Axes, edges: Sequence[float], colors: Sequence[str]) -> None:
    """Tints the span of each policy, and draws a line at each switch."""
    for start, end, color in zip(edges[:-1], edges[1:], colors, strict=True):
        ax.axvspan(start, end, color=color, alpha=0.07, linewidth=0, zorder=0)
        if start > edges[0]:
            ax.axvline(start, color=INK, linewidth=0.8, linestyle=(0, (4, 2)), zorder=1)


def _name_spans(ax: Axes, edges: Sequence[float], names: Sequence[str], colors: Sequence[str]) -> None:
    """Names the spans above the axes, each over its middle as far as they do not collide."""
    texts = []
    for start, end, name, color in zip(edges[:-1], edges[1:], names, colors, strict=False):
        place = ax.transAxes.inverted().transform(ax.transData.transform(((start + end) / 2, 0)))[0]
        style = {"fontsize": TEXT, "color": color, "ha": "center", "va": "bottom", "parse_math": False}
        texts.append(ax.text(place, 1.02, name, transform=ax.transAxes, **style))
    if texts:
        widths = [text.get_window_extent().width / ax.bbox.width for text in texts]
        centers = spread([text.get_position()[0] for text in texts], widths, gap=0.015)
        for text, center in zip(texts, centers, strict=True):
            text.set_x(center)


def _end(line: Artist) -> float:
    assert isinstance(line, Line2D)
    return round(float(np.asarray(line.get_ydata())[-1]), 2)


def _count(value: float) -> str:
    """Writes a number of steps short: 1,500,000 as 1.5 M."""
    for unit, letter in ((1e6, " M"), (1e3, " k")):
        if abs(value) >= unit:
            return f"{value / unit:g}{letter}"
    return f"{value:g}"
