"""The class of baselines, and the two simplest ones: a random walk, and gathering at the centroid."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from murmurate.policies.baselines.avoidance import avoid_collisions, local_view, view_centroid
from murmurate.registry import Strategy
from murmurate.types import Observation
from murmurate.world.config import WorldConfig

__all__ = ["Baseline", "Centroid", "RandomWalk"]

GAIN = 0.5
"""Share of the remaining way that a robot moves in one step, where the speed limit allows."""


class Baseline(Strategy):
    """A hand-written policy, to be compared with learned ones.

    A subclass implements `__call__`. It is chosen by its registered name or as "module:Class" in `murmurate compare`,
    and built from the world and the landmark. Further fields need defaults.

    Attributes:
        world: Sizes of the world and its robots.
        landmark: Whether the gathering point is known.
    """

    section: ClassVar[str] = "method"
    title: ClassVar[str] = ""
    """What figures and tables call it; by default the name of the class."""
    centralised: ClassVar[bool] = False
    """Whether it uses the positions of all robots in one common frame, instead of each robot's own view."""
    deviations: ClassVar[str] = ""
    """How it differs from the method that it is named after, and what it knows more than the others."""
    dead_zone: ClassVar[float] = 0.05
    """Share of the speed limit below which its robots stand still, as `rest.dead_zone`."""
    damping: ClassVar[float] = 0.0
    """Share that its shortest moves lose, as `rest.damping`."""

    world: WorldConfig = eqx.field(static=True)
    landmark: bool = eqx.field(static=True)

    @abstractmethod
    def __call__(self, observation: Observation) -> Float[Array, "robots 2 *batch"]:
        """Returns velocities, world units per step: in each robot's own frame, or the world's for a centralised method.

        Args:
            observation: What every robot perceives; only a centralised method may use its `positions`.
        """


@Baseline.register("random")
class RandomWalk(Baseline):
    """Moves each robot at random within its speed limit; it avoids no collisions.

    The velocity is a hash of the robot's view, so the policy has no state and no randomness of its own: the same view
    leads to the same velocity. Unlike the other baselines it moves differently in a rotated frame, or when robots are
    renumbered.
    """

    title: ClassVar[str] = "Random walk"

    def __call__(self, observation: Observation) -> Float[Array, "robots 2 *batch"]:
        """Returns velocities in each robot's own frame, world units per step."""
        view = observation.view
        unit = view.radius[:, None]
        total = jnp.sum(jnp.sin(12.9898 * view.x / unit) + jnp.sin(78.233 * view.y / unit), axis=1)
        angle, share = 2 * jnp.pi * _hash(total), jnp.sqrt(_hash(total + 1.0))
        speed = (1 - 1e-6) * self.world.max_speed * share
        return jnp.stack([speed * jnp.cos(angle), speed * jnp.sin(angle)], axis=1)


def _hash(number: Array) -> Array:
    """Returns a number in [0, 1) that any small change of the argument changes as if at random."""
    return jnp.mod(jnp.sin(number) * 43758.547, 1.0)


@Baseline.register("centroid")
class Centroid(Baseline):
    """Moves to the gathering point, or to the centroid of the robots seen, as near as the safe distance allows."""

    title: ClassVar[str] = "Centroid"

    def __call__(self, observation: Observation) -> Float[Array, "robots 2 *batch"]:
        """Returns velocities in each robot's own frame, world units per step."""
        view = local_view(observation.view, self.world)
        x, y = (view.landmark_x, view.landmark_y) if self.landmark else view_centroid(view)
        return avoid_collisions(GAIN * x, GAIN * y, view, self.world)
