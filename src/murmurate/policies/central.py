"""The paper's policy: one network over the positions of all robots, and another for their value."""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate.policies.base import Policy, PolicyNetwork, check_hidden
from murmurate.policies.layers import Dense, Tanh, widened
from murmurate.representation import short_repr
from murmurate.world.config import WorldConfig

__all__ = ["CentralNetwork", "CentralPolicy", "CentralValue"]


@Policy.register("central")
class CentralPolicy(Policy):
    """The paper's policy: one network over all positions, for one size of swarm.

    Attributes:
        hidden: Widths of the tanh layers.
    """

    any_size: ClassVar[bool] = False

    hidden: tuple[int, ...] = eqx.field(default=(128, 128), static=True)

    def __check_init__(self) -> None:
        check_hidden(self.hidden)

    def networks(self, world: WorldConfig, landmark: bool, key: PRNGKeyArray) -> tuple[CentralNetwork, CentralValue]:
        """Builds the two networks; positions are in the world's frame, so no landmark is needed."""
        first, second = jax.random.split(key)
        return CentralNetwork(self, world, first), CentralValue(self, world, second)


class CentralNetwork(PolicyNetwork):
    """Maps all positions to all velocities; it knows its robots by number."""

    body: Tanh
    head: Dense
    log_std: Float[Array, "robots 2"]
    joint: bool = eqx.field(static=True)
    world: WorldConfig = eqx.field(static=True)

    def __init__(self, policy: CentralPolicy, world: WorldConfig, key: PRNGKeyArray) -> None:
        body, head = jax.random.split(key)
        features = 2 * world.robots
        self.body = Tanh(features, policy.hidden, body)
        self.head = Dense((features, *policy.hidden)[-1], features, head, gain=0.01)
        self.log_std = jnp.zeros((world.robots, 2), jnp.float32)
        self.joint = policy.credit == "swarm"
        self.world = world

    def __call__(self, observation: Float[Array, "robots 2 *batch"]) -> Float[Array, "robots 2 *batch"]:
        """Returns the most likely velocities, world units per step."""
        out = self.head(self.body(_features(observation, self.world)))
        return self.world.max_speed * out.reshape(observation.shape)

    def widened_to(self, template: PolicyNetwork) -> PolicyNetwork:
        """Returns this network with the width of a template that is for as many robots and has as many layers."""
        same = isinstance(template, CentralNetwork) and self.world.robots == template.world.robots
        return widened(self, template) if same else self

    @property
    def is_joint(self) -> bool:
        """Whether the swarm's velocities are ONE action."""
        return self.joint


class CentralValue(eqx.Module):
    """Maps all positions to the value of the configuration."""

    body: Tanh
    head: Dense
    world: WorldConfig = eqx.field(static=True)

    __repr__ = short_repr

    def __init__(self, policy: CentralPolicy, world: WorldConfig, key: PRNGKeyArray) -> None:
        body, head = jax.random.split(key)
        features = 2 * world.robots
        self.body = Tanh(features, policy.hidden, body)
        actions = 1 if policy.credit == "swarm" else world.robots
        self.head = Dense((features, *policy.hidden)[-1], actions, head, gain=1.0)
        self.world = world

    def __call__(self, positions: Float[Array, "robots 2 *batch"]) -> Float[Array, "actions *batch"]:
        """Returns the value of every configuration: one for the swarm, or one for each robot."""
        return self.head(self.body(_features(positions, self.world)))


def _features(positions: Float[Array, "robots 2 *batch"], world: WorldConfig) -> Float[Array, "features *batch"]:
    return positions.reshape((-1, *positions.shape[2:])) / max(world.half_width, world.half_height)
