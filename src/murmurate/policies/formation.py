r"""A policy that remembers formations: robots go straight to the places of one, and a network leads them around others.

Each robot sees all positions. The formation is laid on the swarm by least squares: turned, moved (where the gathering
point is not known) and its places given to robots, so that the sum of the squared distances from robots to their places
is least. Straight motion at such speeds that all arrive together keeps this superposition the best one: the distance of
two patterns is a metric, and the swarm moves along a shortest way. So robots that remember nothing stay with the places
that they chose. On straight paths to places assigned by least squares, no two robots are at the same point at the same
time.

Discs have a width, though, and a swarm may begin in a crowd. A network sees, beside the surroundings that an
equivariant policy sees, where each robot and each other one is heading, and adds velocities that give way. They fade
out as the swarm arrives.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from murmurate.errors import MAX_INTEGER, InputError, check_number
from murmurate.geometry._batch_last import sum_terms
from murmurate.geometry.rings import smallest_ring_radius
from murmurate.policies.assignment import assignment
from murmurate.policies.base import Policy, PolicyNetwork, check_hidden
from murmurate.policies.equivariant import EquivariantPolicy, EquivariantValue
from murmurate.policies.features import (
    offsets_between,
    pair_and_robot_features,
    pair_channels,
    point,
    robot_channels,
)
from murmurate.policies.layers import Dense, Linear
from murmurate.types import Transition
from murmurate.world.config import WorldConfig
from murmurate.world.env import World, Wrapper
from murmurate.world.signals import Configuration, Signal
from murmurate.world.starts import bounds_of

__all__ = ["ArrivalReward", "FormationNetwork", "FormationPolicy", "places_of"]

START_ANGLES = 8
"""Directions from which the best superposition is looked for."""

ROUNDS = 2
"""Rounds from each of them: places are assigned, then the formation is turned to fit them."""

SPREADS = (0.05, 0.7)
"""Spread of the narrowest and the widest formation before training, in radii of the smallest valid ring. From narrow
ones the best patterns are found more often, and from wide ones others."""

SCALES = (0.9, 1.15)
"""Least and greatest scale that are tried for a trained formation."""

SCALE_MARGIN = 2e-4
"""How much larger than the least valid scale a formation is made, as a share: robots stop within rounding of places."""

WALL_DISTANCE = 1.2
"""Distance that places keep from walls, in radii: a shield lets robots come near a wall only slowly."""

HEADING_CHANNELS = 4
"""Where the observer and the other robot of a pair are heading, along the line between them and across."""


@Policy.register("formation")
class FormationPolicy(Policy):
    """Robots that remember formations, each of which sees all positions.

    Attributes:
        formations: How many formations are searched and remembered, the best one first.
        hidden: Widths of the node and the edge layer; one number serves for both.
        basis: Number of radial basis functions.
    """

    any_size: ClassVar[bool] = False
    has_goals: ClassVar[bool] = True

    formations: int = eqx.field(default=256, static=True)
    hidden: tuple[int, ...] = eqx.field(default=(32, 16), static=True)
    basis: int = eqx.field(default=8, static=True)

    def __check_init__(self) -> None:
        check_number("formations", self.formations, 1, MAX_INTEGER, integer=True)
        check_hidden(self.hidden, most=2)
        check_number("basis", self.basis, 2, 1000, integer=True)
        if self.credit == "swarm":
            raise InputError("credit", self.credit, f"robots: with {self.name} each robot acts on its own")

    def networks(
        self, world: WorldConfig, landmark: bool, key: PRNGKeyArray
    ) -> tuple[FormationNetwork, EquivariantValue]:
        """Builds the two networks."""
        first, second = jax.random.split(key)
        value = EquivariantPolicy(hidden=self.hidden, basis=self.basis)
        return FormationNetwork(self, world, landmark, first), EquivariantValue(value, world, landmark, second)

    def refinement_environment(
        self, env: World | Wrapper, network: FormationNetwork, landmark: bool, recorded: dict[str, Signal]
    ) -> Wrapper:
        """Returns an environment in which every step costs how far the swarm is from the best formation."""
        return ArrivalReward(env, network.goals()[..., 0], landmark, recorded)


class FormationNetwork(PolicyNetwork):
    """Maps positions to velocities towards the places of a formation, and around other robots.

    Attributes:
        places: The formations, in radii of the smallest valid ring; around the gathering point where it is known.
    """

    places: Float[Array, "formations robots 2"]
    node: Dense
    pair: Dense
    mine: Linear
    theirs: Linear
    head: Dense
    to_place: Dense
    log_std: Float[Array, ""]
    basis: int = eqx.field(static=True)
    world: WorldConfig = eqx.field(static=True)
    landmark: bool = eqx.field(static=True)

    def __init__(self, policy: FormationPolicy, world: WorldConfig, landmark: bool, key: PRNGKeyArray) -> None:
        keys = jax.random.split(key, 7)
        nodes, edges = policy.hidden[0], policy.hidden[-1]
        spread = jnp.geomspace(*SPREADS, policy.formations, dtype=jnp.float32)[:, None, None]
        self.places = spread * jax.random.normal(keys[0], (policy.formations, world.robots, 2), jnp.float32)
        self.node = Dense(robot_channels(policy.basis, landmark=True), nodes, keys[1], gain=5 / 3)
        self.pair = Dense(pair_channels(policy.basis) + HEADING_CHANNELS, edges, keys[2])
        self.mine = Linear(nodes, edges, keys[3])
        self.theirs = Linear(nodes, edges, keys[4])
        self.head = Dense(edges, 2, keys[5], gain=0.01)
        self.to_place = Dense(nodes, 2, keys[6], gain=0.01)
        self.log_std = jnp.zeros(())
        self.basis = policy.basis
        self.world = world
        self.landmark = landmark

    def __call__(self, observation: Float[Array, "robots 2 *batch"]) -> Float[Array, "robots 2 *batch"]:
        """Returns the most likely velocities, world units per step."""
        # The learner goals alone trains the formations: no gradient of a motion reaches them.
        places = jax.lax.stop_gradient(self.goals()[..., 0])
        offsets = places_of(observation, places, self.world, self.landmark) - observation
        speed = self.world.max_speed
        farthest = _largest(jnp.abs(offsets).reshape((-1, *offsets.shape[2:]))) / speed
        straight = offsets / jnp.maximum(farthest, 1.0)
        velocities = straight + speed * jnp.minimum(farthest, 1.0) ** 2 * self._around(observation, offsets, straight)
        x, y = jnp.abs(velocities[:, 0]), jnp.abs(velocities[:, 1])
        longest = jnp.where(x > y, x, y)[:, None]
        return velocities / jnp.maximum(longest / speed, 1.0)

    def goals(self) -> Float[Array, "robots 2 formations"]:
        """Returns all formations, world units: the configurations that this policy can bring a swarm to."""
        return jnp.moveaxis(_unit(self.world) * self.places, 0, -1)

    def with_first(self, formation: Float[Array, "robots 2"]) -> FormationNetwork:
        """Returns this network with another formation, world units, as the first, which swarms form.

        The others move down, and the last one, which was worth least, is forgotten.
        """
        first = formation[None] / _unit(self.world)
        return eqx.tree_at(lambda n: n.places, self, jnp.concatenate([first, self.places[:-1]]))

    def scaled_and_sorted(self, score: Callable[[np.ndarray], np.ndarray]) -> FormationNetwork:
        """Returns this network with every formation at its best scale, and the best formation first.

        Args:
            score: Returns how good formations `(formations, robots, 2)` in world units are; -inf for one that is no
                valid pattern.
        """
        places = np.moveaxis(np.asarray(self.goals(), float), -1, 0)
        if not self.landmark:
            places = places - places.mean(axis=1, keepdims=True)
        scales, scores = _best_scales(places, score)
        order = np.argsort(-scores, kind="stable")
        places = (places * (scales * (1 + SCALE_MARGIN))[:, None, None])[order] / _unit(self.world)
        return eqx.tree_at(lambda n: n.places, self, jnp.asarray(places, self.places.dtype))

    def _around(
        self,
        positions: Float[Array, "robots 2 *batch"],
        offsets: Float[Array, "robots 2 *batch"],
        straight: Float[Array, "robots 2 *batch"],
    ) -> Float[Array, "robots 2 *batch"]:
        """Returns velocities, in speed limits, that lead robots around each other."""
        world = self.world
        dx, dy, apart = offsets_between(positions)
        around = pair_and_robot_features(dx, dy, apart, offsets[:, 0], offsets[:, 1], self.basis, world, landmark=True)
        vx, vy = straight[:, 0] / world.max_speed, straight[:, 1] / world.max_speed
        headings = [
            jnp.stack([vx * around.ux + vy * around.uy, vy * around.ux - vx * around.uy])
            for vx, vy in ((vx[:, None], vy[:, None]), (vx[None], vy[None]))
        ]
        pairs = jnp.concatenate([around.pair, *headings])
        nodes = jnp.tanh(self.node(around.robot))
        observing, observed = self.mine(nodes), self.theirs(nodes)
        g, h = self.head(jnp.tanh(self.pair(pairs) + observing[:, :, None] + observed[:, None, :]))
        ahead, aside = (g * around.ux - h * around.uy, g * around.uy + h * around.ux)
        vx, vy = sum_terms(lambda i: (ahead[:, i], aside[:, i]), positions.shape[0])
        px, py, _ = point(offsets[:, 0], offsets[:, 1], self.basis, world.safe_distance)
        g, h = self.to_place(nodes)
        return jnp.stack([vx + g * px - h * py, vy + g * py + h * px], axis=1)


class ArrivalReward(Wrapper):
    """Every step costs how far a swarm is from a formation, in steps at the speed limit.

    That is the mean of what the last robot and what the mean robot needs at least. So time counts, that of the last
    robot most.

    Attributes:
        formation: The places of the formation, world units.
        landmark: Whether it keeps its place around the gathering point.
        recorded: The signals that transitions report, in place of those of the objective; no gradient passes through.
    """

    formation: Float[Array, "robots 2"]
    landmark: bool = eqx.field(static=True)
    recorded: dict[str, Signal]

    def step(self, state: Any, action: Any) -> tuple[Any, Transition]:
        """Advances every episode by one step."""
        after, transition = self.env.step(state, action)
        positions = after.positions
        offsets = places_of(positions, self.formation, self.config, self.landmark) - positions
        # The root has no gradient at 0.
        steps = jnp.sqrt(jnp.sum(offsets**2, axis=1) + 1e-6) / self.config.max_speed
        reward = -(_largest(steps) + jnp.mean(steps, axis=0)) / 2
        reward = jnp.where(transition.terminated, transition.reward, reward)
        configuration = Configuration(jax.lax.stop_gradient(positions), self.config)
        signals = {name: signal.value(configuration) for name, signal in self.recorded.items()}
        return after, Transition(reward, transition.terminated, transition.truncated, signals, reward[None])


def places_of(
    positions: Float[Array, "robots 2 *batch"],
    formation: Float[Array, "robots 2"],
    world: WorldConfig,
    landmark: bool,
) -> Float[Array, "robots 2 *batch"]:
    """Lays a formation on swarms by least squares and returns the place of each robot, world units.

    Gradients pass as if the superposition were fixed.

    Args:
        positions: Positions of the robots.
        formation: The places of the formation.
        world: Sizes of the world; the formation is kept inside as far as it fits.
        landmark: Whether the formation keeps its place around the gathering point, the origin; it is turned alone then.
    """
    swarms = positions.reshape((*positions.shape[:2], -1))
    if landmark:
        center = jnp.zeros((2, 1), swarms.dtype)
    else:
        center, formation = jnp.mean(swarms, axis=0), formation - jnp.mean(formation, axis=0)
    turn, order = _superposition(*map(jax.lax.stop_gradient, (swarms - center, formation)))
    places = _turned(jnp.moveaxis(formation[order], -1, 1), turn) + center
    if not landmark and world.bounded:
        limits = bounds_of(world) - WALL_DISTANCE * world.radius
        below = jnp.maximum(-limits - jnp.min(places, axis=0), 0.0)
        above = jnp.maximum(jnp.max(places, axis=0) - limits, 0.0)
        places = places + jax.lax.stop_gradient(below - above)
    return places.reshape(positions.shape)


def _superposition(
    swarms: Float[Array, "robots 2 batch"], formation: Float[Array, "robots 2"]
) -> tuple[Float[Array, " batch"], Int[Array, "robots batch"]]:
    """Returns by which angle a formation is turned, and which place each robot gets, where squared distances are least.

    From several directions, places are assigned and the formation is turned to suit them, in turns. Each turn lowers
    the sum; the least of the sums counts.
    """
    robots, _, batch = swarms.shape
    # Where distances from the centre are fixed, the sum of the squared distances is least where that of products is
    # greatest, those of all places and robots turned by nothing (real) and by a quarter (imaginary).
    x, y = swarms[:, None, 0], swarms[:, None, 1]
    px, py = formation[None, :, 0, None], formation[None, :, 1, None]
    along, across = (jnp.tile(z, START_ANGLES) for z in (px * x + py * y, px * y - py * x))
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


def _largest(values: Float[Array, "numbers *batch"]) -> Float[Array, "*batch"]:
    """Returns the largest number of each swarm.

    Its gradient is that of one number. That of `jnp.max` is not finite where the compiler rounds a number otherwise as
    it computes it again to find the largest.
    """
    index = jnp.argmax(jax.lax.stop_gradient(values), axis=0)
    return jnp.take_along_axis(values, index[None], axis=0)[0]


def _turned(points: Float[Array, "robots 2 batch"], turn: Float[Array, " batch"]) -> Float[Array, "robots 2 batch"]:
    cos, sin = jnp.cos(turn), jnp.sin(turn)
    return jnp.stack([cos * points[:, 0] - sin * points[:, 1], sin * points[:, 0] + cos * points[:, 1]], axis=1)


def _unit(world: WorldConfig) -> float:
    """Returns the radius of the smallest valid ring, in which places are counted."""
    return float(smallest_ring_radius(float(world.robots), world.radius, world.safe_distance))


def _best_scales(
    places: Float[np.ndarray, "formations robots 2"], score: Callable[[np.ndarray], np.ndarray]
) -> tuple[Float[np.ndarray, " formations"], Float[np.ndarray, " formations"]]:
    """Returns the scale of each formation at which its score is best, and that score; 1 where no scale is valid.

    The best of geometrically spaced scales first; then bisection between it and the next smaller one.
    """
    scales = np.geomspace(*SCALES, 101)
    scores = np.stack([score(scale * places) for scale in scales])
    best = np.argmax(scores, axis=0)
    high, low, value = scales[best], scales[np.maximum(best - 1, 0)], np.max(scores, axis=0)
    for _ in range(24):
        middle = (low + high) / 2
        scored = score(middle[:, None, None] * places)
        better = scored >= value
        high, value = np.where(better, middle, high), np.where(better, scored, value)
        low = np.where(better, low, middle)
    return np.where(np.isneginf(value), 1.0, high), value
