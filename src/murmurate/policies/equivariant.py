r"""One policy shared by all robots, blind to numbering, place and direction: the same weights serve any swarm.

Robot k moves along unit vectors u_ki towards the others and their perpendiculars,

    v_k = sum over i of g_ki u_ki + h_ki perp(u_ki),

with coefficients that depend on distances and angles between robots alone, so that permuting, translating or rotating
the swarm permutes, leaves or rotates its velocities. A known gathering point is one more thing that a robot sees.

The coefficients come from one round of messages: every robot sums up its surroundings, and each pair combines what it
is itself with what its two robots found around them. Features are projected per robot before pairs are formed, and the
batch stays last: wide arithmetic on narrow rows is what costs on a CPU.

A bound on each velocity component, as the paper has it, changes with the axes. So the NORM is bounded by the speed
limit, which stays within the component bound in every direction. With `whole_square` each component is: directions are
the same then, but along a diagonal robots move up to sqrt(2) times as fast.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate.errors import InputError, check_number
from murmurate.geometry._batch_last import sum_terms
from murmurate.policies.base import Policy, PolicyNetwork, check_hidden
from murmurate.policies.features import (
    PositionFeatures,
    Surroundings,
    pair_channels,
    point,
    position_features,
    robot_channels,
    surroundings,
)
from murmurate.policies.layers import Dense, Linear, bounded, bounded_by_component, widened
from murmurate.representation import short_repr
from murmurate.world.config import WorldConfig

__all__ = ["EquivariantNetwork", "EquivariantPolicy", "EquivariantValue", "SharedPolicy", "ValueHead"]


class SharedPolicy(Policy):
    """Base of policies whose network is shared by all robots, so that it serves swarms of any size.

    Attributes:
        hidden: Widths of the node and the edge layer; one number serves for both.
        basis: Number of radial basis functions.
    """

    hidden: tuple[int, ...] = eqx.field(default=(128, 128), static=True)
    basis: int = eqx.field(default=8, static=True)

    def __check_init__(self) -> None:
        check_hidden(self.hidden, most=2)
        check_number("basis", self.basis, 2, 1000, integer=True)
        if self.credit == "swarm":
            raise InputError("credit", self.credit, f"robots: with {self.name} each robot acts on its own")


@Policy.register("equivariant")
class EquivariantPolicy(SharedPolicy):
    """One network shared by all robots, each of which sees all positions.

    Attributes:
        hidden: Widths of the node and the edge layer; one number serves for both.
        basis: Number of radial basis functions.
        whole_square: Whether the speed limit is that of each component of a velocity, as in the paper, instead of its
            norm. Robots then need a common frame.
    """

    whole_square: bool = eqx.field(default=False, static=True)

    def networks(
        self, world: WorldConfig, landmark: bool, key: PRNGKeyArray
    ) -> tuple[EquivariantNetwork, EquivariantValue]:
        """Builds the two networks."""
        first, second = jax.random.split(key)
        return EquivariantNetwork(self, world, landmark, first), EquivariantValue(self, world, landmark, second)


class EquivariantNetwork(PolicyNetwork):
    """Maps positions to velocities by coefficients of unit vectors towards what each robot sees."""

    node: Dense
    pair: Dense
    mine: Linear
    theirs: Linear
    head: Dense
    to_point: Dense
    log_std: Float[Array, ""]
    basis: int = eqx.field(static=True)
    world: WorldConfig = eqx.field(static=True)
    landmark: bool = eqx.field(static=True)
    whole_square: bool = eqx.field(static=True)

    def __init__(self, policy: EquivariantPolicy, world: WorldConfig, landmark: bool, key: PRNGKeyArray) -> None:
        keys = jax.random.split(key, 6)
        nodes, edges = policy.hidden[0], policy.hidden[-1]
        self.node = Dense(robot_channels(policy.basis, landmark), nodes, keys[0], gain=5 / 3)
        self.pair = Dense(pair_channels(policy.basis), edges, keys[1])
        self.mine = Linear(nodes, edges, keys[2])
        self.theirs = Linear(nodes, edges, keys[3])
        self.head = Dense(edges, 2, keys[4], gain=0.05)
        self.to_point = Dense(nodes, 2, keys[5], gain=0.05)
        self.log_std = jnp.zeros(())
        self.basis = policy.basis
        self.world = world
        self.landmark = landmark
        self.whole_square = policy.whole_square

    def features(self, observation: Float[Array, "robots 2 *batch"]) -> PositionFeatures:
        """Returns positions with what takes longest to compute from them, a sum over all triples of robots."""
        return position_features(observation, self.world)

    def __call__(
        self, observation: Float[Array, "robots 2 *batch"] | PositionFeatures
    ) -> Float[Array, "robots 2 *batch"]:
        """Returns the most likely velocities, world units per step."""
        positions, around = _seen(observation, self.basis, self.world, self.landmark)
        nodes = jnp.tanh(self.node(around.robot))
        observing, observed = self.mine(nodes), self.theirs(nodes)
        g, h = self.head(jnp.tanh(self.pair(around.pair) + observing[:, :, None] + observed[:, None, :]))
        ahead, aside = (g * around.ux - h * around.uy, g * around.uy + h * around.ux)
        vx, vy = sum_terms(lambda i: (ahead[:, i], aside[:, i]), positions.shape[0])
        if self.landmark:
            px, py, _ = point(-positions[:, 0], -positions[:, 1], self.basis, self.world.safe_distance)
            g, h = self.to_point(nodes)
            vx, vy = vx + g * px - h * py, vy + g * py + h * px
        shorten = bounded_by_component if self.whole_square else bounded
        return shorten(vx, vy, self.world.max_speed)

    def widened_to(self, template: PolicyNetwork) -> PolicyNetwork:
        """Returns this network with the width of a template that has the same inputs."""
        if not isinstance(template, EquivariantNetwork):
            return self
        same = (self.basis, self.landmark) == (template.basis, template.landmark)
        return widened(self, template) if same else self


class ValueHead(eqx.Module):
    """Maps what is known of every robot to its value, from that and the swarm's mean of it."""

    node: Dense
    mine: Dense
    ours: Linear
    head: Dense

    __repr__ = short_repr

    def __init__(self, features: int, width: int, key: PRNGKeyArray) -> None:
        keys = jax.random.split(key, 4)
        self.node = Dense(features, width, keys[0], gain=5 / 3)
        self.mine = Dense(width, width, keys[1], gain=5 / 3)
        self.ours = Linear(width, width, keys[2])
        self.head = Dense(width, 1, keys[3])

    def __call__(self, features: Float[Array, "features robots *batch"]) -> Float[Array, "robots *batch"]:
        """Returns every robot's value."""
        nodes = jnp.tanh(self.node(features))
        swarm = self.ours(jnp.mean(nodes, axis=1))
        return self.head(jnp.tanh(self.mine(nodes) + swarm[:, None]))[0]


class EquivariantValue(eqx.Module):
    """Maps positions to what is still to be gained by every robot, from its own surroundings and the swarm's mean."""

    valuation: ValueHead
    basis: int = eqx.field(static=True)
    world: WorldConfig = eqx.field(static=True)
    landmark: bool = eqx.field(static=True)

    __repr__ = short_repr

    def __init__(self, policy: SharedPolicy, world: WorldConfig, landmark: bool, key: PRNGKeyArray) -> None:
        self.valuation = ValueHead(robot_channels(policy.basis, landmark), policy.hidden[0], key)
        self.basis = policy.basis
        self.world = world
        self.landmark = landmark

    def __call__(
        self, observation: Float[Array, "robots 2 *batch"] | PositionFeatures
    ) -> Float[Array, "robots *batch"]:
        """Returns every robot's value of every configuration."""
        return self.valuation(_seen(observation, self.basis, self.world, self.landmark)[1].robot)


def _seen(
    observation: Float[Array, "robots 2 *batch"] | PositionFeatures, basis: int, world: WorldConfig, landmark: bool
) -> tuple[Float[Array, "robots 2 *batch"], Surroundings]:
    """Returns the positions in an observation or in its features, and what every robot sees there."""
    positions, shadows = observation if isinstance(observation, PositionFeatures) else (observation, None)
    return positions, surroundings(positions, basis, world, landmark, shadows=shadows)
