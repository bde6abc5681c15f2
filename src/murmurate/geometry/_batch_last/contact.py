"""Kernels, batch last: distances between robots, contact during a step, and leaving the world.

Within a step every robot moves in a straight line at constant velocity, so the offset of a pair is p + v t with t in
[0, 1], and its least length has a closed form. Checking only the ends of a step would let discs pass through each
other.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from murmurate.geometry._batch_last.visibility import Array, Scalar, as_floating, fold, off_diagonal, offsets

__all__ = [
    "any_contact",
    "any_outside",
    "clearances",
    "closest_approach",
    "contact_matrix",
    "distances",
    "in_contact",
    "outside",
]

MAX_LISTED_ROBOTS = 48
"""The largest swarm whose pairs are listed, each once, in a program; beyond, the list would take much of its memory."""


def distances(positions: Float[Array, "robots 2 *batch"]) -> Float[Array, "robots robots *batch"]:
    """Returns the distances between centres; 0 on the diagonal."""
    xp, positions = as_floating(positions)
    return offsets(xp, positions)[2]


def clearances(positions: Float[Array, "robots 2 *batch"], radius: Scalar) -> Float[Array, "robots robots *batch"]:
    """Returns the gaps between the edges of the discs; inf on the diagonal."""
    xp, positions = as_floating(positions)
    distance = offsets(xp, positions)[2]
    return xp.where(off_diagonal(xp, distance), distance - 2 * radius, xp.inf)


def closest_approach(
    positions: Float[Array, "robots 2 *batch"], velocities: Float[Array, "robots 2 *batch"]
) -> Float[Array, "robots robots *batch"]:
    """Returns the least distance between each two centres during one step; 0 on the diagonal."""
    xp, positions = as_floating(positions)
    _, velocities = as_floating(velocities)
    dx, dy, _ = offsets(xp, positions)
    vx, vy, _ = offsets(xp, velocities)
    return _least_length(xp, dx, dy, vx, vy)


def _least_length(xp: Any, dx: Any, dy: Any, vx: Any, vy: Any) -> Any:
    """Returns the least length during one step of offsets that change at constant velocities."""
    speed = xp.sqrt(vx * vx + vy * vy)
    moving = speed > 0
    # Along the unit direction of relative motion, so that a tiny relative speed cannot underflow when squared.
    ex, ey = (xp.where(moving, v / xp.where(moving, speed, 1), 0) for v in (vx, vy))
    travelled = xp.clip(-(dx * ex + dy * ey), 0, speed)
    px, py = dx + ex * travelled, dy + ey * travelled
    return xp.sqrt(px * px + py * py)


def contact_matrix(
    positions: Float[Array, "robots 2 *batch"], velocities: Float[Array, "robots 2 *batch"], radius: Scalar
) -> Bool[Array, "robots robots *batch"]:
    """Returns which pairs touch during one step (closest approach <= 2 R); False on the diagonal."""
    approach = closest_approach(positions, velocities)
    xp = approach.__array_namespace__()
    return (approach <= 2 * radius) & off_diagonal(xp, approach)


def in_contact(
    positions: Float[Array, "robots 2 *batch"], velocities: Float[Array, "robots 2 *batch"], radius: Scalar
) -> Bool[Array, "robots *batch"]:
    """Returns which robots touch another one during one step."""
    return fold(operator.or_, contact_matrix(positions, velocities, radius))


def any_contact(
    positions: Float[Array, "robots 2 *batch"], velocities: Float[Array, "robots 2 *batch"], radius: Scalar
) -> Bool[Array, "*batch"]:
    """Returns whether any two robots touch during one step."""
    xp, positions = as_floating(positions)
    _, velocities = as_floating(velocities)
    robots = positions.shape[0]
    if not isinstance(robots, int) or not 2 <= robots <= MAX_LISTED_ROBOTS:
        return fold(operator.or_, in_contact(positions, velocities, radius))
    first, second = np.triu_indices(robots, 1)
    dx, dy, vx, vy = (a[second] - a[first] for v in (positions, velocities) for a in (v[:, 0], v[:, 1]))
    return fold(operator.or_, _least_length(xp, dx, dy, vx, vy) <= 2 * radius)


def outside(
    positions: Float[Array, "robots 2 *batch"], half_width: Scalar, half_height: Scalar
) -> Bool[Array, "robots *batch"]:
    """Returns which centres are not inside |x| <= half_width, |y| <= half_height; a centre at NaN is outside."""
    xp, positions = as_floating(positions)
    x, y = xp.abs(positions[:, 0]), xp.abs(positions[:, 1])
    return ~((x <= half_width) & (y <= half_height))


def any_outside(
    positions: Float[Array, "robots 2 *batch"], half_width: Scalar, half_height: Scalar
) -> Bool[Array, "*batch"]:
    """Returns whether any robot is outside the world."""
    return fold(operator.or_, outside(positions, half_width, half_height))
