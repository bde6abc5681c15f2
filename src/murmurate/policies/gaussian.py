"""The action distribution of both policies: independent normal velocities."""

from __future__ import annotations

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

__all__ = ["Gaussian"]


class Gaussian(eqx.Module):
    """Independent normal velocities of all robots; the batch is last.

    Attributes:
        mean: The most likely velocities.
        log_std: Logarithm of their spread: one number, or one for each component.
        joint: Whether the swarm's velocities are ONE action. Otherwise every robot's is an action of its own, with a
            log density, so a probability ratio, of its own.
    """

    mean: Float[Array, "robots 2 *batch"]
    log_std: Float[Array, "..."]
    joint: bool = eqx.field(static=True)

    def sample(self, key: PRNGKeyArray) -> Float[Array, "robots 2 *batch"]:
        """Draws velocities."""
        return self.mean + jnp.exp(self.log_std) * jax.random.normal(key, self.mean.shape)

    def log_prob(self, action: Float[Array, "robots 2 *batch"]) -> Float[Array, "actions *batch"]:
        """Returns the log density of every action: one (`joint`), or one a robot."""
        z = (action - self.mean) * jnp.exp(-self.log_std)
        density = -0.5 * z * z - self.log_std - 0.5 * math.log(2 * math.pi)
        return jnp.sum(density, axis=(0, 1))[None] if self.joint else jnp.sum(density, axis=1)
