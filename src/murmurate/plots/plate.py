"""A plate of patterns, like a plate of snowflakes: the patterns of a swarm size side by side, all at one scale.

Each lies in a dark field of its own, so that its sight lines shine; robots inside the hull have another colour.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from murmurate.errors import InputError, check_number
from murmurate.plots.drawing import mutual_pairs
from murmurate.plots.page import LEFT, TEXT, WIDTH, add_axes, draw_head, new_page
from murmurate.plots.palette import INK, MUTED, WARNING

__all__ = ["PlatePattern", "plate_figure"]

_HEAD, _FOOT = 0.62, 0.42  # inches
_GAP = 0.18  # between the fields of neighbours
_LARGEST = 3.2  # of the fields
_LINE = 0.155  # from one line of text to the next
_MOST = 8  # columns that leave room for a caption
_ROBOT, _INSIDE, _SIGHT = "#F5F8FB", "#E69F00", "#A9C7E0"


@dataclass(frozen=True, eq=False)
class PlatePattern:
    """One pattern of a plate.

    Attributes:
        positions: Centres, world units; turned as they are to be shown.
        radius: The paper's R_bot, world units.
        scan_radius: The paper's R_scan, world units.
        caption: What to write below.
        note: A second, quieter line; none where empty.
    """

    positions: Float[np.ndarray, "robots 2"]
    radius: float
    scan_radius: float
    caption: str
    note: str = ""


def plate_figure(
    patterns: Sequence[PlatePattern], title: str, subtitle: str = "", columns: int | None = None
) -> Figure:
    """Draws patterns on one plate, row by row in the order given, each robot the same size.

    Args:
        patterns: What to draw.
        title: What the plate shows.
        subtitle: More about it, quieter.
        columns: Patterns in a row, 1 to 8; as many as make a well-shaped plate where None.

    Returns:
        A figure 10 inches wide.

    Raises:
        InputError: There are no patterns, one has no finite positions or no positive radius, or a plate cannot have so
            many columns.
    """
    if not patterns:
        raise InputError("patterns", list(patterns), "at least one")
    if columns is None:
        columns = _well_shaped(len(patterns))
    check_number("columns", columns, 1, _MOST, integer=True)
    shapes = [_centred(pattern) for pattern in patterns]
    pitch = (WIDTH - 2 * LEFT + _GAP) / columns
    field = min(pitch - _GAP, _LARGEST)
    lines = 2 if any(pattern.note for pattern in patterns) else 1
    height = field + (lines + 0.4) * _LINE + _GAP
    rows = -(-len(patterns) // columns)
    figure = new_page(_HEAD + rows * height - _GAP + _FOOT)
    draw_head(figure, title, subtitle)
    ax = add_axes(figure, 0, 0, *figure.get_size_inches())
    ax.set(xlim=(0, WIDTH), ylim=(0, figure.get_figheight()))
    ax.set_axis_off()
    # The widest pattern reaches nearly to the edge of its field.
    scale = field / 2 / max(np.hypot(*shape.T).max() + 2.2 for shape in shapes)
    centers = []
    for place in range(len(patterns)):
        row, column = divmod(place, columns)
        indent = (columns - min(columns, len(patterns) - row * columns)) / 2
        x = WIDTH / 2 + (column + indent - (columns - 1) / 2) * pitch
        centers.append((x, figure.get_figheight() - _HEAD - row * height - field / 2))
    _circles(ax, np.array(centers), field, facecolors=INK, zorder=1)
    for pattern, shape, center in zip(patterns, shapes, centers, strict=True):
        _draw_shape(ax, pattern, shape * scale + center, scale)
    _write_captions(ax, patterns, np.array(centers) - (0, field / 2), pitch - _GAP)
    ax.text(LEFT, 0.16, _key(patterns), fontsize=TEXT, color=MUTED, va="center")
    return figure


def _well_shaped(count: int) -> int:
    """Returns the number of columns that fills the last row best on a plate about 1.6 times as wide as high."""

    def misshape(columns: int) -> float:
        rows = -(-count // columns)
        return abs(math.log(columns / rows / 1.6)) + 1.5 * (rows * columns - count) / columns

    return min(range(1, _MOST + 1), key=misshape)


def _centred(pattern: PlatePattern) -> Float[np.ndarray, "robots 2"]:
    """Returns the positions in radii around the centre of the least circle that holds them (Badoiu and Clarkson)."""
    points = np.asarray(pattern.positions, dtype=float)
    if points.ndim != 2 or points.shape[1:] != (2,) or not len(points) or not np.isfinite(points).all():
        raise InputError("positions", points.shape, "finite numbers of shape (robots, 2)")
    check_number("radius", pattern.radius, 0, exclusive_low=True)
    points = points / pattern.radius
    center = points.mean(axis=0)
    for step in range(2, 1000):
        away = points - center
        center = center + away[np.argmax((away**2).sum(axis=1))] / step
    return points - center


def _inside(points: Float[np.ndarray, "robots 2"]) -> Bool[np.ndarray, " robots"]:
    """Says which robots have others on all sides: those that are not corners of the convex hull."""
    found = np.zeros(len(points), dtype=bool)
    for place, point in enumerate(points):
        others = np.delete(points, place, axis=0) - point
        angles = np.sort(np.arctan2(others[:, 1], others[:, 0]))
        found[place] = len(angles) > 2 and np.diff(angles, append=angles[0] + 2 * np.pi).max() < np.pi - 1e-6
    return found


def _key(patterns: Sequence[PlatePattern]) -> str:
    """Says what is drawn, as far as it is there to be seen."""
    words = "Robots to scale; lines join those that see each other"
    if any(_inside(np.asarray(one.positions, dtype=float)).any() for one in patterns):
        words += "; orange robots are inside the convex hull"
    if any(mutual_pairs(one.positions, one.radius, one.scan_radius)[1].any() for one in patterns):
        words += "; sight is blocked along red lines"
    return f"{words}."


def _circles(ax: Axes, centers: Float[np.ndarray, "circles 2"], diameter: float, **style: Any) -> None:
    sizes = np.full(len(centers), diameter)
    none = np.zeros(len(centers))
    ax.add_collection(
        EllipseCollection(sizes, sizes, none, units="xy", offsets=centers, offset_transform=ax.transData, **style),
        autolim=False,
    )


def _draw_shape(ax: Axes, pattern: PlatePattern, points: Float[np.ndarray, "robots 2"], radius: float) -> None:
    """Draws the robots of one pattern and who sees whom, the shorter a line the brighter."""
    width = float(np.clip(10 * radius, 0.45, 1.1))
    clear, blocked = mutual_pairs(pattern.positions, pattern.radius, pattern.scan_radius)
    segments = points[np.argwhere(clear)]
    lengths = np.hypot(*(segments[:, 1] - segments[:, 0]).T)
    colors = np.tile(to_rgba(_SIGHT), (len(segments), 1))
    colors[:, 3] = np.clip(5 * radius / np.maximum(lengths, radius), 0.3, 0.9)
    style: dict[str, Any] = {"capstyle": "butt", "zorder": 2}
    ax.add_collection(LineCollection(list(segments), colors=colors, linewidths=width, **style), autolim=False)
    crossed = LineCollection(list(points[np.argwhere(blocked)]), colors=WARNING, linewidths=1.5 * width, **style)
    ax.add_collection(crossed, autolim=False)
    colors = np.where(_inside(points), _INSIDE, _ROBOT)
    _circles(ax, points, 2 * radius, facecolors=list(colors), edgecolors=INK, linewidths=0.6 * width, zorder=3)


def _write_captions(ax: Axes, patterns: Sequence[PlatePattern], places: np.ndarray, room: float) -> None:
    """Writes below each field, as large as plain text, or as every line has room."""
    style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": TEXT, "parse_math": False}
    texts = []
    for pattern, (x, y) in zip(patterns, places, strict=True):
        texts.append(ax.text(x, y - 0.9 * _LINE, pattern.caption, color=INK, **style))
        if pattern.note:
            texts.append(ax.text(x, y - 1.9 * _LINE, pattern.note, color=MUTED, **style))
    widest = max(text.get_window_extent().width for text in texts) / ax.figure.dpi
    for text in texts:
        text.set_fontsize(TEXT * min(1.0, room / widest))
