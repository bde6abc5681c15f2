"""The paper's policy: one network over the positions of all robots, and another for their value."""

from __future__ import annotations

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate.policies.config import PolicyConfig, Sizes
from murmurate.policies.gaussian import Gaussian
from murmurate.policies.layers import Dense, Tanh

__all__ = ["CentralPolicy", "CentralValue"]


def _features(positions: Float[Array, "robots 2 *batch"], sizes: Sizes) -> Float[Array, "features *batch"]:
    return positions.reshape((-1, *positions.shape[2:])) / max(sizes.half_width, sizes.half_height)


class CentralPolicy(eqx.Module):
    """Maps all positions to all velocities; it knows its robots by number."""

    body: Tanh
    head: Dense
    log_std: Float[Array, "robots 2"]
    joint: bool = eqx.field(static=True)
    sizes: Sizes = eqx.field(static=True)

    def __init__(self, config: PolicyConfig, sizes: Sizes, key: PRNGKeyArray) -> None:
        body, head = jax.random.split(key)
        features = 2 * sizes.robots
        self.body = Tanh(features, config.hidden, body)
        self.head = Dense((features, *config.hidden)[-1], features, head, gain=0.01)
        self.log_std = jnp.zeros((sizes.robots, 2))
        self.joint = config.credit == "swarm"
        self.sizes = sizes

    def __call__(self, positions: Float[Array, "robots 2 *batch"]) -> Float[Array, "robots 2 *batch"]:
        """Returns the most likely velocities, world units per step."""
        out = self.head(self.body(_features(positions, self.sizes)))
        return self.sizes.max_speed * out.reshape(positions.shape)

    def distribution(self, positions: Float[Array, "robots 2 *batch"]) -> Gaussian:
        """Returns normal velocities around the most likely ones: one action of the swarm, or one of every robot."""
        log_std = self.log_std.reshape(self.log_std.shape + (1,) * (positions.ndim - 2))
        return Gaussian(self(positions), log_std + math.log(self.sizes.max_speed), joint=self.joint)


class CentralValue(eqx.Module):
    """Maps all positions to the value of the configuration."""

    body: Tanh
    head: Dense
    sizes: Sizes = eqx.field(static=True)

    def __init__(self, config: PolicyConfig, sizes: Sizes, key: PRNGKeyArray) -> None:
        body, head = jax.random.split(key)
        features = 2 * sizes.robots
        self.body = Tanh(features, config.hidden, body)
        actions = 1 if config.credit == "swarm" else sizes.robots
        self.head = Dense((features, *config.hidden)[-1], actions, head, gain=1.0)
        self.sizes = sizes

    def __call__(self, positions: Float[Array, "robots 2 *batch"]) -> Float[Array, "actions *batch"]:
        """Returns the value of every configuration: one of the swarm, or one of every robot."""
        return self.head(self.body(_features(positions, self.sizes)))
