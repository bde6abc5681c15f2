"""A regular ring: with places assigned centrally, or found by each robot from what it sees."""

from __future__ import annotations

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.optimize import linear_sum_assignment

from murmurate.geometry.rings import smallest_ring_radius
from murmurate.policies.baselines.avoidance import avoid_collisions, full_view, local_view, view_centroid
from murmurate.policies.baselines.base import Baseline
from murmurate.types import Observation
from murmurate.world.config import WorldConfig

__all__ = ["CentralCircle", "VisibleCircle", "enclosing_circle", "ring_radius"]

SLACK = 1.08
"""Radius of the ring, in radii of the smallest valid one: a ring that is not quite regular needs more room."""

GAIN = 0.5
"""Share of the remaining way that a robot moves in one step, where the speed limit allows."""

ROTATIONS = 6
"""Rotations of the ring among which the centralised circle searches for the shortest paths."""

ENCLOSING_STEPS = 80
"""Iterations of the search for the smallest enclosing circle."""

MAX_CROWDING = 1.5
"""Number of robots that a robot assumes to be there at most, for each robot that it sees."""


def ring_radius(count: Any, world: WorldConfig) -> Float[Array, "*shape"]:
    """Returns the radius of the smallest valid ring of N robots in float32, world units.

    Args:
        count: N, a number or an array; fewer than two robots count as two.
        world: Sizes of the world and its robots.
    """
    return smallest_ring_radius(jnp.asarray(count, jnp.float32), world.radius, world.safe_distance)


def enclosing_circle(
    x: Float[Array, "groups points *batch"],
    y: Float[Array, "groups points *batch"],
    member: Bool[Array, "groups points *batch"],
    start: tuple[Array, Array],
) -> tuple[Array, Array, Array]:
    """Returns the smallest enclosing circle of each group, by Badoiu and Clarkson's iteration (2003).

    Args:
        x: First coordinate of each point, world units.
        y: Second coordinate.
        member: Which points belong to the group; there is at least one.
        start: Where the search begins, such as the centroid.

    Returns:
        Coordinates of the centre, and the radius, each `(groups, *batch)`.
    """

    def farthest(cx: Array, cy: Array) -> tuple[Array, Array, Array]:
        square = jnp.where(member, (x - cx[:, None]) ** 2 + (y - cy[:, None]) ** 2, -1.0)
        index = jnp.argmax(square, axis=1, keepdims=True)
        fx, fy, largest = (jnp.take_along_axis(a, index, axis=1)[:, 0] for a in (x, y, square))
        return fx, fy, jnp.sqrt(jnp.maximum(largest, 0.0))

    def step(index: int, center: tuple[Array, Array]) -> tuple[Array, Array]:
        fx, fy, _ = farthest(*center)
        share = 1 / (index + 2.0)
        return center[0] + share * (fx - center[0]), center[1] + share * (fy - center[1])

    cx, cy = jax.lax.fori_loop(0, ENCLOSING_STEPS, step, start)
    return cx, cy, farthest(cx, cy)[2]


@Baseline.register("circle-central")
class CentralCircle(Baseline):
    """Sends all robots to places on one regular ring, by the assignment with the least sum of squared path lengths.

    All robots set out and arrive together, as in CAPT (Turpin, Michael and Kumar, 2014): on paths so assigned, at such
    speeds, robots that start far enough apart do not meet. The ring surrounds the centre of the smallest circle that
    encloses all robots, or the gathering point, and is rotated so that paths are short.

    It uses the positions of all robots, and its velocities are in the world's frame: the robots' own frames must be
    the world's.
    """

    title: ClassVar[str] = "Assigned circle"
    centralised: ClassVar[bool] = True
    deviations: ClassVar[str] = "Centralised: it knows all positions in a common frame, and assigns places."

    def __call__(self, observation: Observation) -> Float[Array, "robots 2 *batch"]:
        """Returns velocities in the world's frame, world units per step."""
        world, positions = self.world, observation.positions
        robots = positions.shape[0]
        center = jnp.zeros((1, *positions.shape[1:]), positions.dtype)
        if not self.landmark:
            x, y = positions[None, :, 0], positions[None, :, 1]
            cx, cy, _ = enclosing_circle(x, y, jnp.ones(x.shape, bool), (jnp.mean(x, axis=1), jnp.mean(y, axis=1)))
            center = jnp.concatenate([cx, cy])[None]
        radius = SLACK * ring_radius(robots, world)
        shape = jax.ShapeDtypeStruct(positions.shape, positions.dtype)
        places = jax.pure_callback(_assign_places, shape, positions - center, radius) + center
        path = places - positions
        longest = jnp.max(jnp.sqrt(jnp.sum(path**2, axis=1)), axis=0)
        velocity = path / jnp.maximum(longest / world.max_speed, 1 / GAIN)
        return avoid_collisions(velocity[:, 0], velocity[:, 1], full_view(positions), world)


def _assign_places(
    positions: Float[Array, "robots 2 *batch"], radius: Float[Array, ""]
) -> Float[np.ndarray, "robots 2 *batch"]:
    """Returns each robot's place on a ring around the origin; JAX calls it on the host, with arrays of its own."""
    array = np.asarray(positions)
    points = array.astype(float)
    z = (points[:, 0] + 1j * points[:, 1]).reshape(len(points), -1)
    places = np.stack([_ring_places(column, float(radius)) for column in z.T], axis=1)
    return np.stack([np.real(places), np.imag(places)], axis=1).reshape(array.shape).astype(array.dtype)


def _ring_places(z: np.ndarray, radius: float) -> np.ndarray:
    """Returns the best assignment among some rotations of the ring, each rotated on to where its assignment is best."""
    robots = len(z)
    ring = radius * np.exp(2j * np.pi * np.arange(robots) / robots)
    best, least = ring, np.inf
    for turn in np.exp(2j * np.pi * np.arange(ROTATIONS) / (ROTATIONS * robots)):
        _, order = linear_sum_assignment(-(z[:, None] * (turn * ring).conj()[None]).real)
        overlap = np.sum(z * ring[order].conj())
        places = ring[order] * (overlap / abs(overlap) if abs(overlap) > 0 else turn)
        squares = float(np.sum(np.abs(places - z) ** 2))
        if squares < least:
            best, least = places, squares
    return best


@Baseline.register("circle")
class VisibleCircle(Baseline):
    """Moves onto the smallest circle around the robots seen, and along it to the middle between its neighbours.

    The circle shrinks or grows to the smallest valid ring of as many robots as are seen, or as would fit on it as
    densely as around this robot. With a landmark it surrounds the landmark.
    """

    title: ClassVar[str] = "Circle of those seen"

    def __call__(self, observation: Observation) -> Float[Array, "robots 2 *batch"]:
        """Returns velocities in each robot's own frame, world units per step."""
        world = self.world
        view = local_view(observation.view, world)
        itself = jnp.eye(view.x.shape[0], dtype=bool).reshape(view.x.shape[:2] + (1,) * (view.x.ndim - 2))
        cx, cy = view.landmark_x, view.landmark_y
        if not self.landmark:
            cx, cy, _ = enclosing_circle(view.x, view.y, view.seen | itself, view_centroid(view))
        distance = jnp.sqrt(cx * cx + cy * cy + 1e-12)
        # The unit vector outwards, from the centre to the robot.
        ox, oy = -cx / distance, -cy / distance
        after, before = _gaps(view.x - cx[:, None], view.y - cy[:, None], ox, oy, view.seen)
        count = jnp.sum(view.seen, axis=1) + 1
        # A robot that sees its two neighbours on a ring knows how many robots fit on it, even if they hide the rest.
        crowd = jnp.minimum(4 * jnp.pi / jnp.maximum(after + before, 1e-3), MAX_CROWDING * count)
        radius = SLACK * ring_radius(jnp.maximum(count, crowd), world)
        outwards, along = GAIN * (radius - distance), GAIN * jnp.minimum(distance, radius) * (after - before) / 2
        return avoid_collisions(outwards * ox - along * oy, outwards * oy + along * ox, view, world)


def _gaps(x: Array, y: Array, ox: Array, oy: Array, seen: Array) -> tuple[Array, Array]:
    """Returns the angles from each robot to the next one around the centre, in either sense of rotation, radians."""
    ox, oy = ox[:, None], oy[:, None]
    angle = jnp.mod(jnp.arctan2(ox * y - oy * x, ox * x + oy * y), 2 * jnp.pi)
    after = jnp.min(jnp.where(seen, angle, jnp.inf), axis=1)
    before = jnp.min(jnp.where(seen, 2 * jnp.pi - angle, jnp.inf), axis=1)
    alone = ~jnp.any(seen, axis=1)
    return jnp.where(alone, 0.0, after), jnp.where(alone, 0.0, before)
