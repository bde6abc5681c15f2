"""Signals against time: a whole training, and one episode. Every curve is 1 at its best, so both share one scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from murmurate.view.drawing import FAINT, INK, MUTED, WARNING, policy_color
from murmurate.view.record import Episode, Record

__all__ = ["draw_episode", "draw_training"]

_TEXT = 8.5
_TITLE = 10.0
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
    _style(ax, "Training", "environment steps")
    edges = [0.0]
    for place, curve in enumerate(record.training):
        steps, color = curve.environment_steps, policy_color(place)
        ax.plot(steps, curve.objective / len(record.signal_names), color=color, linewidth=1.6)
        if "visible" in curve.signals:
            ax.plot(steps, curve.signals["visible"], color=color, linewidth=1.1, linestyle=(0, (2, 1)))
        edges.append(float(steps[-1]))
    _limit(ax, edges[-1])
    ax.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    ax.xaxis.set_major_formatter(lambda value, _: _count(value))
    _mark_spans(ax, edges, record.policies, [policy_color(place) for place in range(len(edges) - 1)])
    keys = [
        Line2D([], [], color=INK, linewidth=1.6, label=f"objective / {len(record.signal_names)}"),
        Line2D([], [], color=INK, linewidth=1.1, linestyle=(0, (2, 1)), label="visible"),
    ]
    _legend(ax, keys, loc="lower right", framealpha=0.85)


def draw_episode(ax: Axes, record: Record, episode: Episode) -> None:
    """Draws the objective and each of its signals during one episode, the switches and the rest marked."""
    _style(ax, "One episode", "steps")
    still = max(3, round(0.09 * episode.steps))  # some steps of the rest, in which nothing moves any more

    def held(values: np.ndarray) -> np.ndarray:
        return np.append(values, np.full(still, values[-1]))

    for name, values in episode.signals.items():
        color, dashes = _SIGNALS.get(name, (MUTED, "-"))
        ax.plot(held(values), color=color, linestyle=dashes, linewidth=1.3, label=name)
    label = f"objective / {len(episode.signals)}"
    ax.plot(held(episode.objective / len(episode.signals)), color=INK, linewidth=2.0, label=label)
    end = episode.steps + still
    _limit(ax, end)
    ax.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10], integer=True))
    names = (*record.policies[: len(episode.switches) + 1], episode.outcome)
    colors = [policy_color(place) for place in range(len(names) - 1)]
    _mark_spans(ax, [0, *episode.switches, episode.steps, end], names, [*colors, MUTED])
    # Beside the axes: five curves leave no corner free. In the order in which they end, as far as they differ.
    handles = sorted(ax.get_legend_handles_labels()[0], key=_end, reverse=True)
    _legend(ax, handles, loc="center left", bbox_to_anchor=(1.01, 0.5), framealpha=0.0)


def _style(ax: Axes, title: str, label: str) -> None:
    ax.set_title(title, loc="left", fontsize=_TITLE, fontweight="bold", color=INK, pad=20)
    ax.set_xlabel(label, fontsize=_TEXT, color=MUTED, labelpad=2)
    ax.set_ylabel("signal (best: 1)", fontsize=_TEXT, color=MUTED, labelpad=3)
    ax.tick_params(labelsize=_TEXT, colors=MUTED, length=3, width=0.7)
    ax.grid(axis="y", color=FAINT, linewidth=0.5, alpha=0.7)
    ax.set_axisbelow(True)
    for side, spine in ax.spines.items():
        spine.set(visible=side in ("left", "bottom"), color=FAINT, linewidth=0.8)


def _limit(ax: Axes, end: float) -> None:
    """Shows all curves, and a little above the best value that a signal can have."""
    values = np.concatenate([[0.9], *(np.asarray(line.get_ydata(), dtype=float) for line in ax.lines)])
    low = float(values[np.isfinite(values)].min())
    ax.set_ylim(low - 0.05 * (1.0 - low) - 0.02, 1.03)
    ax.set_xlim(0, max(end, 1))


def _mark_spans(ax: Axes, edges: Sequence[float], names: Sequence[str], colors: Sequence[str]) -> None:
    """Tints the span of each policy, draws a line at each switch, and names the spans above the axes."""
    texts = []
    for start, end, name, color in zip(edges[:-1], edges[1:], names, colors, strict=False):
        ax.axvspan(start, end, color=color, alpha=0.07, linewidth=0, zorder=0)
        if start > 0:
            ax.axvline(start, color=INK, linewidth=0.8, linestyle=(0, (4, 2)), zorder=1)
        place = ax.transAxes.inverted().transform(ax.transData.transform(((start + end) / 2, 0)))[0]
        style = {"fontsize": _TEXT, "color": color, "ha": "center", "va": "bottom", "parse_math": False}
        texts.append(ax.text(place, 1.02, name, transform=ax.transAxes, **style))
    if texts:
        widths = [text.get_window_extent().width / ax.bbox.width for text in texts]
        centers = _spread([text.get_position()[0] for text in texts], widths, gap=0.015)
        for text, center in zip(texts, centers, strict=True):
            text.set_x(center)


def _end(line: Artist) -> float:
    assert isinstance(line, Line2D)
    return round(float(np.asarray(line.get_ydata())[-1]), 2)


def _spread(centers: Sequence[float], widths: Sequence[float], gap: float) -> list[float]:
    """Shifts labels of given widths along a line as little as keeps them apart and, if they fit, within 0..1."""
    lefts, edge = [], 0.0
    for center, width in zip(centers, widths, strict=True):
        lefts.append(max(edge, center - width / 2))
        edge = lefts[-1] + width + gap
    edge = 1.0
    for place in reversed(range(len(lefts))):
        lefts[place] = min(lefts[place], edge - widths[place])
        edge = lefts[place] - gap
    return [left + width / 2 for left, width in zip(lefts, widths, strict=True)]


def _legend(ax: Axes, handles: Sequence[Artist], **place: Any) -> None:
    ax.legend(
        handles=list(handles),
        fontsize=_TEXT,
        labelcolor=INK,
        edgecolor="none",
        facecolor="white",
        borderpad=0.3,
        handlelength=2.0,
        labelspacing=0.4,
        **place,
    )


def _count(value: float) -> str:
    """Writes a number of steps short: 1,500,000 as 1.5 M."""
    for unit, letter in ((1e6, " M"), (1e3, " k")):
        if abs(value) >= unit:
            return f"{value / unit:g}{letter}"
    return f"{value:g}"
