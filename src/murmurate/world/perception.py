"""A world whose robots act on what they perceive: each in its own frame, from its own view."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, UInt32

from murmurate.world.randomness import episode_keys, following, plain, wrapped
from murmurate.world.sensing import Frames, SensingConfig, View, draw_frames, perceive
from murmurate.world.starts import Start
from murmurate.world.world import World

__all__ = ["LocalObservation", "Observation", "ObservedState"]


class ObservedState(eqx.Module):
    """Where the robots are, and how each of them looks at it.

    Attributes:
        world: The state of the world, or of what wraps it.
        frames: Every robot's system of coordinates.
        key: Randomness of what is perceived next.
    """

    world: Any
    frames: Frames
    key: UInt32[Array, "two *batch"]

    @property
    def positions(self) -> Float[Array, "robots 2 *batch"]:
        """Centres, world units."""
        return self.world.positions

    @property
    def objective(self) -> Float[Array, "*batch"]:
        """The objective C of this configuration."""
        return self.world.objective


class Observation(eqx.Module):
    """What there is to know of a state, and what the robots perceive of it.

    Attributes:
        view: What every robot perceives: all that an acting policy may be given.
        positions: Centres, world units: for the value network, which serves training only.
        walls: How far each centre is from the nearest wall, world units: likewise.
    """

    view: View
    positions: Float[Array, "robots 2 *batch"]
    walls: Float[Array, "robots *batch"]


class LocalObservation(eqx.Module):
    """A world, seen by its robots. An action is each robot's velocity in its own frame, world units per step.

    Robots know their own size, so that a velocity needs no unit of length: only its direction is the robot's own.

    Attributes:
        env: The world, or something that steps one, such as `SchedulerWrapper` or `learning.ActionRepeat`.
        world: The world: its sizes, and how a configuration is measured.
        sensing: What is perceived, in which frames.
    """

    env: Any
    world: World
    sensing: SensingConfig = eqx.field(static=True)

    def reset_batch(self, key: PRNGKeyArray, batch: int) -> ObservedState:
        """Begins a batch of episodes, each at a fresh start and with fresh frames."""
        begin, look = jax.random.split(key)
        return self._looking(self.env.reset_batch(begin, batch), jax.random.split(look, batch))

    def state(self, positions: Float[Array, "robots 2 *batch"], seed: Any = 0) -> ObservedState:
        """Returns the state at the beginning of an episode from the given configurations."""
        return self._looking(self.env.state(positions, seed), episode_keys(seed, positions))

    @property
    def start(self) -> Start:
        """Where episodes begin."""
        return self.world.start

    def signals(self, positions: Float[Array, "robots 2 *batch"]) -> dict[str, Float[Array, "*batch"]]:
        """Returns the signals of configurations by name."""
        return self.world.signals(positions)

    def observe(self, state: ObservedState) -> Observation:
        """Looks around from every robot."""
        world, keys = self.world, wrapped(state.key)
        reach, half_width, half_height = world.scan_radius, world.half_width, world.half_height
        view = perceive(self.sensing, state.positions, state.frames, keys, world.radius, reach, half_width, half_height)
        aside, above = half_width - abs(state.positions[:, 0]), half_height - abs(state.positions[:, 1])
        return Observation(view, state.positions, jnp.maximum(jnp.minimum(aside, above), 0.0))

    def step(self, state: ObservedState, action: Float[Array, "robots 2 *batch"]) -> tuple[ObservedState, Any]:
        """Moves every robot by its own velocity; see `World.step`."""
        after, transition = self.env.step(state.world, state.frames.outward(action))
        keys = following(wrapped(state.key))
        if self.sensing.redrawn:
            return self._looking(after, keys), transition
        return ObservedState(after, state.frames, plain(keys)), transition

    def _looking(self, state: Any, keys: PRNGKeyArray) -> ObservedState:
        frames = draw_frames(self.sensing, keys, state.positions.shape[0], state.positions.dtype)
        return ObservedState(state, frames, plain(following(keys)))
