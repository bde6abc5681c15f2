r"""One policy that every robot of every swarm runs on what it alone perceives: local, anonymous, oblivious, silent.

Robot k moves along unit vectors u_ki towards those that it perceives, and their perpendiculars,

    v_k = sum over i of w(d_ki) (g_ki u_ki + h_ki perp(u_ki)) + mean over i of (g'_ki u_ki + h'_ki perp(u_ki)),

with coefficients that depend on the distances and angles in its own view alone. Who matters most is summed up: who is
near (w falls off about where neighbours are on a ring, and only so many robots fit there), and who is about to hide, to
be hidden, or to be hidden behind the robot itself, however far (w is bounded by their number). Everybody else is
averaged. What is far is measured by the mean distance of all that are seen, and so are neighbours on a ring; what is
counted enters by its logarithm, and two things are the same on every ring, however many robots it has: how far a robot
stands out from the line between its neighbours on the hull of what it sees, and how much wider that is than it must be.
So nothing grows with the swarm or its width, and the same weights act in swarms larger than those they were trained in.

Lengths are taken in radii as the robot perceives them, so that its unit of length drops out; turning its frame turns
its velocity with it. Where walls are perceived, nobody goes more than a share of its way to one in a step.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from murmurate.policies.config import PolicyConfig, Sizes
from murmurate.policies.equivariant import ValueHead
from murmurate.policies.features import (
    SHADOWS,
    Surroundings,
    measured,
    pair_channels,
    point,
    radial_basis,
    robot_channels,
    surroundings,
)
from murmurate.policies.gaussian import Gaussian
from murmurate.policies.hull import CORNER_CHANNELS, EDGE_CHANNELS, hull
from murmurate.policies.layers import Dense, Linear, bounded, fold

__all__ = ["LocalPolicy", "LocalValue", "Perception", "View", "ways"]


BRAKE = 0.2
"""Share of its way to a wall that a robot goes in a step, at most; moves of up to 5 steps end before it."""

CRITICAL = 6.0
"""Lines of sight about to be crossed weigh, all together, less than so many robots near by."""


class View(Protocol):
    """What every robot perceives, in a frame and a unit of its own; the observer is the first axis."""

    @property
    def x(self) -> Float[Array, "robots robots *batch"]:
        """First coordinate of each robot that is perceived."""
        ...

    @property
    def y(self) -> Float[Array, "robots robots *batch"]:
        """Second coordinate, likewise."""
        ...

    @property
    def seen(self) -> Bool[Array, "robots robots *batch"]:
        """Which robots are perceived."""
        ...

    @property
    def radius(self) -> Float[Array, "robots *batch"]:
        """The robots' radius in the observer's unit."""
        ...

    @property
    def point_x(self) -> Float[Array, "robots *batch"]:
        """First coordinate of the gathering point."""
        ...

    @property
    def point_y(self) -> Float[Array, "robots *batch"]:
        """Second coordinate of it."""
        ...

    @property
    def walls(self) -> Float[Array, "robots 4 2 *batch"] | None:
        """The nearest point of each wall, opposite ones two places apart; None where walls are not perceived."""
        ...


class Perception(Protocol):
    """An observation that says what the robots perceive, and what there is."""

    @property
    def view(self) -> View:
        """What the robots perceive."""
        ...

    @property
    def positions(self) -> Float[Array, "robots 2 *batch"]:
        """Where they are."""
        ...

    @property
    def walls(self) -> Float[Array, "robots *batch"]:
        """How far each is from the nearest wall."""
        ...


class LocalPolicy(eqx.Module):
    """Maps what each robot perceives to its velocity, in its own frame, world units per step."""

    node: Dense
    pair: Dense
    mine: Linear
    head: Dense
    to_point: Dense
    log_std: Float[Array, ""]
    basis: int = eqx.field(static=True)
    sizes: Sizes = eqx.field(static=True)

    def __init__(self, config: PolicyConfig, sizes: Sizes, key: PRNGKeyArray) -> None:
        keys = jax.random.split(key, 5)
        nodes, edges = config.hidden[0], config.hidden[-1]
        robots = robot_channels(config.basis, sizes.landmark, scale_free=True) + CORNER_CHANNELS
        self.node = Dense(robots, nodes, keys[0], gain=5 / 3)
        self.pair = Dense(pair_channels(config.basis) + EDGE_CHANNELS, edges, keys[1])
        self.mine = Linear(nodes, edges, keys[2])
        self.head = Dense(edges, 4, keys[3], gain=0.05)
        self.to_point = Dense(nodes, 2, keys[4], gain=0.05)
        self.log_std = jnp.zeros(())
        self.basis = config.basis
        self.sizes = sizes

    def __call__(self, observation: Perception) -> Float[Array, "robots 2 *batch"]:
        """Returns the most likely velocities; nothing but the view is looked at."""
        view, sizes = observation.view, self.sizes
        # In world units, by the size at which robots are perceived.
        scale = sizes.radius / view.radius
        x, y = view.x * scale[:, None], view.y * scale[:, None]
        px, py = view.point_x * scale, view.point_y * scale
        seen = view.seen & (x * x + y * y > 0)
        around = measured(x, y, seen, px, py, self.basis, sizes, scale_free=True)
        square = jnp.where(seen, x * x + y * y, 1.0)
        outline = hull(around.ux, around.uy, jnp.sqrt(square) / sizes.radius, seen)
        nodes = jnp.tanh(self.node(jnp.concatenate([_compressed(around.robot), outline.robot])))
        pairs = jnp.concatenate([_compressed(around.pair), outline.pair])
        edges = jnp.tanh(self.pair(pairs) + self.mine(nodes)[:, :, None])
        weight = self._weight(around)
        vx, vy = self._sum(around, self.head(edges), weight, seen)
        if sizes.landmark:
            ux, uy, _ = point(px, py, self.basis, sizes.safe_distance)
            g, h = self.to_point(nodes)
            vx, vy = vx + g * ux - h * uy, vy + g * uy + h * ux
        velocity = bounded(vx, vy, sizes.max_speed)
        return velocity if view.walls is None else braked(velocity, view.walls * scale[:, None, None])

    def _weight(self, around: Surroundings) -> Array:
        """How much each robot seen counts, besides in the mean."""
        hiding, _, hidden, _, behind, _ = around.pair[-SHADOWS:]
        critical = jnp.tanh(hiding + hidden + behind)
        # However many they are, they weigh no more than so many.
        most = CRITICAL / (CRITICAL + jnp.sum(critical, axis=1))[:, None]
        near = jnp.exp(-jnp.exp(2 * around.logarithm) / 4)
        return jnp.maximum(near, most * critical)

    def _sum(self, around: Surroundings, head: Any, weight: Array, seen: Array) -> tuple[Array, Array]:
        g, h, far_g, far_h = head
        share = 1 / jnp.maximum(jnp.sum(seen, axis=1), 1)[:, None].astype(weight.dtype)
        g, h = weight * g + share * far_g, weight * h + share * far_h
        ahead, aside = (g * around.ux - h * around.uy, g * around.uy + h * around.ux)
        vx, vy = fold(lambda i: (ahead[:, i], aside[:, i]), seen.shape[1])
        return vx, vy

    def distribution(self, observation: Perception) -> Gaussian:
        """Returns normal velocities around the most likely ones: each robot draws its own."""
        return Gaussian(self(observation), self.log_std + math.log(self.sizes.max_speed), joint=False)


def braked(
    velocity: Float[Array, "robots 2 *batch"], walls: Float[Array, "robots 4 2 *batch"]
) -> Float[Array, "robots 2 *batch"]:
    """Shortens velocities so that no robot goes more than a share of its way to a wall.

    Args:
        velocity: Of each robot, world units per step.
        walls: The nearest point of each wall from where it is, world units, opposite ones two places apart.
    """
    normal, way = ways(walls)
    excess = jnp.maximum(jnp.sum(velocity[:, None] * normal, axis=2) - BRAKE * way, 0.0)
    return velocity - jnp.sum(excess[:, :, None] * normal, axis=1)


def ways(
    walls: Float[Array, "robots 4 2 *batch"],
) -> tuple[Float[Array, "robots 4 2 *batch"], Float[Array, "robots 4 *batch"]]:
    """Returns the unit vector towards each wall, and how far it is, at least 0."""
    # From wall to wall: a robot at a wall knows by the opposite one where that lies.
    across = walls - jnp.roll(walls, 2, axis=1)
    normal = across / jnp.sqrt(jnp.sum(across**2, axis=2, keepdims=True))
    return normal, jnp.maximum(jnp.sum(walls * normal, axis=2), 0.0)


class LocalValue(eqx.Module):
    """Maps what there is to what is still to be gained: training may know everything, acting never does.

    It sees robots that are hidden, and the walls, which nobody who acts does.
    """

    valuation: ValueHead
    basis: int = eqx.field(static=True)
    sizes: Sizes = eqx.field(static=True)

    def __init__(self, config: PolicyConfig, sizes: Sizes, key: PRNGKeyArray) -> None:
        channels = robot_channels(config.basis, sizes.landmark, scale_free=True) + config.basis
        self.valuation = ValueHead(channels, config.hidden[0], key)
        self.basis = config.basis
        self.sizes = sizes

    def __call__(self, observation: Perception) -> Float[Array, "robots *batch"]:
        """Returns every robot's value of every configuration."""
        around = surroundings(observation.positions, self.basis, self.sizes, scale_free=True)
        walls = radial_basis(jnp.log(observation.walls / self.sizes.safe_distance + 0.02), self.basis)
        return self.valuation(jnp.concatenate([_compressed(around.robot), walls]))


def _compressed(features: Float[Array, "features *batch"]) -> Float[Array, "features *batch"]:
    """Compresses what is counted: odd, all but linear up to 1, logarithmic beyond."""
    return jnp.arcsinh(features)
