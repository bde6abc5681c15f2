"""Distances between robots, contact during a step, and leaving the world.

Within a step every robot moves in a straight line at constant velocity. Two robots touch during a step when the
distance of their centres is at most 2 R at any moment of it: the closest approach, in closed form.

Functions take positions and velocities `(..., robots, 2)`, batch axes first, and compute in the library of their
argument, NumPy or JAX, as the functions for visibility do.
"""

from __future__ import annotations

from typing import Any

from jaxtyping import Bool, Float

from murmurate.errors import InputError
from murmurate.geometry import _batch_last
from murmurate.geometry._checks import (
    check_length,
    check_vectors,
    pairs_first,
    robots_first,
    to_batch_last,
    to_last,
)

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

Array = Any  # a NumPy or a JAX array


def distances(positions: Float[Array, "*batch robots 2"]) -> Float[Array, "*batch robots robots"]:
    """Returns the distances between centres, world units; 0 on the diagonal.

    Args:
        positions: Centres of the robots, world units.

    Raises:
        InputError: The positions are not finite numbers of that shape.
    """
    xp, positions = to_batch_last("positions", positions)
    return pairs_first(xp, _batch_last.distances(positions))


def clearances(positions: Float[Array, "*batch robots 2"], radius: float) -> Float[Array, "*batch robots robots"]:
    """Returns the gaps between the edges of the discs, world units: negative where discs overlap.

    Args:
        positions: Centres of the robots, world units.
        radius: The paper's R_bot, world units.

    Returns:
        The gap of each pair; inf on the diagonal.

    Raises:
        InputError: The positions are not finite numbers of that shape, or the radius is not positive.
    """
    xp, positions = to_batch_last("positions", positions)
    check_length("radius", radius)
    return pairs_first(xp, _batch_last.clearances(positions, radius))


def closest_approach(
    positions: Float[Array, "*batch robots 2"], velocities: Float[Array, "*batch robots 2"]
) -> Float[Array, "*batch robots robots"]:
    """Returns the least distance of each pair of centres at any moment of one step.

    Args:
        positions: Centres at the start of the step, world units.
        velocities: Constant velocities during the step, world units per step.

    Returns:
        The closest approach of each pair, world units; 0 on the diagonal.

    Raises:
        InputError: The positions or velocities are not finite numbers of one and the same shape.
    """
    xp, positions, velocities = _step(positions, velocities)
    return pairs_first(xp, _batch_last.closest_approach(positions, velocities))


def contact_matrix(
    positions: Float[Array, "*batch robots 2"], velocities: Float[Array, "*batch robots 2"], radius: float
) -> Bool[Array, "*batch robots robots"]:
    """Returns which pairs of discs touch or overlap at any moment of one step.

    Args:
        positions: Centres at the start of the step, world units.
        velocities: Constant velocities during the step, world units per step.
        radius: The paper's R_bot, world units.

    Returns:
        True for each pair in contact; False on the diagonal.

    Raises:
        InputError: The positions or velocities are not finite numbers of one and the same shape, or the radius is not
            positive.
    """
    xp, positions, velocities = _step(positions, velocities)
    check_length("radius", radius)
    return pairs_first(xp, _batch_last.contact_matrix(positions, velocities, radius))


def in_contact(
    positions: Float[Array, "*batch robots 2"], velocities: Float[Array, "*batch robots 2"], radius: float
) -> Bool[Array, "*batch robots"]:
    """Returns which robots touch another one during one step; for the arguments see `contact_matrix`."""
    xp, positions, velocities = _step(positions, velocities)
    check_length("radius", radius)
    return robots_first(xp, _batch_last.in_contact(positions, velocities, radius))


def any_contact(
    positions: Float[Array, "*batch robots 2"], velocities: Float[Array, "*batch robots 2"], radius: float
) -> Bool[Array, "*batch"]:
    """Returns whether any two robots touch during one step; for the arguments see `contact_matrix`."""
    _, positions, velocities = _step(positions, velocities)
    check_length("radius", radius)
    return _batch_last.any_contact(positions, velocities, radius)


def outside(
    positions: Float[Array, "*batch robots 2"], half_width: float, half_height: float
) -> Bool[Array, "*batch robots"]:
    """Returns which centres are outside the world |x| <= half_width, |y| <= half_height.

    Args:
        positions: Centres of the robots, world units.
        half_width: The paper's X, world units.
        half_height: The paper's Y, world units.

    Raises:
        InputError: The positions are not finite numbers of that shape, or a length is not positive.
    """
    xp, positions = to_batch_last("positions", positions)
    check_length("half_width", half_width, infinite=True)
    check_length("half_height", half_height, infinite=True)
    return robots_first(xp, _batch_last.outside(positions, half_width, half_height))


def any_outside(
    positions: Float[Array, "*batch robots 2"], half_width: float, half_height: float
) -> Bool[Array, "*batch"]:
    """Returns whether any robot is outside the world; for the arguments see `outside`."""
    _, positions = to_batch_last("positions", positions)
    check_length("half_width", half_width, infinite=True)
    check_length("half_height", half_height, infinite=True)
    return _batch_last.any_outside(positions, half_width, half_height)


def _step(positions: Any, velocities: Any) -> tuple[Any, Any, Any]:
    xp, positions = check_vectors("positions", positions)
    _, velocities = check_vectors("velocities", velocities)
    if velocities.shape != positions.shape:
        raise InputError("velocities", velocities.shape, f"of the positions' shape, {positions.shape}")
    return xp, to_last(xp, positions), to_last(xp, velocities)
