"""Obstacles that stand still: how far robots are from them, whether robots touch them, and which robots they hide.

Obstacles are discs of any radius, `(..., discs, 3)`: x, y and radius; and straight walls without thickness,
`(..., walls, 4)`: x and y of both ends. Answers number the discs first, then the walls. A disc of radius -inf is
absent, so that episodes with fewer discs fit into one array.

Robot i is occluded by an obstacle from k when any part of disc i lies in the shadow that the obstacle throws in the
light of a point source at the centre of k. Functions take the batch axes first, and compute in the library of the
positions, NumPy or JAX, as the functions for visibility do.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from murmurate.errors import InputError
from murmurate.geometry import _batch_last
from murmurate.geometry._batch_last.loops import is_traced
from murmurate.geometry._checks import check_length, check_vectors, pairs_first, to_last

__all__ = ["obstacle_approach", "obstacle_clearances", "occluded_by_obstacles"]

Array = Any  # a NumPy or a JAX array


def obstacle_clearances(
    positions: Float[Array, "*batch robots 2"],
    radius: float,
    discs: Float[Array, "*batch discs 3"],
    walls: Float[Array, "*batch walls 4"],
) -> Float[Array, "*batch robots obstacles"]:
    """Returns the gaps between the edges of robots and obstacles, world units.

    Args:
        positions: Centres of the robots, world units.
        radius: The paper's R_bot, world units.
        discs: x, y and radius of each disc, world units.
        walls: x, y, x and y of both ends of each wall, world units.

    Returns:
        The gaps: negative where a robot overlaps an obstacle, inf of absent discs.

    Raises:
        InputError: An argument is not finite numbers of its shape, or a radius is not positive.
    """
    xp, positions, discs, walls = _checked(positions, radius, discs, walls)
    return pairs_first(xp, _batch_last.obstacle_clearances(positions, radius, discs, walls))


def obstacle_approach(
    positions: Float[Array, "*batch robots 2"],
    velocities: Float[Array, "*batch robots 2"],
    radius: float,
    discs: Float[Array, "*batch discs 3"],
    walls: Float[Array, "*batch walls 4"],
) -> Float[Array, "*batch robots obstacles"]:
    """Returns the least gaps between robots and obstacles at any moment of one step: contact where one is <= 0.

    Args:
        positions: Centres of the robots at the start of the step, world units.
        velocities: Constant velocities during the step, world units per step.
        radius: The paper's R_bot, world units.
        discs: x, y and radius of each disc, world units.
        walls: x, y, x and y of both ends of each wall, world units.

    Raises:
        InputError: An argument is not finite numbers of its shape, or a radius is not positive.
    """
    _, velocities = check_vectors("velocities", velocities)
    if np.shape(positions) != velocities.shape:
        raise InputError("velocities", velocities.shape, f"of the positions' shape, {np.shape(positions)}")
    xp, positions, discs, walls = _checked(positions, radius, discs, walls)
    return pairs_first(xp, _batch_last.obstacle_approach(positions, to_last(xp, velocities), radius, discs, walls))


def occluded_by_obstacles(
    positions: Float[Array, "*batch robots 2"],
    radius: float,
    discs: Float[Array, "*batch discs 3"],
    walls: Float[Array, "*batch walls 4"],
) -> Bool[Array, "*batch robots robots"]:
    """Returns which robots lie, in part or whole, in the shadow of an obstacle.

    Args:
        positions: Centres of the robots, world units.
        radius: The paper's R_bot, world units.
        discs: x, y and radius of each disc, world units.
        walls: x, y, x and y of both ends of each wall, world units.

    Returns:
        True where the robot of the column is occluded from the robot of the row; False on the diagonal.

    Raises:
        InputError: An argument is not finite numbers of its shape, or a radius is not positive.
    """
    xp, positions, discs, walls = _checked(positions, radius, discs, walls)
    return pairs_first(xp, _batch_last.occluded_by_obstacles(positions, radius, discs, walls))


def _checked(positions: Any, radius: Any, discs: Any, walls: Any) -> tuple[Any, Any, Any, Any]:
    """Returns the array namespace, and checked positions, discs and walls with the batch last."""
    xp, positions = check_vectors("positions", positions)
    check_length("radius", radius)
    batch = tuple(positions.shape[:-2])
    parts = []
    for field, rows, length in (("discs", discs, 3), ("walls", walls, 4)):
        allowed = f"finite numbers of shape (..., {field}, {length}) with the batch axes of the positions"
        try:
            rows = xp.asarray(rows, dtype=positions.dtype)
        except (TypeError, ValueError):
            raise InputError(field, type(rows).__name__, allowed) from None
        if rows.ndim < 2 or rows.shape[-1] != length or tuple(rows.shape[:-2]) not in (batch, ()):
            raise InputError(field, tuple(rows.shape), allowed)
        if not is_traced(rows):
            _check_numbers(field, np.asarray(rows, float), allowed)
        rows = xp.broadcast_to(rows, (*batch, *rows.shape[-2:]))
        parts.append(to_last(xp, rows))
    return xp, to_last(xp, positions), *parts


def _check_numbers(field: str, rows: np.ndarray, allowed: str) -> None:
    numbers, radii = (rows[..., :2], rows[..., 2]) if field == "discs" else (rows, np.ones(()))
    if not np.isfinite(numbers).all():
        raise InputError(field, numbers[~np.isfinite(numbers)][0].item(), allowed)
    wrong = ~((radii > 0) & (radii < np.inf) | (radii == -np.inf))
    if wrong.any():
        raise InputError(field, f"the radius {radii[wrong][0]:g}", "of radii > 0, or -inf of an absent disc")
