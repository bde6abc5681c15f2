"""The policy list as it is executed: each policy acts until the swarm is at rest; then what follows is watched."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt32

from murmurate import prng
from murmurate.discovery.rest import RestLimits, RestRule, all_still, has_ended
from murmurate.errors import InputError, RunError, check_function, check_number
from murmurate.interrupts import raise_if_interrupted
from murmurate.types import Trajectories
from murmurate.world import World, Wrapper, checked_starts, episodes_at_once

__all__ = ["MAX_RECORD_BYTES", "STATIONARY_STEPS", "Cascade"]

MAX_RECORD_BYTES = 1 << 32
"""Memory of the positions of a rollout, at most: 10,000 episodes of ten robots, more than 5,000 steps each."""

CHUNK = 50
"""Steps between two checks whether every episode has ended, at most."""

CHUNK_TRIPLES = 1 << 28
"""Triples of robots in all steps of a chunk of two or more, about: they take seconds, and nothing interrupts them."""


STATIONARY_STEPS = 200
"""Steps (cycles, under a scheduler) for which a swarm that came to rest is watched: does its pattern stay?"""

DECIDING_PERIODS = 3
"""Periods of a scheduler in which every robot looks, and begins the move that it decides on, at least once.

A move may begin a period after its look, and between two looks there is at most one.
"""


class _Status(eqx.Module):
    """The state of the cascade in each episode of the batch.

    Attributes:
        state: State of the environment; that of an ended episode stays as it is, whatever its scheduler had begun.
        signals: Signals of that state by name.
        active_policy: Place in the list of the policy that acts; the number of policies when all are done.
        steps_active: Steps for which it has acted.
        recent_changes: The last changes of the objective.
        still_steps: Its last steps in a row in which every robot was still.
        unmoved_steps: Its last steps in a row in which no robot moved at all.
        length: Steps so far.
        switch: Steps at which each policy ended.
        at_rest: Whether the last policy came to rest.
        terminated: Whether the episode ended in contact or outside the world.
        watched: Whether it came to rest and goes on, to see whether its pattern stays: nothing ends it any more.
    """

    state: Any
    signals: dict[str, Array]
    active_policy: Int[Array, " batch"]
    steps_active: Int[Array, " batch"]
    recent_changes: Float[Array, "window batch"]
    still_steps: Int[Array, " batch"]
    unmoved_steps: Int[Array, " batch"]
    length: Int[Array, " batch"]
    switch: Int[Array, "policies batch"]
    at_rest: Bool[Array, " batch"]
    terminated: Bool[Array, " batch"]
    watched: Bool[Array, " batch"]

    def moving(self) -> Bool[Array, " batch"]:
        """Returns which episodes have not ended."""
        return (self.active_policy < self.switch.shape[0]) & ~self.terminated


class Cascade(eqx.Module):
    """A list of policies, executed one after another in an environment.

    Attributes:
        policies: The policies; each maps an observation to velocities.
        env: The world as the policies act in it: with its scheduler, sensing and shield.
        rest: When a policy has come to rest, in steps.
    """

    policies: tuple[Any, ...]
    env: World | Wrapper
    rest: RestRule = eqx.field(static=True)

    def __repr__(self) -> str:
        policies = ", ".join(type(policy).__name__ for policy in self.policies)
        return f"Cascade({self.world.config.robots} robots: {policies})"

    @property
    def world(self) -> World:
        """The world inside all wrappers."""
        return self.env.unwrapped if isinstance(self.env, Wrapper) else self.env

    @prng.reproducible()
    def rollout(
        self,
        starts: Float[np.ndarray, "episodes robots 2"],
        seed: int = 0,
        on_chunk: Callable[[int, int, int], None] | None = None,
    ) -> Trajectories:
        """Executes the cascade from the given configurations, always with the most likely action.

        Swarms that came to rest are executed for `STATIONARY_STEPS` more steps, with nothing frozen.
        Episodes are executed in batches of a fixed size, one after another: see `episodes_at_once`.

        Args:
            starts: One configuration for each episode.
            seed: Seed of the robots' frames, of noise and of the scheduler, where there are any.
            on_chunk: Called as `on_chunk(steps, max_steps, ended)` after every chunk of steps: those executed, of all
                batches together, those after which the last episode is cut off, and how many episodes have ended.

        Returns:
            What happened, until the last episode ended.

        Raises:
            InputError: The starts have another shape, or the seed is none.
            RunError: So many swarms move on after rest, for so many steps of their scheduler, that memory is full.
        """
        starts = checked_starts("starts", starts, self.world.config.robots)
        if not np.isfinite(starts).all():
            raise InputError("starts", "numbers that are not finite", "finite")
        check_number("seed", seed, 0, prng.MAX_SEED, integer=True)
        check_function("on_chunk", on_chunk, "on_chunk(steps, max_steps, ended)")
        starts = np.asarray(starts, np.float32)
        episodes, size = len(starts), episodes_at_once(starts.shape[1])
        keys = np.asarray(_episode_key_data(jax.device_put(np.uint32(seed)), episodes))
        firsts = range(0, episodes, size)
        max_steps = self.rest.max_steps * len(self.policies) * len(firsts)
        most = MAX_RECORD_BYTES // starts.nbytes
        batches: list[Trajectories] = []

        def report(steps: int, ended: int) -> None:
            if on_chunk is not None:
                before = sum(int(batch.lengths.max()) for batch in batches)
                on_chunk(before + steps, max_steps, len(batches) * size + ended)

        cascade = _committed(self)
        for first in firsts:
            part = slice(first, first + size)
            batches.append(cascade._execute_batch(starts[part], keys[part], size, most, report))
        return _concatenated(batches)

    def _execute_batch(
        self,
        starts: Float[np.ndarray, "episodes robots 2"],
        keys: UInt32[np.ndarray, "episodes two"],
        size: int,
        most: int,
        report: Callable[[int, int], None],
    ) -> Trajectories:
        """Executes few episodes as part of a batch of a fixed size, which copies of the first one fill.

        Args:
            starts: Their configurations.
            keys: Their randomness.
            size: The size of the batch.
            most: Steps after rest that memory holds.
            report: Called with the steps so far, and how many episodes have ended.
        """
        episodes, robots, _ = starts.shape
        chosen = np.where(np.arange(size) < episodes, np.arange(size), 0)
        positions = jax.device_put(np.moveaxis(starts[chosen], 0, -1), _device())
        status, first = _begin(self, positions, *jax.device_put((keys[chosen], np.int32(episodes))))
        parts = [jax.device_get(first)]
        chunk = max(2, min(CHUNK, CHUNK_TRIPLES // (size * robots**3)))
        moving = episodes
        while moving:
            raise_if_interrupted()
            status, part = _advance(self, status, chunk)
            parts.append(jax.device_get(part))
            moving = int(np.count_nonzero(status.moving()))
            report(int(np.asarray(status.length).max()), episodes - moving)
        after_rest = self._watch(status, chunk, most)[:episodes]
        lengths = np.asarray(status.length)[:episodes]
        recorded = int(lengths.max()) + 1
        positions, signals = jax.tree.map(lambda *parts: np.concatenate(parts)[:recorded, ..., :episodes], *parts)
        return Trajectories(
            positions=np.ascontiguousarray(np.moveaxis(positions, -1, 0)),
            lengths=lengths.astype(np.int32),
            switch=np.asarray(status.switch, np.int32)[:-1, :episodes].T,
            at_rest=np.asarray(status.at_rest)[:episodes],
            terminated=np.asarray(status.terminated)[:episodes],
            signals={name: signals[name].T for name in self.world.objective.names},
            epochs=np.asarray(status.state.epochs, np.int32)[:episodes],
            interventions=np.asarray(status.state.interventions, np.int32)[:episodes],
            after_rest=after_rest,
        )

    def _watch(self, status: _Status, chunk: int, most: int) -> Float[np.ndarray, "batch steps robots 2"]:
        """Executes the swarms that came to rest for some more steps, and records them until nobody moves any more."""
        # Nothing can change any more where no robot moved at all while each looked, decided and would have begun to
        # move: robots remember nothing, so a robot that sees the same again, without noise, decides the same.
        decided = self.env.keeps_rest and self.rest.window >= DECIDING_PERIODS * self.env.period
        settled = decided & np.asarray(status.unmoved_steps >= self.rest.window)
        unsettled = np.asarray(status.at_rest) & ~settled
        steps = STATIONARY_STEPS * self.env.period if unsettled.any() else 0
        if steps > most:
            raise RunError(f"the {steps} steps after rest are more than memory holds: try fewer episodes")
        # With the same program: the last policy goes on where it came to rest, and all others have ended.
        last = len(self.policies) - 1
        active_policy = jnp.where(status.at_rest, last, last + 1).astype(status.active_policy.dtype)
        status = eqx.tree_at(lambda s: (s.active_policy, s.watched), status, (active_policy, status.at_rest))
        parts = [np.asarray(status.state.positions)[None]]
        for _ in range(0, steps, chunk):
            status, (part, _) = _advance(self, status, chunk)
            parts.append(np.asarray(part))
        recorded = np.concatenate(parts)[: steps + 1]
        moved = np.flatnonzero((recorded[1:] != recorded[:-1]).any(axis=(1, 2, 3)))
        count = moved[-1] + 1 if len(moved) else 0
        return np.ascontiguousarray(np.moveaxis(recorded[1 : count + 1], -1, 0))


def _concatenated(batches: Sequence[Trajectories]) -> Trajectories:
    """Returns the episodes of all batches; those of the shorter ones hold still until the end of the longest."""

    def join(parts: Sequence[np.ndarray]) -> np.ndarray:
        steps = max(part.shape[1] for part in parts)
        return np.concatenate(
            [np.pad(x, ((0, 0), (0, steps - x.shape[1]), *[(0, 0)] * (x.ndim - 2)), mode="edge") for x in parts]
        )

    # Where nobody moved after rest there is no step to repeat, but the configuration of rest.
    watched = [(batch.final[:, None], batch.after_rest) for batch in batches if batch.after_rest is not None]
    after_rest = join([np.concatenate(parts, axis=1) for parts in watched])[:, 1:]
    return Trajectories(
        positions=join([batch.positions for batch in batches]),
        lengths=np.concatenate([batch.lengths for batch in batches]),
        switch=np.concatenate([batch.switch for batch in batches]),
        at_rest=np.concatenate([batch.at_rest for batch in batches]),
        terminated=np.concatenate([batch.terminated for batch in batches]),
        signals={name: join([batch.signals[name] for batch in batches]) for name in batches[0].signals},
        epochs=np.concatenate([batch.epochs for batch in batches]),
        interventions=np.concatenate([batch.interventions for batch in batches if batch.interventions is not None]),
        after_rest=after_rest,
    )


def _committed(tree: Any) -> Any:
    """Returns a PyTree with its arrays committed to the default device.

    Weights that come from a training are committed to a device, and weights that come from a file are not. JAX would
    compile a program for each.
    """
    arrays, others = eqx.partition(tree, eqx.is_array)
    return eqx.combine(jax.device_put(arrays, _device()), others)


def _device() -> jax.sharding.Sharding:
    return jnp.zeros(()).sharding


@eqx.filter_jit
def _episode_key_data(seed: UInt32[Array, ""], episodes: int) -> UInt32[Array, "episodes two"]:
    return jax.random.key_data(jax.random.split(prng.key(seed), episodes))


@eqx.filter_jit
def _begin(
    cascade: Cascade,
    positions: Float[Array, "robots 2 batch"],
    keys: UInt32[Array, "batch two"],
    episodes: Int[Array, ""],
) -> tuple[_Status, tuple[Array, Any]]:
    batch = positions.shape[-1]
    zero, false = jnp.zeros(batch, jnp.int32), jnp.zeros(batch, bool)
    signals = cascade.world.signals(positions)
    status = _Status(
        state=cascade.env.state(positions, prng.wrap(keys)),
        signals=signals,
        # The rest of the batch has ended before it began.
        # Everything is of a stated type, not a weak one: otherwise the next call would be compiled once more.
        active_policy=jnp.where(jnp.arange(batch) < episodes, zero, len(cascade.policies)),
        steps_active=zero,
        recent_changes=jnp.zeros((cascade.rest.window, batch), jnp.float32),
        still_steps=zero,
        unmoved_steps=zero,
        length=zero,
        switch=jnp.zeros((len(cascade.policies), batch), jnp.int32),
        at_rest=false,
        terminated=false,
        watched=false,
    )
    return status, jax.tree.map(lambda x: x[None], (positions, signals))


@eqx.filter_jit
def _advance(cascade: Cascade, status: _Status, steps: int) -> tuple[_Status, tuple[Array, dict[str, Array]]]:
    return jax.lax.scan(lambda status, _: _step(cascade, status), status, None, length=steps)


def _step(cascade: Cascade, status: _Status) -> tuple[_Status, tuple[Array, dict[str, Array]]]:
    rest, moving = cascade.rest, status.moving()
    observation = cascade.env.observe(status.state)
    velocities = jnp.zeros_like(status.state.positions)
    for index, policy in enumerate(cascade.policies):
        velocities = jnp.where(status.active_policy == index, policy(observation), velocities)
    after, transition = cascade.env.step(status.state, velocities)
    # To hold still is more than to set no new velocity: a scheduler completes the moves that robots committed to before
    # the end. So the whole state stays, and an episode ends alike alone and in the company of longer ones.
    after, signals = jax.tree.map(
        lambda new, old: jnp.where(moving, new, old), (after, transition.signals), (status.state, status.signals)
    )
    length = status.length + moving
    terminated = status.terminated | (moving & transition.terminated & ~status.watched)
    change = jnp.abs(after.objective - status.state.objective)
    recent_changes = jnp.concatenate([status.recent_changes[1:], change[None]])
    moves = after.positions - status.state.positions
    is_still = all_still(moves, rest.stillness, cascade.world.config.radius)
    still_steps = jnp.where(is_still, status.still_steps + 1, 0)
    unmoved_steps = jnp.where(jnp.all(moves == 0, axis=(0, 1)), status.unmoved_steps + 1, 0)
    steps_active = status.steps_active + moving
    is_last = status.active_policy == len(cascade.policies) - 1
    limits = RestLimits.from_rule(rest)
    rested, ended = has_ended(is_last, still_steps, recent_changes.mean(axis=0), steps_active, limits)
    may_end = moving & ~status.watched & ~terminated
    over = may_end & ended
    hands_over = over & ~is_last
    # The active policy was still at work at this step; the next one, if any, takes over after it.
    index = jnp.arange(len(cascade.policies))[:, None]
    switch = jnp.where(moving & (index >= status.active_policy), length, status.switch)
    status = _Status(
        state=after,
        signals=signals,
        active_policy=status.active_policy + over,
        steps_active=jnp.where(over, 0, steps_active),
        recent_changes=recent_changes,
        still_steps=jnp.where(hands_over, 0, still_steps),
        unmoved_steps=jnp.where(moving, jnp.where(hands_over, 0, unmoved_steps), status.unmoved_steps),
        length=length,
        switch=switch,
        at_rest=status.at_rest | (may_end & rested & is_last),
        terminated=terminated,
        watched=status.watched,
    )
    return status, (after.positions, signals)
