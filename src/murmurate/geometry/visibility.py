r"""Which robots neighbour, occlude and see each other, in swarms of fat, opaque robots.

Robot i is occluded by j from k when any part of disc i lies in the shadow that disc j throws in the light of a point
source at the centre of k. For disjoint equal discs this is exactly: j is nearer to k than i is, and the open angular
intervals [theta - asin(R / d), theta + asin(R / d)] that both discs cover, seen from k, overlap.

Functions take positions `(..., robots, 2)`, batch axes first, and compute in the library of their argument: NumPy in,
NumPy out in that precision; JAX in, JAX out. They may be called under `jax.jit` and `jax.vmap`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from murmurate.errors import InputError
from murmurate.geometry import _batch_last
from murmurate.geometry._checks import check_length, pairs_first, robots_first, to_batch_last

__all__ = ["neighbors", "neighbors_and_visible", "occluded", "shadow", "sole_occluder_counts", "visible"]

Array = Any  # a NumPy or a JAX array


def neighbors(positions: Float[Array, "*batch robots 2"], scan_radius: float) -> Bool[Array, "*batch robots robots"]:
    """Returns which robots are neighbours: their centres are at most `scan_radius` apart.

    Args:
        positions: Centres of the robots, world units.
        scan_radius: The paper's R_scan, world units.

    Returns:
        True where the robot of the column is a neighbour of the robot of the row; False on the diagonal.

    Raises:
        InputError: The positions are not finite numbers of that shape, or a length is not positive.
    """
    xp, positions = to_batch_last("positions", positions)
    check_length("scan_radius", scan_radius, infinite=True)
    return pairs_first(xp, _batch_last.neighbors(positions, scan_radius))


def occluded(positions: Float[Array, "*batch robots 2"], radius: float) -> Bool[Array, "*batch robots robots"]:
    """Returns which robots lie, in part or whole, in a shadow thrown by any third robot.

    Args:
        positions: Centres of the robots, world units.
        radius: The paper's R_bot, world units.

    Returns:
        True where the robot of the column is occluded from the robot of the row; False on the diagonal.

    Raises:
        InputError: The positions are not finite numbers of that shape, or the radius is not positive.
    """
    xp, positions = to_batch_last("positions", positions)
    check_length("radius", radius)
    return pairs_first(xp, _batch_last.occluded(positions, radius))


def visible(
    positions: Float[Array, "*batch robots 2"], radius: float, scan_radius: float
) -> Bool[Array, "*batch robots robots"]:
    """Returns which robots are fully visible neighbours: within `scan_radius` and not occluded.

    Args:
        positions: Centres of the robots, world units.
        radius: The paper's R_bot, world units.
        scan_radius: The paper's R_scan, world units.

    Returns:
        True where the robot of the column is visible from the robot of the row; False on the diagonal.

    Raises:
        InputError: The positions are not finite numbers of that shape, or a length is not positive.
    """
    return neighbors_and_visible(positions, radius, scan_radius)[1]


def neighbors_and_visible(
    positions: Float[Array, "*batch robots 2"], radius: float, scan_radius: float
) -> tuple[Bool[Array, "*batch robots robots"], Bool[Array, "*batch robots robots"]]:
    """Returns `neighbors` and `visible` from one pass over the pairs."""
    xp, positions = to_batch_last("positions", positions)
    check_length("radius", radius)
    check_length("scan_radius", scan_radius, infinite=True)
    near, seen = _batch_last.neighbors_and_visible(positions, radius, scan_radius)
    return pairs_first(xp, near), pairs_first(xp, seen)


def sole_occluder_counts(
    positions: Float[Array, "*batch robots 2"], radius: float, scan_radius: float
) -> Float[Array, "*batch robots"]:
    """Returns for each robot how many pairs of others would see each other if that robot were not there.

    Args:
        positions: Centres of the robots, world units.
        radius: The paper's R_bot, world units.
        scan_radius: The paper's R_scan, world units; pairs that are farther apart do not count.

    Returns:
        Ordered pairs (observer, observed) that the robot alone occludes, in the precision of the positions.

    Raises:
        InputError: The positions are not finite numbers of that shape, or a length is not positive.
    """
    xp, positions = to_batch_last("positions", positions)
    check_length("radius", radius)
    check_length("scan_radius", scan_radius, infinite=True)
    return robots_first(xp, _batch_last.sole_occluder_counts(positions, radius, scan_radius))


def shadow(
    observer: Float[np.ndarray, "2"], occluder: Float[np.ndarray, "2"], radius: float, reach: float
) -> Float[np.ndarray, "4 2"]:
    """Returns the outline of the shadow that one robot throws in the light at another's centre, for drawing.

    Two tangents from the light touch the occluder. The shadow lies between them, beyond the chord between the two
    points where they touch. (The occluder's own disc covers what the chord cuts off.)

    Args:
        observer: Position of the light, world units.
        occluder: Centre of the robot that throws the shadow, world units.
        radius: The paper's R_bot, world units.
        reach: Distance from the light at which the outline ends, along the tangents, world units.

    Returns:
        The four corners, clockwise from the point where the left tangent, as seen from the light, touches.

    Raises:
        InputError: The light is not outside the occluder, or the tangents end before they touch it.
    """
    check_length("radius", radius)
    light = np.asarray(observer, dtype=float)
    towards = np.asarray(occluder, dtype=float) - light
    if towards.shape != (2,):
        raise InputError("occluder", np.shape(occluder), "one point, as the observer")
    distance = math.hypot(*towards)
    if not radius < distance < math.inf:
        raise InputError("occluder", distance, f"farther than the radius, {radius:g}, from the observer")
    length = math.sqrt((distance - radius) * (distance + radius))
    if not length <= reach < math.inf:
        raise InputError("reach", reach, f"finite and at least {length:g}, where the tangents touch the occluder")
    across = np.array([-towards[1], towards[0]])
    # Unit vectors along the tangents: the direction to the occluder turned by +-alpha, sin(alpha) = R / d.
    left, right = ((length * towards + side * radius * across) / distance**2 for side in (1, -1))
    return light + np.stack([length * left, reach * left, reach * right, length * right])
