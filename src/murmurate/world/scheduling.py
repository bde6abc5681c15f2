"""Look-Compute-Move: when each robot looks and when it moves (FSYNC, SSYNC, ASYNC), and how far it gets.

A robot's cycle is to look, to compute a velocity from what it saw, and to move by it. A scheduler says who begins a
cycle at which step, how long it takes, and how far its move may go. A policy is asked for every robot at every step;
only whoever looks at that step takes the answer, and whoever is still computing or moving keeps the one it has. So a
stale snapshot is never stored: what was computed from it is.

See Flocchini, Prencipe and Santoro, Distributed Computing by Oblivious Mobile Robots (2012), for the models.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, UInt32

from murmurate.errors import GREATEST, InputError, check_choice, check_number
from murmurate.world.randomness import each, episode_keys, following, plain, wrapped
from murmurate.world.starts import Start
from murmurate.world.world import World

__all__ = ["ScheduledState", "SchedulerConfig", "SchedulerKind", "SchedulerWrapper", "epochs_of"]

SchedulerKind = Literal["fsync", "ssync", "async"]

CANDIDATES = 4
"""Choices among which an adversary takes the worst."""


@dataclass(frozen=True)
class SchedulerConfig:
    """When robots look and move.

    Attributes:
        kind: fsync (all of them at every step), ssync (some of them at every step) or async (each in its own time: it
            moves by what it saw some steps ago, and others may see it moving).
        share: Probability that a robot is active at a step (ssync).
        within: A robot is idle for fewer than so many steps in a row (ssync): the bound of fairness.
        adversarial: Whether an adversary chooses, as the worst of 4 drawn choices for the next objective, who is active
            and how far each gets (not async).
        delay: A robot rests for up to so many steps before it looks, and again between its look and its move (async).
        span: A move takes up to so many steps, at the velocity computed before the first (async).
        rigid: Whether every move ends where it was meant to; otherwise it may be stopped on its way.
        least: A move is never stopped before this distance, world units.
    """

    kind: SchedulerKind = "fsync"
    share: float = 0.5
    within: int = 8
    adversarial: bool = False
    delay: int = 2
    span: int = 4
    rigid: bool = True
    least: float = 0.25

    def __post_init__(self) -> None:
        check_choice("kind", self.kind, get_args(SchedulerKind))
        check_number("share", self.share, 0, 1)
        check_number("within", self.within, 1, 1000, integer=True)
        check_number("delay", self.delay, 0, 1000, integer=True)
        check_number("span", self.span, 1, 1000, integer=True)
        check_number("least", self.least, 0, GREATEST, exclusive_low=True)
        if self.adversarial and self.kind == "async":
            raise InputError("adversarial", True, "false with kind = 'async': there each robot has its own time")

    @property
    def plain(self) -> bool:
        """Whether every robot completes a cycle at every step, as the world itself has it."""
        return self.kind == "fsync" and self.rigid

    @property
    def period(self) -> int:
        """Steps within which every robot completes a cycle."""
        return {"fsync": 1, "ssync": self.within, "async": 2 * self.delay + self.span}[self.kind]


class ScheduledState(eqx.Module):
    """Where the robots are, and where each is in its cycle.

    Attributes:
        world: The state of the world.
        pause: Steps that a robot rests before it looks.
        delay: Steps from its look to its move.
        moving: Steps that its move still takes.
        held: Velocity of its move, world units per step.
        left: How far the move may still go, world units.
        idle: Steps since it was last active.
        completed: Who has completed a cycle in this epoch.
        epochs: Epochs so far: in each, every robot completed at least one cycle.
        key: Randomness of what comes next.
    """

    world: Any
    pause: Int[Array, "robots *batch"]
    delay: Int[Array, "robots *batch"]
    moving: Int[Array, "robots *batch"]
    held: Float[Array, "robots 2 *batch"]
    left: Float[Array, "robots *batch"]
    idle: Int[Array, "robots *batch"]
    completed: Bool[Array, "robots *batch"]
    epochs: Int[Array, "*batch"]
    key: UInt32[Array, "two *batch"]

    @property
    def positions(self) -> Float[Array, "robots 2 *batch"]:
        """Centres, world units."""
        return self.world.positions

    @property
    def objective(self) -> Float[Array, "*batch"]:
        """The objective C of this configuration."""
        return self.world.objective


class _Choice(eqx.Module):
    """What a scheduler chose: for those who look, their clocks and which share of their move they may go."""

    active: Bool[Array, "robots *batch"]
    pause: Int[Array, "robots *batch"]
    delay: Int[Array, "robots *batch"]
    span: Int[Array, "robots *batch"]
    share: Float[Array, "robots *batch"]


class SchedulerWrapper(eqx.Module):
    """A world whose robots look and move when a scheduler lets them.

    Attributes:
        world: The world.
        scheduler: The scheduler.
    """

    world: World
    scheduler: SchedulerConfig = eqx.field(static=True)

    def reset_batch(self, key: PRNGKeyArray, batch: int) -> ScheduledState:
        """Begins a batch of episodes, each at a fresh start, every robot somewhere in its cycle."""
        begin, clocks = jax.random.split(key)
        return self._begun(self.world.reset_batch(begin, batch), jax.random.split(clocks, batch))

    def state(self, positions: Float[Array, "robots 2 *batch"], seed: Any = 0) -> ScheduledState:
        """Returns the state at the beginning of an episode from the given configurations."""
        # Other numbers than those of the frames, which are drawn by the same seed.
        return self._begun(self.world.state(positions), following(episode_keys(seed, positions), 2))

    @property
    def start(self) -> Start:
        """Where episodes begin."""
        return self.world.start

    def signals(self, positions: Float[Array, "robots 2 *batch"]) -> dict[str, Float[Array, "*batch"]]:
        """Returns the signals of configurations by name."""
        return self.world.signals(positions)

    def observe(self, state: ScheduledState) -> Float[Array, "robots 2 *batch"]:
        """Returns the positions."""
        return state.positions

    def step(self, state: ScheduledState, velocities: Float[Array, "robots 2 *batch"]) -> tuple[ScheduledState, Any]:
        """Moves those who are moving; see `World.step`."""
        keys = wrapped(state.key)
        robots, dtype = state.positions.shape[0], state.positions.dtype
        if self.scheduler.adversarial:
            after, transition = self._worst(state, velocities, keys)
        else:
            choice = each(lambda key: self._choose(key, robots, dtype), keys)
            after, transition = self._moved(state, velocities, choice)
        return eqx.tree_at(lambda s: s.key, after, plain(following(keys))), transition

    def _begun(self, state: Any, keys: PRNGKeyArray) -> ScheduledState:
        robots, dtype = state.positions.shape[0], state.positions.dtype
        first = each(lambda key: self._choose(key, robots, dtype), keys)
        none = jnp.zeros_like(first.pause)
        return ScheduledState(
            world=state,
            pause=first.pause,
            delay=none,
            moving=none,
            held=jnp.zeros_like(state.positions),
            left=jnp.zeros_like(first.share),
            idle=none,
            completed=jnp.zeros_like(first.active),
            epochs=jnp.zeros_like(none[0]),
            key=plain(following(keys)),
        )

    def _choose(self, key: PRNGKeyArray, robots: int, dtype: Any) -> _Choice:
        """Draws what might happen at one step of one episode."""
        config, shape = self.scheduler, (robots,)
        who, one, pause, delay, span, share = jax.random.split(key, 6)
        active = jnp.ones(shape, bool)
        if config.kind == "ssync":
            somebody = jnp.arange(robots) == jax.random.randint(one, (), 0, robots)
            drawn = jax.random.bernoulli(who, config.share, shape)
            active = jnp.where(jnp.any(drawn), drawn, somebody)
        none = jnp.zeros(shape, jnp.int32)
        slow = config.kind == "async"
        return _Choice(
            active=active,
            pause=jax.random.randint(pause, shape, 0, config.delay + 1) if slow else none,
            delay=jax.random.randint(delay, shape, 0, config.delay + 1) if slow else none,
            span=jax.random.randint(span, shape, 1, config.span + 1) if slow else none + 1,
            share=jnp.ones(shape, dtype) if config.rigid else jax.random.uniform(share, shape, dtype),
        )

    def _worst(self, state: ScheduledState, velocities: Array, keys: PRNGKeyArray) -> tuple[ScheduledState, Any]:
        """Tries some choices, and takes the one after which the objective is least, a collision least of all."""
        robots, dtype = state.positions.shape[0], state.positions.dtype

        def attempt(number: int) -> tuple[ScheduledState, Any]:
            choice = each(lambda key: self._choose(key, robots, dtype), following(keys, number))
            return self._moved(state, velocities, choice)

        tried = [attempt(number) for number in range(2, 2 + CANDIDATES)]
        worst = tried[0]
        for other in tried[1:]:
            worse = other[1].reward < worst[1].reward
            worst = jax.tree.map(lambda a, b, worse=worse: jnp.where(worse, a, b), other, worst)
        return worst

    def _moved(self, state: ScheduledState, velocities: Array, choice: _Choice) -> tuple[ScheduledState, Any]:
        config, limit = self.scheduler, self.world.max_speed
        ready = state.pause + state.delay + state.moving == 0
        looks = ready & (choice.active | (state.idle >= config.within - 1))
        held = jnp.where(looks[:, None], jnp.clip(velocities, -limit, limit), state.held)
        delay = jnp.where(looks, choice.delay, state.delay)
        moving = jnp.where(looks, choice.span, state.moving)
        speed = jnp.sqrt(jnp.sum(held**2, axis=1))
        whole = speed * moving
        least = jnp.minimum(config.least, whole)
        left = jnp.where(looks, least + choice.share * (whole - least), state.left)
        moves = (state.pause == 0) & (delay == 0) & (moving > 0)
        # A move that is not stopped is whole: no rounding shortens its last step.
        way = speed if config.rigid else jnp.minimum(speed, left)
        share = jnp.where(moves & (speed > 0), way / jnp.where(speed > 0, speed, 1), 0)
        after, transition = self.world.step(state.world, held * share[:, None])
        ends = moves & (moving == 1)
        completed = state.completed | ends
        epoch = jnp.all(completed, axis=0)
        return ScheduledState(
            world=after,
            pause=jnp.where(ends, choice.pause, jnp.maximum(state.pause - 1, 0)),
            delay=jnp.maximum(delay - 1, 0),
            moving=moving - moves,
            held=held,
            left=left - share * speed,
            idle=jnp.where(ready & ~looks, state.idle + 1, 0),
            completed=completed & ~epoch,
            epochs=state.epochs + epoch,
            key=state.key,
        ), transition


def epochs_of(state: Any) -> Int[Array, "*batch"]:
    """Returns the epochs of an episode so far, whatever its world is wrapped in; without a scheduler, its steps."""
    while not hasattr(state, "epochs") and hasattr(state, "world"):
        state = state.world
    return state.epochs if hasattr(state, "epochs") else state.step
