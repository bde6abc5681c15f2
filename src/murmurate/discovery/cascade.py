"""The policy list as it is executed: each acts until the swarm is at rest, then the next; then all hold still."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from murmurate.errors import GREATEST, MOST, check_number
from murmurate.world import LocalObservation, SchedulerWrapper, World, epochs_of

__all__ = ["Cascade", "RestRule", "Trajectories"]


@dataclass(frozen=True)
class RestRule:
    """When a policy has brought the swarm to rest.

    Attributes:
        window: Steps over which the mean |step reward| is taken.
        tolerance: Rest is a mean below this; the reward is the objective's change, all weights as the paper's.
        switch_tolerance: The same for a policy that another one follows: it need not settle what that one moves again.
        max_steps: Steps after which a policy that does not come to rest is cut off.
    """

    window: int = 5
    tolerance: float = 3e-4
    switch_tolerance: float = 1.5e-3
    max_steps: int = 300

    def __post_init__(self) -> None:
        for name in ("window", "max_steps"):
            check_number(name, getattr(self, name), 1, MOST, integer=True)
        for name in ("tolerance", "switch_tolerance"):
            check_number(name, getattr(self, name), 0, GREATEST, exclusive_low=True)


@dataclass(frozen=True)
class Trajectories:
    """Episodes of a cascade; after its length an episode holds still.

    Attributes:
        positions: Centres, world units.
        lengths: Formation steps: steps until the cascade was at rest, terminated or cut off.
        switch: Steps at which each later policy took over; the length where it never did.
        at_rest: Whether the last policy came to rest.
        terminated: Whether the episode ended in a collision or outside the world.
        signals: Signals by name.
        epochs: Epochs until then: in each, every robot completed a cycle of looking and moving.
    """

    positions: Float[np.ndarray, "episodes steps_and_one robots 2"]
    lengths: Int[np.ndarray, " episodes"]
    switch: Int[np.ndarray, "episodes later_policies"]
    at_rest: Bool[np.ndarray, " episodes"]
    terminated: Bool[np.ndarray, " episodes"]
    signals: dict[str, Float[np.ndarray, "episodes steps_and_one"]]
    epochs: Int[np.ndarray, " episodes"]

    @property
    def final(self) -> Float[np.ndarray, "episodes robots 2"]:
        """The configurations at the end."""
        return self.positions[:, -1]


class _Status(eqx.Module):
    """Where the cascade stands in each episode of the batch."""

    state: Any
    charge: Int[Array, " batch"]
    since: Int[Array, " batch"]
    changes: Float[Array, "window batch"]
    length: Int[Array, " batch"]
    switch: Int[Array, "policies batch"]
    at_rest: Bool[Array, " batch"]
    terminated: Bool[Array, " batch"]
    epochs: Int[Array, " batch"]

    def active(self) -> Bool[Array, " batch"]:
        """Says which episodes still move."""
        return (self.charge < self.switch.shape[0]) & ~self.terminated


CHUNK = 50
"""Steps between two looks at whether every episode has ended."""


class Cascade(eqx.Module):
    """A list of policies, executed one after another in a world."""

    policies: tuple[Any, ...]
    world: World | SchedulerWrapper | LocalObservation
    rest: RestRule = eqx.field(static=True)

    def rollout(self, starts: Float[np.ndarray, "episodes robots 2"], seed: int = 0) -> Trajectories:
        """Executes the cascade from the given configurations, always with the most likely action.

        Args:
            starts: One configuration for each episode.
            seed: Seed of the robots' frames, of noise and of the scheduler, where there are any.

        Returns:
            What happened, until the last episode ended.
        """
        status, first = _begin(self, jnp.moveaxis(jnp.asarray(starts, jnp.float32), 0, -1), jnp.asarray(seed))
        parts = [jax.device_get(first)]
        while bool(jnp.any(status.active())):
            status, part = _advance(self, status)
            parts.append(jax.device_get(part))
        lengths = np.asarray(status.length)
        steps = int(lengths.max()) + 1
        positions = np.concatenate([p for p, _ in parts])[:steps]
        names = list(parts[0][1])
        return Trajectories(
            positions=np.ascontiguousarray(np.moveaxis(positions, -1, 0)),
            lengths=lengths.astype(np.int32),
            switch=np.asarray(status.switch[:-1].T, np.int32),
            at_rest=np.asarray(status.at_rest),
            terminated=np.asarray(status.terminated),
            signals={n: np.concatenate([s[n] for _, s in parts])[:steps].T for n in names},
            epochs=np.asarray(status.epochs, np.int32),
        )


@eqx.filter_jit
def _begin(
    cascade: Cascade, positions: Float[Array, "robots 2 batch"], seed: Int[Array, ""]
) -> tuple[_Status, tuple[Array, Any]]:
    batch = positions.shape[-1]
    none = jnp.zeros(batch, jnp.int32)
    no = jnp.zeros(batch, bool)
    # Of a stated type, not a weak one: the next call would be compiled once more.
    changes = jnp.full((cascade.rest.window, batch), jnp.inf, jnp.float32)
    switch = jnp.zeros((len(cascade.policies), batch), jnp.int32)
    status = _Status(cascade.world.state(positions, seed), none, none, changes, none, switch, no, no, none)
    first = (positions, cascade.world.signals(positions))
    return status, jax.tree.map(lambda x: x[None], first)


@eqx.filter_jit
def _advance(cascade: Cascade, status: _Status) -> tuple[_Status, tuple[Array, dict[str, Array]]]:
    return jax.lax.scan(lambda status, _: _step(cascade, status), status, None, length=CHUNK)


def _step(cascade: Cascade, status: _Status) -> tuple[_Status, tuple[Array, dict[str, Array]]]:
    rest, active = cascade.rest, status.active()
    observation = cascade.world.observe(status.state)
    velocities = jnp.zeros_like(status.state.positions)
    for index, policy in enumerate(cascade.policies):
        velocities = jnp.where(active & (status.charge == index), policy(observation), velocities)
    after, transition = cascade.world.step(status.state, velocities)
    length = status.length + active
    terminated = status.terminated | (active & transition.terminated)
    changes = jnp.concatenate([status.changes[1:], jnp.abs(after.objective - status.state.objective)[None]])
    since = status.since + active
    last = status.charge == len(cascade.policies) - 1
    tolerance = jnp.where(last, rest.tolerance, rest.switch_tolerance)
    rested = active & (changes.mean(axis=0) < tolerance) & ~terminated
    over = rested | (active & (since >= rest.max_steps))
    charge = status.charge + over
    # The policy in charge was still at work at this step; the next one, if any, takes over after it.
    number = jnp.arange(len(cascade.policies))[:, None]
    switch = jnp.where(active & (number >= status.charge), length, status.switch)
    status = _Status(
        state=after,
        charge=charge,
        since=jnp.where(over, 0, since),
        changes=jnp.where(over, jnp.inf, changes),
        length=length,
        switch=switch,
        at_rest=status.at_rest | (rested & last),
        terminated=terminated,
        epochs=jnp.where(active, epochs_of(after), status.epochs),
    )
    return status, (after.positions, transition.signals)
