"""Shields: rules that shorten a robot's move whatever its policy wants."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from murmurate.errors import InputError, check_number
from murmurate.registry import Strategy
from murmurate.types import View
from murmurate.world.config import WorldConfig
from murmurate.world.env import WrappedState, Wrapper
from murmurate.world.scheduling import FsyncScheduler, Scheduler
from murmurate.world.sensing import view_of, wall_directions

__all__ = [
    "ClearanceShield",
    "NoShield",
    "Shield",
    "ShieldWrapper",
    "ShieldedState",
    "WallShield",
    "limit_wall_approach",
    "safe_share",
]

WALL_SHARE = 0.2
"""Share of its distance from a wall that a robot goes in a step, at most: moves of up to 4 steps end before the wall,
and those of 5 at it, but for rounding."""


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

    def prepare(self, scheduler: Scheduler) -> Shield:
        """Returns the shield as it acts under a scheduler.

        Raises:
            InputError: It cannot serve the scheduler.
        """
        del scheduler
        return self

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
    """Keeps robots inside: limits how fast they approach walls.

    These are the walls that robots perceive, or all walls where they act on all positions.

    Attributes:
        share: Share of its distance from a wall that a robot goes in a step, at most. Under a scheduler whose moves
            take many steps, it is so much less that no move reaches the wall.
    """

    share: float = WALL_SHARE

    def __check_init__(self) -> None:
        check_number("share", self.share, 0, 1, exclusive_low=True)

    def prepare(self, scheduler: Scheduler) -> WallShield:
        """Returns the shield with its share.

        Raises:
            InputError: The scheduler states no longest move.
        """
        if scheduler.max_move_steps is None:
            allowed = f"none: the scheduler {scheduler.name} states no max_move_steps, and no share is safe"
            raise InputError("shield.use", "walls", allowed)
        return WallShield(min(self.share, ROUNDING / scheduler.max_move_steps))

    def __call__(self, velocities: Array, observation: Any, world: WorldConfig) -> Array:
        """Returns the velocities with their components towards near walls shortened."""
        return _kept_inside(velocities, view_of(observation, world), world, self.share)


def _kept_inside(velocities: Array, view: View, world: WorldConfig, share: Any) -> Array:
    if view.walls is None:
        return velocities
    walls = view.walls * (world.radius / view.radius)[:, None, None]
    # What the first time leaves of a long velocity towards a wall is rounded; the second time removes that too.
    for _ in range(2):
        velocities = limit_wall_approach(velocities, walls, share, _rounding(world))
    return velocities


@Shield.register("clearance")
class ClearanceShield(Shield):
    """Keeps every move so short that no robot touches another or leaves the world, whatever anybody wants.

    In a step, a robot goes at most a share of d - 2R far, where d is its distance from the nearest robot, and at most
    the same share of its way to each wall that it perceives. Opaque robots perceive their nearest robot: nothing hides
    it but one that is nearer. So this needs no more than a robot's own view; `docs/shield.md` has the proof. It holds
    for exact distances: under noise and missed detections, robots are careful by what they perceive. To a robot that it
    approaches, a robot leaves some room.

    Attributes:
        share: The share; none: as much as is proved to be safe under the scheduler, see `safe_share`.
    """

    share: float | None = None

    def __check_init__(self) -> None:
        if self.share is not None:
            check_number("share", self.share, 0, 1, exclusive_low=True)

    def prepare(self, scheduler: Scheduler) -> ClearanceShield:
        """Returns the shield with its share.

        Raises:
            InputError: The share is not safe under the scheduler, or none is.
        """
        most = safe_share(scheduler)
        if self.share is None:
            return ClearanceShield(most)
        if self.share > most:
            allowed = f"at most {most:.4g}, which is safe under the scheduler {scheduler.name}"
            raise InputError("shield.share", self.share, allowed)
        return self

    def __call__(self, velocities: Array, observation: Any, world: WorldConfig) -> Array:
        """Returns the velocities, shortened where they are longer than the clearance allows."""
        share = safe_share(FsyncScheduler()) if self.share is None else self.share
        view = view_of(observation, world)
        x, y, scale = view.x, view.y, (world.radius / view.radius)[:, None]
        length, speed = _length(x, y), _length(velocities[:, 0], velocities[:, 1])
        # Who approaches a robot leaves it some room. Otherwise two who approach each other would halve their clearance
        # until it is as good as none, and none of it lets them go.
        forward = velocities[:, :1] * x + velocities[:, 1:] * y
        size = length * speed[:, None]
        approach = jnp.where(size > 0, jnp.maximum(forward, 0.0) / jnp.where(size > 0, size, 1.0), 0.0)
        distance = jnp.where(view.seen, length * scale - ROOM * world.radius * approach, jnp.inf)
        # A robot that perceives nobody knows that nobody is within the scan radius.
        far = jnp.full_like(velocities[:, :1, ...], world.scan_radius)
        nearest = jnp.min(jnp.concatenate([distance, far], axis=1), axis=1)
        limit = share * jnp.maximum(nearest - 2 * world.radius - _rounding(world), 0.0)
        shortened = velocities * jnp.where(speed > limit, limit / jnp.where(speed > limit, speed, 1.0), 1.0)[:, None]
        return _kept_inside(shortened, view, world, share)


ROUNDING = 0.98
"""Share of what is proved for exact numbers that is used, so that rounding a velocity does no harm."""


ROOM = 0.02
"""Clearance in robot radii that a robot leaves to one that it approaches."""


def safe_share(scheduler: Scheduler) -> float:
    """Returns which share of its clearance d - 2R a robot may go in a step under a scheduler.

    While one robot's cycle lasts, from its look to the end of its move, another one looks at most m = `max_delay` +
    `max_move_steps` times. For m = 1 all who move look at the same moment, and a displacement of c (d - 2R) is safe for
    c < 1/2. Otherwise c <= (1 - c)^(m - 1) / 4 suffices. A move goes on for up to `max_move_steps` steps.

    Raises:
        InputError: The scheduler states no greatest delay or no longest move.
    """
    delay, steps = scheduler.max_delay, scheduler.max_move_steps
    if delay is None or steps is None:
        allowed = f"none: the scheduler {scheduler.name} states no max_delay and max_move_steps, and no share is safe"
        raise InputError("shield.use", "clearance", allowed)
    low, high = 0.0, 0.5
    if delay + steps > 1:
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (middle, high) if middle <= (1 - middle) ** (delay + steps - 1) / 4 else (low, middle)
        high = low
    return ROUNDING * high / steps


def _length(x: Array, y: Array) -> Array:
    """Returns the lengths of vectors; the gradient at 0 is 0."""
    squared = x**2 + y**2
    return jnp.where(squared > 0, jnp.sqrt(jnp.where(squared > 0, squared, 1.0)), 0.0)


def _rounding(world: WorldConfig) -> Any:
    """Returns a clearance in which rounded positions cannot be told from touching ones, world units.

    Each of two robots' coordinates is rounded by half a unit in the last place of the world's sides; with that of their
    distance, by less than two such units in all.
    """
    return 2 * _EPSILON * jnp.maximum(world.half_width, world.half_height) + 4 * _EPSILON * world.radius


_EPSILON = float(jnp.finfo(jnp.float32).eps)


def limit_wall_approach(
    velocity: Float[Array, "robots 2 *batch"],
    walls: Float[Array, "robots 4 2 *batch"],
    share: Any = WALL_SHARE,
    rounding: Any = 0.0,
) -> Float[Array, "robots 2 *batch"]:
    """Shortens velocities so that no robot goes more than a share of its distance from a wall in a step.

    Args:
        velocity: Of each robot, world units per step.
        walls: The nearest point of each wall relative to the robot, world units, opposite walls two places apart.
        share: The share.
        rounding: Distance that counts as none, world units.
    """
    normal, distance = wall_directions(walls)
    limit = share * jnp.maximum(distance - rounding, 0.0)
    excess = jnp.maximum(jnp.sum(velocity[:, None] * normal, axis=2) - limit, 0.0)
    return velocity - jnp.sum(excess[:, :, None] * normal, axis=1)


class ShieldedState(WrappedState):
    """A state together with how often the shield acted.

    Attributes:
        shortened: Robots whose velocity was shortened, summed over the steps so far.
    """

    shortened: Int[Array, "*batch"]

    @property
    def interventions(self) -> Int[Array, "*batch"]:
        """How often the shield has shortened a robot's move."""
        return self.shortened


class ShieldWrapper(Wrapper):
    """An environment in which a shield shortens every move.

    Attributes:
        shield: The shield, prepared for the scheduler.
        world: The sizes by which it acts.
    """

    shield: Shield
    world: WorldConfig

    def reset_batch(self, key: PRNGKeyArray, batch: int) -> ShieldedState:
        """Begins a batch of episodes, each at a fresh start."""
        return self._begun(self.env.reset_batch(key, batch))

    def state(self, positions: Float[Array, "robots 2 *batch"], seed: Any = 0) -> ShieldedState:
        """Returns the state at the beginning of an episode from the given configurations."""
        return self._begun(self.env.state(positions, seed))

    def observe(self, state: ShieldedState) -> Any:
        """Returns what policy and value networks are given."""
        return self.env.observe(state.inner)

    def step(self, state: ShieldedState, action: Float[Array, "robots 2 *batch"]) -> tuple[ShieldedState, Any]:
        """Shortens the velocities and advances every episode by one step."""
        velocities = self.shield(action, self.observe(state), self.world)
        after, transition = self.env.step(state.inner, velocities)
        # Robots that do not look now move, if at all, with what they decided before.
        shortened = jnp.any(velocities != action, axis=1) & after.looked(state.inner)
        shortened = jnp.sum(shortened, axis=0, dtype=jnp.int32)
        return ShieldedState(after, state.shortened + shortened), transition

    def _begun(self, inner: Any) -> ShieldedState:
        return ShieldedState(inner, jnp.zeros(inner.positions.shape[2:], jnp.int32))
