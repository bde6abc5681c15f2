r"""What baselines see, in world units, and the velocities with which a robot cannot collide with any that it sees.

As in ORCA (van den Berg, Guy, Lin and Manocha, 2011), every other robot forbids a half-plane of velocities, and both
robots of a pair take half of the responsibility. Robots do not see velocities here, so the half-plane of a pair lies
beyond the perpendicular bisector of the two centres less a radius,

    v . u_j <= d_j / 2 - R,

which makes the allowed set a buffered Voronoi cell (Zhou, Wang, Bandyopadhyay and Schwager, 2017). The rule needs no
memory. Two robots that see each other and keep it never collide. Perceived walls forbid what lies beyond them in the
same way.

Robots are opaque, so a robot may be hidden in the shadow of one that is seen, no nearer than that one. The last step
therefore treats each robot seen as if its whole shadow were robots: it shortens velocities until no bound is broken.
(Only a robot that is hidden by a hidden robot escapes this.)
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from murmurate.geometry._batch_last import sum_terms
from murmurate.representation import short_repr
from murmurate.types import View
from murmurate.world.config import WorldConfig
from murmurate.world.sensing import wall_directions

__all__ = ["SAFETY_FACTOR", "LocalView", "avoid_collisions", "full_view", "limit_norm", "local_view", "view_centroid"]

FREE_MARGIN = 0.02
"""Share of a radius that is kept free around a robot, so that rounding causes no collision."""

SAFETY_FACTOR = 1.02
"""Distance that pairs keep, in safe distances: wide enough that robots at rest are not just below the safe distance."""

MAX_PROJECTED = 12
"""Robots whose half-planes are projected onto, the nearest first; no more are within reach at the safe distance."""

PROJECTION_ROUNDS = 16
"""Times that all half-planes are projected onto in turn."""


class LocalView(NamedTuple):
    """What each robot sees, in world units; the observer is the first axis, the observed robot the second.

    Attributes:
        x: First coordinate of each robot seen; 0 for the others.
        y: Second coordinate.
        seen: Which robots are seen, at another place than the observer's.
        distance: Distance of each robot seen; 1 for the others.
        landmark_x: First coordinate of the gathering point.
        landmark_y: Second coordinate.
        walls: The nearest point of each wall; None where walls are not perceived.
    """

    x: Float[Array, "robots robots *batch"]
    y: Float[Array, "robots robots *batch"]
    seen: Bool[Array, "robots robots *batch"]
    distance: Float[Array, "robots robots *batch"]
    landmark_x: Float[Array, "robots *batch"]
    landmark_y: Float[Array, "robots *batch"]
    walls: Float[Array, "robots 4 2 *batch"] | None = None

    __repr__ = short_repr


def local_view(view: View, world: WorldConfig) -> LocalView:
    """Returns what robots see, in world units: the perceived radius tells a robot how long its own unit is."""
    scale = world.radius / view.radius
    x, y = view.x * scale[:, None], view.y * scale[:, None]
    walls = None if view.walls is None else view.walls * scale[:, None, None]
    return _make_view(x, y, view.seen, view.landmark_x * scale, view.landmark_y * scale)._replace(walls=walls)


def full_view(positions: Float[Array, "robots 2 *batch"]) -> LocalView:
    """Returns what robots would see if each saw all others, in the world's frame."""
    x = positions[None, :, 0] - positions[:, None, 0]
    y = positions[None, :, 1] - positions[:, None, 1]
    return _make_view(x, y, jnp.ones(x.shape, bool), -positions[:, 0], -positions[:, 1])


def _make_view(x: Array, y: Array, seen: Array, landmark_x: Array, landmark_y: Array) -> LocalView:
    square = x * x + y * y
    seen = seen & (square > 0)
    distance = jnp.sqrt(jnp.where(seen, square, 1.0))
    return LocalView(jnp.where(seen, x, 0.0), jnp.where(seen, y, 0.0), seen, distance, landmark_x, landmark_y)


def view_centroid(view: LocalView) -> tuple[Float[Array, "robots *batch"], Float[Array, "robots *batch"]]:
    """Returns the centroid of each robot and the robots that it sees, relative to that robot."""

    def seen_robot(i: int) -> tuple[Array, Array, Array]:
        return view.x[:, i], view.y[:, i], view.seen[:, i].astype(view.x.dtype)

    x, y, count = sum_terms(seen_robot, view.x.shape[1])
    return x / (count + 1), y / (count + 1)


def limit_norm(x: Array, y: Array, limit: float) -> tuple[Array, Array]:
    """Shortens vectors so that no norm is above the limit."""
    # Slightly less, so that rounding does not lift any above it.
    share = (1 - 1e-6) * jnp.minimum(1.0, limit / jnp.sqrt(x * x + y * y + 1e-12))
    return x * share, y * share


def avoid_collisions(
    x: Float[Array, "robots *batch"], y: Float[Array, "robots *batch"], view: LocalView, world: WorldConfig
) -> Float[Array, "robots 2 *batch"]:
    """Returns the velocities nearest to the wanted ones that avoid collisions and keep the safe distance.

    The safe distance is a soft bound: robots that are nearer move apart at up to a quarter of the speed limit.

    Args:
        x: First coordinate of each robot's wanted velocity in its own frame, world units per step.
        y: Second coordinate.
        view: What each robot sees.
        world: Sizes of the world and its robots.
    """
    x, y = limit_norm(x, y, world.max_speed)
    distance = jnp.where(view.seen, view.distance, jnp.inf)
    ux, uy = view.x / view.distance, view.y / view.distance
    # The nearest first: an order that does not depend on the robots' numbers.
    near, sx, sy = (a[:, :MAX_PROJECTED] for a in jax.lax.sort((distance, ux, uy), dimension=1, num_keys=1))
    soft = jnp.maximum((near - SAFETY_FACTOR * world.safe_distance) / 2, -world.max_speed / 4)
    bound = jnp.minimum(soft, _free_path(near, world))
    wx, wy, wall_distance = _wall_planes(view)
    planes = (jnp.concatenate(pair, axis=1) for pair in ((sx, wx), (sy, wy), (bound, wall_distance)))
    x, y = limit_norm(*_project(x, y, *planes), world.max_speed)
    share = jnp.minimum(
        _share_clear_of_shadows(x, y, ux, uy, distance, world),
        _share_within(x[:, None] * wx + y[:, None] * wy, wall_distance),
    )
    return jnp.stack([x * share, y * share], axis=1)


def _free_path(distance: Array, world: WorldConfig) -> Array:
    """Returns how far a robot may move towards another one at a distance: half of the way, less a radius."""
    return jnp.maximum(distance / 2 - (1 + FREE_MARGIN) * world.radius, 0.0)


def _wall_planes(view: LocalView) -> tuple[Array, Array, Array]:
    """Returns unit vectors towards the perceived walls, and how far a robot may move towards each."""
    if view.walls is None:
        none = view.x[:, :0]
        return none, none, none
    normal, distance = wall_directions(view.walls)
    return normal[:, :, 0], normal[:, :, 1], (1 - FREE_MARGIN) * distance


def _project(x: Array, y: Array, ux: Array, uy: Array, bound: Array) -> tuple[Array, Array]:
    """Projects onto all half-planes v . u <= bound by Dykstra's cyclic projections (for half-planes: Hildreth's)."""

    def project(_: int, carry: tuple[Array, Array, tuple[Array, ...]]) -> tuple[Array, Array, tuple[Array, ...]]:
        x, y, pushes = carry
        updated = []
        for j, push in enumerate(pushes):
            pushed = jnp.maximum(push + x * ux[:, j] + y * uy[:, j] - bound[:, j], 0.0)
            x, y = x - (pushed - push) * ux[:, j], y - (pushed - push) * uy[:, j]
            updated.append(pushed)
        return x, y, tuple(updated)

    pushes = tuple(jnp.zeros_like(x) for _ in range(ux.shape[1]))
    x, y, _ = jax.lax.fori_loop(0, PROJECTION_ROUNDS, project, (x, y, pushes))
    return x, y


def _share_clear_of_shadows(x: Array, y: Array, ux: Array, uy: Array, distance: Array, world: WorldConfig) -> Array:
    """Returns the share of a velocity that stays clear of each robot seen, and of any robot hidden in its shadow."""
    speed = jnp.sqrt(x * x + y * y + 1e-12)
    along = jnp.clip((x[:, None] * ux + y[:, None] * uy) / speed[:, None], -1.0, 1.0)
    # A disc no nearer than this one that overlaps it in view is less than twice its half-angle away in direction.
    angle = jnp.arccos(along) - 2 * jnp.arcsin(jnp.minimum(world.radius / distance, 1.0))
    approach = speed[:, None] * jnp.cos(jnp.maximum(angle, 0.0))
    return _share_within(approach, _free_path(distance, world))


def _share_within(approach: Array, limit: Array) -> Array:
    """Returns the share of a velocity that keeps each of several approaches within its limit."""
    share = jnp.where(approach > limit, limit / jnp.where(approach > limit, approach, 1.0), 1.0)
    return jnp.min(share, axis=1, initial=1.0)
