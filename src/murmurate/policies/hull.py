"""Features of a robot's place on the convex hull of what it sees, and of the gap through which it could leave."""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from murmurate.geometry._batch_last import hull_shares
from murmurate.representation import short_repr

__all__ = ["CORNER_CHANNELS", "EDGE_CHANNELS", "GAP_CHANNELS", "Gap", "Hull", "hull", "mean_position", "widest_gap"]

EDGE_CHANNELS, CORNER_CHANNELS, GAP_CHANNELS = 2, 3, 2

NO_ANGLE, ANGLE = 1e-4, 1e-3
"""Sines of the angles up to which two robots count as in one direction, and from which on as in two. In between it is
partly so: rounding alone, such as that of robots in line, does not decide who is a corner. On a ring of 1,000 robots
that all see each other the angles are 3e-3."""

FAR_OUT = 4.0
"""Distance from the line between a robot's two neighbours on the hull, in radii, that maps to one half."""


WIDEST = 6
"""Power of a gap's angle by which its direction is weighted: a gap a quarter wider counts nearly four times as much."""

NO_GAP = 4 * math.pi
"""Stands for the angle of a robot that is not seen: greater than all others, also a turn later."""


class Gap(NamedTuple):
    """Where the widest angle around each robot is in which it sees nobody.

    Of gaps that are equally wide the mean counts, so that no comparison decides: a robot amid a regular polygon has
    none, and nothing changes by more than rounding as the swarm turns.

    Attributes:
        x: x of the mean direction of the gaps, each weighted by a power of its angle; a vector of at most length 1.
        y: y of it.
        width: The mean angle of the gaps, weighted alike, in half turns, less 1: at corners of the hull above 0.
    """

    x: Float[Array, "robots *batch"]
    y: Float[Array, "robots *batch"]
    width: Float[Array, "robots *batch"]

    __repr__ = short_repr


class Hull(NamedTuple):
    """Each robot's place on the convex hull of itself and the robots that it sees; the observer is the first axis.

    Attributes:
        pair: Scalars of each pair: whether they share an edge of the hull (a corner does so with two robots, a robot
            inside with none), and on which side of the edge the other robots are.
        robot: Scalars of each robot: whether it is a corner, and two functions of its distance from the line between
            its two neighbours on the hull. Robots that all see each other stand out from that line by more than about a
            radius, whatever their number and distances.
    """

    pair: Float[Array, "edge_channels robots others *batch"]
    robot: Float[Array, "corner_channels robots *batch"]

    __repr__ = short_repr


def hull(
    ux: Float[Array, "robots others *batch"],
    uy: Float[Array, "robots others *batch"],
    distance: Float[Array, "robots others *batch"],
    seen: Bool[Array, "robots others *batch"],
) -> Hull:
    """Returns the features of each robot's place on the hull of what it sees.

    Args:
        ux: x of the unit vectors to the robots that each robot sees; 0 for the others.
        uy: y of them.
        distance: Distances of the robots seen, in radii.
        seen: Which robots each robot sees.
    """
    last, first = hull_shares(ux, uy, seen, lambda sine: jnp.clip((sine - NO_ANGLE) / (ANGLE - NO_ANGLE), 0.0, 1.0))
    (ax, ay), (bx, by) = mean_position(last, ux, uy, distance), mean_position(first, ux, uy, distance)
    width = jnp.sqrt((ax - bx) ** 2 + (ay - by) ** 2 + 1e-6)
    # On a line both neighbours are in the same direction: the product would be rounding alone, over almost no width.
    # The greatest of none, where a robot perceives nobody, is 0.
    bulge = (1 - jnp.max(last * first, axis=1, initial=0.0)) * jnp.abs(ax * by - ay * bx) / width
    corner = jnp.minimum(jnp.max(last, axis=1, initial=0.0), jnp.max(first, axis=1, initial=0.0))
    robot = [corner, corner / (1 + bulge**2) ** 2, corner * bulge / (FAR_OUT + bulge)]
    pair = [jnp.maximum(last, first), last - first]
    return Hull(jnp.stack(pair), jnp.stack(robot))


def widest_gap(
    ux: Float[Array, "robots others *batch"],
    uy: Float[Array, "robots others *batch"],
    seen: Bool[Array, "robots others *batch"],
) -> Gap:
    """Returns the widest gap in what each robot sees: outwards at a corner of the hull, the way out inside.

    Args:
        ux: x of the unit vectors to the robots that each robot sees.
        uy: y of them.
        seen: Which robots each robot sees.
    """
    angle = jnp.where(seen, jnp.arctan2(jnp.where(seen, uy, 0.0), jnp.where(seen, ux, 1.0)), NO_GAP)
    first = jnp.min(angle, axis=1, keepdims=True, initial=NO_GAP) + 2 * math.pi
    if isinstance(angle.shape[1], int):
        angle, share = jnp.sort(angle, axis=1), 1.0
        following = jnp.concatenate([angle[:, 1:], jnp.full_like(angle[:, :1], NO_GAP)], axis=1)
    else:
        # A program for swarms of any size, which ONNX cannot sort. Robots in one direction have one gap together.
        pairs = angle[:, None], angle[:, :, None]
        share = 1 / jnp.sum(jnp.where(pairs[0] == pairs[1], 1.0, 0.0), axis=2)
        following = jnp.min(jnp.where(pairs[0] > pairs[1], pairs[0], NO_GAP), axis=2, initial=NO_GAP)
    # The last of those that are seen is followed by the first, a turn later.
    following = jnp.where(following < NO_GAP, following, first)
    gap = jnp.where(angle < NO_GAP, following - angle, 0.0) / math.pi
    weight = share * gap**WIDEST
    middle = angle + gap * (math.pi / 2)
    # A robot that sees nobody has no gap, and no direction.
    total = jnp.maximum(jnp.sum(weight, axis=1), 1e-9)
    x, y, width = (jnp.sum(weight * value, axis=1) / total for value in (jnp.cos(middle), jnp.sin(middle), gap - 1))
    return Gap(x, y, width)


def mean_position(marked: Array, ux: Array, uy: Array, distance: Array) -> tuple[Array, Array]:
    """Returns the mean position of the marked robots; several are in one direction from the observer."""
    weight = marked / jnp.maximum(jnp.sum(marked, axis=1), 1e-9)[:, None]
    return jnp.sum(weight * distance * ux, axis=1), jnp.sum(weight * distance * uy, axis=1)
