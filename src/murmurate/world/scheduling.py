"""Look-Compute-Move: when each robot looks and moves (FSYNC, SSYNC, ASYNC), and how far it gets.

A robot's cycle is to look, to compute a velocity from what it saw, and to move with that velocity. A scheduler decides
which robots begin a cycle at which step, how long it takes, and how far the move may go. The policy is evaluated for
every robot at every step; only the robots that look at that step use the result, and the others keep the velocity that
they committed to. So a stale snapshot is never stored: the velocity computed from it is.

See Flocchini, Prencipe and Santoro, Distributed Computing by Oblivious Mobile Robots (2012), for the models.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from murmurate import prng
from murmurate.errors import MAX_MAGNITUDE, check_number
from murmurate.registry import Strategy
from murmurate.representation import short_repr

__all__ = ["Activation", "AsyncScheduler", "Clock", "FsyncScheduler", "Scheduler", "SsyncScheduler"]

MAX_STEPS = 1000


class Clock(eqx.Module):
    """What a scheduler is told of one episode at one step; `activate` gets it without batch axes.

    Attributes:
        step: Steps since the episode began.
        idle: Steps since each robot was last active.
        positions: Centres, world units.
    """

    step: Int[Array, "*batch"]
    idle: Int[Array, "robots *batch"]
    positions: Float[Array, "robots 2 *batch"]

    __repr__ = short_repr


class Activation(eqx.Module):
    """What a scheduler decides at one step of one episode.

    Attributes:
        active: Which robots begin a cycle, if they are not in one.
        pause: Steps that each rests before its next look, once its move has ended.
        delay: Steps from its look to its move.
        move_steps: Steps that its move takes.
        completion: Share of the move beyond the least one that it completes, from 0 to 1.
    """

    active: Bool[Array, "robots *batch"]
    pause: Int[Array, "robots *batch"]
    delay: Int[Array, "robots *batch"]
    move_steps: Int[Array, "robots *batch"]
    completion: Float[Array, "robots *batch"]

    __repr__ = short_repr


class Scheduler(Strategy):
    """When robots look and move.

    A subclass implements `activate` and `period`.

    Attributes:
        rigid: Whether every move ends where it was meant to; otherwise it may be stopped on its way.
        min_move: A move is never stopped before this distance, world units.
    """

    section: ClassVar[str] = "scheduler"

    rigid: bool = eqx.field(default=True, static=True, kw_only=True)
    min_move: float = eqx.field(default=0.25, static=True, kw_only=True)

    fairness_bound: ClassVar[int] = MAX_STEPS
    """A robot is idle for fewer than so many steps in a row; a subclass may make it a field."""

    max_delay: ClassVar[int | None] = None
    """Steps from a look to the move, at most; None: not stated."""

    max_move_steps: ClassVar[int | None] = None
    """Steps that a move takes, at most; None: not stated."""

    candidates: ClassVar[int] = 1
    """Activations drawn at each step, of which the one with the worst outcome happens: an adversary draws several."""

    def __check_init__(self) -> None:
        check_number("min_move", self.min_move, 0, MAX_MAGNITUDE, exclusive_low=True)

    @abstractmethod
    def activate(self, key: PRNGKeyArray, clock: Clock) -> Activation:
        """Draws what happens at one step of one episode."""

    @property
    @abstractmethod
    def period(self) -> int:
        """Steps within which every robot completes a cycle."""

    @property
    def is_trivial(self) -> bool:
        """Whether every robot completes a whole cycle at every step, so that nothing needs to be scheduled."""
        return False

    def completion(self, key: PRNGKeyArray, robots: int) -> Float[Array, " robots"]:
        """Draws which share of its move each robot completes: all of it where moves are rigid."""
        return jnp.ones(robots, jnp.float32) if self.rigid else jax.random.uniform(key, (robots,), jnp.float32)


@Scheduler.register("fsync")
class FsyncScheduler(Scheduler):
    """FSYNC: all robots are active at every step."""

    max_delay: ClassVar[int | None] = 0
    max_move_steps: ClassVar[int | None] = 1

    def activate(self, key: PRNGKeyArray, clock: Clock) -> Activation:
        """Activates all robots."""
        robots = clock.idle.shape[0]
        zero = jnp.zeros(robots, jnp.int32)
        completion = self.completion(jax.random.split(key, 6)[5], robots)
        return Activation(jnp.ones(robots, bool), zero, zero, zero + 1, completion)

    @property
    def period(self) -> int:
        """One step."""
        return 1

    @property
    def is_trivial(self) -> bool:
        """Whether moves are rigid."""
        return self.rigid


@Scheduler.register("ssync")
class SsyncScheduler(Scheduler):
    """SSYNC: some robots, at least one, are active at every step.

    Attributes:
        activation_probability: Probability that a robot is active at a step.
        fairness_bound: A robot is idle for fewer than so many steps in a row.
        adversarial: Whether an adversary chooses which robots are active and how far each gets: of 4 drawn choices the
            one with the least next objective.
    """

    max_delay: ClassVar[int | None] = 0
    max_move_steps: ClassVar[int | None] = 1

    activation_probability: float = eqx.field(default=0.5, static=True)
    fairness_bound: int = eqx.field(default=8, static=True)  # type: ignore[misc]
    adversarial: bool = eqx.field(default=False, static=True)

    def __check_init__(self) -> None:
        check_number("activation_probability", self.activation_probability, 0, 1)
        check_number("fairness_bound", self.fairness_bound, 1, MAX_STEPS, integer=True)

    def activate(self, key: PRNGKeyArray, clock: Clock) -> Activation:
        """Draws the active robots independently; where that gives none, one robot with equal chances."""
        robots = clock.idle.shape[0]
        active_key, single_key, _, _, _, completion_key = jax.random.split(key, 6)
        single = jnp.arange(robots) == jax.random.randint(single_key, (), 0, robots, jnp.int32)
        drawn = prng.bernoulli(active_key, self.activation_probability, (robots,))
        zero = jnp.zeros(robots, jnp.int32)
        active = jnp.where(jnp.any(drawn), drawn, single)
        return Activation(active, zero, zero, zero + 1, self.completion(completion_key, robots))

    @property
    def period(self) -> int:
        """The bound of fairness."""
        return self.fairness_bound

    @property
    def candidates(self) -> int:  # type: ignore[override]
        """Four for an adversary."""
        return 4 if self.adversarial else 1


@Scheduler.register("async")
class AsyncScheduler(Scheduler):
    """ASYNC: each robot in its own time. It moves by what it saw some steps ago, and others may see it moving.

    Attributes:
        max_delay: A robot rests for up to so many steps before it looks, and again between its look and its move.
        max_move_steps: A move takes up to so many steps, at the velocity computed before the first.
    """

    max_delay: int = eqx.field(default=2, static=True)  # type: ignore[misc]
    max_move_steps: int = eqx.field(default=4, static=True)  # type: ignore[misc]

    def __check_init__(self) -> None:
        check_number("max_delay", self.max_delay, 0, MAX_STEPS, integer=True)
        check_number("max_move_steps", self.max_move_steps, 1, MAX_STEPS, integer=True)

    def activate(self, key: PRNGKeyArray, clock: Clock) -> Activation:
        """Draws every robot's times; each begins its cycle as soon as the one before has ended."""
        robots = clock.idle.shape[0]
        _, _, pause, delay, move_steps, completion_key = jax.random.split(key, 6)
        shape, dtype = (robots,), jnp.int32
        return Activation(
            active=jnp.ones(robots, bool),
            pause=jax.random.randint(pause, shape, 0, self.max_delay + 1, dtype),
            delay=jax.random.randint(delay, shape, 0, self.max_delay + 1, dtype),
            move_steps=jax.random.randint(move_steps, shape, 1, self.max_move_steps + 1, dtype),
            completion=self.completion(completion_key, robots),
        )

    @property
    def period(self) -> int:
        """Both rests and the move, at their longest."""
        return 2 * self.max_delay + self.max_move_steps
