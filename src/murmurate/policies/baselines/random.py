"""Any direction, whatever is seen: the floor of every comparison."""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from murmurate.types import Observation
from murmurate.world.config import WorldConfig

__all__ = ["RandomWalk"]


class RandomWalk(eqx.Module):
    """Moves each robot anywhere in the disc of its speed limit, drawn by hashing its view; it avoids nobody.

    So it has no state and no randomness of its own: the same view leads to the same velocity. Unlike every other
    baseline it moves otherwise in a frame that is turned, or when robots are renumbered, as a walk at random may.
    """

    title: ClassVar[str] = "Random walk"
    centralised: ClassVar[bool] = False
    deviations: ClassVar[str] = ""
    world: WorldConfig = eqx.field(static=True)
    landmark: bool = eqx.field(static=True)

    def __call__(self, observation: Observation) -> Float[Array, "robots 2 *batch"]:
        """Returns velocities in each robot's own frame, world units per step."""
        view = observation.view
        unit = view.radius[:, None]
        total = jnp.sum(jnp.sin(12.9898 * view.x / unit) + jnp.sin(78.233 * view.y / unit), axis=1)
        angle, share = 2 * jnp.pi * _hashed(total), jnp.sqrt(_hashed(total + 1.0))
        speed = (1 - 1e-6) * self.world.max_speed * share
        return jnp.stack([speed * jnp.cos(angle), speed * jnp.sin(angle)], axis=1)


def _hashed(number: Array) -> Array:
    """Returns a number in [0, 1) that any small change of the argument changes as if at random."""
    return jnp.mod(jnp.sin(number) * 43758.547, 1.0)
