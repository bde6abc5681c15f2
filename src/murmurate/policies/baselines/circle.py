"""A regular ring: assigned by somebody who knows everything, or found by each robot from what it sees."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.optimize import linear_sum_assignment

from murmurate.policies.baselines.avoidance import avoiding
from murmurate.policies.baselines.sight import everyone, mean_of_seen, sight
from murmurate.types import Observation
from murmurate.world.config import WorldConfig

__all__ = ["CentralCircle", "VisibleCircle", "enclosing", "least_ring"]

SLACK = 1.08
"""Radius of the ring, in radii of the smallest that will do: a ring need not be quite regular to be valid."""

GAIN = 0.5
"""Share of the way that is left to do in one step, where the speed limit allows."""

ROTATIONS = 6
"""Turns of the ring among which the centralised circle looks for the shortest ways."""

ENCLOSING_STEPS = 80

MOST_HIDDEN = 1.5
"""Robots that a robot takes to be there at most, for each that it sees."""


def least_ring(count: Any, world: WorldConfig) -> Float[Array, "*shape"]:
    """Returns the least radius of a regular ring on which all see each other and keep the safe distance, world units.

    From one robot on a ring the next ones are theta = pi / N apart in view, and the first two are the nearest, so they
    are the first to hide one another: when asin(R / (2 r sin theta)) + asin(R / (2 r sin 2 theta)) = theta. That is a
    triangle with two sides in the ratio 1 / sin theta : 1 / sin 2 theta, which gives r.

    Args:
        count: N, any number or array of them; fewer than two count as two.
        world: The radius R and the safe distance.
    """
    count = jnp.asarray(count, jnp.float32)
    theta = math.pi / jnp.maximum(count, 3.0)
    first, second = jnp.sin(theta), jnp.sin(2 * theta)
    third = jnp.sqrt(first**2 + second**2 + 2 * first * second * jnp.cos(theta))
    clear = world.radius * third / (2 * first * second * first)
    safe = world.safe_distance / (2 * first)
    return jnp.where(count > 2, jnp.maximum(clear, safe), world.safe_distance / 2)


def enclosing(
    x: Float[Array, "groups points *batch"],
    y: Float[Array, "groups points *batch"],
    member: Bool[Array, "groups points *batch"],
    start: tuple[Array, Array],
) -> tuple[Array, Array, Array]:
    """Finds the smallest enclosing circle of each group by Badoiu and Clarkson's iteration (2003).

    Args:
        x: First coordinate of each point, world units.
        y: Second coordinate.
        member: Which points belong to the group; there is at least one.
        start: Where the search begins, such as the centroid.

    Returns:
        Coordinates of the centre and the radius, each `(groups, *batch)`.
    """

    def farthest(cx: Array, cy: Array) -> tuple[Array, Array, Array]:
        square = jnp.where(member, (x - cx[:, None]) ** 2 + (y - cy[:, None]) ** 2, -1.0)
        index = jnp.argmax(square, axis=1, keepdims=True)
        fx, fy, most = (jnp.take_along_axis(a, index, axis=1)[:, 0] for a in (x, y, square))
        return fx, fy, jnp.sqrt(jnp.maximum(most, 0.0))

    def step(index: int, center: tuple[Array, Array]) -> tuple[Array, Array]:
        fx, fy, _ = farthest(*center)
        share = 1 / (index + 2.0)
        return center[0] + share * (fx - center[0]), center[1] + share * (fy - center[1])

    cx, cy = jax.lax.fori_loop(0, ENCLOSING_STEPS, step, start)
    return cx, cy, farthest(cx, cy)[2]


class VisibleCircle(eqx.Module):
    """Moves onto the smallest circle around those seen, and along it to the middle between the next ones.

    The circle becomes the least ring for as many robots as are seen, or as would fit on it as densely as around this
    one. With a landmark it is around that.
    """

    title: ClassVar[str] = "Circle of those seen"
    centralised: ClassVar[bool] = False
    deviations: ClassVar[str] = ""
    world: WorldConfig = eqx.field(static=True)
    landmark: bool = eqx.field(static=True)

    def __call__(self, observation: Observation) -> Float[Array, "robots 2 *batch"]:
        """Returns velocities in each robot's own frame, world units per step."""
        world = self.world
        seen = sight(observation.view, world)
        me = jnp.eye(seen.x.shape[0], dtype=bool).reshape(seen.x.shape[:2] + (1,) * (seen.x.ndim - 2))
        cx, cy = seen.point_x, seen.point_y
        if not self.landmark:
            cx, cy, _ = enclosing(seen.x, seen.y, seen.seen | me, mean_of_seen(seen))
        mine = jnp.sqrt(cx * cx + cy * cy + 1e-12)
        ox, oy = -cx / mine, -cy / mine
        after, before = _gaps(seen.x - cx[:, None], seen.y - cy[:, None], ox, oy, seen.seen)
        count = jnp.sum(seen.seen, axis=1) + 1
        # Who sees its two neighbours on a ring knows how many fit on it, even if they hide the rest.
        crowd = jnp.minimum(4 * jnp.pi / jnp.maximum(after + before, 1e-3), MOST_HIDDEN * count)
        radius = SLACK * least_ring(jnp.maximum(count, crowd), world)
        outwards, along = GAIN * (radius - mine), GAIN * jnp.minimum(mine, radius) * (after - before) / 2
        return avoiding(outwards * ox - along * oy, outwards * oy + along * ox, seen, world)


def _gaps(x: Array, y: Array, ox: Array, oy: Array, seen: Array) -> tuple[Array, Array]:
    """Angles from each robot to the next one seen, counter-clockwise and clockwise around the centre, radians."""
    ox, oy = ox[:, None], oy[:, None]
    angle = jnp.mod(jnp.arctan2(ox * y - oy * x, ox * x + oy * y), 2 * jnp.pi)
    after = jnp.min(jnp.where(seen, angle, jnp.inf), axis=1)
    before = jnp.min(jnp.where(seen, 2 * jnp.pi - angle, jnp.inf), axis=1)
    alone = ~jnp.any(seen, axis=1)
    return jnp.where(alone, 0.0, after), jnp.where(alone, 0.0, before)


class CentralCircle(eqx.Module):
    """Sends all robots to places on one regular ring, by the assignment with the least sum of squared ways.

    All set out and arrive together, as in CAPT (Turpin, Michael and Kumar, 2014): on ways so assigned, at such speeds,
    robots that start far enough apart do not meet. The ring is around the middle of the smallest circle that encloses
    all, or around the gathering point, turned so that ways are short.

    It looks at the positions of all robots, and what it returns is in the world's frame: it needs robots whose own
    frames are the world's, and it is for the caller to give it no others.
    """

    title: ClassVar[str] = "Assigned circle"
    centralised: ClassVar[bool] = True
    deviations: ClassVar[str] = "Centralised: it knows where everybody is in a common frame, and assigns places."
    world: WorldConfig = eqx.field(static=True)
    landmark: bool = eqx.field(static=True)

    def __call__(self, observation: Observation) -> Float[Array, "robots 2 *batch"]:
        """Returns velocities in the world's frame, world units per step."""
        world, positions = self.world, observation.positions
        robots = positions.shape[0]
        center = jnp.zeros((1, *positions.shape[1:]), positions.dtype)
        if not self.landmark:
            x, y = positions[None, :, 0], positions[None, :, 1]
            cx, cy, _ = enclosing(x, y, jnp.ones(x.shape, bool), (jnp.mean(x, axis=1), jnp.mean(y, axis=1)))
            center = jnp.concatenate([cx, cy])[None]
        radius = SLACK * least_ring(robots, world)
        shape = jax.ShapeDtypeStruct(positions.shape, positions.dtype)
        places = jax.pure_callback(_assigned, shape, positions - center, radius) + center
        way = places - positions
        longest = jnp.max(jnp.sqrt(jnp.sum(way**2, axis=1)), axis=0)
        way = way / jnp.maximum(longest / world.max_speed, 1 / GAIN)
        return avoiding(way[:, 0], way[:, 1], everyone(positions), world)


def _assigned(
    positions: Float[np.ndarray, "robots 2 *batch"], radius: Float[np.ndarray, ""]
) -> Float[np.ndarray, "robots 2 *batch"]:
    """Returns each robot's place on a ring around the origin."""
    given = np.asarray(positions)
    points = given.astype(float)
    z = (points[:, 0] + 1j * points[:, 1]).reshape(len(points), -1)
    places = np.stack([_ring_places(column, float(radius)) for column in z.T], axis=1)
    return np.stack([np.real(places), np.imag(places)], axis=1).reshape(given.shape).astype(given.dtype)


def _ring_places(z: np.ndarray, radius: float) -> np.ndarray:
    """Tries some turns of the ring, each turned on to where its own assignment is best, and takes the best of all."""
    robots = len(z)
    ring = radius * np.exp(2j * np.pi * np.arange(robots) / robots)
    best, least = ring, np.inf
    for turn in np.exp(2j * np.pi * np.arange(ROTATIONS) / (ROTATIONS * robots)):
        _, order = linear_sum_assignment(-(z[:, None] * (turn * ring).conj()[None]).real)
        overlap = np.sum(z * ring[order].conj())
        places = ring[order] * (overlap / abs(overlap) if abs(overlap) > 0 else turn)
        ways = float(np.sum(np.abs(places - z) ** 2))
        if ways < least:
            best, least = places, ways
    return best
