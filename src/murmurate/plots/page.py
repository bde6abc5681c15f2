"""The page that every figure stands on: its width, its sizes of text, its head, and how axes look on it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from murmurate.plots.palette import FAINT, INK, MUTED

__all__ = [
    "HEAD",
    "LEFT",
    "TEXT",
    "TITLE",
    "WIDTH",
    "add_axes",
    "add_legend",
    "draw_head",
    "new_page",
    "spread",
    "style_axes",
]

WIDTH = 10.0
"""Inches; shown 1000 pixels wide, a point is 1.4 pixels."""

LEFT = 0.25
"""Inches left free at both sides."""

TEXT = 8.5
"""Size of plain text, points."""

TITLE = 10.0
"""Size of the title of axes, points."""

HEAD = 13.0
"""Size of the page's own title, points."""


def new_page(height: float) -> Figure:
    """Returns an empty white page, `height` inches high: white of its own, on a dark screen as well."""
    return Figure(figsize=(WIDTH, height), facecolor="white")


def add_axes(figure: Figure, left: float, bottom: float, width: float, height: float, **options: Any) -> Axes:
    """Adds axes at a place given in inches."""
    across, up = figure.get_size_inches()
    return figure.add_axes((left / across, bottom / up, width / across, height / up), **options)


def draw_head(figure: Figure, title: str, subtitle: str = "", remark: str = "") -> None:
    """Writes title and subtitle at the top of the page, on one line, and a remark at its right end."""
    width, height = figure.get_size_inches()
    y = 1 - 0.32 / height
    plain: dict[str, Any] = {"fontsize": TITLE, "parse_math": False}
    name = figure.text(LEFT / width, y, title, fontsize=HEAD, fontweight="bold", color=INK, parse_math=False)
    x = name.get_window_extent().x1 / figure.bbox.width + 0.012
    figure.text(x, y, subtitle, color=MUTED, **plain)
    figure.text(1 - LEFT / width, y, remark, color=INK, ha="right", **plain)


def style_axes(ax: Axes, title: str, across: str, up: str, pad: float = 20) -> None:
    """Gives axes of curves their look: a title at the left, quiet labels, a faint grid, no frame.

    Args:
        ax: The axes.
        title: What they show.
        across: Label of the horizontal axis.
        up: Label of the vertical axis.
        pad: Points between axes and title.
    """
    ax.set_title(title, loc="left", fontsize=TITLE, fontweight="bold", color=INK, pad=pad)
    ax.set_xlabel(across, fontsize=TEXT, color=MUTED, labelpad=2)
    ax.set_ylabel(up, fontsize=TEXT, color=MUTED, labelpad=3)
    ax.tick_params(labelsize=TEXT, colors=MUTED, length=3, width=0.7)
    ax.grid(axis="y", color=FAINT, linewidth=0.5, alpha=0.7)
    ax.set_axisbelow(True)
    for side, spine in ax.spines.items():
        spine.set(visible=side in ("left", "bottom"), color=FAINT, linewidth=0.8)


def add_legend(ax: Axes, handles: Sequence[Artist], **place: Any) -> None:
    """Adds a legend without a frame, its place and opacity as Matplotlib's `legend` takes them."""
    ax.legend(
        handles=list(handles),
        fontsize=TEXT,
        labelcolor=INK,
        edgecolor="none",
        facecolor="white",
        borderpad=0.3,
        handlelength=2.0,
        labelspacing=0.4,
        **place,
    )


def spread(centers: Sequence[float], widths: Sequence[float], gap: float) -> list[float]:
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
