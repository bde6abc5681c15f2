"""Each robot climbs the objective of its own view, as if it alone could move.

Deviation from the objective: the visible signal is a step, with no gradient anywhere. Here every angular gap between
two discs that is less than a margin costs the square of what it lacks. So does every distance that lacks something of
the safe one, since the safety signal's root is infinitely steep where it begins.
"""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from murmurate.policies.baselines.avoidance import KEEP, avoiding
from murmurate.policies.baselines.circle import least_ring
from murmurate.policies.baselines.sight import Sight, mean_of_seen, sight
from murmurate.policies.layers import fold
from murmurate.types import Observation
from murmurate.world.config import WorldConfig

__all__ = ["GradientAscent"]

GATHERING = 0.15
"""Speed at which a robot gathers where nothing else moves it, in speed limits."""

NEARER = 0.2
"""Weight of being too far from the middle: gaps open at any size, but walls are not seen."""

LARGEST = 3.0
"""Distance from the middle that is far enough for any gap to open, in radii of the least ring."""

VISIBLE = 2.0
"""Weight of a missing angular gap, shared among as many as are seen: a step goes downhill, not across the valley."""

SAFETY = 0.15
"""Weight of a missing distance."""

OPEN = 3.0
"""Angle between two centres at which nothing is missing, in angles at which the two discs touch in view."""


class GradientAscent(eqx.Module):
    """Climbs the gradient of gathering, safety and visibility over the robot's own place, clear of collisions."""

    title: ClassVar[str] = "Gradient ascent"
    centralised: ClassVar[bool] = False
    deviations: ClassVar[str] = (
        "The visible signal is replaced by squared hinges on the angular gaps between discs, and safety by squared "
        "hinges on distances; weights are the baseline's own."
    )
    world: WorldConfig = eqx.field(static=True)
    landmark: bool = eqx.field(static=True)

    def __call__(self, observation: Observation) -> Float[Array, "robots 2 *batch"]:
        """Returns velocities in each robot's own frame, world units per step."""
        seen = sight(observation.view, self.world)

        def total(mx: Array, my: Array) -> Array:
            return jnp.sum(_value(mx, my, seen, self.world, self.landmark))

        still = jnp.zeros_like(seen.point_x)
        x, y = jax.grad(total, (0, 1))(still, still)
        return avoiding(x, y, seen, self.world)


def _value(
    mx: Float[Array, "robots *batch"],
    my: Float[Array, "robots *batch"],
    seen: Sight,
    world: WorldConfig,
    landmark: bool,
) -> Float[Array, "robots *batch"]:
    """The value for each robot of standing somewhere near, in its own frame, those that it sees standing still."""
    x, y = seen.x - mx[:, None], seen.y - my[:, None]
    distance = _norm(x, y)
    count = jnp.maximum(jnp.sum(seen.seen, axis=1), 1)
    if landmark:
        far = _norm(seen.point_x - mx, seen.point_y - my, 0.5 * world.radius)
    else:
        far = jnp.sum(jnp.where(seen.seen, distance, 0.0), axis=1) / count
    cx, cy = (seen.point_x, seen.point_y) if landmark else mean_of_seen(seen)
    reach = LARGEST * least_ring(count + 1, world)
    beyond = jnp.maximum(_norm(cx - mx, cy - my) - reach, 0.0) ** 2
    near = jnp.where(seen.seen, jnp.maximum(1.1 * KEEP * world.safe_distance - distance, 0.0) ** 2, 0.0)
    crowded = fold(lambda i: (_crowding(i, x, y, distance, seen, world),), x.shape[1])[0]
    return world.max_speed * (
        -GATHERING * far - NEARER * beyond - SAFETY * jnp.sum(near, axis=1) - VISIBLE * world.radius * crowded / count
    )


def _crowding(i: int, x: Array, y: Array, distance: Array, seen: Sight, world: WorldConfig) -> Array:
    """What is missing of the gaps between robot i and each other one in view, and of those between both seen from i."""
    other = seen.seen & seen.seen[:, i, None]
    other = other.at[:, i].set(False)
    ix, iy, far = x[:, i, None], y[:, i, None], distance[:, i, None]
    # From here each pair is met twice, once by each of its robots.
    here = _missing(x, y, distance, ix, iy, far, other, world) / 2
    jx, jy = x - ix, y - iy
    there = _missing(jx, jy, _norm(jx, jy), -ix, -iy, far, other, world)
    return jnp.sum(jnp.where(other, here + there, 0.0), axis=1)


def _missing(ax: Array, ay: Array, a: Array, bx: Array, by: Array, b: Array, other: Array, world: WorldConfig) -> Array:
    """The square of the share that an angular gap between two discs lacks."""
    # Where there is no gap, no angle without a gradient either.
    ax, bx = jnp.where(other, ax, 1.0), jnp.where(other, bx, 1.0)
    gap = jnp.abs(jnp.arctan2(ax * by - ay * bx, ax * bx + ay * by))
    touching = world.radius / a + world.radius / b
    return jnp.maximum(OPEN - gap / touching, 0.0) ** 2


def _norm(x: Array, y: Array, soft: float = 1e-3) -> Array:
    """The length of a vector, rounded off at 0 so that it has a gradient there."""
    return jnp.sqrt(x * x + y * y + soft**2)
