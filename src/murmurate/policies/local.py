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

Where `gaps` is set, robots also move along the direction of the widest gap in what they see. At a corner of the hull
that is outwards; a robot that is enclosed by others has no better way to where everybody sees it. In the middle of a
wide ring all gaps are nearly alike, and their mean direction is short: where `exits` is set, enclosed robots also move
along it whatever its length. So they leave that middle, the faster the farther from it.
"""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate.errors import InputError
from murmurate.geometry._batch_last import sum_terms
from murmurate.policies.base import Policy, PolicyNetwork
from murmurate.policies.equivariant import SharedPolicy, ValueHead
from murmurate.policies.features import (
    SHADOW_CHANNELS,
    Surroundings,
    pair_and_robot_features,
    pair_channels,
    point,
    radial_basis,
    robot_channels,
    surroundings,
)
from murmurate.policies.hull import CORNER_CHANNELS, EDGE_CHANNELS, GAP_CHANNELS, hull, widest_gap
from murmurate.policies.layers import Dense, Linear, bounded, widened
from murmurate.policies.shield import limit_wall_approach
from murmurate.types import Observation
from murmurate.world.config import WorldConfig
from murmurate.world.sensing import wall_directions

__all__ = ["LocalNetwork", "LocalPolicy", "LocalValue"]


CRITICAL = 6.0
"""Lines of sight about to be crossed weigh, all together, less than so many robots near by."""


ENCLOSED = 0.05
"""Robots whose widest gap is narrower than a half turn by this share of it are enclosed."""


ALIKE = 0.02
"""Length of the mean direction of all gaps at which an enclosed robot acts on half of it: 0 is no direction."""


WALL_REACH = 2.0
"""Walls farther away than about so many safe distances do not count: no swarm drifts away from them for ever."""


@Policy.register("local")
class LocalPolicy(SharedPolicy):
    """One network shared by all robots, each of which acts on what it alone perceives.

    Attributes:
        hidden: Widths of the node and the edge layer; one number serves for both.
        basis: Number of radial basis functions.
        walls: Whether robots act on the walls that they perceive; otherwise walls only limit their velocities.
        gaps: Whether robots act on the widest gap in what they see.
        exits: Whether enclosed robots act on its direction alone, however little wider than the others it is; only with
            `gaps`.
    """

    walls: bool = eqx.field(default=False, static=True)
    gaps: bool = eqx.field(default=False, static=True)
    exits: bool = eqx.field(default=False, static=True)

    def __check_init__(self) -> None:
        if self.exits and not self.gaps:
            raise InputError("exits", self.exits, "false without gaps")

    perceives: ClassVar[bool] = True

    @property
    def needs_walls(self) -> bool:
        """Whether `walls` says so."""
        return self.walls

    def networks(self, world: WorldConfig, landmark: bool, key: PRNGKeyArray) -> tuple[LocalNetwork, LocalValue]:
        """Builds the two networks."""
        first, second = jax.random.split(key)
        return LocalNetwork(self, world, landmark, first), LocalValue(self, world, landmark, second)


class LocalNetwork(PolicyNetwork):
    """Maps what each robot perceives to its velocity, in its own frame, world units per step."""

    node: Dense
    pair: Dense
    mine: Linear
    head: Dense
    to_point: Dense
    to_walls: Dense | None
    to_gap: Dense | None
    to_exit: Dense | None
    log_std: Float[Array, ""]
    basis: int = eqx.field(static=True)
    world: WorldConfig = eqx.field(static=True)
    landmark: bool = eqx.field(static=True)

    def __init__(self, policy: LocalPolicy, world: WorldConfig, landmark: bool, key: PRNGKeyArray) -> None:
        keys = jax.random.split(key, 5)
        nodes, edges = policy.hidden[0], policy.hidden[-1]
        robots = robot_channels(policy.basis, landmark, scale_free=True) + CORNER_CHANNELS
        robots += (policy.basis if policy.walls else 0) + (GAP_CHANNELS if policy.gaps else 0)
        pairs = pair_channels(policy.basis) + EDGE_CHANNELS + (GAP_CHANNELS if policy.gaps else 0)
        self.node = Dense(robots, nodes, keys[0], gain=5 / 3)
        self.pair = Dense(pairs, edges, keys[1])
        self.mine = Linear(nodes, edges, keys[2])
        self.head = Dense(edges, 4, keys[3], gain=0.05)
        self.to_point = Dense(nodes, 2, keys[4], gain=0.05)
        # Of keys of their own, so that the other weights are those of a policy without.
        self.to_walls = Dense(nodes, policy.basis, jax.random.fold_in(key, 5), gain=0.05) if policy.walls else None
        self.to_gap = Dense(nodes, 2, jax.random.fold_in(key, 6), gain=0.05) if policy.gaps else None
        self.to_exit = Dense(nodes, 1, jax.random.fold_in(key, 7), gain=0.05) if policy.exits else None
        self.log_std = jnp.zeros(())
        self.basis = policy.basis
        self.world = world
        self.landmark = landmark

    def __call__(self, observation: Observation) -> Float[Array, "robots 2 *batch"]:
        """Returns the most likely velocities; nothing but the view is looked at."""
        view, world = observation.view, self.world
        # In world units, by the size at which robots are perceived.
        scale = world.radius / view.radius
        x, y = view.x * scale[:, None], view.y * scale[:, None]
        px, py = view.landmark_x * scale, view.landmark_y * scale
        seen = view.seen & (x * x + y * y > 0)
        around = pair_and_robot_features(x, y, seen, px, py, self.basis, world, self.landmark, scale_free=True)
        square = jnp.where(seen, x * x + y * y, 1.0)
        outline = hull(around.ux, around.uy, jnp.sqrt(square) / world.radius, seen)
        robots = [_compressed(around.robot), outline.robot]
        walls = None if view.walls is None else view.walls * scale[:, None, None]
        if self.to_walls is not None:
            # In the whole plane there are none: that looks as walls do that are far away.
            none = jnp.zeros((self.basis, *scale.shape), scale.dtype)
            robots.append(none if walls is None else jnp.sum(self._near_walls(walls), axis=2))
        pairs = [_compressed(around.pair), outline.pair]
        gap = None if self.to_gap is None else widest_gap(around.ux, around.uy, seen)
        if gap is not None:
            # The length of the direction says how much wider this gap is than the others.
            robots.append(jnp.stack([jnp.sqrt(gap.x**2 + gap.y**2 + 1e-6), gap.width]))
            x, y = gap.x[:, None], gap.y[:, None]
            pairs.append(jnp.stack([around.ux * x + around.uy * y, around.ux * y - around.uy * x]))
        nodes = jnp.tanh(self.node(jnp.concatenate(robots)))
        edges = jnp.tanh(self.pair(jnp.concatenate(pairs)) + self.mine(nodes)[:, :, None])
        weight = self._weight(around)
        vx, vy = self._sum(around, self.head(edges), weight, seen)
        if self.to_gap is not None and gap is not None:
            g, h = self.to_gap(nodes)
            vx, vy = vx + g * gap.x - h * gap.y, vy + g * gap.y + h * gap.x
            if self.to_exit is not None:
                (g,) = self.to_exit(nodes)
                # Corners of the hull are left alone, and so are robots to which all gaps are alike but for rounding.
                g = g * jnp.clip(-gap.width / ENCLOSED, 0.0, 1.0) / (jnp.sqrt(gap.x**2 + gap.y**2 + 1e-12) + ALIKE)
                vx, vy = vx + g * gap.x, vy + g * gap.y
        if self.landmark:
            ux, uy, _ = point(px, py, self.basis, world.safe_distance)
            g, h = self.to_point(nodes)
            vx, vy = vx + g * ux - h * uy, vy + g * uy + h * ux
        if self.to_walls is not None and walls is not None:
            strength = jnp.sum(self.to_walls(nodes)[:, :, None] * self._near_walls(walls), axis=0)
            push = jnp.sum(strength[:, :, None] * wall_directions(walls)[0], axis=1)
            vx, vy = vx + push[:, 0], vy + push[:, 1]
        velocity = bounded(vx, vy, world.max_speed)
        return velocity if walls is None else limit_wall_approach(velocity, walls)

    def widened_to(self, template: PolicyNetwork) -> PolicyNetwork:
        """Returns this network with a template's width, perceived walls, widest gap and exits, where it has less."""
        if not isinstance(template, LocalNetwork):
            return self
        if (self.basis, self.landmark) != (template.basis, template.landmark):
            return self
        heads = ("to_walls", "to_gap", "to_exit")
        missing = [name for name in heads if getattr(self, name) is None and getattr(template, name)]
        # Inputs are in order: a network with gaps cannot be given walls.
        if "to_walls" in missing and self.to_gap is not None:
            return self
        silent = [jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), getattr(template, name)) for name in missing]

        def added(network: LocalNetwork) -> list[Dense | None]:
            return [getattr(network, name) for name in missing]

        wider = eqx.tree_at(added, self, silent, is_leaf=lambda leaf: leaf is None) if missing else self
        return widened(wider, template)

    def _near_walls(self, walls: Array) -> Float[Array, "basis robots 4 *batch"]:
        """Returns the radial basis of the distance of each wall, faded out beyond `WALL_REACH`."""
        distance = wall_directions(walls)[1] / self.world.safe_distance
        return jnp.exp(-((distance / WALL_REACH) ** 2)) * radial_basis(jnp.log(distance + 0.02), self.basis)

    def _weight(self, around: Surroundings) -> Array:
        """How much each robot seen counts, besides in the mean."""
        hiding, _, hidden, _, behind, _ = around.pair[-SHADOW_CHANNELS:]
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
        vx, vy = sum_terms(lambda i: (ahead[:, i], aside[:, i]), seen.shape[1])
        return vx, vy


class LocalValue(eqx.Module):
    """Maps what there is to what is still to be gained: training may know everything, acting never does.

    It sees robots that are hidden, and the walls, which nobody who acts does.
    """

    valuation: ValueHead
    basis: int = eqx.field(static=True)
    world: WorldConfig = eqx.field(static=True)
    landmark: bool = eqx.field(static=True)

    def __init__(self, policy: SharedPolicy, world: WorldConfig, landmark: bool, key: PRNGKeyArray) -> None:
        channels = robot_channels(policy.basis, landmark, scale_free=True) + policy.basis
        self.valuation = ValueHead(channels, policy.hidden[0], key)
        self.basis = policy.basis
        self.world = world
        self.landmark = landmark

    def __call__(self, observation: Observation) -> Float[Array, "robots *batch"]:
        """Returns every robot's value of every configuration."""
        around = surroundings(observation.positions, self.basis, self.world, self.landmark, scale_free=True)
        walls = radial_basis(jnp.log(observation.walls / self.world.safe_distance + 0.02), self.basis)
        return self.valuation(jnp.concatenate([_compressed(around.robot), walls]))


ROUNDING = 1e-3
"""Features well below this are taken as 0. Robots in line are aside of each other by rounding alone, which is not small
beside the angles at which distant robots hide each other, and many robots add up."""


def _compressed(features: Float[Array, "features *batch"]) -> Float[Array, "features *batch"]:
    """Compresses what is counted: odd, all but linear up to 1, logarithmic beyond."""
    square = features * features
    return jnp.arcsinh(features) * (square / (square + ROUNDING**2))
