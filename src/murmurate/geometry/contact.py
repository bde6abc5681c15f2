"""How near robots are, how near they come during one step, and whether they stay in the world.

Within a step every robot moves in a straight line at constant velocity, so the offset of a pair is p + v t with t in
[0, 1] and its least length has a closed form. Looking only at the end points would let discs pass through each other.
"""

from __future__ import annotations

import operator

from jaxtyping import Bool, Float

from murmurate.geometry.visibility import Array, as_configuration, fold, off_diagonal, offsets

__all__ = ["clearances", "closest_approach", "collides", "contacts", "distances", "leaves", "outside", "touches"]


def distances(positions: Float[Array, "robots 2 *batch"]) -> Float[Array, "robots robots *batch"]:
    """Returns the distances between centres, world units; 0 on the diagonal."""
    xp, positions = as_configuration(positions)
    return offsets(xp, positions)[2]


def clearances(positions: Float[Array, "robots 2 *batch"], radius: float) -> Float[Array, "robots robots *batch"]:
    """Returns the gaps between the discs' edges, world units: negative where discs overlap, inf on the diagonal."""
    xp, positions = as_configuration(positions)
    distance = offsets(xp, positions)[2]
    return xp.where(off_diagonal(xp, distance), distance - 2 * radius, xp.inf)


def closest_approach(
    positions: Float[Array, "robots 2 *batch"], velocities: Float[Array, "robots 2 *batch"]
) -> Float[Array, "robots robots *batch"]:
    """Returns the least distance of each pair of centres at any moment of one step.

    Args:
        positions: Centres at the start of the step, world units.
        velocities: Constant velocities during the step, world units per step.

    Returns:
        The closest approach of each pair, world units; 0 on the diagonal.
    """
    xp, positions = as_configuration(positions)
    _, velocities = as_configuration(velocities)
    dx, dy, _ = offsets(xp, positions)
    vx, vy, speed = offsets(xp, velocities)
    moving = speed > 0
    # Along the unit direction of relative motion, so that a tiny relative speed cannot underflow when squared.
    ex, ey = (xp.where(moving, v / xp.where(moving, speed, 1), 0) for v in (vx, vy))
    travelled = xp.clip(-(dx * ex + dy * ey), 0, speed)
    px, py = dx + ex * travelled, dy + ey * travelled
    return xp.sqrt(px * px + py * py)


def contacts(
    positions: Float[Array, "robots 2 *batch"], velocities: Float[Array, "robots 2 *batch"], radius: float
) -> Bool[Array, "robots robots *batch"]:
    """Says whose discs touch or overlap at any moment of one step (closest approach <= 2 R).

    Args:
        positions: Centres at the start of the step, world units.
        velocities: Constant velocities during the step, world units per step.
        radius: The paper's R_bot, world units.

    Returns:
        True for each pair that collides; False on the diagonal.
    """
    approach = closest_approach(positions, velocities)
    xp = approach.__array_namespace__()
    return (approach <= 2 * radius) & off_diagonal(xp, approach)


def touches(
    positions: Float[Array, "robots 2 *batch"], velocities: Float[Array, "robots 2 *batch"], radius: float
) -> Bool[Array, "robots *batch"]:
    """Says which robots collide with any other in one step; arguments as of `contacts`."""
    return fold(operator.or_, contacts(positions, velocities, radius))


def collides(
    positions: Float[Array, "robots 2 *batch"], velocities: Float[Array, "robots 2 *batch"], radius: float
) -> Bool[Array, "*batch"]:
    """Says whether any two robots collide in one step; arguments as of `contacts`."""
    touching = touches(positions, velocities, radius)
    return touching.__array_namespace__().any(touching, axis=0)


def outside(
    positions: Float[Array, "robots 2 *batch"], half_width: float, half_height: float
) -> Bool[Array, "robots *batch"]:
    """Says whose centre is outside the world |x| <= half_width, |y| <= half_height (or not a number)."""
    xp, positions = as_configuration(positions)
    x, y = xp.abs(positions[:, 0]), xp.abs(positions[:, 1])
    return ~((x <= half_width) & (y <= half_height))


def leaves(positions: Float[Array, "robots 2 *batch"], half_width: float, half_height: float) -> Bool[Array, "*batch"]:
    """Says whether any robot is outside the world."""
    gone = outside(positions, half_width, half_height)
    return gone.__array_namespace__().any(gone, axis=0)
