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

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate.errors import MAX_INTEGER, InputError, check_number, check_type
from murmurate.geometry._batch_last import sum_terms
from murmurate.geometry.rings import smallest_ring_radius
from murmurate.geometry.superposition import superposition
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
from murmurate.world.config import WorldConfig, scaled_to
from murmurate.world.env import World, Wrapper
from murmurate.world.signals import Configuration, Signal
from murmurate.world.starts import bounds_of

__all__ = ["ArrivalReward", "FormationNetwork", "FormationPolicy", "places_of"]

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

Freedom = Literal["moved", "turned", "fixed"]
"""How a formation may be laid on a swarm: moved and turned, turned around the origin, or as it is."""


@Policy.register("formation")
class FormationPolicy(Policy):
    """Robots that remember formations, each of which sees all positions.

    Attributes:
        formations: How many formations are searched and remembered for each swarm size, the best one first.
        fixed: Whether formations keep their place and direction in the world, as walls or several given points ask for.
            Otherwise swarms turn them as suits, around the gathering point or, where none is known, anywhere.
        hidden: Widths of the node and the edge layer; one number serves for both.
        basis: Number of radial basis functions.
    """

    any_size: ClassVar[bool] = False
    has_goals: ClassVar[bool] = True

    formations: int = eqx.field(default=256, static=True)
    fixed: bool = eqx.field(default=False, static=True)
    hidden: tuple[int, ...] = eqx.field(default=(32, 16), static=True)
    basis: int = eqx.field(default=8, static=True)

    def __check_init__(self) -> None:
        check_number("formations", self.formations, 1, MAX_INTEGER, integer=True)
        check_type("fixed", self.fixed, bool, "true or false")
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
        return FormationNetwork.create(self, world, landmark, first), EquivariantValue(value, world, landmark, second)

    def refinement_environment(
        self, env: World | Wrapper, network: FormationNetwork, landmark: bool, recorded: dict[str, Signal]
    ) -> Wrapper:
        """Returns an environment in which every step costs how far the swarm is from the best formation."""
        del landmark
        return ArrivalReward(env, network.goals(env.config.robots)[..., 0], network.freedom, recorded)


class FormationNetwork(PolicyNetwork):
    """Maps positions to velocities towards the places of a formation, and around other robots.

    Attributes:
        places: The formations of a swarm of the world's size, in radii of the smallest valid ring; around the gathering
            point where it is known.
        other_places: The same of swarms of other sizes, each in the world scaled to it.
        freedom: How formations may be laid on swarms.
    """

    places: Float[Array, "formations robots 2"]
    other_places: tuple[Float[Array, "_ _ 2"], ...]
    node: Dense
    pair: Dense
    mine: Linear
    theirs: Linear
    head: Dense
    to_place: Dense
    log_std: Float[Array, ""]
    basis: int = eqx.field(static=True)
    world: WorldConfig = eqx.field(static=True)
    freedom: Freedom = eqx.field(static=True)

    @classmethod
    def create(cls, policy: FormationPolicy, world: WorldConfig, landmark: bool, key: PRNGKeyArray) -> FormationNetwork:
        """Returns a network with random formations of one size, and weights that lead hardly anybody around."""
        keys = jax.random.split(key, 7)
        nodes, edges = policy.hidden[0], policy.hidden[-1]
        return cls(
            places=_random_places(policy.formations, world.robots, keys[0]),
            other_places=(),
            node=Dense(robot_channels(policy.basis, landmark=True), nodes, keys[1], gain=5 / 3),
            pair=Dense(pair_channels(policy.basis) + HEADING_CHANNELS, edges, keys[2]),
            mine=Linear(nodes, edges, keys[3]),
            theirs=Linear(nodes, edges, keys[4]),
            head=Dense(edges, 2, keys[5], gain=0.01),
            to_place=Dense(nodes, 2, keys[6], gain=0.01),
            log_std=jnp.zeros(()),
            basis=policy.basis,
            world=world,
            freedom="fixed" if policy.fixed else "turned" if landmark else "moved",
        )

    def __call__(self, observation: Float[Array, "robots 2 *batch"]) -> Float[Array, "robots 2 *batch"]:
        """Returns the most likely velocities, world units per step."""
        # The learner goals alone trains the formations: no gradient of a motion reaches them.
        world = self._world(observation.shape[0])
        places = jax.lax.stop_gradient(self.goals(world.robots)[..., 0])
        offsets = places_of(observation, places, world, self.freedom) - observation
        speed = world.max_speed
        farthest = _largest(jnp.abs(offsets).reshape((-1, *offsets.shape[2:]))) / speed
        straight = offsets / jnp.maximum(farthest, 1.0)
        velocities = straight + speed * jnp.minimum(farthest, 1.0) ** 2 * self._around(observation, offsets, straight)
        x, y = jnp.abs(velocities[:, 0]), jnp.abs(velocities[:, 1])
        longest = jnp.where(x > y, x, y)[:, None]
        return velocities / jnp.maximum(longest / speed, 1.0)

    @property
    def sizes(self) -> tuple[int, ...]:
        """The sizes of swarms for which formations are remembered."""
        return tuple(places.shape[1] for places in (self.places, *self.other_places))

    def goals(self, robots: int | None = None) -> Float[Array, "robots 2 formations"]:
        """Returns all formations, world units: the configurations that this policy can bring a swarm to.

        Args:
            robots: Size of the swarm; by default that of the world.

        Raises:
            InputError: No formation of this size is remembered.
        """
        robots = self.world.robots if robots is None else robots
        return jnp.moveaxis(_unit(self._world(robots)) * self._places(robots), 0, -1)

    def with_sizes(self, sizes: Sequence[int], key: PRNGKeyArray) -> FormationNetwork:
        """Returns this network with as many random formations for each of some other sizes of the swarm."""
        network = self
        for size in sizes:
            if size not in self.sizes:
                places = _random_places(len(self.places), size, jax.random.fold_in(key, size))
                network = network._with_places(size, places)
        return network

    def of_size(self, robots: int) -> FormationNetwork:
        """Returns this network with the formations of one size alone, as a swarm of this size has it.

        Raises:
            InputError: No formation of this size is remembered.
        """
        return replace(self, places=self._places(robots), other_places=(), world=self._world(robots))

    def with_first(self, formation: Float[Array, "robots 2"]) -> FormationNetwork:
        """Returns this network with another formation, world units, as the first of its size, which swarms form.

        The others move down, and the last one, which was worth least, is forgotten.
        """
        robots = len(formation)
        places = formation[None] / _unit(self._world(robots))
        if robots in self.sizes:
            places = jnp.concatenate([places, self._places(robots)[:-1]])
        return self._with_places(robots, places)

    def scaled_and_sorted(
        self, score: Callable[[np.ndarray], np.ndarray], robots: int | None = None
    ) -> FormationNetwork:
        """Returns this network with every formation of a size at its best scale, and the best formation first.

        Args:
            score: Returns how good formations `(formations, robots, 2)` in world units are; -inf for one that is no
                valid pattern.
            robots: Size of the swarm; by default that of the world.
        """
        world = self._world(self.world.robots if robots is None else robots)
        places = np.moveaxis(np.asarray(self.goals(world.robots), float), -1, 0)
        if self.freedom == "moved":
            places = places - places.mean(axis=1, keepdims=True)
        scales, scores = _best_scales(places, score)
        order = np.argsort(-scores, kind="stable")
        places = (places * (scales * (1 + SCALE_MARGIN))[:, None, None])[order] / _unit(world)
        return self._with_places(world.robots, jnp.asarray(places, self.places.dtype))

    def _places(self, robots: int) -> Float[Array, "formations robots 2"]:
        for places in (self.places, *self.other_places):
            if places.shape[1] == robots:
                return places
        raise InputError("robots", robots, f"a size that it has formations of: {', '.join(map(str, self.sizes))}")

    def _with_places(self, robots: int, places: Float[Array, "formations robots 2"]) -> FormationNetwork:
        """Returns this network with these formations for swarms of a size, of which it may have had none."""
        if robots == self.world.robots:
            return replace(self, places=places)
        others = {other.shape[1]: other for other in self.other_places} | {robots: places}
        return replace(self, other_places=tuple(others.values()))

    def _world(self, robots: int) -> WorldConfig:
        return self.world if robots == self.world.robots else scaled_to(self.world, robots)

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
        freedom: How it may be laid on swarms.
        recorded: The signals that transitions report, in place of those of the objective; no gradient passes through.
    """

    formation: Float[Array, "robots 2"]
    freedom: Freedom = eqx.field(static=True)
    recorded: dict[str, Signal]

    def step(self, state: Any, action: Any) -> tuple[Any, Transition]:
        """Advances every episode by one step."""
        after, transition = self.env.step(state, action)
        positions = after.positions
        offsets = places_of(positions, self.formation, self.config, self.freedom) - positions
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
    freedom: Freedom,
) -> Float[Array, "robots 2 *batch"]:
    """Lays a formation on swarms by least squares and returns the place of each robot, world units.

    Gradients pass as if the superposition were fixed.

    Args:
        positions: Positions of the robots.
        formation: The places of the formation.
        world: Sizes of the world; the formation is kept inside as far as it fits.
        freedom: How the formation may be laid on them.
    """
    swarms = positions.reshape((*positions.shape[:2], -1))
    if freedom == "moved":
        center, formation = jnp.mean(swarms, axis=0), formation - jnp.mean(formation, axis=0)
    else:
        center = jnp.zeros((2, 1), swarms.dtype)
    turn, order = superposition(swarms - center, formation, turned=freedom != "fixed")
    places = _turned(jnp.moveaxis(formation[order], -1, 1), turn) + center
    if freedom == "moved" and world.bounded:
        limits = bounds_of(world) - WALL_DISTANCE * world.radius
        below = jnp.maximum(-limits - jnp.min(places, axis=0), 0.0)
        above = jnp.maximum(jnp.max(places, axis=0) - limits, 0.0)
        places = places + jax.lax.stop_gradient(below - above)
    return places.reshape(positions.shape)


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


def _random_places(formations: int, robots: int, key: PRNGKeyArray) -> Float[Array, "formations robots 2"]:
    """Returns formations before training, in radii of the smallest valid ring: from narrow to wide."""
    spread = jnp.geomspace(*SPREADS, formations, dtype=jnp.float32)[:, None, None]
    return spread * jax.random.normal(key, (formations, robots, 2), jnp.float32)


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
