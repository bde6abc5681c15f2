"""A plate of patterns, like a plate of snowflakes: the patterns of a swarm size side by side, all at one scale.

Each lies on a dark disc, on which its sight lines stand out; robots inside the convex hull have another colour.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from murmurate.errors import InputError, check_all, check_number
from murmurate.geometry import on_hull
from murmurate.geometry.similarity import configuration
from murmurate.plots.style import INK, INSIDE, LEFT, MUTED, TEXT, WIDTH, add_axes, draw_head, new_page
from murmurate.plots.swarm import NIGHT, SwarmArtist, sight_pairs
from murmurate.representation import short_repr
from murmurate.world import WorldConfig

__all__ = ["PlatePattern", "plate_figure"]

_HEAD, _FOOT = 0.62, 0.42  # heights, inches
_GAP = 0.18  # between neighbouring discs
_MAX_SIDE = 3.2  # of a disc
_LINE = 0.155  # from one line of text to the next
_MAX_COLUMNS = 8  # leave room for a caption


@dataclass(frozen=True, eq=False)
class PlatePattern:
    """One pattern of a plate.

    It has no `WorldConfig`: the findings of a catalogue and the best-known patterns have none, and a plate draws robots
    and sight alone.

    Attributes:
        positions: Centres, world units; turned as they are to be shown.
        radius: The paper's R_bot, world units.
        scan_radius: The paper's R_scan, world units.
        caption: What to write below.
        note: A second, muted line; none where empty.
    """

    positions: Float[np.ndarray, "robots 2"]
    radius: float
    scan_radius: float
    caption: str
    note: str = ""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        points = configuration(self.positions)
        if len(points) < 2:
            raise InputError("positions", points.shape, "finite numbers of shape (robots, 2), at least two robots")
        check_number("radius", self.radius, 0, exclusive_low=True)

    @property
    def centred(self) -> Float[np.ndarray, "robots 2"]:
        """The positions around their centroid."""
        points = np.asarray(self.positions, dtype=float)
        return points - points.mean(axis=0)

    @property
    def world(self) -> WorldConfig:
        """The robots' own sizes, as `SwarmArtist` takes them; a plate draws nothing that depends on the others."""
        return WorldConfig(
            robots=len(self.positions),
            radius=self.radius,
            scan_radius=self.scan_radius,
            safe_distance=3 * self.radius,
        )


def plate_figure(
    patterns: Sequence[PlatePattern], title: str, subtitle: str = "", columns: int | None = None
) -> Figure:
    """Draws patterns on one plate, row by row in the order given, all robots of the same size.

    Args:
        patterns: What to draw.
        title: What the plate shows.
        subtitle: More about it, muted.
        columns: Patterns in a row, 1 to 8; as many as make a well-shaped plate where None.

    Returns:
        A figure 10 inches wide.

    Raises:
        InputError: There are no patterns, or a plate cannot have so many columns.
    """
    check_all("patterns", patterns, PlatePattern, "a list of PlatePattern")
    if not patterns:
        raise InputError("patterns", list(patterns), "at least one")
    columns = _best_columns(len(patterns)) if columns is None else columns
    check_number("columns", columns, 1, _MAX_COLUMNS, integer=True)
    pitch = (WIDTH - 2 * LEFT + _GAP) / columns
    side = min(pitch - _GAP, _MAX_SIDE)
    text_lines = 2 if any(pattern.note for pattern in patterns) else 1
    row_height = side + (text_lines + 0.4) * _LINE + _GAP
    rows = -(-len(patterns) // columns)
    figure = new_page(_HEAD + rows * row_height - _GAP + _FOOT)
    draw_head(figure, title, subtitle)
    page_height = figure.get_figheight()
    # In radii: the widest pattern, with its robots, reaches nearly to the edge of its disc.
    half = max(np.hypot(*pattern.centred.T).max() / pattern.radius for pattern in patterns) + 2.2
    texts = []
    for index, pattern in enumerate(patterns):
        row, column = divmod(index, columns)
        in_row = min(columns, len(patterns) - row * columns)  # a short last row is centred
        x = WIDTH / 2 + (column - (in_row - 1) / 2) * pitch
        bottom = page_height - _HEAD - row * row_height - side
        _draw_pattern(figure, pattern, (x - side / 2, bottom), side, half * pattern.radius)
        for line, (label, color) in enumerate(((pattern.caption, INK), (pattern.note, MUTED))):
            y = bottom - (0.9 + line) * _LINE
            style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": TEXT, "parse_math": False}
            texts += [figure.text(x / WIDTH, y / page_height, label, color=color, **style)] if label else []
    # All captions in one size: that of plain text, or smaller where one of them would be wider than its column.
    widest = max((text.get_window_extent().width / figure.dpi for text in texts), default=0.0)
    for text in texts:
        text.set_fontsize(TEXT * min(1.0, (pitch - _GAP) / widest))
    figure.text(LEFT / WIDTH, 0.16 / page_height, _explain(patterns), fontsize=TEXT, color=MUTED, va="center")
    return figure


def _best_columns(count: int) -> int:
    """Returns the number of columns that fills the last row best on a plate about 1.6 times as wide as high."""

    def misfit(columns: int) -> float:
        rows = -(-count // columns)
        return abs(math.log(columns / rows / 1.6)) + 1.5 * (rows * columns - count) / columns

    return min(range(1, _MAX_COLUMNS + 1), key=misfit)


def _draw_pattern(figure: Figure, pattern: PlatePattern, corner: tuple[float, float], side: float, half: float) -> None:
    """Draws one pattern on its disc; `half` is half the side of the axes in world units."""
    ax = add_axes(figure, *corner, side, side)
    ax.set(xlim=(-half, half), ylim=(-half, half))
    ax.set_axis_off()
    ax.add_patch(Circle((0, 0), half, facecolor=NIGHT.background, zorder=0.5)).set_clip_on(False)
    points = pattern.centred
    colors = np.where(on_hull(points), NIGHT.robot, INSIDE).tolist()
    # Lines as wide as the robots' size on the page allows.
    weight = 2 * float(np.clip(10 * side / 2 * pattern.radius / half, 0.45, 1.1))
    swarm = SwarmArtist(ax, points, pattern.world, look=NIGHT, colors=colors, weight=weight, shells=False)
    # The longer a line the fainter: many long lines would hide the pattern.
    lengths = np.hypot(*(points[:, None] - points).transpose(2, 0, 1))
    brightness = np.clip(6 * pattern.radius / np.maximum(lengths, pattern.radius), 0.35, 1.0)
    swarm.update(points, brightness * sight_pairs(points, pattern.world)[0])


def _explain(patterns: Sequence[PlatePattern]) -> str:
    """Returns what the colours mean, as far as they occur."""
    text = "Robots to scale; lines join those that see each other"
    if not all(on_hull(np.asarray(pattern.positions, float)).all() for pattern in patterns):
        text += "; orange robots are inside the convex hull"
    if any(sight_pairs(pattern.centred, pattern.world)[1].any() for pattern in patterns):
        text += "; sight is blocked along thick red lines"
    return f"{text}."
