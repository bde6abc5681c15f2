"""Algorithm 1: the training of one policy of the list, from a set of initial configurations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate import prng
from murmurate.discovery.build import build_environment, build_networks
from murmurate.discovery.curriculum import Curriculum
from murmurate.discovery.problem import Problem
from murmurate.discovery.validity import is_valid_pattern
from murmurate.learning import LEARNERS, Chunk, Learner, TrainState
from murmurate.world import (
    ActionRepeat,
    Configuration,
    GoalValue,
    GoalValues,
    HardStart,
    JitteredStart,
    MixtureStart,
    MotionCost,
    Objective,
    Start,
    SurroundedStart,
    SymmetricStart,
    UniformStart,
    World,
    Wrapper,
    with_array_leaves,
)

__all__ = ["Stage", "draw_key", "policy_name", "training_world"]

PURPOSES = ("networks", "training", "sigma", "evaluation", "worlds", "initial")
"""What random numbers are drawn for: each purpose has a key of its own."""


def policy_name(index: int) -> str:
    """Returns what a policy is called by its place in the list."""
    return "base" if index == 0 else "auxiliary"


def draw_key(problem: Problem, index: int, purpose: str) -> PRNGKeyArray:
    """Returns the key for one purpose at a place in the list: it depends on nothing that ran before."""
    return jax.random.fold_in(jax.random.fold_in(prng.key(problem.seed), index), PURPOSES.index(purpose))


def training_world(problem: Problem, index: int, start: Start, sigma: Float[Array, "sigma robots 2"]) -> World:
    """Builds the world that a policy trains in.

    Base and auxiliary policies differ in numbers only where the start jitters given configurations, so one compilation
    serves both.

    Args:
        problem: The problem.
        index: Place of the policy in the list.
        start: The problem's start, prepared.
        sigma: The configurations that episodes begin from: of the start, or where the policies before came to rest.
    """
    stage = problem.stage(index)
    factor = 1 + stage.margin
    config = replace(
        problem.world, radius=factor * problem.world.radius, safe_distance=factor * problem.world.safe_distance
    )
    start = _training_start(problem, index, start, sigma)
    horizon: Any = jnp.asarray(stage.horizon, jnp.int32)
    signals, weights = problem.reward(index)
    per_robot = problem.policy.credit == "robots"
    return with_array_leaves(World.create(config, start, signals, weights, horizon, per_robot))


def refinement_world(
    problem: Problem, index: int, start: Start, sigma: Float[Array, "sigma robots 2"], learner: str = "gradients"
) -> World:
    """Builds the world in which a learner with weights of its own improves a policy; see `training_world`.

    Its signals have margins of their own, so robots are as large as they are.
    """
    signals, weights = problem.refinement(index, learner)
    horizon: Any = jnp.asarray(problem.stage(index).horizon, jnp.int32)
    start = _training_start(problem, index, start, sigma)
    return with_array_leaves(World.create(problem.world, start, signals, weights, horizon))


def _training_start(problem: Problem, index: int, start: Start, sigma: Float[Array, "sigma robots 2"]) -> Start:
    """Returns where the training episodes of a policy begin."""
    stage, is_base = problem.stage(index), index == 0
    if isinstance(start, JitteredStart):
        first: Start = JitteredStart(sigma, start.noise if is_base else stage.noise)
    else:
        # The base policy begins at fresh configurations every time, not at those that were drawn once.
        first = start if is_base else JitteredStart(sigma, stage.noise)
    random_share = stage.random_share if is_base else 0.0
    start = MixtureStart(first, UniformStart(stage.random_spread), random_share)
    if problem.base.symmetric_share:
        start = MixtureStart(start, SymmetricStart(), stage.symmetric_share if is_base else 0.0)
    if problem.base.hard_share:
        start = MixtureStart(start, HardStart(), stage.hard_share if is_base else 0.0)
    if problem.base.surrounded_share:
        start = MixtureStart(start, SurroundedStart(), stage.surrounded_share if is_base else 0.0)
    return start


def _discovery_environment(problem: Problem, index: int, start: Start, sigma: Any, policy: Any) -> Wrapper:
    """Every action is kept up for some steps; rewards are the changes of the objective."""
    del policy
    world = training_world(problem, index, start, sigma)
    # Robots perceive the world as it is: the margin is in the reward and in what counts as contact alone.
    env, stage = build_environment(problem, world, with_array_leaves(problem.world)), problem.stage(index)
    return ActionRepeat(_with_motion_cost(env, stage.motion_cost), jnp.asarray(stage.repeat, jnp.int32))


def _refinement_environment(problem: Problem, index: int, start: Start, sigma: Any, policy: Any) -> Wrapper:
    """Every step costs what the objective of smooth signals lacks, or what the policy says."""
    env = build_environment(problem, refinement_world(problem, index, start, sigma))
    env = problem.policy.refinement_environment(
        env, policy, problem.landmark, with_array_leaves(problem.objective_signals)
    )
    return _with_motion_cost(env, problem.stage(index).gradients.motion_cost)


def _goal_environment(problem: Problem, index: int, start: Start, sigma: Any, policy: Any) -> Wrapper:
    """Nobody moves: configurations in which robots could come to rest are worth their objective of smooth signals."""
    del policy
    numbers = problem.stage(index).goals
    softness, softness_end, emphasis = (
        jnp.asarray(x, jnp.float32) for x in (numbers.softness, numbers.softness_end, numbers.emphasis)
    )
    world = refinement_world(problem, index, start, sigma, "goals")
    return GoalValue(world, softness, softness_end, emphasis, with_array_leaves(problem.objective_signals))


def _with_motion_cost(env: World | Wrapper, cost: float) -> Any:
    return MotionCost(env, jnp.asarray(cost, jnp.float32)) if cost else env


_ENVIRONMENTS = {
    "ppo": _discovery_environment,
    "gradients": _refinement_environment,
    "goals": _goal_environment,
}
"""What each learner trains in: base and auxiliary policies in one program, where shapes agree."""


class Stage:
    """The training of one policy by one learner: of one swarm size, or of several in turns.

    Args:
        curriculum: The problems that it alternates among.
        index: Place of the policy in the list.
        phase: Which of the learners of the policy trains it.
        starts: The prepared start of each problem.
        sigmas: The set of initial configurations of each problem.
    """

    def __init__(
        self,
        curriculum: Curriculum,
        index: int,
        phase: int,
        starts: Sequence[Start],
        sigmas: Sequence[Float[Array, "_ _ 2"]],
    ) -> None:
        self.curriculum, self.index, self.phase = curriculum, index, phase
        self.config = curriculum.problem.stage(index)
        self._learner: Learner = LEARNERS[self.config.learners[phase]]
        self._starts, self._sigmas = starts, sigmas

    def environment(self, part_index: int, policy: Any) -> Wrapper:
        """Returns what a policy network is trained in: the problem's environment, rewarded as the learner needs it."""
        part = self.curriculum.parts[part_index]
        start, sigma = self._starts[part_index], self._sigmas[part_index]
        return _ENVIRONMENTS[self.config.learners[self.phase]](part, self.index, start, sigma, policy)

    def begin(self, warm_start: Any | None = None) -> TrainState:
        """Returns the state of the training before its first update.

        The value network is always new: rewards are others in another phase.

        Args:
            warm_start: A policy network whose weights to begin with.
        """
        problem = self.curriculum.problem
        policy, value = build_networks(problem, self._key(problem, "networks"))
        policy = policy if warm_start is None else warm_start
        states = tuple(self._worlds(part_index, policy) for part_index in range(len(self.curriculum.parts)))
        key = self._key(problem, "training")
        return self._learner.begin(policy, value, states, key, self.config.learning(self.phase))

    def next_chunk(self, train: TrainState) -> Chunk:
        """Returns the updates to run next."""
        update = int(train.update)
        part_index, policy = self._turn(update), train.policy
        numbers, learner = self.curriculum.parts[part_index].stage(self.index).learning(self.phase), self._learner
        train = eqx.tree_at(lambda t: t.env_state, train, train.env_state[part_index])
        updates = self.curriculum.chunk(self.index, self.phase, update)
        hyper, shape = learner.hyperparameters(numbers), learner.shape(numbers)
        env: Any = self.environment(part_index, policy)
        if learner.searches_goals:
            parts = range(len(self.curriculum.parts))
            env = GoalValues(tuple(self.environment(part, policy) for part in parts))
        return Chunk(train, env, hyper, shape, updates, learner.train_chunk)

    def after_chunk(
        self, before: TrainState, trained: TrainState, metrics: dict[str, Any]
    ) -> tuple[TrainState, list[dict[str, Any]]]:
        """Returns the state of the training after a chunk of updates, and a row of metrics for each update."""
        part_index, done = self._turn(int(before.update)), int(trained.update)
        states = (*before.env_state[:part_index], trained.env_state, *before.env_state[part_index + 1 :])
        trained = eqx.tree_at(lambda t: t.env_state, trained, states)
        metrics = jax.device_get(metrics)
        count, robots = len(metrics["reward"]), self.curriculum.parts[part_index].world.robots
        earlier, rows = self.curriculum.policy_steps(self.index, self.phase), []
        place = {"policy": self.index, "name": policy_name(self.index), "learner": self.config.learners[self.phase]}
        # A search of goals is of all sizes at once.
        size = {} if self._learner.searches_goals and len(self.curriculum.parts) > 1 else {"robots": robots}
        for number in range(count):
            update = done - count + number + 1
            values = jax.tree.map(lambda x, number=number: float(x[number]), metrics)
            steps = earlier + self.curriculum.steps(self.index, self.phase, update)
            rows.append({**place, "update": update, **values, "policy_steps": steps, **size})
        return trained, rows

    def result(self, train: TrainState) -> Any:
        """Returns the policy network that the training has come to, its best goal first where it has searched goals."""
        policy = train.result
        if self._learner.searches_goals:
            for part in self.curriculum.parts:
                policy = policy.scaled_and_sorted(partial(_score, part), part.world.robots)
        return policy

    def _turn(self, update: int) -> int:
        """Returns the place of the part whose episodes an update takes. A search for goals takes none: any will do."""
        return 0 if self._learner.searches_goals else self.curriculum.turn(update)

    @property
    def is_last_phase(self) -> bool:
        """Whether no other learner trains the policy after this one."""
        return self.phase == len(self.config.learners) - 1

    def is_done(self, train: TrainState) -> bool:
        """Returns whether the last update has been run."""
        return int(train.update) >= self.config.learning(self.phase).updates

    def _key(self, problem: Problem, purpose: str) -> PRNGKeyArray:
        """Returns the key for one purpose in this phase."""
        key = draw_key(problem, self.index, purpose)
        return jax.random.fold_in(key, self.phase) if self.phase else key

    def _worlds(self, part_index: int, policy: Any) -> Any:
        """Begins the parallel episodes that the policy is trained in."""
        part = self.curriculum.parts[part_index]
        stage = part.stage(self.index)
        worlds, clock = jax.random.split(self._key(part, "worlds"))
        state = _reset(self.environment(part_index, policy), worlds, stage.learning(self.phase).worlds)
        # Episodes that all began together would all end together, and every batch would hold one age only.
        step = state.unwrapped.step
        ages = jax.random.randint(clock, step.shape, 0, stage.horizon, step.dtype)
        return eqx.tree_at(lambda s: s.unwrapped.step, state, ages)


def _score(problem: Problem, formations: Float[np.ndarray, "formations robots 2"]) -> Float[np.ndarray, " formations"]:
    """Returns the objective of formations in float64; -inf for one that is no valid pattern at rest."""
    valid = is_valid_pattern(formations, problem.world, problem.thresholds)
    objective = Objective(problem.objective_signals)
    configuration = Configuration(np.moveaxis(formations.astype(float), 0, -1), problem.world)
    return np.where(valid, objective(objective.measure(configuration)), -np.inf)


# Outside of a jit, the loop that redraws overlaps would be compiled anew at every call.
@eqx.filter_jit
def _reset(env: Any, key: PRNGKeyArray, batch: int) -> Any:
    return env.reset_batch(key, batch)


def repeat_to(configurations: np.ndarray, size: int) -> Float[Array, "size robots 2"]:
    """Returns `size` configurations: the given ones in turns."""
    return jnp.asarray(configurations[np.arange(size) % len(configurations)], jnp.float32)
