"""The paper's Markov decision process of a swarm of fat, opaque robots, and the wrappers around it.

States and actions of the world take the batch LAST: `(robots, 2, *batch)`. There is no reset inside a step: a
terminated or truncated episode is the caller's to end (see `learning.step_with_autoreset`).
"""

from __future__ import annotations

import operator
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, PRNGKeyArray, UInt32

from murmurate.errors import InputError, check_type
from murmurate.geometry import _batch_last
from murmurate.representation import short_repr
from murmurate.types import Observation, Transition, View
from murmurate.world.config import WorldConfig
from murmurate.world.randomness import draw_each, episode_keys, key_data, next_keys, wrap_keys
from murmurate.world.scheduling import Activation, Clock, Scheduler
from murmurate.world.sensing import Frames, Sensing, view_of, wall_directions
from murmurate.world.signals import Configuration, Objective, Signal, objective_signals
from murmurate.world.smooth import Soft
from murmurate.world.starts import Start
from murmurate.world.tiles import in_tiles

__all__ = [
    "ActionRepeat",
    "DeadZone",
    "GoalValue",
    "GoalValues",
    "LocalObservation",
    "MotionCost",
    "ObservedState",
    "ScheduledState",
    "SchedulerWrapper",
    "ShortfallReward",
    "SlowMoves",
    "State",
    "World",
    "WrappedState",
    "Wrapper",
    "apply_dead_zone",
]


class State(eqx.Module):
    """The state of the world.

    Attributes:
        positions: Centres, world units.
        step: Steps since the episode began.
        objective: The objective C of this configuration.
        potential: The reward of each action is the change of this: C itself, or each robot's potential.
    """

    positions: Float[Array, "robots 2 *batch"]
    step: Int[Array, "*batch"]
    objective: Float[Array, "*batch"]
    potential: Float[Array, "actions *batch"]

    __repr__ = short_repr

    @property
    def epochs(self) -> Int[Array, "*batch"]:
        """Epochs so far: without a scheduler every robot completes a cycle at every step."""
        return self.step

    @property
    def interventions(self) -> Int[Array, "*batch"]:
        """How often a shield has shortened a robot's move: never without one."""
        return jnp.zeros_like(self.step)

    @property
    def unwrapped(self) -> State:
        """The state of the world: this one."""
        return self

    def looked(self, before: State) -> Bool[Array, "robots *batch"]:
        """Returns which robots began a cycle in the step that led here: all, without a scheduler."""
        return jnp.ones_like(before.positions[:, 0], bool)


class World(eqx.Module):
    """A rectangle with N robots: the state is their positions, the action their velocities.

    Methods take one configuration or a batch of them on the LAST axis, which is twice as fast in the inner loop of
    training, and raise an `InputError` for another shape. Numbers are leaves of the PyTree: changing one does not
    recompile what was compiled for another.

    Attributes:
        config: Sizes of the world and its robots.
        objective: The signals and their weights.
        start: Where episodes begin.
        horizon: Steps after which an episode is truncated.
        per_robot_credit: Whether each robot's action learns from its own potential, instead of all from C.
    """

    config: WorldConfig
    objective: Objective
    start: Start
    horizon: Any
    per_robot_credit: bool = eqx.field(static=True)

    @classmethod
    def create(
        cls,
        config: WorldConfig,
        start: Start,
        objective: str | Mapping[str, Signal] = "C1",
        weights: Mapping[str, float] | None = None,
        horizon: int = 400,
        per_robot_credit: bool = False,
    ) -> World:
        """Builds a world.

        Args:
            config: Its sizes.
            start: Where episodes begin; it is prepared here.
            objective: C1 (gathering at the origin), C2 (at no predefined point), or signals by name.
            weights: Weights that replace the signals' own.
            horizon: Steps after which an episode is truncated.
            per_robot_credit: Whether credit is given robot by robot.

        Raises:
            InputError: There is no such objective or signal, or the start is not possible.
        """
        check_type("config", config, WorldConfig, "sizes of a world, such as WorldConfig(robots=8)")
        check_type("start", start, Start, "a start, such as UniformStart()")
        signals = objective_signals(objective) if isinstance(objective, str) else objective
        return cls(config, Objective(signals, weights), start.prepare(config), horizon, per_robot_credit)

    @property
    def period(self) -> int:
        """Steps within which every robot completes a cycle: one, without a scheduler."""
        return 1

    @property
    def keeps_rest(self) -> bool:
        """Whether a robot that sees the same again decides the same again: nothing is random here."""
        return True

    def __repr__(self) -> str:
        return f"World({self.config.robots} robots, objective of {', '.join(self.objective.names)})"

    def signals(self, positions: Float[Array, "robots 2 *batch"]) -> dict[str, Float[Array, "*batch"]]:
        """Returns the signals of configurations by name."""
        self._check_robots(jnp.shape(positions))
        return self.objective.measure(Configuration(positions, self.config))

    def state(self, positions: Float[Array, "robots 2 *batch"], seed: Any = 0) -> State:
        """Returns the state at the beginning of an episode from the given configurations.

        Args:
            positions: The configurations.
            seed: Not used: the world draws nothing. Wrappers may.
        """
        del seed
        self._check_robots(positions.shape)
        return in_tiles(self._state, positions.shape[0], positions)

    def reset_batch(self, key: PRNGKeyArray, batch: int) -> State:
        """Begins a batch of episodes, each at a fresh start of its own."""
        return self.state(jnp.moveaxis(self.start.sample(key, batch, self.config), 0, -1))

    def step(self, state: State, velocities: Float[Array, "robots 2 *batch"]) -> tuple[State, Transition]:
        """Moves every robot for one step; velocities are clipped to the speed limit component by component."""
        if velocities.shape != state.positions.shape:
            raise InputError("velocities", f"an array {velocities.shape}", f"of shape {state.positions.shape}")
        return in_tiles(self._step, velocities.shape[0], state, velocities)

    def observe(self, state: State | WrappedState) -> Any:
        """Returns the positions: the paper's policy sees all of them."""
        return state.positions

    def _check_robots(self, shape: tuple[Any, ...]) -> None:
        robots = self.config.robots
        if shape[:2] != (robots, 2):
            raise InputError("positions", f"an array {shape}", f"of shape ({robots}, 2, ...), the batch last")

    def _state(self, positions: Float[Array, "robots 2 *batch"]) -> State:
        configuration = Configuration(positions, self.config)
        objective = self.objective(self.objective.measure(configuration))
        step = jnp.zeros(positions.shape[2:], jnp.int32)
        return State(positions, step, objective, self._potential(configuration, objective))

    def _step(self, state: State, velocities: Float[Array, "robots 2 *batch"]) -> tuple[State, Transition]:
        config = self.config
        velocities = jnp.clip(velocities, -config.max_speed, config.max_speed)
        positions = state.positions + velocities
        configuration = Configuration(positions, config)
        signals = self.objective.measure(configuration)
        objective = self.objective(signals)
        potential = self._potential(configuration, objective)
        sides = (config.half_width, config.half_height) if config.bounded else (jnp.inf, jnp.inf)
        motion, sides = (state.positions, velocities, config.radius), (positions, *sides)
        if self.per_robot_credit:
            penalised = _batch_last.in_contact(*motion) | _batch_last.outside(*sides)
            terminated = _batch_last.fold(operator.or_, penalised)
        else:
            terminated = _batch_last.any_contact(*motion) | _batch_last.any_outside(*sides)
            penalised = terminated[None]
        credit = jnp.where(terminated, -config.collision_penalty * penalised, potential - state.potential)
        reward = jnp.where(terminated, -config.collision_penalty, objective - state.objective)
        step = state.step + 1
        truncated = (step >= self.horizon) & ~terminated
        after = State(positions, step, objective, potential)
        return after, Transition(reward, terminated, truncated, signals, credit)

    def _potential(self, configuration: Configuration, objective: Any) -> Float[Array, "actions *batch"]:
        return self.objective.credit(configuration) if self.per_robot_credit else objective[None]


class WrappedState(eqx.Module):
    """A state of a wrapper, around the state of what it wraps."""

    inner: Any

    __repr__ = short_repr

    @property
    def unwrapped(self) -> State:
        """The state of the world."""
        return self.inner.unwrapped

    @property
    def positions(self) -> Float[Array, "robots 2 *batch"]:
        """Centres, world units."""
        return self.inner.positions

    @property
    def objective(self) -> Float[Array, "*batch"]:
        """The objective C of this configuration."""
        return self.inner.objective

    @property
    def epochs(self) -> Int[Array, "*batch"]:
        """Epochs so far."""
        return self.inner.epochs

    @property
    def interventions(self) -> Int[Array, "*batch"]:
        """How often a shield has shortened a robot's move."""
        return self.inner.interventions

    def looked(self, before: Any) -> Bool[Array, "robots *batch"]:
        """Returns which robots began a cycle in the step that led here.

        Args:
            before: The state before that step.
        """
        return self.inner.looked(before.inner)


class Wrapper(eqx.Module):
    """Base of all wrappers: forwards everything to the wrapped environment.

    Attributes:
        env: The world, or a wrapper around it.
    """

    env: Any

    __repr__ = short_repr

    @property
    def unwrapped(self) -> World:
        """The world inside all wrappers."""
        return self.env if isinstance(self.env, World) else self.env.unwrapped

    @property
    def config(self) -> WorldConfig:
        """Sizes of the world and its robots."""
        return self.env.config

    @property
    def start(self) -> Start:
        """Where episodes begin."""
        return self.env.start

    @property
    def period(self) -> int:
        """Steps within which every robot completes a cycle."""
        return self.env.period

    @property
    def keeps_rest(self) -> bool:
        """Whether robots that see the same again decide the same again, as far as that is known."""
        return self.env.keeps_rest

    def signals(self, positions: Float[Array, "robots 2 *batch"]) -> dict[str, Float[Array, "*batch"]]:
        """Returns the signals of configurations by name."""
        return self.env.signals(positions)

    def reset_batch(self, key: PRNGKeyArray, batch: int) -> Any:
        """Begins a batch of episodes, each at a fresh start."""
        return self.env.reset_batch(key, batch)

    def state(self, positions: Float[Array, "robots 2 *batch"], seed: Any = 0) -> Any:
        """Returns the state at the beginning of an episode from the given configurations.

        Args:
            positions: The configurations.
            seed: Seed of the robots' frames, of noise and of the scheduler; or a key for each episode.
        """
        return self.env.state(positions, seed)

    def observe(self, state: Any) -> Any:
        """Returns what policy and value networks are given."""
        return self.env.observe(state)

    def step(self, state: Any, action: Any) -> tuple[Any, Any]:
        """Advances every episode by one step."""
        return self.env.step(state, action)


class ActionRepeat(Wrapper):
    """Keeps up every action for some steps, unless the episode ends before.

    Decisions are then fewer and reach farther: noise that is kept up moves robots, where noise that is drawn anew at
    every step only jitters them. Rewards and credits add up.

    Attributes:
        times: Steps for which each action is kept up.
    """

    times: Any

    def step(self, state: Any, action: Any) -> tuple[Any, Any]:
        """Advances every episode by up to `times` steps."""
        first = self.env.step(state, action)

        def repeat(_: Any, carry: tuple[Any, Any]) -> tuple[Any, Any]:
            before, total = carry
            after, transition = self.env.step(before, action)
            summed = (total.reward + transition.reward, total.credit + transition.credit)
            transition = eqx.tree_at(lambda t: (t.reward, t.credit), transition, summed)
            done = total.terminated | total.truncated
            return jax.tree.map(lambda old, new: jnp.where(done, old, new), carry, (after, transition))

        return jax.lax.fori_loop(1, self.times, repeat, first)


class ShortfallReward(Wrapper):
    """Rewards every step by how far the objective is from its best, instead of by its change.

    So time counts, and the reward of a step says in which direction a better configuration lies where the signals do.

    Attributes:
        recorded: The signals that transitions report, in place of those of the objective; no gradient passes through.
    """

    recorded: dict[str, Signal]

    def step(self, state: Any, action: Any) -> tuple[Any, Transition]:
        """Advances every episode by one step."""
        after, transition = self.env.step(state, action)
        best = sum(self.unwrapped.objective.weights.values())
        reward = jnp.where(transition.terminated, transition.reward, after.objective - best)
        configuration = Configuration(jax.lax.stop_gradient(after.positions), self.config)
        signals = {name: signal.value(configuration) for name, signal in self.recorded.items()}
        return after, Transition(reward, transition.terminated, transition.truncated, signals, reward[None])


class GoalValue(Wrapper):
    """Values configurations in which robots could come to rest, without moving any robot.

    Attributes:
        softness: Of the soft signals of the objective, at the beginning of a training.
        softness_end: At its end.
        emphasis: Factor on the weights of these signals at the beginning; it falls to 1.
        recorded: The signals to report, in place of those of the objective; no gradient passes through.
    """

    softness: Any
    softness_end: Any
    emphasis: Any
    recorded: dict[str, Signal]

    def goal_value(
        self, policy: Any, progress: Float[Array, ""]
    ) -> tuple[Float[Array, " goals"], dict[str, Float[Array, " goals"]]]:
        """Returns the objective of the configurations that a policy steers to, and the recorded signals by name.

        Args:
            policy: A policy network whose `goals(robots)` returns them, `(robots, 2, goals)`.
            progress: Share of the training that is done: softness and emphasis fall geometrically.
        """
        goals = policy.goals(self.config.robots)
        softness = self.softness * (self.softness_end / self.softness) ** progress
        emphasis = self.emphasis ** (1 - progress)
        objective, configuration = self.unwrapped.objective, Configuration(goals, self.config)
        values = {
            name: emphasis * jnp.mean(signal.softened(configuration, softness), axis=0)
            if isinstance(signal, Soft)
            else signal.value(configuration)
            for name, signal in objective.signals.items()
        }
        configuration = Configuration(jax.lax.stop_gradient(goals), self.config)
        return objective(values), {name: signal.value(configuration) for name, signal in self.recorded.items()}


class GoalValues(eqx.Module):
    """Values the goals of a policy in swarms of several sizes, each in a world of its own.

    Attributes:
        parts: A `GoalValue` for each size, or another environment that values goals.
    """

    parts: tuple[Any, ...]

    __repr__ = short_repr

    def goal_value(
        self, policy: Any, progress: Float[Array, ""]
    ) -> tuple[Float[Array, " goals"], dict[str, Float[Array, " goals"]]]:
        """Returns what `GoalValue.goal_value` does, of the goals of all sizes, one after the other."""
        results = [part.goal_value(policy, progress) for part in self.parts]
        return jax.tree.map(lambda *x: jnp.concatenate(x), *results)


ASIDE = (0.5403023, 0.8414710)
"""Direction of a sidestep, in a robot's own frame: that of the angle 1."""

NEAR_WALL = 2.0
"""Sidesteps lead away from walls that are nearer than so many safe distances. Robots in line along a wall are much
nearer to it, so a robot that steps off their line is far from it before a sidestep may lead back."""

LEAST_APART = 0.2
"""Least speed with which robots step apart, relative to the slowest move that they begin otherwise. As fast as those,
two that lack a little would go so far that a policy brings them back, for ever."""


class SlowMoves(eqx.Module):
    """What becomes of moves that are slow, as robots have to come to a stop.

    Attributes:
        least_speed: Moves that are slower than this are not begun, world units per step.
        damped_speed: Moves that are slower than this are shortened, world units per step.
        damping: Share that the shortest moves lose; 0: none is shortened.
        sidestep: Speed of a robot that would stand still in a pattern that it sees is not valid, world units per step;
            0: it stands still.
    """

    least_speed: Any
    damped_speed: Any = 0.0
    damping: float = eqx.field(default=0.0, static=True)
    sidestep: float = eqx.field(default=0.0, static=True)

    __repr__ = short_repr


class DeadZone(Wrapper):
    """Robots whose policy wants a slow move stand still, or step aside: see `apply_dead_zone`.

    Attributes:
        slow: What becomes of slow moves.
        world: The sizes by which robots perceive: in training with a margin, those of the world as it is.
    """

    slow: SlowMoves
    world: WorldConfig

    def step(self, state: Any, action: Float[Array, "robots 2 *batch"]) -> tuple[Any, Any]:
        """Stops the slow robots and advances every episode by one step."""
        observation = self.env.observe(state) if self.slow.sidestep else None
        return self.env.step(state, apply_dead_zone(action, observation, self.slow, self.world))


def apply_dead_zone(
    velocities: Float[Array, "robots 2 *batch"], observation: Any, slow: SlowMoves, world: WorldConfig
) -> Float[Array, "robots 2 *batch"]:
    """Returns velocities of which those whose length is less than `slow.least_speed` are exactly 0.

    That is how a swarm comes to rest. With `damping`, the others lose the more of their length the nearer it is to 0,
    up to `damped_speed`: robots that correct the same error at the same moment would else correct too much, and for
    ever.

    With `sidestep`, a robot that sees that the pattern is not valid does not stand still. If it occludes one robot that
    it sees from another one, it steps aside: see `_step_aside`. Where a configuration is symmetric, so is what any
    policy makes of it, and the robot in its centre could never leave: robots' frames break the symmetry. Else, if
    robots are nearer than the safe distance, it moves away from them, by half of what is missing, as they do too.

    Args:
        velocities: What a policy wants, world units per step, in each robot's own frame.
        observation: What the policy acts on: what the robots see, or all positions; only used with `sidestep`.
        slow: What becomes of slow moves.
        world: The sizes by which robots perceive; only used with `sidestep`.
    """
    squared = jnp.sum(velocities**2, axis=1, keepdims=True)
    is_slow = squared < slow.least_speed**2
    decided = velocities
    if slow.damping:
        speed = jnp.sqrt(jnp.where(squared > 0, squared, 1.0))
        decided = velocities * (1 - slow.damping * jnp.maximum(1 - speed / slow.damped_speed, 0.0))
    decided = jnp.where(is_slow, 0.0, decided)
    if slow.sidestep:
        view = view_of(observation, world)
        is_between = _batch_last.stands_between(view.x, view.y, view.seen, view.radius)[:, None]
        stepped = jnp.where(is_between, _step_aside(view, slow, world), _step_apart(view, slow, world))
        decided = jnp.where(is_slow, stepped, decided)
    # Gradients pass as if nothing were changed: a robot that stands still would never learn to set out.
    return velocities - jax.lax.stop_gradient(velocities - decided)


def _step_aside(view: View, slow: SlowMoves, world: WorldConfig) -> Float[Array, "robots 2 *batch"]:
    """Returns velocities in one direction of each robot's own frame; near a wall, what leads to the wall leads away.

    The direction is oblique: robots stand in line along walls, and frames may be parallel to these. A robot that turned
    back only where the next step would cross a wall would come back with the one after that, and never get away from a
    line along it.
    """
    direction = jnp.asarray(ASIDE, view.radius.dtype).reshape((1, 2) + (1,) * (view.radius.ndim - 1))
    aside = slow.sidestep * jnp.broadcast_to(direction, (view.x.shape[0], 2, *view.radius.shape[1:]))
    if view.walls is None:
        return aside
    normal, distance = wall_directions(view.walls * (world.radius / view.radius)[:, None, None])
    approach = jnp.sum(aside[:, None] * normal, axis=2)
    mirrored = jnp.where(distance < NEAR_WALL * world.safe_distance, jnp.maximum(approach, 0.0), 0.0)
    return aside - 2 * jnp.sum(mirrored[:, :, None] * normal, axis=1)


def _step_apart(view: View, slow: SlowMoves, world: WorldConfig) -> Float[Array, "robots 2 *batch"]:
    """Returns velocities away from the robots that are nearer than the safe distance; 0 where none is."""
    length = jnp.sqrt(view.x**2 + view.y**2)
    # A robot at one's own place is in no direction.
    missing = world.safe_distance - length * (world.radius / view.radius)[:, None]
    missing = jnp.where(view.seen & (length > 0), jnp.maximum(missing, 0.0), 0.0)
    weight = missing / jnp.where(length > 0, length, 1.0)
    away = -jnp.stack([jnp.sum(weight * axis, axis=1) for axis in (view.x, view.y)], axis=1)
    size = jnp.sqrt(jnp.sum(away**2, axis=1, keepdims=True))
    # The maximum of no robots is not defined. A little more than half: rounding a half could leave them too near.
    nobody = jnp.zeros_like(view.radius[:, None])
    most = jnp.max(jnp.concatenate([missing, nobody], axis=1), axis=1, keepdims=True)
    speed = jnp.clip(0.51 * most, LEAST_APART * slow.least_speed, slow.sidestep)
    return jnp.where(size > 0, speed * away / jnp.where(size > 0, size, 1.0), 0.0)


class MotionCost(Wrapper):
    """Training in which motion costs a little: what an action learns from, its credit, loses by how far robots went.

    Where credit is given robot by robot, each pays for its own way; else the swarm pays for the mean. The reward, which
    is recorded, stays the change of the objective.

    Attributes:
        cost: Cost of a step at the speed limit along an axis.
    """

    cost: Any

    def step(self, state: Any, action: Float[Array, "robots 2 *batch"]) -> tuple[Any, Transition]:
        """Advances every episode by one step."""
        after, transition = self.env.step(state, action)
        squared = jnp.sum((after.positions - state.positions) ** 2, axis=1)
        # The gradient of the square root at 0 is not finite.
        distance = jnp.where(squared > 0, jnp.sqrt(jnp.where(squared > 0, squared, 1.0)), 0.0)
        cost = self.cost * distance / self.config.max_speed
        if transition.credit.shape != cost.shape:
            cost = jnp.mean(cost, axis=0, keepdims=True)
        return after, eqx.tree_at(lambda t: t.credit, transition, transition.credit - cost)


class ObservedState(WrappedState):
    """A state together with how each robot looks at it.

    Attributes:
        frames: Every robot's system of coordinates.
        key: Randomness of what is perceived next.
    """

    frames: Frames
    key: UInt32[Array, "two *batch"]


class LocalObservation(Wrapper):
    """Robots that act on what they perceive: each from its own view, with a velocity in its own frame.

    Robots know their own size, so a velocity needs no unit of length: only its direction is in the robot's own frame.

    Attributes:
        sensing: What is perceived, in which frames.
        world: The sizes by which it is perceived: in training with a margin, robots perceive the world as it is.
    """

    sensing: Sensing
    world: WorldConfig

    @property
    def keeps_rest(self) -> bool:
        """Whether robots see a configuration alike every time."""
        return self.sensing.is_constant and self.env.keeps_rest

    def reset_batch(self, key: PRNGKeyArray, batch: int) -> ObservedState:
        """Begins a batch of episodes, each at a fresh start and with fresh frames."""
        start, frames = jax.random.split(key)
        return self._observed(self.env.reset_batch(start, batch), jax.random.split(frames, batch))

    def state(self, positions: Float[Array, "robots 2 *batch"], seed: Any = 0) -> ObservedState:
        """Returns the state at the beginning of an episode from the given configurations."""
        return self._observed(self.env.state(positions, seed), episode_keys(seed, positions))

    def observe(self, state: ObservedState) -> Observation:
        """Returns what every robot perceives, and what the value network may know."""
        x, y = state.positions[:, 0], state.positions[:, 1]
        # In the whole plane, the value network is told that walls are as far as anybody sees.
        far = jnp.full_like(x, self.world.scan_radius)
        sides = (self.world.half_width - abs(x), self.world.half_height - abs(y))
        distance = jnp.minimum(*sides) if self.world.bounded else far
        return Observation(self.view(state), state.positions, jnp.maximum(distance, 0.0))

    def view(self, state: ObservedState) -> View:
        """Returns what every robot perceives."""
        return self.sensing.view(state.positions, state.frames, wrap_keys(state.key), self.world)

    def step(self, state: ObservedState, action: Float[Array, "robots 2 *batch"]) -> tuple[ObservedState, Transition]:
        """Moves every robot by its own velocity."""
        after, transition = self.env.step(state.inner, state.frames.to_world(action))
        keys = next_keys(wrap_keys(state.key))
        if self.sensing.resample_frames:
            return self._observed(after, keys), transition
        return ObservedState(after, state.frames, key_data(keys)), transition

    def _observed(self, inner: Any, keys: Key[Array, "*batch"]) -> ObservedState:
        frames = self.sensing.draw_frames(keys, inner.positions.shape[0], inner.positions.dtype)
        return ObservedState(inner, frames, key_data(next_keys(keys)))


class ScheduledState(WrappedState):
    """A state together with where each robot is in its Look-Compute-Move cycle.

    Attributes:
        pause: Steps that a robot rests before it looks.
        delay: Steps from its look to its move.
        steps_to_go: Steps that its move still takes.
        committed_velocity: Velocity of its move, world units per step.
        remaining_distance: How far the move may still go, world units.
        idle: Steps since it was last active.
        completed: Which robots have completed a cycle in this epoch.
        completed_epochs: Epochs so far: in each, every robot completed at least one cycle.
        key: Randomness of what comes next.
    """

    pause: Int[Array, "robots *batch"]
    delay: Int[Array, "robots *batch"]
    steps_to_go: Int[Array, "robots *batch"]
    committed_velocity: Float[Array, "robots 2 *batch"]
    remaining_distance: Float[Array, "robots *batch"]
    idle: Int[Array, "robots *batch"]
    completed: Bool[Array, "robots *batch"]
    completed_epochs: Int[Array, "*batch"]
    key: UInt32[Array, "two *batch"]

    @property
    def epochs(self) -> Int[Array, "*batch"]:
        """Epochs so far."""
        return self.completed_epochs

    @property
    def ready(self) -> Bool[Array, "robots *batch"]:
        """Which robots are in no cycle, and begin one as soon as they are active."""
        return self.pause + self.delay + self.steps_to_go == 0

    def looked(self, before: ScheduledState) -> Bool[Array, "robots *batch"]:
        """Returns which robots began a cycle in the step that led here."""
        return before.ready & (self.idle == 0)


class SchedulerWrapper(Wrapper):
    """Robots that look and move when a scheduler lets them.

    Attributes:
        scheduler: The scheduler.
    """

    scheduler: Scheduler

    @property
    def period(self) -> int:
        """Steps within which every robot completes a cycle."""
        return self.scheduler.period

    @property
    def keeps_rest(self) -> bool:
        """Whether every robot looks within the scheduler's period, as far as that is known."""
        return not self.scheduler.is_foreign() and self.env.keeps_rest

    def reset_batch(self, key: PRNGKeyArray, batch: int) -> ScheduledState:
        """Begins a batch of episodes, each at a fresh start, every robot somewhere in its cycle."""
        start, clocks = jax.random.split(key)
        return self._scheduled(self.env.reset_batch(start, batch), jax.random.split(clocks, batch))

    def state(self, positions: Float[Array, "robots 2 *batch"], seed: Any = 0) -> ScheduledState:
        """Returns the state at the beginning of an episode from the given configurations."""
        # Other numbers than those of the frames, which are drawn from the same seed.
        return self._scheduled(self.env.state(positions, seed), next_keys(episode_keys(seed, positions), 2))

    def step(self, state: ScheduledState, action: Float[Array, "robots 2 *batch"]) -> tuple[ScheduledState, Transition]:
        """Moves the robots whose move is under way."""
        keys, candidates = wrap_keys(state.key), self.scheduler.candidates
        clock = Clock(state.unwrapped.step, state.idle, state.positions)
        if candidates == 1:
            after, transition = self._moved(state, action, draw_each(self.scheduler.activate, keys, clock))
        else:
            outcomes = [
                self._moved(state, action, draw_each(self.scheduler.activate, next_keys(keys, number), clock))
                for number in range(2, 2 + candidates)
            ]
            # The worst has the least reward; an episode that terminates has the least of all.
            after, transition = outcomes[0]
            for outcome in outcomes[1:]:
                worse = outcome[1].reward < transition.reward
                after, transition = jax.tree.map(
                    lambda new, old, worse=worse: jnp.where(worse, new, old), outcome, (after, transition)
                )
        return eqx.tree_at(lambda s: s.key, after, key_data(next_keys(keys))), transition

    def _scheduled(self, inner: Any, keys: Key[Array, "*batch"]) -> ScheduledState:
        positions = inner.positions
        zero = jnp.zeros((positions.shape[0], *positions.shape[2:]), jnp.int32)
        clock = Clock(inner.unwrapped.step, zero, positions)
        first: Activation = draw_each(self.scheduler.activate, keys, clock)
        return ScheduledState(
            inner=inner,
            pause=first.pause,
            delay=zero,
            steps_to_go=zero,
            committed_velocity=jnp.zeros_like(positions),
            remaining_distance=jnp.zeros_like(first.completion),
            idle=zero,
            completed=jnp.zeros_like(first.active),
            completed_epochs=jnp.zeros_like(zero[0]),
            key=key_data(next_keys(keys)),
        )

    def _moved(
        self, state: ScheduledState, velocities: Array, activation: Activation
    ) -> tuple[ScheduledState, Transition]:
        scheduler, limit = self.scheduler, self.config.max_speed
        # Look and compute: a robot that is ready and active commits itself to the velocity of what it sees now.
        ready = state.ready
        looks = ready & (activation.active | (state.idle >= scheduler.fairness_bound - 1))
        committed = jnp.where(looks[:, None], jnp.clip(velocities, -limit, limit), state.committed_velocity)
        # A shield relies on what a scheduler states.
        delay = jnp.where(looks, _at_most(activation.delay, scheduler.max_delay), state.delay)
        steps_to_go = jnp.where(looks, _at_most(activation.move_steps, scheduler.max_move_steps), state.steps_to_go)
        speed = jnp.sqrt(jnp.sum(committed**2, axis=1))
        whole = speed * steps_to_go
        least = jnp.minimum(scheduler.min_move, whole)
        remaining = jnp.where(looks, least + activation.completion * (whole - least), state.remaining_distance)
        # Move. A rigid move is not shortened, so that no rounding shortens its last step.
        moves = (state.pause == 0) & (delay == 0) & (steps_to_go > 0)
        distance = speed if scheduler.rigid else jnp.minimum(speed, remaining)
        share = jnp.where(moves & (speed > 0), distance / jnp.where(speed > 0, speed, 1), 0)
        after, transition = self.env.step(state.inner, committed * share[:, None])
        ends = moves & (steps_to_go == 1)
        completed = state.completed | ends
        epoch = jnp.all(completed, axis=0)
        return ScheduledState(
            inner=after,
            pause=jnp.where(ends, activation.pause, jnp.maximum(state.pause - 1, 0)),
            delay=jnp.maximum(delay - 1, 0),
            steps_to_go=steps_to_go - moves,
            committed_velocity=committed,
            remaining_distance=remaining - share * speed,
            idle=jnp.where(ready & ~looks, state.idle + 1, 0),
            completed=completed & ~epoch,
            completed_epochs=state.completed_epochs + epoch,
            key=state.key,
        ), transition


def _at_most(steps: Int[Array, "robots *batch"], limit: int | None) -> Int[Array, "robots *batch"]:
    return steps if limit is None else jnp.minimum(steps, limit)
