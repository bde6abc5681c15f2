r"""The velocity nearest to the wanted one with which a robot cannot collide with any that it sees.

As ORCA (van den Berg, Guy, Lin and Manocha, 2011), every other robot forbids a half-plane of velocities, and both of a
pair take half of the responsibility. But robots do not see velocities here, so the half-plane of a pair is that beyond
the perpendicular bisector of the two centres less a radius,

    v . u_j <= d_j / 2 - R,

which makes the allowed set a buffered Voronoi cell (Zhou, Wang, Bandyopadhyay and Schwager, 2017). It is memoryless,
and two robots that see each other never collide, whatever else they do. Walls, where they are perceived, forbid what is
beyond them likewise.

Robots are opaque, so somebody may stand in the shadow of a robot that is seen, no nearer than that one. Therefore the
last step, which shortens velocities until none of these bounds is broken, treats each robot seen as if its whole shadow
were robots. (Only who is hidden by somebody hidden in turn escapes that.)
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from murmurate.policies.baselines.sight import Sight
from murmurate.policies.shield import wall_directions
from murmurate.world.config import WorldConfig

__all__ = ["KEEP", "avoiding", "limited"]

MARGIN = 0.02
"""Share of a radius that is kept free beyond it, so that rounding causes no collision."""

KEEP = 1.02
"""Distance that is kept between pairs, in safe distances: enough that those that come to rest are not just below it."""

NEAREST = 12
"""Robots that are projected away from: no more than these are within reach once pairs are the safe distance apart."""

ROUNDS = 16
"""Times that all half-planes are projected onto in turn."""


def limited(x: Array, y: Array, limit: float) -> tuple[Array, Array]:
    """Shortens vectors so that the norm of none is above the limit."""
    # A hair less, so that rounding does not lift any above it.
    share = (1 - 1e-6) * jnp.minimum(1.0, limit / jnp.sqrt(x * x + y * y + 1e-12))
    return x * share, y * share


def avoiding(
    x: Float[Array, "robots *batch"], y: Float[Array, "robots *batch"], seen: Sight, world: WorldConfig
) -> Float[Array, "robots 2 *batch"]:
    """Returns the velocities nearest to the wanted ones that avoid collisions and keep the safe distance.

    The safe distance is a soft bound: whoever is nearer moves apart at up to a quarter of the speed limit.

    Args:
        x: First coordinate of each robot's wanted velocity, its own frame, world units per step.
        y: Second coordinate, likewise.
        seen: Whom each robot sees.
        world: The world's.
    """
    x, y = limited(x, y, world.max_speed)
    far = jnp.where(seen.seen, seen.distance, jnp.inf)
    ux, uy = seen.x / seen.distance, seen.y / seen.distance
    # The nearest first: an order that depends on no robot's number.
    near, sx, sy = (a[:, :NEAREST] for a in jax.lax.sort((far, ux, uy), dimension=1, num_keys=1))
    soft = jnp.maximum((near - KEEP * world.safe_distance) / 2, -world.max_speed / 4)
    bound = jnp.minimum(soft, _room(near, world))
    wx, wy, way = _walls(seen)
    planes = (jnp.concatenate(pair, axis=1) for pair in ((sx, wx), (sy, wy), (bound, way)))
    x, y = limited(*_projected(x, y, *planes), world.max_speed)
    share = jnp.minimum(
        _share(x, y, ux, uy, far, world),
        _shortest(x[:, None] * wx + y[:, None] * wy, way),
    )
    return jnp.stack([x * share, y * share], axis=1)


def _room(distance: Array, world: WorldConfig) -> Array:
    """How far a robot may go towards another one."""
    return jnp.maximum(distance / 2 - (1 + MARGIN) * world.radius, 0.0)


def _walls(seen: Sight) -> tuple[Array, Array, Array]:
    """Unit vectors towards the walls that are perceived, and how far a robot may go."""
    if seen.walls is None:
        nowhere = seen.x[:, :0]
        return nowhere, nowhere, nowhere
    normal, way = wall_directions(seen.walls)
    return normal[:, :, 0], normal[:, :, 1], (1 - MARGIN) * way


def _projected(x: Array, y: Array, ux: Array, uy: Array, bound: Array) -> tuple[Array, Array]:
    """Projects onto all half-planes v.u <= bound by Dykstra's cyclic projections (for half-planes: Hildreth's)."""

    def project(_: int, carry: tuple[Array, Array, tuple[Array, ...]]) -> tuple[Array, Array, tuple[Array, ...]]:
        x, y, pushes = carry
        after = []
        for j, push in enumerate(pushes):
            pushed = jnp.maximum(push + x * ux[:, j] + y * uy[:, j] - bound[:, j], 0.0)
            x, y = x - (pushed - push) * ux[:, j], y - (pushed - push) * uy[:, j]
            after.append(pushed)
        return x, y, tuple(after)

    pushes = tuple(jnp.zeros_like(x) for _ in range(ux.shape[1]))
    x, y, _ = jax.lax.fori_loop(0, ROUNDS, project, (x, y, pushes))
    return x, y


def _share(x: Array, y: Array, ux: Array, uy: Array, distance: Array, world: WorldConfig) -> Array:
    """How much of a velocity leads it nowhere near a robot that is seen, or that one in its shadow could be."""
    speed = jnp.sqrt(x * x + y * y + 1e-12)
    along = jnp.clip((x[:, None] * ux + y[:, None] * uy) / speed[:, None], -1.0, 1.0)
    # Discs no nearer than this one that overlap it in view are less than twice its own half-angle aside.
    aside = jnp.arccos(along) - 2 * jnp.arcsin(jnp.minimum(world.radius / distance, 1.0))
    approach = speed[:, None] * jnp.cos(jnp.maximum(aside, 0.0))
    return _shortest(approach, _room(distance, world))


def _shortest(approach: Array, room: Array) -> Array:
    """How much of a velocity leaves each of several approaches within its room."""
    share = jnp.where(approach > room, room / jnp.where(approach > room, approach, 1.0), 1.0)
    return jnp.min(share, axis=1, initial=1.0)
