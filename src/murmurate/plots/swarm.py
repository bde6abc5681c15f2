"""The one artist that draws a swarm: robots to scale, their sight lines, safe distances and paths, and the world.

Every figure, every animation, the camera of the Gymnasium environment and the figures of the documentation use it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.transforms import blended_transform_factory

from murmurate import geometry
from murmurate.errors import check_type
from murmurate.geometry.similarity import configuration
from murmurate.plots.style import FAINT, INK, MUTED, NIGHT_POLICIES, POLICIES, ROBOT, SIGHT, WARNING
from murmurate.representation import short_repr
from murmurate.world import WorldConfig, check_world

__all__ = [
    "LIGHT",
    "NIGHT",
    "Look",
    "SwarmArtist",
    "draw_paths",
    "draw_robots",
    "draw_scale",
    "draw_sight_key",
    "draw_world",
    "path_segments",
    "show_window",
    "sight_pairs",
    "window",
    "world_half_side",
]


@dataclass(frozen=True)
class Look:
    """The colours of a swarm on its background.

    Attributes:
        background: What the swarm is drawn on.
        robot: A robot.
        clear: Sight lines of pairs that see each other, with their opacity.
        blocked: Sight lines of neighbours that do not.
        shell: Circles of the safe distance, and the edge of the world.
        point: The gathering point.
        policies: Paths, by the policy that made each step.
    """

    background: str
    robot: str
    clear: tuple[str, float]
    blocked: tuple[str, float]
    shell: str
    point: str
    policies: tuple[str, ...]

    __repr__ = short_repr


LIGHT = Look("white", ROBOT, (SIGHT, 0.65), (WARNING, 0.9), FAINT, INK, POLICIES)
NIGHT = Look(INK, "#F5F8FB", ("#A9C7E0", 0.8), ("#FF8A3D", 1.0), "#4A5D6F", "#F5F8FB", NIGHT_POLICIES)


def sight_pairs(
    positions: Float[np.ndarray, "robots 2"], world: WorldConfig
) -> tuple[Bool[np.ndarray, "robots robots"], Bool[np.ndarray, "robots robots"]]:
    """Returns the pairs that see each other, and the pairs of neighbours that do not; each pair once (row < column)."""
    near, seen = geometry.neighbors_and_visible(positions, world.radius, world.scan_radius)
    mutual = seen & seen.T
    return np.triu(mutual), np.triu(near & ~mutual)


def draw_robots(
    ax: Axes,
    positions: Float[np.ndarray, "robots 2"],
    radius: float,
    color: str | Sequence[str] = ROBOT,
    edge: str | Sequence[str] = "none",
    linewidth: float = 1.5,
    zorder: float = 4.0,
) -> EllipseCollection:
    """Draws robots as discs in world units.

    Args:
        ax: Where to draw.
        positions: Centres, world units.
        radius: Radius, world units.
        color: Of all discs, or of each.
        edge: Colour of all outlines, or of each.
        linewidth: Width of the outlines, points.
        zorder: What lies over what.
    """
    return _circles(ax, positions, 2 * radius, facecolors=color, edgecolors=edge, linewidths=linewidth, zorder=zorder)


class SwarmArtist:
    """A swarm on axes; `update` moves it to another configuration.

    Attributes:
        shells: Circles of diameter `safe_distance`: where two overlap, the pair is closer than the safe distance.
        clear: Sight lines of the pairs that see each other.
        blocked: Sight lines of the pairs of neighbours that do not.
        discs: The robots, to scale; those that a neighbour cannot see are outlined in the colour of blocked sight.
    """

    def __init__(
        self,
        ax: Axes,
        positions: Float[np.ndarray, "robots 2"],
        world: WorldConfig,
        *,
        gathering_point: bool = False,
        look: Look = LIGHT,
        colors: Sequence[str] | None = None,
        weight: float = 1.0,
        shells: bool = True,
        clear: bool = True,
        min_radius: float = 0.0,
    ) -> None:
        """Draws one configuration in world coordinates; the limits of the axes are left to the caller.

        Args:
            ax: Where to draw.
            positions: Centres, world units.
            world: Sizes of the robots and their world.
            gathering_point: Draw a cross at the origin.
            look: The colours.
            colors: A colour for each robot, instead of the look's.
            weight: Factor on the width of every line.
            shells: Draw the circles of the safe distance.
            clear: Draw the sight lines of pairs that see each other.
            min_radius: Least radius of a disc, world units: large worlds would make discs too small to be seen.
        """
        check_type("ax", ax, Axes, "axes of Matplotlib")
        positions = configuration(positions)
        check_world(world)
        self._world, self._look, self._clear = world, look, clear
        ax.set_aspect("equal")
        if gathering_point:
            cross: dict[str, Any] = {"markersize": 9 * weight, "markeredgewidth": 1.3 * weight, "color": look.point}
            ax.add_line(Line2D([0], [0], marker="+", zorder=2.5, **cross))
        diameter = world.safe_distance if shells else 0.0
        self.shells = _circles(
            ax, positions, diameter, facecolors="none", edgecolors=look.shell, linewidths=0.7 * weight, zorder=1.0
        )
        self.shells.set_visible(shells)
        self.clear = _lines(ax, look.clear, 0.5 * weight, zorder=2.0)
        self.blocked = _lines(ax, look.blocked, 1.0 * weight, zorder=3.0)
        radius = max(world.radius, min_radius)
        self.discs = draw_robots(ax, positions, radius, colors or look.robot, linewidth=1.5 * weight)
        self.update(positions)

    def update(
        self,
        positions: Float[np.ndarray, "robots 2"],
        strength: Float[np.ndarray, "robots robots"] | None = None,
    ) -> None:
        """Shows another configuration of the same robots.

        Args:
            positions: Centres, world units.
            strength: Opacity of the sight line of each pair that sees each other, from 0 to 1; all 1 where None.
        """
        positions = np.asarray(positions, dtype=float)
        near, seen = geometry.neighbors_and_visible(positions, self._world.radius, self._world.scan_radius)
        clear, blocked = np.triu(seen & seen.T), np.triu(near & ~(seen & seen.T))
        shown = np.argwhere(clear if strength is None else np.triu(strength, 1) > 0) if self._clear else []
        self.clear.set_segments(list(positions[shown]))
        if strength is not None and len(shown):
            color, opacity = self._look.clear
            self.clear.set_color([to_rgba(color, float(opacity * strength[i, j])) for i, j in shown])
        self.blocked.set_segments(list(positions[np.argwhere(blocked)]))
        # A robot is outlined when a neighbour cannot see it; robots farther away than the scan radius do not count.
        hidden = (near & ~seen).any(axis=0)
        self.discs.set_edgecolor([self._look.blocked[0] if robot else "none" for robot in hidden])
        for circles in (self.shells, self.discs):
            circles.set_offsets(positions)


def path_segments(
    positions: Float[np.ndarray, "configurations robots 2"],
    policies: Int[np.ndarray, " steps"],
    oldest: float = 0.12,
    look: Look = LIGHT,
) -> tuple[Float[np.ndarray, "segments 2 2"], Float[np.ndarray, "segments 4"]]:
    """Returns the straight pieces of all paths, step by step, and their colours: the policy's, fading with age.

    Args:
        positions: Consecutive configurations, world units.
        policies: Index of the policy that made each step.
        oldest: Opacity of the oldest piece, as a share of the latest.
        look: The colours.
    """
    # An episode that starts at rest has no step, and may be recorded with another configuration behind its end.
    positions = positions[: len(policies) + 1]
    steps, robots = len(positions) - 1, positions.shape[1]
    segments = np.stack([positions[:-1], positions[1:]], axis=2).reshape(-1, 2, 2)
    palette = np.array([to_rgba(color) for color in look.policies])
    colors = palette[np.asarray(policies) % len(palette)].reshape(-1, 4)
    age = np.arange(steps)[::-1] / max(1, steps)
    colors[:, 3] = 0.85 * (oldest + (1 - oldest) * (1 - age) ** 1.5)
    return segments, np.repeat(colors, robots, axis=0)


def draw_paths(
    ax: Axes,
    positions: Float[np.ndarray, "configurations robots 2"],
    policies: Int[np.ndarray, " steps"],
    *,
    oldest: float = 0.12,
    width: float = 1.1,
) -> LineCollection:
    """Draws the robots' paths; see `path_segments`.

    Args:
        ax: Where to draw.
        positions: Consecutive configurations, world units.
        policies: Index of the policy that made each step.
        oldest: Opacity of the oldest piece, as a share of the latest.
        width: Line width, points.
    """
    segments, colors = path_segments(positions, policies, oldest=oldest)
    paths = LineCollection(list(segments), colors=colors, linewidths=width, zorder=1.5, capstyle="butt")
    ax.add_collection(paths, autolim=False)
    return paths


def window(positions: Float[np.ndarray, "*configurations robots 2"], margin: float) -> tuple[np.ndarray, float]:
    """Returns centre and half side of the smallest square around positions that leaves a margin, world units."""
    points = positions.reshape(-1, 2).astype(float)
    low, high = points.min(axis=0), points.max(axis=0)
    return (low + high) / 2, float((high - low).max() / 2 + margin)


def show_window(ax: Axes, center: np.ndarray, half: float) -> None:
    """Shows a square of the world, to scale, without ticks."""
    ax.set(xlim=(center[0] - half, center[0] + half), ylim=(center[1] - half, center[1] + half), xticks=[], yticks=[])
    ax.set_aspect("equal")
    for spine in ax.spines.values():
        spine.set(color=FAINT, linewidth=0.8)


def draw_world(ax: Axes, world: WorldConfig, *, clip: bool = True, width: float = 1.0, color: str = SIGHT) -> Rectangle:
    """Draws the edge of the world; without `clip`, axes that end there do not cut the line in half.

    The whole plane has none: there it is not visible.
    """
    low, size = (-world.half_width, -world.half_height), (2 * world.half_width, 2 * world.half_height)
    edge = Rectangle(low, *size, fill=False, edgecolor=color, linewidth=width, zorder=0.5, clip_on=clip)
    edge.set_visible(world.bounded)
    ax.add_patch(edge)
    return edge


def world_half_side(world: WorldConfig, positions: np.ndarray) -> float:
    """Returns the half side of a square around the origin that shows the world, or all of a swarm in the plane."""
    half = max(world.half_width, world.half_height)
    return half if world.bounded else max(half, float(np.abs(positions).max()) + world.radius)


def draw_scale(ax: Axes, length: float, text: str, size: float) -> None:
    """Draws a bar of `length` world units below the axes, and writes what it measures."""
    start, y = ax.get_xlim()[0], -0.035
    transform = blended_transform_factory(ax.transData, ax.transAxes)
    bar = Line2D([start, start + length], [y, y], color=INK, linewidth=1.4, transform=transform, clip_on=False)
    bar.set_solid_capstyle("butt")
    ax.add_line(bar)
    gap = 0.02 * (ax.get_xlim()[1] - start)
    ax.text(start + length + gap, y, text, transform=transform, fontsize=size, color=MUTED, va="center")


def draw_sight_key(ax: Axes, size: float) -> None:
    """Explains the two kinds of sight lines below the axes, at the right."""
    handles = [
        Line2D([], [], color=SIGHT, linewidth=0.8, label="clear sight"),
        Line2D([], [], color=WARNING, linewidth=1.2, label="blocked"),
    ]
    text: dict[str, Any] = {"fontsize": size, "labelcolor": MUTED, "frameon": False}
    space: dict[str, Any] = {"borderpad": 0, "borderaxespad": 0, "handlelength": 1.3, "handletextpad": 0.5}
    position: dict[str, Any] = {"loc": "center right", "bbox_to_anchor": (1.0, -0.035), "ncols": 2}
    ax.legend(handles=handles, columnspacing=1.0, **text | space | position)


def _circles(ax: Axes, centers: Float[np.ndarray, "circles 2"], diameter: float, **style: Any) -> EllipseCollection:
    sizes, no_turn = np.full(len(centers), diameter), np.zeros(len(centers))
    circles = EllipseCollection(
        sizes, sizes, no_turn, units="xy", offsets=centers, offset_transform=ax.transData, **style
    )
    ax.add_collection(circles, autolim=False)
    return circles


def _lines(ax: Axes, color: tuple[str, float], width: float, zorder: float) -> LineCollection:
    lines = LineCollection([], colors=to_rgba(*color), linewidths=width, capstyle="butt", zorder=zorder)
    ax.add_collection(lines, autolim=False)
    return lines
