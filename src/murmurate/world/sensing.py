"""Robots with their own eyes: what each one perceives, in a frame of its own, and nothing else.

A robot is anonymous, oblivious and silent: it sees where others are now, not who they are, and is told nothing. What it
does not perceive is absent from its view, as a robot that does not exist would be.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from murmurate.errors import InputError, check_choice, check_number
from murmurate.geometry import neighbors_and_visible
from murmurate.world.randomness import each

__all__ = ["Frames", "SensingConfig", "SensingKind", "View", "draw_frames", "perceive"]

SensingKind = Literal["global", "scan", "visible"]

MOST_UNIT = 1000.0


@dataclass(frozen=True)
class SensingConfig:
    """What a robot perceives, and in which frame.

    Attributes:
        kind: global (all positions: the paper's), scan (those within the scan radius) or visible (those of them that
            are fully visible: robots are opaque).
        rotation: Whether every robot has a direction of its own, so that there is no north.
        reflection: Whether half of the robots see a mirror image, so that there is no common left.
        unit: Robots' units of length differ by up to this factor from the world's, up or down; 1: all agree.
        redrawn: Whether frames are drawn anew at every step, instead of once an episode.
        range_noise: Standard deviation of a perceived distance, as a share of it.
        bearing_noise: Standard deviation of a perceived direction, radians.
        missed: Probability that a robot that could be perceived is not.
        landmark: Whether something marks the gathering point, so that robots perceive it, however far (C1).
        walls: Whether robots perceive the four walls, however far.
    """

    kind: SensingKind = "global"
    rotation: bool = False
    reflection: bool = False
    unit: float = 1.0
    redrawn: bool = False
    range_noise: float = 0.0
    bearing_noise: float = 0.0
    missed: float = 0.0
    landmark: bool = True
    walls: bool = False

    def __post_init__(self) -> None:
        check_choice("kind", self.kind, get_args(SensingKind))
        check_number("unit", self.unit, 1, MOST_UNIT)
        check_number("range_noise", self.range_noise, 0, 1)
        check_number("bearing_noise", self.bearing_noise, 0, 10)
        check_number("missed", self.missed, 0, 1)
        if self.missed == 1:
            raise InputError("missed", self.missed, "less than 1: who perceives nobody learns nothing")

    @property
    def disoriented(self) -> bool:
        """Whether any robot's frame differs from the world's."""
        return self.rotation or self.reflection or self.unit > 1


class Frames(eqx.Module):
    """Every robot's own system of coordinates, centred on itself.

    Attributes:
        cos: Cosine of the angle of its first axis in the world.
        sin: Sine of it.
        mirror: 1, or -1 where its second axis lies to the right of the first.
        unit: Its unit of length, world units.
    """

    cos: Float[Array, "robots *batch"]
    sin: Float[Array, "robots *batch"]
    mirror: Float[Array, "robots *batch"]
    unit: Float[Array, "robots *batch"]

    def inward(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Turns vectors of the world, observer first, into each observer's frame; lengths stay the world's."""
        cos, sin, mirror = (a.reshape(a.shape[:1] + (1,) * (x.ndim - a.ndim) + a.shape[1:]) for a in self._turn)
        return cos * x + sin * y, mirror * (cos * y - sin * x)

    def outward(self, vectors: Float[Array, "robots 2 *batch"]) -> Float[Array, "robots 2 *batch"]:
        """Turns each robot's own vector into the world's frame."""
        x, y = vectors[:, 0], self.mirror * vectors[:, 1]
        return jnp.stack([self.cos * x - self.sin * y, self.sin * x + self.cos * y], axis=1)

    @property
    def _turn(self) -> tuple[Array, Array, Array]:
        return self.cos, self.sin, self.mirror


class View(eqx.Module):
    """What every robot perceives, in its own frame and unit; the observer is the first axis, the observed the second.

    Attributes:
        x: First coordinate of each robot that is perceived; 0 for the others.
        y: Second coordinate, likewise.
        seen: Which robots are perceived; never the observer itself.
        radius: The robots' radius in the observer's unit: by it a robot tells how long its unit is.
        point_x: First coordinate of the gathering point, which a landmark shows to all.
        point_y: Second coordinate of it.
        walls: The nearest point of each wall, opposite ones two places apart; None where walls are not perceived.
    """

    x: Float[Array, "robots robots *batch"]
    y: Float[Array, "robots robots *batch"]
    seen: Bool[Array, "robots robots *batch"]
    radius: Float[Array, "robots *batch"]
    point_x: Float[Array, "robots *batch"]
    point_y: Float[Array, "robots *batch"]
    walls: Float[Array, "robots 4 2 *batch"] | None = None


def draw_frames(config: SensingConfig, keys: PRNGKeyArray, robots: int, dtype: Any = jnp.float32) -> Frames:
    """Draws a frame for every robot.

    Args:
        config: Which freedoms frames have.
        keys: Randomness, `(*batch)`.
        robots: Swarm size.
        dtype: Of the numbers.
    """

    def draw(key: PRNGKeyArray) -> tuple[Array, Array, Array]:
        turn, flip, size = jax.random.split(key, 3)
        return (
            jax.random.uniform(turn, (robots,), dtype, 0.0, 2 * jnp.pi),
            jax.random.rademacher(flip, (robots,), dtype),
            jax.random.uniform(size, (robots,), dtype, -1.0, 1.0),
        )

    angle, mirror, exponent = each(draw, keys)
    angle = angle if config.rotation else jnp.zeros_like(angle)
    mirror = mirror if config.reflection else jnp.ones_like(mirror)
    return Frames(jnp.cos(angle), jnp.sin(angle), mirror, jnp.asarray(config.unit, dtype) ** exponent)


def perceive(
    config: SensingConfig,
    positions: Float[Array, "robots 2 *batch"],
    frames: Frames,
    keys: PRNGKeyArray,
    radius: Any,
    scan_radius: Any,
    half_width: Any,
    half_height: Any,
) -> View:
    """Looks around from every robot.

    Args:
        config: What is perceived.
        positions: Centres, world units.
        frames: Every robot's system of coordinates.
        keys: Randomness of noise and missed detections, `(*batch)`.
        radius: The paper's R_bot, world units.
        scan_radius: The paper's R_scan, world units.
        half_width: The world's X, world units.
        half_height: The world's Y, world units.
    """
    dx = positions[None, :, 0] - positions[:, None, 0]
    dy = positions[None, :, 1] - positions[:, None, 1]
    seen = _seen(config, positions, radius, scan_radius)
    dx, dy, seen = _blurred(config, dx, dy, seen, keys)
    x, y = frames.inward(dx, dy)
    px, py = frames.inward(-positions[:, 0], -positions[:, 1])
    unit = frames.unit[:, None]
    return View(
        x=jnp.where(seen, x / unit, 0.0),
        y=jnp.where(seen, y / unit, 0.0),
        seen=seen,
        radius=radius / frames.unit,
        point_x=px / frames.unit,
        point_y=py / frames.unit,
        walls=_walls(positions, frames, half_width, half_height) if config.walls else None,
    )


def _walls(
    positions: Float[Array, "robots 2 *batch"], frames: Frames, half_width: Any, half_height: Any
) -> Float[Array, "robots 4 2 *batch"]:
    """Returns the nearest point of the right, upper, left and lower wall, as each robot perceives it."""
    x, y = positions[:, 0], positions[:, 1]
    nothing = jnp.zeros_like(x)
    right, upper, left, lower = half_width - x, half_height - y, -half_width - x, -half_height - y
    offsets = ((right, nothing), (nothing, upper), (left, nothing), (nothing, lower))
    return jnp.stack([jnp.stack(frames.inward(*way), axis=1) / frames.unit[:, None] for way in offsets], axis=1)


def _blurred(
    config: SensingConfig, dx: Array, dy: Array, seen: Array, keys: PRNGKeyArray
) -> tuple[Array, Array, Array]:
    """Puts in what goes wrong with perceiving; draws nothing where nothing does."""
    if not (config.missed or config.bearing_noise or config.range_noise):
        return dx, dy, seen
    shape = dx.shape[:2]

    def draw(key: PRNGKeyArray) -> tuple[Array, Array, Array]:
        miss, aside, far = jax.random.split(key, 3)
        turned, nearer = (jax.random.normal(one, shape, dx.dtype) for one in (aside, far))
        return jax.random.bernoulli(miss, config.missed, shape), turned, nearer

    missed, aside, far = each(draw, keys)
    angle = config.bearing_noise * aside
    # A perceived distance is never negative: the robot would be seen behind.
    factor = jnp.maximum(1 + config.range_noise * far, 0.01)
    cos, sin = factor * jnp.cos(angle), factor * jnp.sin(angle)
    return cos * dx - sin * dy, sin * dx + cos * dy, seen & ~missed


def _seen(
    config: SensingConfig, positions: Float[Array, "robots 2 *batch"], radius: Any, scan_radius: Any
) -> Bool[Array, "robots robots *batch"]:
    robots = positions.shape[0]
    other = ~jnp.eye(robots, dtype=bool).reshape((robots, robots) + (1,) * (positions.ndim - 2))
    if config.kind == "global":
        return jnp.broadcast_to(other, (robots, robots, *positions.shape[2:]))
    near, visible = neighbors_and_visible(positions, radius, scan_radius)
    return near if config.kind == "scan" else visible
