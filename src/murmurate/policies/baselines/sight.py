"""What each robot sees, in its own frame and in world units."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from murmurate.policies.layers import fold
from murmurate.types import View
from murmurate.world.config import WorldConfig

__all__ = ["Sight", "everyone", "mean_of_seen", "sight"]


class Sight(NamedTuple):
    """What each robot sees around itself; the observer is the first axis, the observed the second.

    Attributes:
        x: First coordinate of each robot seen, world units; 0 for the others.
        y: Second coordinate, likewise.
        seen: Which robots are seen, and are not where the observer is.
        distance: How far away each one is, world units; 1 for those not seen.
        point_x: First coordinate of the gathering point, world units.
        point_y: Second coordinate of it.
        walls: The nearest point of each wall, world units; None where walls are not perceived.
    """

    x: Float[Array, "robots robots *batch"]
    y: Float[Array, "robots robots *batch"]
    seen: Bool[Array, "robots robots *batch"]
    distance: Float[Array, "robots robots *batch"]
    point_x: Float[Array, "robots *batch"]
    point_y: Float[Array, "robots *batch"]
    walls: Float[Array, "robots 4 2 *batch"] | None = None


def sight(view: View, world: WorldConfig) -> Sight:
    """Returns what the robots see; how long a robot's unit is it tells by the radius it perceives."""
    scale = world.radius / view.radius
    x, y = view.x * scale[:, None], view.y * scale[:, None]
    walls = None if view.walls is None else view.walls * scale[:, None, None]
    return _sight(x, y, view.seen, view.landmark_x * scale, view.landmark_y * scale)._replace(walls=walls)


def everyone(positions: Float[Array, "robots 2 *batch"]) -> Sight:
    """Returns what robots would see that saw all others, in the world's frame."""
    x = positions[None, :, 0] - positions[:, None, 0]
    y = positions[None, :, 1] - positions[:, None, 1]
    return _sight(x, y, jnp.ones(x.shape, bool), -positions[:, 0], -positions[:, 1])


def _sight(x: Array, y: Array, seen: Array, point_x: Array, point_y: Array) -> Sight:
    square = x * x + y * y
    seen = seen & (square > 0)
    distance = jnp.sqrt(jnp.where(seen, square, 1.0))
    return Sight(jnp.where(seen, x, 0.0), jnp.where(seen, y, 0.0), seen, distance, point_x, point_y)


def mean_of_seen(seen: Sight) -> tuple[Float[Array, "robots *batch"], Float[Array, "robots *batch"]]:
    """Returns the centroid of each robot and those that it sees, world units."""
    x, y, count = fold(lambda i: (seen.x[:, i], seen.y[:, i], seen.seen[:, i].astype(seen.x.dtype)), seen.x.shape[1])
    return x / (count + 1), y / (count + 1)
