"""How one configuration looks: robots to scale, who sees whom, who keeps the safe distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.transforms import blended_transform_factory

from murmurate import geometry
from murmurate.plots.palette import FAINT, INK, MUTED, ROBOT, SIGHT, WARNING, policy_color
from murmurate.plots.record import Episode, Sizes

__all__ = [
    "Drawing",
    "add_paths",
    "draw_configuration",
    "draw_key",
    "draw_scale",
    "draw_world",
    "mutual_pairs",
    "path_colors",
    "path_segments",
    "show_window",
    "window",
]


def mutual_pairs(
    positions: Float[np.ndarray, "robots 2"], radius: float, scan_radius: float
) -> tuple[Bool[np.ndarray, "robots robots"], Bool[np.ndarray, "robots robots"]]:
    """Returns which pairs of neighbours see each other, and which do not, each pair once (row < column).

    Args:
        positions: Centres, world units.
        radius: The paper's R_bot, world units.
        scan_radius: The paper's R_scan, world units.
    """
    near, seen = geometry.neighbors_and_visible(positions, radius, scan_radius)
    return np.triu(near & seen & seen.T), np.triu(near & ~(seen & seen.T))


@dataclass(frozen=True)
class Drawing:
    """The artists of one configuration; `update` moves them to another.

    Attributes:
        radius: The paper's R_bot, world units.
        scan_radius: The paper's R_scan, world units.
        shells: Circles of diameter `safe_distance`: where two overlap, the pair is not safe.
        clear: Sight lines of the pairs that see each other.
        blocked: Sight lines of neighbours of whom at least one is occluded from the other.
        discs: The robots, to scale; the occluded ones outlined in the warning colour.
    """

    radius: float
    scan_radius: float
    shells: EllipseCollection
    clear: LineCollection
    blocked: LineCollection
    discs: EllipseCollection

    def update(self, positions: Float[np.ndarray, "robots 2"]) -> None:
        """Shows another configuration of the same robots."""
        positions = np.asarray(positions, dtype=float)
        clear, blocked = mutual_pairs(positions, self.radius, self.scan_radius)
        for lines, pairs in ((self.clear, clear), (self.blocked, blocked)):
            lines.set_segments(list(positions[np.argwhere(pairs)]))
        # Occluded from a neighbour, that is: a robot out of scanning distance is not there to be seen.
        near = geometry.neighbors(positions, self.scan_radius)
        hidden = (near & geometry.occluded(positions, self.radius)).any(axis=0)
        self.discs.set_edgecolor([WARNING if one else "none" for one in hidden])
        for circles in (self.shells, self.discs):
            circles.set_offsets(positions)


def draw_configuration(
    ax: Axes,
    positions: Float[np.ndarray, "robots 2"],
    radius: float,
    scan_radius: float,
    safe_distance: float,
    objective: str = "C2",
    *,
    weight: float = 1.0,
) -> Drawing:
    """Draws one configuration in world coordinates.

    Args:
        ax: Where to draw; its limits are the caller's business.
        positions: Centres, world units.
        radius: The paper's R_bot, world units.
        scan_radius: The paper's R_scan, world units.
        safe_distance: The paper's delta_s, world units.
        objective: "C1" draws the gathering point, a cross at the origin.
        weight: Factor on the width of every line.

    Returns:
        The artists, which can be moved to another configuration.
    """
    ax.set_aspect("equal")
    count = len(positions)

    def circles(diameter: float, **style: object) -> EllipseCollection:
        sizes = np.full(count, diameter)
        found = EllipseCollection(
            sizes, sizes, np.zeros(count), units="xy", offsets=positions, offset_transform=ax.transData, **style
        )
        ax.add_collection(found, autolim=False)
        return found

    def lines(**style: object) -> LineCollection:
        found = LineCollection([], capstyle="butt", **style)  # pyright: ignore[reportArgumentType]
        ax.add_collection(found, autolim=False)
        return found

    if objective == "C1":
        cross = Line2D([0], [0], marker="+", markersize=9 * weight, markeredgewidth=1.3 * weight, color=INK, zorder=2.5)
        ax.add_line(cross)
    drawing = Drawing(
        radius=radius,
        scan_radius=scan_radius,
        shells=circles(safe_distance, facecolors="none", edgecolors=FAINT, linewidths=0.7 * weight, zorder=1.0),
        clear=lines(colors=SIGHT, linewidths=0.5 * weight, alpha=0.65, zorder=2.0),
        blocked=lines(colors=WARNING, linewidths=1.0 * weight, alpha=0.9, zorder=3.0),
        discs=circles(2 * radius, facecolors=ROBOT, linewidths=1.5 * weight, zorder=4.0),
    )
    drawing.update(positions)
    return drawing


def path_segments(positions: Float[np.ndarray, "configurations robots 2"]) -> Float[np.ndarray, "segments 2 2"]:
    """Returns the straight pieces of all robots' paths, step by step (robots vary fastest)."""
    return np.stack([positions[:-1], positions[1:]], axis=2).reshape(-1, 2, 2)


def path_colors(
    episode: Episode, first: int, last: int, strength: float = 0.85, oldest: float = 0.12
) -> Float[np.ndarray, "segments 4"]:
    """Returns the colours of `path_segments` of steps first..last: the policy's, fading with age.

    Args:
        episode: Whose paths they are.
        first: First step.
        last: Last step, the freshest.
        strength: Opacity of the freshest piece.
        oldest: Opacity of the oldest piece, as a share of the freshest.
    """
    steps = np.arange(first, last)
    colors = np.array([to_rgba(policy_color(episode.policy_at(step))) for step in range(first, last)]).reshape(-1, 4)
    age = (last - 1 - steps) / max(1, last - first)
    colors[:, 3] = strength * (oldest + (1 - oldest) * (1 - age) ** 1.5)
    return np.repeat(colors, episode.positions.shape[1], axis=0)


def add_paths(ax: Axes, episode: Episode, last: int, *, oldest: float = 0.12, width: float = 1.1) -> LineCollection:
    """Draws the robots' paths up to a step, each piece in its policy's colour, fading with age.

    Args:
        ax: Where to draw.
        episode: Whose paths.
        last: The step at which they end.
        oldest: Opacity of the oldest piece, as a share of the freshest.
        width: Line width, points.
    """
    segments = path_segments(episode.positions[: last + 1])
    colors = path_colors(episode, 0, last, oldest=oldest)
    paths = LineCollection(list(segments), colors=colors, linewidths=width, zorder=1.5, capstyle="butt")
    ax.add_collection(paths, autolim=False)
    return paths


def window(positions: Float[np.ndarray, "*configurations robots 2"], margin: float) -> tuple[np.ndarray, float]:
    """Returns centre and half side of the least square round some positions, `margin` world units away from all."""
    low, high = (pick(positions.reshape(-1, 2), axis=0).astype(float) for pick in (np.min, np.max))
    return (low + high) / 2, float((high - low).max() / 2 + margin)


def show_window(ax: Axes, center: np.ndarray, half: float) -> None:
    """Shows a square of the world, to scale, without ticks."""
    ax.set(xlim=(center[0] - half, center[0] + half), ylim=(center[1] - half, center[1] + half), xticks=[], yticks=[])
    ax.set_aspect("equal")
    for spine in ax.spines.values():
        spine.set(color=FAINT, linewidth=0.8)


def draw_world(ax: Axes, sizes: Sizes, *, whole: bool = False, width: float = 1.0) -> Rectangle:
    """Draws the edge of the world; where the axes show the `whole` of it, they do not cut the line at their edge."""
    low, size = (-sizes.half_width, -sizes.half_height), (2 * sizes.half_width, 2 * sizes.half_height)
    edge = Rectangle(low, *size, fill=False, edgecolor=SIGHT, linewidth=width, zorder=0.5, clip_on=not whole)
    ax.add_patch(edge)
    return edge


def draw_scale(ax: Axes, length: float, text: str, size: float) -> None:
    """Draws a bar of `length` world units under the axes, where it can hide nothing, and says what it measures."""
    start, y = ax.get_xlim()[0], -0.035
    transform = blended_transform_factory(ax.transData, ax.transAxes)
    bar = Line2D([start, start + length], [y, y], color=INK, linewidth=1.4, transform=transform, clip_on=False)
    bar.set_solid_capstyle("butt")
    ax.add_line(bar)
    gap = 0.02 * (ax.get_xlim()[1] - start)
    ax.text(start + length + gap, y, text, transform=transform, fontsize=size, color=MUTED, va="center")


def draw_key(ax: Axes, size: float) -> None:
    """Says under the axes, at the right, what the two kinds of sight lines mean."""
    keys = [
        Line2D([], [], color=SIGHT, linewidth=0.8, label="clear sight"),
        Line2D([], [], color=WARNING, linewidth=1.2, label="blocked"),
    ]
    ax.legend(
        handles=keys,
        loc="center right",
        bbox_to_anchor=(1.0, -0.035),
        ncols=2,
        fontsize=size,
        labelcolor=MUTED,
        frameon=False,
        borderpad=0,
        borderaxespad=0,
        handlelength=1.3,
        handletextpad=0.5,
        columnspacing=1.0,
    )
