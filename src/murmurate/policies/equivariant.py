r"""One policy shared by all robots, blind to numbering, place and direction: the same weights serve any swarm.

Robot k moves along unit vectors u_ki towards the others and their perpendiculars,

    v_k = sum over i of g_ki u_ki + h_ki perp(u_ki),

with coefficients that depend on distances and angles between robots alone, so that permuting, translating or rotating
the swarm permutes, leaves or rotates its velocities. A known gathering point is one more thing that a robot sees.

The coefficients come from one round of messages: every robot sums up its surroundings, and each pair combines what it
is itself with what its two robots found around them. Features are projected per robot before pairs are formed, and the
batch stays last: wide arithmetic on narrow rows is what costs on a CPU.

A bound on each velocity component, as the paper has it, changes with the axes. Here the NORM is bounded by the speed
limit, which stays within the component bound in every direction; the world clips by component all the same.
"""

from __future__ import annotations

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate.policies.config import PolicyConfig, Sizes
from murmurate.policies.features import pair_channels, point, robot_channels, surroundings
from murmurate.policies.gaussian import Gaussian
from murmurate.policies.layers import Dense, Linear, bounded, fold

__all__ = ["EquivariantPolicy", "EquivariantValue", "ValueHead"]


class EquivariantPolicy(eqx.Module):
    """Maps positions to velocities by coefficients of unit vectors towards what each robot sees."""

    node: Dense
    pair: Dense
    mine: Linear
    theirs: Linear
    head: Dense
    to_point: Dense
    log_std: Float[Array, ""]
    basis: int = eqx.field(static=True)
    sizes: Sizes = eqx.field(static=True)

    def __init__(self, config: PolicyConfig, sizes: Sizes, key: PRNGKeyArray) -> None:
        keys = jax.random.split(key, 6)
        nodes, edges = config.hidden[0], config.hidden[-1]
        self.node = Dense(robot_channels(config.basis, sizes.landmark), nodes, keys[0], gain=5 / 3)
        self.pair = Dense(pair_channels(config.basis), edges, keys[1])
        self.mine = Linear(nodes, edges, keys[2])
        self.theirs = Linear(nodes, edges, keys[3])
        self.head = Dense(edges, 2, keys[4], gain=0.05)
        self.to_point = Dense(nodes, 2, keys[5], gain=0.05)
        self.log_std = jnp.zeros(())
        self.basis = config.basis
        self.sizes = sizes

    def __call__(self, positions: Float[Array, "robots 2 *batch"]) -> Float[Array, "robots 2 *batch"]:
        """Returns the most likely velocities, world units per step."""
        seen = surroundings(positions, self.basis, self.sizes)
        nodes = jnp.tanh(self.node(seen.robot))
        mine, theirs = self.mine(nodes), self.theirs(nodes)
        g, h = self.head(jnp.tanh(self.pair(seen.pair) + mine[:, :, None] + theirs[:, None, :]))
        ahead, aside = (g * seen.ux - h * seen.uy, g * seen.uy + h * seen.ux)
        vx, vy = fold(lambda i: (ahead[:, i], aside[:, i]), positions.shape[0])
        if self.sizes.landmark:
            px, py, _ = point(-positions[:, 0], -positions[:, 1], self.basis, self.sizes.safe_distance)
            g, h = self.to_point(nodes)
            vx, vy = vx + g * px - h * py, vy + g * py + h * px
        return bounded(vx, vy, self.sizes.max_speed)

    def distribution(self, positions: Float[Array, "robots 2 *batch"]) -> Gaussian:
        """Returns normal velocities around the most likely ones: each robot draws its own."""
        return Gaussian(self(positions), self.log_std + math.log(self.sizes.max_speed), joint=False)


class ValueHead(eqx.Module):
    """Maps what is known of every robot to its value, from that and the swarm's mean of it."""

    node: Dense
    mine: Dense
    ours: Linear
    head: Dense

    def __init__(self, features: int, width: int, key: PRNGKeyArray) -> None:
        keys = jax.random.split(key, 4)
        self.node = Dense(features, width, keys[0], gain=5 / 3)
        self.mine = Dense(width, width, keys[1], gain=5 / 3)
        self.ours = Linear(width, width, keys[2])
        self.head = Dense(width, 1, keys[3])

    def __call__(self, features: Float[Array, "features robots *batch"]) -> Float[Array, "robots *batch"]:
        """Returns every robot's value."""
        nodes = jnp.tanh(self.node(features))
        ours = self.ours(jnp.mean(nodes, axis=1))
        return self.head(jnp.tanh(self.mine(nodes) + ours[:, None]))[0]


class EquivariantValue(eqx.Module):
    """Maps positions to what is still to be gained by every robot, from its own surroundings and the swarm's mean."""

    valuation: ValueHead
    basis: int = eqx.field(static=True)
    sizes: Sizes = eqx.field(static=True)

    def __init__(self, config: PolicyConfig, sizes: Sizes, key: PRNGKeyArray) -> None:
        self.valuation = ValueHead(robot_channels(config.basis, sizes.landmark), config.hidden[0], key)
        self.basis = config.basis
        self.sizes = sizes

    def __call__(self, positions: Float[Array, "robots 2 *batch"]) -> Float[Array, "robots *batch"]:
        """Returns every robot's value of every configuration."""
        return self.valuation(surroundings(positions, self.basis, self.sizes).robot)
