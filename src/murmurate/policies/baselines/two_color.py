r"""Two colours: corners of the convex hull make room, all others leave through its edges, until all are corners.

After the idea of Alsaedi, Gudmundsson and van Renssen, The Mutual Visibility Problem for Fat Robots with Lights
(arXiv:2206.14423), but not their algorithm to the letter. Robots have two colours. In the fully synchronous model, a
robot that is not a corner of the convex hull moves out through one of its edges and becomes a corner. On a strictly
convex hull with enough room for the discs, all robots see each other.

Deviations from the paper:

* No lights. In the paper each robot keeps its colour and shows it to the others. Here a robot judges at every step,
  from what it sees then, whether it is a corner, and judges the others' colours from its own view.
* A robot is a corner only if it stands out from the line between its two neighbours on the hull by as much as two
  discs need in order not to occlude one another; a hull of points would allow less.
* There are no phases, and edges do not take turns: all robots on or inside the hull move at once, each to its nearest
  edge. Two robots that choose the same edge are kept apart by the collision avoidance that all baselines share.
* Moves end at the speed limit, and corners beside long edges move outwards slowly, since walls are not seen. In the
  paper a move is completed in one round.

Powers that the paper does not use:

* Robots know the radius, the safe distance and the speed limit in world units, and keep the safe distance.
* Corners move towards the centroid of what they see while their edges are long, so that the swarm gathers, and move
  outwards while their edges are too short for one more robot; with a landmark (C1) they drift towards it as well.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from murmurate.geometry._batch_last import hull_neighbors
from murmurate.policies.baselines.avoidance import SAFETY_FACTOR, LocalView, avoid_collisions, local_view, view_centroid
from murmurate.policies.baselines.base import Baseline
from murmurate.policies.hull import mean_position
from murmurate.types import Observation
from murmurate.world.config import WorldConfig

__all__ = ["TwoColor"]

GAIN = 0.5
"""Share of the remaining way that a robot moves in one step, where the speed limit allows."""

LONG_EDGE = 3.0
"""Least length of long edges, in safe distances."""

SLOW = 0.2
"""Share of the speed limit at which corners beside long edges move outwards, before the gain."""

BULGE = 1.25
"""How far a corner stands out, in the least distance at which its neighbours see one another and it sees both."""


@Baseline.register("two-color")
class TwoColor(Baseline):
    """Corners keep or make room; all others move out through the nearest edge of the hull of what they see."""

    title: ClassVar[str] = "Two colours"
    deviations: ClassVar[str] = (
        "Colours are not lights but what each robot judges by its own view at every step; corners stand out as far as "
        "discs need; no phases and no turns: robots inside move at once, each to its nearest edge, at bounded speed, "
        "with the baselines' collision avoidance; robots know the radius, the safe distance and the speed limit; "
        "corners gather, and make room where edges are too short."
    )

    def __call__(self, observation: Observation) -> Float[Array, "robots 2 *batch"]:
        """Returns velocities in each robot's own frame, world units per step."""
        world = self.world
        view = local_view(observation.view, world)
        corner, edges = _own_corner(view, world), _edges(view)
        exit_x, exit_y = _path_outside(view, edges, world)
        any_inside = jnp.any(view.seen & ~edges.corner, axis=1)
        corner_x, corner_y = _path_of_corner(view, corner, any_inside, world, self.landmark)
        x, y = jnp.where(corner.is_corner, corner_x, exit_x), jnp.where(corner.is_corner, corner_y, exit_y)
        return avoid_collisions(GAIN * x, GAIN * y, view, world)


class _Corner(NamedTuple):
    """A robot's own corner of the hull of what it sees.

    Attributes:
        is_corner: Whether all that it sees lies within less than half a turn.
        out_x: First coordinate of the unit vector outwards, across the line between its two neighbours on the hull.
        out_y: Second coordinate.
        bulge: How far it stands out from that line, world units.
        needed: How far it has to stand out, world units.
        shorter: Length of its shorter edge, world units.
        longer: Length of its longer edge, world units.
    """

    is_corner: Bool[Array, "robots *batch"]
    out_x: Float[Array, "robots *batch"]
    out_y: Float[Array, "robots *batch"]
    bulge: Float[Array, "robots *batch"]
    needed: Float[Array, "robots *batch"]
    shorter: Float[Array, "robots *batch"]
    longer: Float[Array, "robots *batch"]


def _own_corner(view: LocalView, world: WorldConfig) -> _Corner:
    ux, uy = view.x / view.distance, view.y / view.distance
    last, first = hull_neighbors(ux, uy, view.seen)
    ones = jnp.ones_like(view.distance)
    # Between two others on one line, a robot has no robots to its left in either direction, but it is no corner.
    along_x, along_y = mean_position(last, ux, uy, ones)
    is_corner = jnp.any(last, axis=1) & (along_x**2 + along_y**2 > 0.5)
    (ax, ay), (bx, by) = (mean_position(marked, ux, uy, view.distance) for marked in (last, first))
    a, b = jnp.sqrt(ax * ax + ay * ay), jnp.sqrt(bx * bx + by * by)
    ex, ey = bx - ax, by - ay
    edge = jnp.sqrt(ex * ex + ey * ey)
    # At the end of a line both neighbours are the same robots, and there is no line between them.
    two = ~jnp.any(last & first, axis=1)
    width, longer = jnp.where(two, edge, 1.0), jnp.maximum(a, b)
    return _Corner(
        is_corner=is_corner,
        out_x=jnp.where(two, ey / width, 0.0),
        out_y=jnp.where(two, -ex / width, 0.0),
        bulge=jnp.where(two, (ay * ex - ax * ey) / width, longer),
        needed=jnp.where(two, BULGE * world.radius * (1 + longer / width), 0.0),
        shorter=jnp.minimum(a, b),
        longer=longer,
    )


class _Edges(NamedTuple):
    """The hull of what each robot sees and itself: first end, second end and observer, in this order.

    Attributes:
        is_edge: Whether there is an edge from one robot seen to another, with all others to the left of it.
        x: First coordinate of the first end.
        y: Second coordinate.
        gap_x: First coordinate of the second end relative to the first.
        gap_y: Second coordinate.
        corner: Which robots (second axis) are on the hull of what each observer (first axis) sees.
    """

    is_edge: Bool[Array, "robots robots robots *batch"]
    x: Float[Array, "robots one robots *batch"]
    y: Float[Array, "robots one robots *batch"]
    gap_x: Float[Array, "robots robots robots *batch"]
    gap_y: Float[Array, "robots robots robots *batch"]
    corner: Bool[Array, "robots robots *batch"]


def _edges(view: LocalView) -> _Edges:
    itself = jnp.eye(view.x.shape[0], dtype=bool).reshape(view.x.shape[:2] + (1,) * (view.x.ndim - 2))
    # From now on the observer is the last robot axis: the kernel takes each observer's view as one of a batch.
    x, y, seen, member = (jnp.swapaxes(a, 0, 1) for a in (view.x, view.y, view.seen, view.seen | itself))
    gap_x, gap_y = x[None] - x[:, None], y[None] - y[:, None]
    square = gap_x * gap_x + gap_y * gap_y
    apart = member[None] & member[:, None] & (square > 0)
    length = jnp.sqrt(jnp.where(apart, square, 1.0))
    ux, uy = (jnp.where(apart, gap / length, 0.0) for gap in (gap_x, gap_y))
    _, none_right = hull_neighbors(ux, uy, apart)
    corner = jnp.swapaxes(jnp.any(none_right, axis=1), 0, 1)
    return _Edges(none_right & seen[None] & seen[:, None], x[:, None], y[:, None], gap_x, gap_y, corner)


def _path_outside(view: LocalView, edges: _Edges, world: WorldConfig) -> tuple[Array, Array]:
    """Returns the path from each robot to just beyond the middle of the nearest edge; 0 where it sees no edge."""
    robots, shape = view.x.shape[0], edges.gap_x.shape
    length = jnp.sqrt(jnp.where(edges.is_edge, edges.gap_x**2 + edges.gap_y**2, 1.0))
    nx, ny = edges.gap_y / length, -edges.gap_x / length
    distance = jnp.where(edges.is_edge, nx * edges.x + ny * edges.y, jnp.inf)
    beyond = BULGE * 1.5 * world.radius
    x, y = edges.x + edges.gap_x / 2 + beyond * nx, edges.y + edges.gap_y / 2 + beyond * ny
    # One axis of all edges.
    x, y, distance = (a.reshape((robots * robots, *shape[2:])) for a in (x, y, distance))
    nearest = jnp.argmin(distance, axis=0, keepdims=True)
    x, y, distance = (jnp.take_along_axis(a, nearest, axis=0)[0] for a in (x, y, distance))
    return jnp.where(jnp.isfinite(distance), x, 0.0), jnp.where(jnp.isfinite(distance), y, 0.0)


def _path_of_corner(
    view: LocalView, corner: _Corner, any_inside: Array, world: WorldConfig, landmark: bool
) -> tuple[Array, Array]:
    """Returns the path of a corner: outwards while it is too flat or its edges are too short, else inwards."""
    keep = SAFETY_FACTOR * world.safe_distance
    too_flat = jnp.maximum(corner.needed - corner.bulge, 0.0)
    # An edge through which a robot leaves is split in two.
    needed = jnp.where(any_inside, 2.0, 1.0) * keep
    too_short = jnp.where(any_inside, jnp.maximum(needed - corner.longer, 0.0) / 2, 0.0)
    outwards = jnp.maximum(too_flat, too_short)
    # Slowly while the swarm is wide: walls are not seen, and the corners beside this one still move inwards.
    outwards = jnp.where(corner.shorter > LONG_EDGE * keep, jnp.minimum(outwards, SLOW * world.max_speed), outwards)
    cx, cy = view_centroid(view)
    if landmark:
        cx, cy = (cx + view.landmark_x) / 2, (cy + view.landmark_y) / 2
    distance = jnp.sqrt(cx * cx + cy * cy + 1e-12)
    spare = jnp.minimum(corner.shorter - 1.1 * needed, corner.bulge - 1.2 * corner.needed)
    inwards = jnp.maximum(spare / 2, 0.0) / distance
    return outwards * corner.out_x + inwards * cx, outwards * corner.out_y + inwards * cy
