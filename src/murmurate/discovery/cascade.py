"""The policy list as it is executed: each policy acts until the swarm is at rest; then all robots hold still."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt32

from murmurate import prng
from murmurate.errors import MAX_INTEGER, MAX_MAGNITUDE, InputError, check_function, check_number
from murmurate.types import Trajectories
from murmurate.world import World, Wrapper, checked_starts

__all__ = ["Cascade", "RestRule", "tile_episodes"]

CHUNK = 50
"""Steps between two checks whether every episode has ended, at most."""

CHUNK_TRIPLES = 1 << 28
"""Triples of robots in all steps of a chunk of two or more, about: they take seconds, and nothing interrupts them."""

TILE_PAIRS = 1 << 13
"""Pairs of robots in the episodes that are executed at once: what is computed of each pair fits in a core's cache."""

TILE_EPISODES = 64
"""Episodes that are executed at once, at most."""


@dataclass(frozen=True)
class RestRule:
    """When a policy has brought the swarm to rest.

    Attributes:
        window: Steps over which the mean |step reward| is taken.
        tolerance: Rest is a mean below this; the reward is the objective's change, with the signals' own weights.
        switch_tolerance: The same for a policy that another one follows: it need not settle what that one moves again.
        max_steps: Steps after which a policy that does not come to rest is cut off.
    """

    window: int = 5
    tolerance: float = 3e-4
    switch_tolerance: float = 1.5e-3
    max_steps: int = 300

    def __post_init__(self) -> None:
        for name in ("window", "max_steps"):
            check_number(name, getattr(self, name), 1, MAX_INTEGER, integer=True)
        for name in ("tolerance", "switch_tolerance"):
            check_number(name, getattr(self, name), 0, MAX_MAGNITUDE, exclusive_low=True)


class _Status(eqx.Module):
    """The state of the cascade in each episode of the batch.

    Attributes:
        state: State of the environment; that of an ended episode stays as it is, whatever its scheduler had begun.
        signals: Signals of that state by name.
        active_policy: Place in the list of the policy that acts; the number of policies when all are done.
        steps_active: Steps for which it has acted.
        recent_changes: Its last changes of the objective.
        length: Steps so far.
        switch: Steps at which each policy ended.
        at_rest: Whether the last policy came to rest.
        terminated: Whether the episode ended in contact or outside the world.
    """

    state: Any
    signals: dict[str, Array]
    active_policy: Int[Array, " batch"]
    steps_active: Int[Array, " batch"]
    recent_changes: Float[Array, "window batch"]
    length: Int[Array, " batch"]
    switch: Int[Array, "policies batch"]
    at_rest: Bool[Array, " batch"]
    terminated: Bool[Array, " batch"]

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

        Episodes are executed in batches of a fixed size, one after another: see `tile_episodes`.

        Args:
            starts: One configuration for each episode.
            seed: Seed of the robots' frames, of noise and of the scheduler, where there are any.
            on_chunk: Called as `on_chunk(steps, max_steps, ended)` after every chunk of steps: those executed, of all
                batches together, those after which the last episode is cut off, and how many episodes have ended.

        Returns:
            What happened, until the last episode ended.

        Raises:
            InputError: The starts have another shape, or the seed is none.
        """
        starts = checked_starts("starts", starts, self.world.config.robots)
        if not np.isfinite(starts).all():
            raise InputError("starts", "numbers that are not finite", "finite")
        check_number("seed", seed, 0, prng.MAX_SEED, integer=True)
        check_function("on_chunk", on_chunk, "on_chunk(steps, max_steps, ended)")
        starts = np.asarray(starts, np.float32)
        episodes, size = len(starts), tile_episodes(starts.shape[1])
        keys = np.asarray(_episode_key_data(jnp.asarray(seed, jnp.uint32), episodes))
        firsts = range(0, episodes, size)
        max_steps = self.rest.max_steps * len(self.policies) * len(firsts)
        tiles: list[Trajectories] = []

        def report(steps: int, ended: int) -> None:
            if on_chunk is not None:
                before = sum(int(tile.lengths.max()) for tile in tiles)
                on_chunk(before + steps, max_steps, len(tiles) * size + ended)

        for first in firsts:
            part = slice(first, first + size)
            tiles.append(self._execute_tile(starts[part], keys[part], size, report))
        return _concatenated(tiles)

    def _execute_tile(
        self,
        starts: Float[np.ndarray, "episodes robots 2"],
        keys: UInt32[np.ndarray, "episodes two"],
        size: int,
        report: Callable[[int, int], None],
    ) -> Trajectories:
        """Executes few episodes as part of a batch of a fixed size, which copies of the first one fill."""
        episodes, robots, _ = starts.shape
        chosen = np.where(np.arange(size) < episodes, np.arange(size), 0)
        # Committed to its device, as the weights of a training are and all that is computed with them: otherwise the
        # second chunk would be another program than the first.
        positions = jnp.asarray(np.moveaxis(starts[chosen], 0, -1))
        positions = jax.device_put(positions, positions.sharding)
        status, first = _begin(self, positions, jnp.asarray(keys[chosen]), jnp.asarray(episodes, jnp.int32))
        parts = [jax.device_get(first)]
        chunk = max(2, min(CHUNK, CHUNK_TRIPLES // (size * robots**3)))
        moving = episodes
        while moving:
            status, part = _advance(self, status, chunk)
            parts.append(jax.device_get(part))
            moving = int(np.count_nonzero(status.moving()))
            report(int(status.length.max()), episodes - moving)
        lengths = np.asarray(status.length)[:episodes]
        recorded = int(lengths.max()) + 1
        positions, signals = jax.tree.map(lambda *parts: np.concatenate(parts)[:recorded, ..., :episodes], *parts)
        return Trajectories(
            positions=np.ascontiguousarray(np.moveaxis(positions, -1, 0)),
            lengths=lengths.astype(np.int32),
            switch=np.asarray(status.switch[:-1, :episodes].T, np.int32),
            at_rest=np.asarray(status.at_rest)[:episodes],
            terminated=np.asarray(status.terminated)[:episodes],
            signals={name: values.T for name, values in signals.items()},
            epochs=np.asarray(status.state.epochs, np.int32)[:episodes],
        )


def tile_episodes(robots: int) -> int:
    """Returns how many episodes of a swarm of this size are executed at once, a power of two.

    It is the same for any number of episodes. So each of them is computed alike whatever the others are, to the last
    bit, and a program that was compiled for some episodes serves any number.
    """
    fitting = max(TILE_PAIRS // robots**2, 1)
    return min(TILE_EPISODES, 1 << (fitting.bit_length() - 1))


def _concatenated(tiles: Sequence[Trajectories]) -> Trajectories:
    """Returns the episodes of all tiles; those of the shorter ones hold still until the end of the longest."""
    steps = max(tile.positions.shape[1] for tile in tiles)

    def join(parts: Iterable[np.ndarray]) -> np.ndarray:
        return np.concatenate(
            [np.pad(x, ((0, 0), (0, steps - x.shape[1]), *[(0, 0)] * (x.ndim - 2)), mode="edge") for x in parts]
        )

    return Trajectories(
        positions=join(tile.positions for tile in tiles),
        lengths=np.concatenate([tile.lengths for tile in tiles]),
        switch=np.concatenate([tile.switch for tile in tiles]),
        at_rest=np.concatenate([tile.at_rest for tile in tiles]),
        terminated=np.concatenate([tile.terminated for tile in tiles]),
        signals={name: join(tile.signals[name] for tile in tiles) for name in tiles[0].signals},
        epochs=np.concatenate([tile.epochs for tile in tiles]),
    )


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
        active_policy=jnp.where(jnp.arange(batch) < episodes, 0, len(cascade.policies)),
        steps_active=zero,
        # Of a stated type, not a weak one: the next call would be compiled once more.
        recent_changes=jnp.full((cascade.rest.window, batch), jnp.inf, jnp.float32),
        length=zero,
        switch=jnp.zeros((len(cascade.policies), batch), jnp.int32),
        at_rest=false,
        terminated=false,
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
    terminated = status.terminated | (moving & transition.terminated)
    change = jnp.abs(after.objective - status.state.objective)
    recent_changes = jnp.concatenate([status.recent_changes[1:], change[None]])
    steps_active = status.steps_active + moving
    is_last = status.active_policy == len(cascade.policies) - 1
    tolerance = jnp.where(is_last, rest.tolerance, rest.switch_tolerance)
    rested = moving & (recent_changes.mean(axis=0) < tolerance) & ~terminated
    over = rested | (moving & (steps_active >= rest.max_steps))
    # The active policy was still at work at this step; the next one, if any, takes over after it.
    index = jnp.arange(len(cascade.policies))[:, None]
    switch = jnp.where(moving & (index >= status.active_policy), length, status.switch)
    status = _Status(
        state=after,
        signals=signals,
        active_policy=status.active_policy + over,
        steps_active=jnp.where(over, 0, steps_active),
        recent_changes=jnp.where(over, jnp.inf, recent_changes),
        length=length,
        switch=switch,
        at_rest=status.at_rest | (rested & is_last),
        terminated=terminated,
    )
    return status, (after.positions, signals)
