"""Shields: rules that shorten a robot's move whatever its policy wants."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from murmurate.errors import check_number
from murmurate.registry import Strategy
from murmurate.types import Observation
from murmurate.world.config import WorldConfig
from murmurate.world.env import Wrapper

__all__ = ["NoShield", "Shield", "ShieldWrapper", "WallShield", "limit_wall_approach", "wall_directions"]

WALL_SHARE = 0.2
"""Share of its distance from a wall that a robot goes in a step, at most: moves of up to 5 steps end before the
wall."""


class Shield(Strategy):
    """Shortens velocities before they are executed, in training as in execution.

    A subclass implements `__call__`.
    """

    section: ClassVar[str] = "shield"

    @abstractmethod
    def __call__(
        self, velocities: Float[Array, "robots 2 *batch"], observation: Any, world: WorldConfig
    ) -> Float[Array, "robots 2 *batch"]:
        """Returns the velocities that are executed.

        Args:
            velocities: What the policy wants, world units per step: in each robot's own frame where robots act on their
                own view, else in the world's.
            observation: What the policy acted on: an `Observation`, or all positions.
            world: Sizes of the world and its robots.
        """

    @property
    def is_trivial(self) -> bool:
        """Whether every velocity is executed as it is."""
        return False


@Shield.register("none")
class NoShield(Shield):
    """No shield: every velocity is executed as it is."""

    def __call__(self, velocities: Array, observation: Any, world: WorldConfig) -> Array:
        """Returns the velocities."""
        return velocities

    @property
    def is_trivial(self) -> bool:
        """Always."""
        return True


@Shield.register("walls")
class WallShield(Shield):
    """Limits how fast robots approach walls: those that they perceive, or all where they act on all positions.

    Attributes:
        share: Share of its distance from a wall that a robot goes in a step, at most.
    """

    share: float = WALL_SHARE

    def __check_init__(self) -> None:
        check_number("share", self.share, 0, 1, exclusive_low=True)

    def __call__(self, velocities: Array, observation: Any, world: WorldConfig) -> Array:
        """Returns the velocities with their components towards near walls shortened."""
        if isinstance(observation, Observation):
            view = observation.view
            if view.walls is None:
                return velocities
            walls = view.walls * (world.radius / view.radius)[:, None, None]
        else:
            x, y = observation[:, 0], observation[:, 1]
            zero = jnp.zeros_like(x)
            right, left = world.half_width - x, -world.half_width - x
            upper, lower = world.half_height - y, -world.half_height - y
            offsets = ((right, zero), (zero, upper), (left, zero), (zero, lower))
            walls = jnp.stack([jnp.stack(offset, axis=1) for offset in offsets], axis=1)
        return limit_wall_approach(velocities, walls, self.share)


def limit_wall_approach(
    velocity: Float[Array, "robots 2 *batch"], walls: Float[Array, "robots 4 2 *batch"], share: Any = WALL_SHARE
) -> Float[Array, "robots 2 *batch"]:
    """Shortens velocities so that no robot goes more than a share of its distance from a wall in a step.

    Args:
        velocity: Of each robot, world units per step.
        walls: The nearest point of each wall relative to the robot, world units, opposite walls two places apart.
        share: The share.
    """
    normal, distance = wall_directions(walls)
    excess = jnp.maximum(jnp.sum(velocity[:, None] * normal, axis=2) - share * distance, 0.0)
    return velocity - jnp.sum(excess[:, :, None] * normal, axis=1)


def wall_directions(
    walls: Float[Array, "robots 4 2 *batch"],
) -> tuple[Float[Array, "robots 4 2 *batch"], Float[Array, "robots 4 *batch"]]:
    """Returns the unit vector towards each wall, and its distance, at least 0."""
    # From wall to wall: a robot at a wall knows from the opposite one where that wall lies.
    across = walls - jnp.roll(walls, 2, axis=1)
    normal = across / jnp.sqrt(jnp.sum(across**2, axis=2, keepdims=True))
    return normal, jnp.maximum(jnp.sum(walls * normal, axis=2), 0.0)


class ShieldWrapper(Wrapper):
    """An environment in which a shield shortens every move.

    Attributes:
        shield: The shield.
        world: The sizes by which it acts.
    """

    shield: Shield
    world: WorldConfig

    def step(self, state: Any, action: Float[Array, "robots 2 *batch"]) -> tuple[Any, Any]:
        """Shortens the velocities and advances every episode by one step."""
        return self.env.step(state, self.shield(action, self.env.observe(state), self.world))
