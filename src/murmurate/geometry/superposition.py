"""Superposition: how one formation is laid on each of many swarms, by least squares."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from murmurate.geometry.assignment import assignment

__all__ = ["superposition"]

START_ANGLES = 8
"""Directions from which the best superposition is looked for."""

ROUNDS = 2
"""Rounds from each of them: places are assigned, then the formation is turned to fit them."""


def superposition(
    swarms: Float[Array, "robots 2 batch"], formation: Float[Array, "robots 2"], turned: bool = True
) -> tuple[Float[Array, " batch"], Int[Array, "robots batch"]]:
    """Returns by which angle a formation is turned, and which place each robot gets, where squared distances are least.

    From several directions, places are assigned and the formation is turned to suit them, in turns. Each turn lowers
    the sum; the least of the sums counts. It is almost always the least there is. No gradient passes through.

    Args:
        swarms: Positions, from the point around which the formation is turned.
        formation: The places of the formation, from the same point.
        turned: Whether it may be turned. Otherwise its places are assigned once.
    """
    swarms, formation = map(jax.lax.stop_gradient, (swarms, formation))
    robots, _, batch = swarms.shape
    # Where distances from the centre are fixed, the sum of the squared distances is least where that of products is
    # greatest, those of all places and robots turned by nothing (real) and by a quarter (imaginary).
    x, y = swarms[:, None, 0], swarms[:, None, 1]
    px, py = formation[None, :, 0, None], formation[None, :, 1, None]
    products = px * x + py * y, px * y - py * x
    if not turned:
        return jnp.zeros(batch, swarms.dtype), assignment(-products[0])
    along, across = (jnp.tile(z, START_ANGLES) for z in products)
    turn = jnp.repeat(jnp.arange(START_ANGLES) * (2 * math.pi / START_ANGLES), batch)
    order, real, imaginary = jnp.zeros((robots, START_ANGLES * batch), int), turn, turn
    for _ in range(ROUNDS):
        order = assignment(-(jnp.cos(turn) * along + jnp.sin(turn) * across))
        real, imaginary = (
            jnp.sum(jnp.take_along_axis(z, order[:, None], axis=1)[:, 0], axis=0) for z in (along, across)
        )
        turn = jnp.atan2(imaginary, real)
    best = jnp.argmax((real**2 + imaginary**2).reshape(START_ANGLES, batch), axis=0)
    place = best * batch + jnp.arange(batch)
    return turn[place], order[:, place]
