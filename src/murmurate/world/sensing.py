"""What each robot perceives, in a frame of its own, and nothing else.

A robot is anonymous, oblivious and silent: it sees where others are now, not who they are, and is told nothing. What it
does not perceive is absent from its view, as a robot that does not exist would be.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import partial
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key, PRNGKeyArray

from murmurate import prng
from murmurate.errors import InputError, check_number
from murmurate.registry import Strategy
from murmurate.representation import short_repr
from murmurate.types import Observation, View
from murmurate.world.config import WorldConfig
from murmurate.world.randomness import draw_each
from murmurate.world.signals import Configuration
from murmurate.world.tiles import in_tiles

__all__ = ["Frames", "GlobalSensing", "ScanSensing", "Sensing", "VisibleSensing", "view_of"]

MAX_UNIT_RATIO = 1000.0


class Frames(eqx.Module):
    """Every robot's own system of coordinates, centred on the robot.

    Attributes:
        cos: Cosine of the angle of its first axis in the world.
        sin: Sine of that angle.
        chirality: 1, or -1 where its second axis lies to the right of the first.
        unit: Its unit of length, world units.
    """

    cos: Float[Array, "robots *batch"]
    sin: Float[Array, "robots *batch"]
    chirality: Float[Array, "robots *batch"]
    unit: Float[Array, "robots *batch"]

    __repr__ = short_repr

    def to_local(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Turns vectors of the world, observer first, into each observer's frame; lengths stay the world's."""
        axes = (self.cos, self.sin, self.chirality)
        cos, sin, chirality = (a.reshape(a.shape[:1] + (1,) * (x.ndim - a.ndim) + a.shape[1:]) for a in axes)
        return cos * x + sin * y, chirality * (cos * y - sin * x)

    def to_world(self, vectors: Float[Array, "robots 2 *batch"]) -> Float[Array, "robots 2 *batch"]:
        """Turns each robot's own vector into the world's frame."""
        x, y = vectors[:, 0], self.chirality * vectors[:, 1]
        return jnp.stack([self.cos * x - self.sin * y, self.sin * x + self.cos * y], axis=1)


class Sensing(Strategy):
    """Which robots a robot perceives, and in which frame.

    A subclass implements `perceived`; frames, noise, landmark and walls are the same for all.

    Attributes:
        rotation: Whether every robot has a direction of its own, so that there is no north.
        reflection: Whether half of the robots see a mirror image, so that there is no common left.
        unit_ratio: Robots' units of length differ by up to this factor from the world's, up or down; 1: all agree.
        resample_frames: Whether frames are drawn anew at every step, instead of once an episode.
        range_noise: Standard deviation of a perceived distance, as a share of it.
        bearing_noise: Standard deviation of a perceived direction, radians.
        miss_probability: Probability that a robot that could be perceived is not.
        landmark: Whether something marks the gathering point, so that robots perceive it, however far (C1).
        walls: Whether robots perceive the four walls: however far, or within the scan radius where they see no farther.
            Of a wall that is farther away they perceive the direction, and that it is as far at least.
    """

    section: ClassVar[str] = "sensing"

    sees_far: ClassVar[bool] = False
    """Whether walls are perceived beyond the scan radius."""

    rotation: bool = eqx.field(default=False, static=True, kw_only=True)
    reflection: bool = eqx.field(default=False, static=True, kw_only=True)
    unit_ratio: float = eqx.field(default=1.0, static=True, kw_only=True)
    resample_frames: bool = eqx.field(default=False, static=True, kw_only=True)
    range_noise: float = eqx.field(default=0.0, static=True, kw_only=True)
    bearing_noise: float = eqx.field(default=0.0, static=True, kw_only=True)
    miss_probability: float = eqx.field(default=0.0, static=True, kw_only=True)
    landmark: bool = eqx.field(default=True, static=True, kw_only=True)
    walls: bool = eqx.field(default=False, static=True, kw_only=True)

    def __check_init__(self) -> None:
        check_number("unit_ratio", self.unit_ratio, 1, MAX_UNIT_RATIO)
        check_number("range_noise", self.range_noise, 0, 1)
        check_number("bearing_noise", self.bearing_noise, 0, 10)
        check_number("miss_probability", self.miss_probability, 0, 1)
        if self.miss_probability == 1:
            raise InputError("miss_probability", 1.0, "less than 1: a robot that perceives no other learns nothing")

    @property
    def is_constant(self) -> bool:
        """Whether a robot sees a configuration alike every time; of a class of a user's own that is not known."""
        is_noisy = self.range_noise > 0 or self.bearing_noise > 0 or self.miss_probability > 0
        return not (is_noisy or self.resample_frames or self.is_foreign())

    @abstractmethod
    def perceived(self, configuration: Configuration) -> Bool[Array, "robots robots *batch"]:
        """Returns which robots (second axis) each robot (first axis) perceives; what the diagonal holds is ignored."""

    def sees_walls(self, world: WorldConfig) -> bool:
        """Returns whether there are walls, and robots perceive them."""
        return self.walls and world.bounded

    def draw_frames(self, keys: Key[Array, "*batch"], robots: int, dtype: Any = jnp.float32) -> Frames:
        """Draws a frame for every robot.

        Args:
            keys: Randomness, `(*batch)`.
            robots: Swarm size.
            dtype: Of the numbers.
        """

        def draw(key: PRNGKeyArray) -> tuple[Array, Array, Array]:
            turn, flip, size = jax.random.split(key, 3)
            return (
                jax.random.uniform(turn, (robots,), dtype, 0.0, 2 * jnp.pi),
                prng.signs(flip, (robots,)).astype(dtype),
                jax.random.uniform(size, (robots,), dtype, -1.0, 1.0),
            )

        angle, chirality, exponent = draw_each(draw, keys)
        angle = angle if self.rotation else jnp.zeros_like(angle)
        chirality = chirality if self.reflection else jnp.ones_like(chirality)
        return Frames(jnp.cos(angle), jnp.sin(angle), chirality, jnp.asarray(self.unit_ratio, dtype) ** exponent)

    def view(
        self, positions: Float[Array, "robots 2 *batch"], frames: Frames, keys: Key[Array, "*batch"], world: WorldConfig
    ) -> View:
        """Returns what every robot perceives of a configuration.

        Args:
            positions: Centres, world units.
            frames: Every robot's system of coordinates.
            keys: Randomness of noise and missed detections, `(*batch)`.
            world: Sizes of the world and its robots.
        """
        return in_tiles(partial(self._view, world), positions.shape[0], positions, frames, keys)

    def _view(
        self, world: WorldConfig, positions: Float[Array, "robots 2 *batch"], frames: Frames, keys: Key[Array, "*batch"]
    ) -> View:
        dx, dy, others = _offsets(positions)
        seen = others & self.perceived(Configuration(positions, world))
        dx, dy, seen = self._with_noise(dx, dy, seen, keys)
        x, y = frames.to_local(dx, dy)
        landmark_x, landmark_y = frames.to_local(-positions[:, 0], -positions[:, 1])
        unit = frames.unit[:, None]
        return View(
            x=jnp.where(seen, x / unit, 0.0),
            y=jnp.where(seen, y / unit, 0.0),
            seen=seen,
            radius=world.radius / frames.unit,
            landmark_x=landmark_x / frames.unit,
            landmark_y=landmark_y / frames.unit,
            walls=nearest_wall_points(positions, frames, world, self.sees_far) if self.sees_walls(world) else None,
        )

    def _with_noise(self, dx: Array, dy: Array, seen: Array, keys: Key[Array, "*batch"]) -> tuple[Array, Array, Array]:
        """Adds noise and missed detections; draws nothing where there are none."""
        if not (self.miss_probability or self.bearing_noise or self.range_noise):
            return dx, dy, seen
        shape = dx.shape[:2]

        def draw(key: PRNGKeyArray) -> tuple[Array, Array, Array]:
            miss, bearing, distance = jax.random.split(key, 3)
            missed = prng.bernoulli(miss, self.miss_probability, shape)
            return missed, jax.random.normal(bearing, shape, dx.dtype), jax.random.normal(distance, shape, dx.dtype)

        missed, bearing, distance = draw_each(draw, keys)
        angle = self.bearing_noise * bearing
        # A perceived distance is never negative: the robot would be seen on the other side.
        factor = jnp.maximum(1 + self.range_noise * distance, 0.01)
        cos, sin = factor * jnp.cos(angle), factor * jnp.sin(angle)
        return cos * dx - sin * dy, sin * dx + cos * dy, seen & ~missed


@Sensing.register("global")
class GlobalSensing(Sensing):
    """Every robot perceives all others: the paper's sensing."""

    sees_far: ClassVar[bool] = True

    def perceived(self, configuration: Configuration) -> Bool[Array, "robots robots *batch"]:
        """Returns True for all."""
        positions = configuration.positions
        return jnp.ones((positions.shape[0], positions.shape[0], *positions.shape[2:]), bool)


@Sensing.register("scan")
class ScanSensing(Sensing):
    """Every robot perceives its neighbours: the robots within the scan radius."""

    def perceived(self, configuration: Configuration) -> Bool[Array, "robots robots *batch"]:
        """Returns the neighbours."""
        return configuration.neighbors


@Sensing.register("visible")
class VisibleSensing(Sensing):
    """Every robot perceives its fully visible neighbours: robots are opaque."""

    def perceived(self, configuration: Configuration) -> Bool[Array, "robots robots *batch"]:
        """Returns the visible neighbours."""
        return configuration.visible


def view_of(observation: Any, world: WorldConfig) -> View:
    """Returns what every robot perceives.

    Robots that act on all positions perceive all others and the walls, in the world's frame and unit.

    Args:
        observation: What a policy acts on: an `Observation`, or the positions of all robots, world units.
        world: Sizes of the world and its robots.
    """
    if isinstance(observation, Observation):
        return observation.view
    dx, dy, others = _offsets(observation)
    x, y = observation[:, 0], observation[:, 1]
    one, zero = jnp.ones_like(x), jnp.zeros_like(x)
    frames = Frames(one, zero, one, one)
    walls = nearest_wall_points(observation, frames, world, sees_far=True) if world.bounded else None
    return View(dx, dy, others, world.radius * one, -x, -y, walls)


def _offsets(positions: Float[Array, "robots 2 *batch"]) -> tuple[Array, Array, Array]:
    """Returns the way from each robot to each other along the axes, and which pairs are of two robots."""
    robots = positions.shape[0]
    dx = positions[None, :, 0] - positions[:, None, 0]
    dy = positions[None, :, 1] - positions[:, None, 1]
    others = ~jnp.eye(robots, dtype=bool).reshape((robots, robots) + (1,) * (positions.ndim - 2))
    return dx, dy, jnp.broadcast_to(others, dx.shape)


def nearest_wall_points(
    positions: Float[Array, "robots 2 *batch"], frames: Frames, world: WorldConfig, sees_far: bool
) -> Float[Array, "robots 4 2 *batch"]:
    """Returns the nearest point of the right, upper, left and lower wall, as each robot perceives it."""
    reach = jnp.inf if sees_far else world.scan_radius
    x, y = positions[:, 0], positions[:, 1]
    zero = jnp.zeros_like(x)
    right, left = jnp.minimum(world.half_width - x, reach), jnp.maximum(-world.half_width - x, -reach)
    upper, lower = jnp.minimum(world.half_height - y, reach), jnp.maximum(-world.half_height - y, -reach)
    offsets = ((right, zero), (zero, upper), (left, zero), (zero, lower))
    return jnp.stack([jnp.stack(frames.to_local(*offset), axis=1) / frames.unit[:, None] for offset in offsets], axis=1)


def wall_directions(
    walls: Float[Array, "robots 4 2 *batch"],
) -> tuple[Float[Array, "robots 4 2 *batch"], Float[Array, "robots 4 *batch"]]:
    """Returns the unit vector towards each wall, and its distance, at least 0."""
    # From wall to wall: a robot at a wall knows from the opposite one where that wall lies.
    across = walls - jnp.roll(walls, 2, axis=1)
    normal = across / jnp.sqrt(jnp.sum(across**2, axis=2, keepdims=True))
    return normal, jnp.maximum(jnp.sum(walls * normal, axis=2), 0.0)
