r"""Corners of the hull make room, everybody else leaves through its edges, until all are corners.

After the idea of Alsaedi, Gudmundsson and van Renssen, The Mutual Visibility Problem for Fat Robots with Lights
(arXiv:2206.14423), not after its letter: robots are of two colours, and a robot that is no corner of the convex hull
moves out through an edge of it and becomes one, in the fully synchronous model; strictly convex, with room enough for
discs, all see all.

What deviates from the paper:

* No lights. The paper's two colours are kept and shown to others; here a robot is a corner or not by what it sees now,
  anew at every step, and judges the others' colours by its own view.
* A robot is a corner only if it stands out from the line between its two neighbours on the hull by what two discs need
  in order not to hide one another; the hull of points would allow less.
* There are no phases, and edges are not taken in turn: the robots on and inside the hull move at once, each to the edge
  nearest to it, and two that chose the same one are kept apart by the collision avoidance that all baselines share.
* Moves end at the speed limit, and corners beside long edges make theirs outwards slowly: walls are not seen. A move of
  the paper's is completed in one round.

Powers that the paper does not use:

* Robots know the radius, the safe distance and the speed limit in world units, and keep the safe distance.
* Corners draw in on the middle of what they see while their edges are long, so that the swarm gathers, and make way
  outwards while their edges are too short for one more robot; with a landmark (C1) they drift towards it as well.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from murmurate.policies.baselines.avoidance import KEEP, avoiding
from murmurate.policies.baselines.sight import Sight, mean_of_seen, sight
from murmurate.types import Observation
from murmurate.world.config import WorldConfig

__all__ = ["TwoColor"]

GAIN = 0.5
"""Share of the way that is left to do in one step, where the speed limit allows."""

WIDE = 3.0
"""Least length of long edges, in safe distances."""

SLOW = 0.2
"""Share of the speed limit at which corners beside long edges go outwards, before the gain."""

BULGE = 1.25
"""How far a corner stands out, in the least distance at which its neighbours see one another and it sees both."""


class TwoColor(eqx.Module):
    """Corners keep or make room, all others move out through the nearest edge of the hull of what they see."""

    title: ClassVar[str] = "Two colours"
    centralised: ClassVar[bool] = False
    deviations: ClassVar[str] = (
        "Colours are not lights but what each robot judges by its own view at every step; corners stand out as far as "
        "discs need; no phases and no turns: robots inside move at once, each to its nearest edge, at bounded speed, "
        "with the baselines' collision avoidance; robots know the radius, the safe distance and the speed limit; "
        "corners gather, and make room where edges are too short."
    )
    world: WorldConfig = eqx.field(static=True)
    landmark: bool = eqx.field(static=True)

    def __call__(self, observation: Observation) -> Float[Array, "robots 2 *batch"]:
        """Returns velocities in each robot's own frame, world units per step."""
        world = self.world
        seen = sight(observation.view, world)
        mine, edges = _own_edges(seen, world), _edges(seen)
        out = _way_out(seen, edges, world)
        inside = jnp.any(seen.seen & ~edges.corner, axis=1)
        corner_x, corner_y = _as_corner(seen, mine, inside, world, self.landmark)
        x, y = jnp.where(mine.corner, corner_x, out[0]), jnp.where(mine.corner, corner_y, out[1])
        return avoiding(GAIN * x, GAIN * y, seen, world)


class _Own(NamedTuple):
    """A robot's own corner of the hull of what it sees: whether it is one, and what it is like.

    Attributes:
        corner: Whether all that it sees lies within less than half a turn.
        out_x: Unit vector outwards, across the line between its two neighbours on the hull.
        out_y: Second coordinate of it.
        bulge: How far it stands out from that line, world units.
        needed: How far it has to, world units.
        least: The shorter one of its two edges, world units.
        most: The longer one.
    """

    corner: Bool[Array, "robots *batch"]
    out_x: Float[Array, "robots *batch"]
    out_y: Float[Array, "robots *batch"]
    bulge: Float[Array, "robots *batch"]
    needed: Float[Array, "robots *batch"]
    least: Float[Array, "robots *batch"]
    most: Float[Array, "robots *batch"]


def _own_edges(seen: Sight, world: WorldConfig) -> _Own:
    angle = jnp.arctan2(seen.y, seen.x)
    turns, followers = [], []
    for j in range(seen.x.shape[1]):
        turn = jnp.mod(angle - angle[:, j, None], 2 * jnp.pi)
        other = (seen.seen & seen.seen[:, j, None]).at[:, j].set(False)
        turn = jnp.where(other, turn, jnp.where(seen.seen[:, j, None], 2 * jnp.pi, -1.0))
        turns.append(jnp.min(turn, axis=1))
        followers.append(jnp.argmin(turn, axis=1))
    turn, follower = jnp.stack(turns, axis=1), jnp.stack(followers, axis=1)
    last = jnp.argmax(turn, axis=1, keepdims=True)
    first = jnp.take_along_axis(follower, last, axis=1)
    (ax, ay, a), (bx, by, b) = (
        tuple(jnp.take_along_axis(c, i, axis=1)[:, 0] for c in (seen.x, seen.y, seen.distance)) for i in (last, first)
    )
    ex, ey = bx - ax, by - ay
    edge = jnp.sqrt(ex * ex + ey * ey)
    wide = jnp.where(edge > 0, edge, 1.0)
    longer = jnp.maximum(a, b)
    return _Own(
        corner=jnp.max(turn, axis=1) > jnp.pi,
        out_x=ey / wide,
        out_y=-ex / wide,
        # Who sees only one robot has no such line.
        bulge=jnp.where(edge > 0, (ay * ex - ax * ey) / wide, longer),
        needed=jnp.where(edge > 0, BULGE * world.radius * (1 + longer / wide), 0.0),
        least=jnp.minimum(a, b),
        most=longer,
    )


class _Edges(NamedTuple):
    """The hull of what each robot sees, itself included: observer, first and second end of each edge, in that order.

    Attributes:
        edge: Whether there is an edge from one robot to another, all others being to the left of it.
        gap_x: From its first end to its second.
        gap_y: Second coordinate.
        corner: Which robots are corners, as the observer judges it.
    """

    edge: Bool[Array, "robots robots robots *batch"]
    gap_x: Float[Array, "robots robots robots *batch"]
    gap_y: Float[Array, "robots robots robots *batch"]
    corner: Bool[Array, "robots robots *batch"]


def _edges(seen: Sight) -> _Edges:
    gap_x, gap_y = seen.x[:, None] - seen.x[:, :, None], seen.y[:, None] - seen.y[:, :, None]
    # The observer itself, which is at (0, 0), must not be outside.
    edge = seen.seen[:, None] & seen.seen[:, :, None] & (gap_y * seen.x[:, :, None] - gap_x * seen.y[:, :, None] >= 0)
    edge = edge & (gap_x * gap_x + gap_y * gap_y > 0)
    rounding = 1e-5 * (jnp.abs(gap_x) + jnp.abs(gap_y))
    for i in range(seen.x.shape[1]):
        ix, iy = seen.x[:, i, None, None] - seen.x[:, :, None], seen.y[:, i, None, None] - seen.y[:, :, None]
        edge = edge & ((gap_x * iy - gap_y * ix >= -rounding) | ~seen.seen[:, i, None, None])
    # Beside the observer's own two edges there are no others that it is an end of.
    beside = _beside(seen)
    return _Edges(edge, gap_x, gap_y, jnp.any(edge, axis=2) | jnp.any(edge, axis=1) | beside)


def _beside(seen: Sight) -> Bool[Array, "robots robots *batch"]:
    """Says with whom each robot shares an edge of the hull: all others are on one side of it."""
    left, right = jnp.ones(seen.seen.shape, bool), jnp.ones(seen.seen.shape, bool)
    for i in range(seen.x.shape[1]):
        side = seen.x * seen.y[:, i, None] - seen.y * seen.x[:, i, None]
        left, right = left & ((side >= 0) | ~seen.seen[:, i, None]), right & ((side <= 0) | ~seen.seen[:, i, None])
    return seen.seen & (left | right)


def _way_out(seen: Sight, edges: _Edges, world: WorldConfig) -> tuple[Array, Array]:
    """The way from each robot inside to just beyond the middle of the nearest edge; whoever sees none stays."""
    robots, batch = seen.x.shape[1], seen.x.shape[2:]
    length = jnp.sqrt(jnp.where(edges.edge, edges.gap_x**2 + edges.gap_y**2, 1.0))
    nx, ny = edges.gap_y / length, -edges.gap_x / length
    away = nx * seen.x[:, :, None] + ny * seen.y[:, :, None]
    beyond = BULGE * 1.5 * world.radius
    x = seen.x[:, :, None] + edges.gap_x / 2 + beyond * nx
    y = seen.y[:, :, None] + edges.gap_y / 2 + beyond * ny
    flat = [a.reshape((robots, robots * robots, *batch)) for a in (x, y, jnp.where(edges.edge, away, jnp.inf))]
    nearest = jnp.argmin(flat[2], axis=1, keepdims=True)
    x, y, away = (jnp.take_along_axis(a, nearest, axis=1)[:, 0] for a in flat)
    return jnp.where(jnp.isfinite(away), x, 0.0), jnp.where(jnp.isfinite(away), y, 0.0)


def _as_corner(seen: Sight, mine: _Own, inside: Array, world: WorldConfig, landmark: bool) -> tuple[Array, Array]:
    """The way of a corner: outwards while it stands out or has room too little, else in on the middle."""
    keep = KEEP * world.safe_distance
    flat = jnp.maximum(mine.needed - mine.bulge, 0.0)
    # An edge through which a robot comes is split in two.
    room = jnp.where(inside, 2.0, 1.0) * keep
    short = jnp.where(inside, jnp.maximum(room - mine.most, 0.0) / 2, 0.0)
    outwards = jnp.maximum(flat, short)
    # Slowly while the swarm is wide: walls are not seen, and the corners beside this one are still drawing in.
    outwards = jnp.where(mine.least > WIDE * keep, jnp.minimum(outwards, SLOW * world.max_speed), outwards)
    cx, cy = mean_of_seen(seen)
    if landmark:
        cx, cy = (cx + seen.point_x) / 2, (cy + seen.point_y) / 2
    far = jnp.sqrt(cx * cx + cy * cy + 1e-12)
    spare = jnp.minimum(mine.least - 1.1 * room, mine.bulge - 1.2 * mine.needed)
    inwards = jnp.maximum(spare / 2, 0.0) / far
    return outwards * mine.out_x + inwards * cx, outwards * mine.out_y + inwards * cy
