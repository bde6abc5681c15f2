"""The paper's two algorithms: train one policy from a set of configurations; grow the list until patterns are valid."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate.discovery.cascade import Cascade
from murmurate.discovery.problem import Problem
from murmurate.discovery.validity import check_validity
from murmurate.learning import (
    ActionRepeat,
    Chunk,
    Hyperparameters,
    Shape,
    TrainState,
    check_divides,
    init,
    sharding,
    train_together,
)
from murmurate.policies import Sizes, make_networks
from murmurate.world import (
    Family,
    JitteredStart,
    LocalObservation,
    MixtureStart,
    SchedulerWrapper,
    Start,
    StartConfig,
    UniformStart,
    WeightsConfig,
    World,
    draw_starts,
    make_start,
    symmetric_starts,
)

__all__ = ["Discovery", "Snapshot", "advance_together", "policy_name"]

SYMMETRIC = 128
"""Symmetric starts of each family that training episodes begin at."""

SEEDS = 2**33
"""Seeds that evaluations draw by are less than this."""


@dataclass(frozen=True)
class Snapshot:
    """How far a discovery has come: all that resuming needs.

    Attributes:
        policies: The list Pi of finished policies.
        sigma: The set of configurations that the policy in training starts from, repeated up to a fixed number; empty
            when every episode of the policy before ended in a collision or outside the world.
        valid: Share of valid patterns after the last finished policy.
        train: Training of the policy at hand; None between two policies.
        finished: Whether the search is over.
    """

    policies: tuple[Any, ...]
    sigma: Float[Array, "sigma robots 2"]
    valid: float
    train: TrainState | None
    finished: bool = False


def policy_name(index: int) -> str:
    """Returns what a policy is called by its place in the list."""
    return "base" if index == 0 else "auxiliary"


class Discovery:
    """Algorithm 2, one chunk of updates at a time.

    Whatever is random derives from the seed and the place in the list, never from what ran before, so a discovery that
    is resumed from any snapshot ends in the same weights as an unbroken one.
    """

    def __init__(self, problem: Problem) -> None:
        """Builds the world; no training yet.

        Raises:
            InputError: The problem is impossible, as with too many robots for the start.
        """
        self.problem = problem
        self.world = _with_array_leaves(problem.evaluation_world())
        if problem.base.random_share:
            make_start(StartConfig(kind="random"), problem.world)
        if problem.base.symmetric_share:
            self._symmetric()
        self._sensing = problem.sensing if problem.policy.kind == "local" else None
        self._key = jax.random.key(problem.seed)
        self._parts = tuple(Discovery(part) for part in problem.parts()) or (self,)
        sizes = problem.world
        self._sizes = Sizes(
            robots=sizes.robots,
            half_width=sizes.half_width,
            half_height=sizes.half_height,
            radius=sizes.radius,
            safe_distance=sizes.safe_distance,
            max_speed=sizes.max_speed,
            landmark=problem.objective == "C1",
        )

    def check_devices(self) -> None:
        """Checks that the devices at hand divide every batch that is trained on.

        Raises:
            InputError: They do not.
        """
        stages = ("base", "auxiliary")[: self.problem.discovery.max_policies]
        for index, name in enumerate(stages):
            for part in self._parts:
                ppo = part.problem.stage(index).ppo
                robots = "" if part is self else f" (swarms of {part.problem.world.robots})"
                check_divides(f"{name}.ppo.worlds{robots}", ppo.worlds)
                part_of_pass = ppo.worlds * ppo.steps // ppo.minibatches
                check_divides(f"{name}.ppo.worlds * steps / minibatches{robots}", part_of_pass)

    def begin(self) -> Snapshot:
        """Returns the snapshot before the first policy: sigma is the experiment's start."""
        return Snapshot(policies=(), sigma=self._initial_sigma(), valid=0.0, train=None)

    def networks(self, index: int) -> tuple[Any, Any]:
        """Builds the fresh networks of the policy at a place in the list."""
        networks = make_networks(self.problem.policy, self._sizes, self._draw(index, "networks"))
        # An array made of a Python number is weakly typed: training would compile once more at its second chunk.
        return jax.tree.map(lambda x: jnp.asarray(x, x.dtype), networks)

    def template(self, snapshot: Snapshot) -> TrainState:
        """Returns a training state of the right structure, to load a checkpoint into."""
        index = len(snapshot.policies)
        return self._init(index, snapshot)

    def cascade(self, policies: tuple[Any, ...]) -> Cascade:
        """Returns the list of policies as it is executed."""
        return Cascade(policies, self._seen(self._scheduled(self.world), self.world), self.problem.rest_in_steps)

    def advance(self, snapshot: Snapshot) -> tuple[Snapshot, list[dict[str, Any]]]:
        """Runs one chunk of updates; after a policy's last one, also evaluates the list.

        Returns:
            The new snapshot, and the metrics of every update of the chunk.
        """
        return advance_together([self], [snapshot])[0]

    def steps(self, index: int, updates: int) -> int:
        """Counts the environment's steps in the first updates of the policy at a place in the list."""
        each = [part.problem.stage(index).steps_per_update for part in self._parts]
        rounds, left = divmod(updates, len(each))
        return rounds * sum(each) + sum(each[self._turn(rounds * len(each) + turn)] for turn in range(left))

    def _turn(self, update: int) -> int:
        """Returns the place of the swarm size whose turn it is: in every round each once, in an order drawn anew."""
        turn, place = divmod(update, len(self._parts))
        return int(np.random.default_rng((self.problem.seed, turn)).permutation(len(self._parts))[place])

    def _begun(self, snapshot: Snapshot) -> TrainState:
        """Returns where the next policy's training stands, which may be at its beginning."""
        return snapshot.train or self._init(len(snapshot.policies), snapshot)

    def _chunk(self, snapshot: Snapshot, train: TrainState) -> Chunk:
        """Returns the updates to run next, all of one swarm size."""
        index = len(snapshot.policies)
        place = self._turn(int(train.update))
        part = self._parts[place]
        ppo = part.problem.stage(index).ppo
        updates = min(self.problem.discovery.chunk, ppo.updates - int(train.update)) if part is self else 1
        train = eqx.tree_at(lambda t: t.env_state, train, train.env_state[place])
        env = part._environment(index, self._sources(snapshot)[place])
        return Chunk(train, env, Hyperparameters.from_config(ppo), Shape.from_config(ppo), updates)

    def _after(
        self, snapshot: Snapshot, before: TrainState, train: TrainState, metrics: dict[str, Any]
    ) -> tuple[Snapshot, list[dict[str, Any]]]:
        """Returns the snapshot after a chunk of updates, and their metrics."""
        index = len(snapshot.policies)
        place, done = self._turn(int(before.update)), int(train.update)
        states = (*before.env_state[:place], train.env_state, *before.env_state[place + 1 :])
        train = eqx.tree_at(lambda t: t.env_state, train, states)
        rows = _rows(jax.device_get(metrics), index, done)
        for row in rows:
            row["policy_steps"] = self.steps(index, row["update"])
            row["robots"] = self._parts[place].problem.world.robots
        if done < self.problem.stage(index).ppo.updates:
            return replace(snapshot, train=train), rows
        return self._conclude(snapshot, train.policy), rows

    @functools.cached_property
    def _beginnings(self) -> list[Snapshot]:
        # Not drawn before it is trained from, so that whoever only opens a run does not wait for it; with its numbers
        # even where only shapes are asked for, as these are kept.
        with jax.ensure_compile_time_eval():
            return [part.begin() for part in self._parts if part is not self]

    def _sources(self, snapshot: Snapshot) -> list[Snapshot]:
        """Returns where each part's training begins: among several swarm sizes there are no restarts."""
        return self._beginnings or [snapshot]

    def _conclude(self, snapshot: Snapshot, policy: Any) -> Snapshot:
        """Appends a trained policy, evaluates from sigma, and decides whether the list is complete."""
        config = self.problem.discovery
        index = len(snapshot.policies)
        policies = (*snapshot.policies, policy)
        # Every policy's sigma* comes from running the whole list so far from where the base policy was trained.
        source = self._training_world(0, self.begin()).start
        ran = self.cascade(policies).rollout(draw_starts(source, self._draw(index, "sigma"), config.sigma))
        final, terminated = sharding.broadcast((ran.final, ran.terminated))
        alive = final[~terminated]
        valid = self.validity(policies, self._draw(index, "evaluation"))
        complete = len(policies) >= config.min_policies and valid >= config.required_valid
        finished = complete or len(policies) == config.max_policies or len(alive) == 0
        sigma = _repeat_to(alive, config.sigma) if len(alive) else jnp.asarray(alive)
        return Snapshot(policies=policies, sigma=sigma, valid=valid, train=None, finished=finished)

    def validity(self, policies: tuple[Any, ...], key: PRNGKeyArray) -> float:
        """Returns the share of fresh episodes from (S_0, epsilon) in which the list forms a valid pattern."""
        valid = [
            check_validity(
                part.cascade(policies).rollout(draw_starts(part.world.start, key, part.problem.discovery.episodes)),
                part.problem.world,
            ).valid
            for part in self._parts
        ]
        return float(sharding.broadcast(np.concatenate(valid)).mean())

    def _draw(self, index: int, purpose: str) -> PRNGKeyArray:
        purposes = ("networks", "training", "sigma", "evaluation", "worlds", "initial")
        return jax.random.fold_in(jax.random.fold_in(self._key, index), purposes.index(purpose))

    def _initial_sigma(self) -> Float[Array, "sigma robots 2"]:
        start, size = self.world.start, self.problem.discovery.sigma
        if isinstance(start, JitteredStart):
            # Each start of a file as often as every other, and none left out.
            return _repeat_to(np.asarray(start.points), -(-size // len(start.points)) * len(start.points))
        return jnp.asarray(draw_starts(start, self._draw(0, "initial"), size))

    def _training_world(self, index: int, snapshot: Snapshot) -> World:
        """The world that a policy trains in: base and auxiliary differ in numbers only, so one compilation serves."""
        stage, sizes = self.problem.stage(index), self.problem.world
        factor = 1 + stage.margin
        sizes = replace(sizes, radius=factor * sizes.radius, safe_distance=factor * sizes.safe_distance)
        place = {"half_width": sizes.half_width, "half_height": sizes.half_height, "radius": sizes.radius}
        noise = (self.problem.start.noise if index == 0 else stage.noise) * sizes.radius
        share = stage.random_share if index == 0 else 0.0
        # Where nothing comes from anywhere at random, nothing need fit there: without a radius nothing is redrawn.
        anywhere = {**place, "radius": sizes.radius if share else 0.0}
        first: Start = JitteredStart(points=snapshot.sigma, noise=noise, **place)
        if index == 0 and self.problem.start.kind == "random":
            # Not one of the starts drawn once, but always another.
            first = UniformStart(robots=sizes.robots, **place)
        start = MixtureStart(first, UniformStart(robots=sizes.robots, spread=stage.random_spread, **anywhere), share)
        if self.problem.base.symmetric_share:
            share = stage.symmetric_share if index == 0 else 0.0
            start = MixtureStart(start, JitteredStart(points=self._symmetric(), noise=0.0, **place), share)
        weights: WeightsConfig = stage.weights
        by_robot = self.problem.policy.credit == "robots"
        return _with_array_leaves(World.create(sizes, start, self.problem.objective, weights, stage.horizon, by_robot))

    def _symmetric(self) -> Float[Array, "starts robots 2"]:
        """Draws exactly symmetric starts, as many of each family; none of them is ever one of an evaluation's.

        Raises:
            InputError: One of them does not fit.
        """
        world, seed = self.problem.world, self.problem.seed + SEEDS
        names: list[Family] = [name for name in get_args(Family) if name != "rings" or world.robots >= 4]
        return jnp.asarray(np.concatenate([symmetric_starts(name, world, SYMMETRIC, seed) for name in names]), float)

    def _environment(self, index: int, snapshot: Snapshot) -> Any:
        """What a policy is trained in: the world, each action kept up, and what robots perceive of it."""
        world = self._training_world(index, snapshot)
        # What robots perceive, they perceive as it is: no margin there.
        return self._seen(
            ActionRepeat(self._scheduled(world), jnp.asarray(self.problem.stage(index).repeat)), self.world
        )

    def _scheduled(self, world: World) -> World | SchedulerWrapper:
        scheduler = self.problem.scheduler
        return world if scheduler.plain else SchedulerWrapper(world, scheduler)

    def _seen(self, env: Any, world: World) -> Any:
        return env if self._sensing is None else LocalObservation(env, world, self._sensing)

    def _init(self, index: int, snapshot: Snapshot) -> TrainState:
        policy, value = self.networks(index)
        stage = self.problem.stage(index)
        if index and stage.warm_start:
            policy = snapshot.policies[-1]
        policy = eqx.tree_at(lambda p: p.log_std, policy, jnp.full_like(policy.log_std, stage.ppo.log_std))
        begun = zip(self._parts, self._sources(snapshot), strict=True)
        states = tuple(part._worlds(index, source) for part, source in begun)
        return init(policy, value, states, self._draw(index, "training"))

    def _worlds(self, index: int, snapshot: Snapshot) -> Any:
        """Begins the parallel episodes that a policy is trained in."""
        stage = self.problem.stage(index)
        worlds, clock = jax.random.split(self._draw(index, "worlds"))
        state = _reset(self._environment(index, snapshot), worlds, stage.ppo.worlds)
        # Episodes that all began together would all end together, and every batch would hold one age only.
        ages = jax.random.randint(clock, _age(state).shape, 0, stage.horizon, _age(state).dtype)
        return eqx.tree_at(_age, state, ages)


def advance_together(
    discoveries: Sequence[Discovery], snapshots: Sequence[Snapshot]
) -> list[tuple[Snapshot, list[dict[str, Any]]]]:
    """Runs one chunk of updates of each of many discoveries, in one program where their shapes agree.

    Args:
        discoveries: Of any experiments; what differs in numbers only, such as seeds, weights or discounts, agrees.
        snapshots: How far each has come; none of them is finished.

    Returns:
        What `Discovery.advance` returns, for each. It is the same as alone, but for the order of floating-point sums.
    """
    begun = [one._begun(snapshot) for one, snapshot in zip(discoveries, snapshots, strict=True)]
    works = list(zip(discoveries, snapshots, begun, strict=True))
    trained = train_together([one._chunk(snapshot, train) for one, snapshot, train in works])
    return [one._after(snapshot, train, *after) for (one, snapshot, train), after in zip(works, trained, strict=True)]


# Outside of a jit, the loop that redraws overlaps would be compiled anew at every call.
@eqx.filter_jit
def _reset(env: Any, key: PRNGKeyArray, batch: int) -> Any:
    return env.reset_batch(key, batch)


def _age(state: Any) -> Any:
    """Returns the steps since an episode began, whatever its world is wrapped in."""
    while hasattr(state, "world"):
        state = state.world
    return state.step


def _repeat_to(configurations: np.ndarray, size: int) -> Float[Array, "size robots 2"]:
    return jnp.asarray(configurations[np.arange(size) % len(configurations)], jnp.float32)


def _with_array_leaves(tree: Any) -> Any:
    """Turns plain numbers into arrays, so that changing one does not recompile what was compiled for another."""
    return jax.tree.map(lambda x: jnp.asarray(x) if isinstance(x, int | float) else x, tree)


def _rows(metrics: dict[str, Any], index: int, done: int) -> list[dict[str, Any]]:
    """Turns stacked metrics of the last updates, `done` of them by now, into one row an update."""
    count = len(metrics["reward"])
    return [
        {
            "policy": index,
            "name": policy_name(index),
            "update": done - count + i + 1,
            **jax.tree.map(lambda x, i=i: float(x[i]), metrics),
        }
        for i in range(count)
    ]
