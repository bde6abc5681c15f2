"""Gradient ascent: each robot climbs the objective of its own view, as if it alone could move.

The visible signal is a step function without a gradient. In its place every angular gap between two discs that is
smaller than a margin costs the square of what it lacks. Every distance below the safe one costs the square of what it
lacks too, since the root in the safety signal is infinitely steep where it begins.
"""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from murmurate.geometry._batch_last import sum_terms
from murmurate.policies.baselines.avoidance import SAFETY_FACTOR, LocalView, avoid_collisions, local_view, view_centroid
from murmurate.policies.baselines.base import Baseline
from murmurate.policies.baselines.circle import ring_radius
from murmurate.types import Observation
from murmurate.world.config import WorldConfig

__all__ = ["GradientAscent"]

GATHERING_SPEED = 0.15
"""Speed at which a robot gathers where nothing else moves it, in speed limits."""

DISTANT_WEIGHT = 0.2
"""Weight of being too far from the centre: gaps open at any size of the swarm, but walls are not seen."""

MAX_RADIUS = 3.0
"""Distance from the centre at which any gap can open, in radii of the smallest valid ring."""

VISIBLE_WEIGHT = 2.0
"""Weight of missing angular gaps, divided by the number of robots seen: a step then does not overshoot."""

SAFETY_WEIGHT = 0.15
"""Weight of missing distance."""

OPEN_GAP = 3.0
"""Angle between two centres from which on nothing is missing, in angles at which the two discs touch in view."""


@Baseline.register("gradient")
class GradientAscent(Baseline):
    """Climbs the gradient of gathering, safety and visibility in the robot's own position, and avoids collisions."""

    title: ClassVar[str] = "Gradient ascent"
    deviations: ClassVar[str] = (
        "The visible signal is replaced by squared hinges on the angular gaps between discs, and safety by squared "
        "hinges on distances; weights are the baseline's own."
    )
    # It goes on around its optimum with less.
    dead_zone: ClassVar[float] = 0.12
    damping: ClassVar[float] = 0.4

    def __call__(self, observation: Observation) -> Float[Array, "robots 2 *batch"]:
        """Returns velocities in each robot's own frame, world units per step."""
        view = local_view(observation.view, self.world)

        def total(mx: Array, my: Array) -> Array:
            return jnp.sum(_value(mx, my, view, self.world, self.landmark))

        still = jnp.zeros_like(view.landmark_x)
        x, y = jax.grad(total, (0, 1))(still, still)
        return avoid_collisions(x, y, view, self.world)


def _value(
    mx: Float[Array, "robots *batch"],
    my: Float[Array, "robots *batch"],
    view: LocalView,
    world: WorldConfig,
    landmark: bool,
) -> Float[Array, "robots *batch"]:
    """Returns each robot's value of moving by (mx, my) in its own frame while the robots that it sees stand still."""
    x, y = view.x - mx[:, None], view.y - my[:, None]
    distance = _norm(x, y)
    count = jnp.maximum(jnp.sum(view.seen, axis=1), 1)
    if landmark:
        far = _norm(view.landmark_x - mx, view.landmark_y - my, 0.5 * world.radius)
    else:
        far = jnp.sum(jnp.where(view.seen, distance, 0.0), axis=1) / count
    cx, cy = (view.landmark_x, view.landmark_y) if landmark else view_centroid(view)
    limit = MAX_RADIUS * ring_radius(count + 1, world)
    beyond = jnp.maximum(_norm(cx - mx, cy - my) - limit, 0.0) ** 2
    near = jnp.where(view.seen, jnp.maximum(1.1 * SAFETY_FACTOR * world.safe_distance - distance, 0.0) ** 2, 0.0)
    hidden = sum_terms(lambda i: (_missing_gaps(i, x, y, distance, view, world),), x.shape[1])[0]
    return world.max_speed * (
        -GATHERING_SPEED * far
        - DISTANT_WEIGHT * beyond
        - SAFETY_WEIGHT * jnp.sum(near, axis=1)
        - VISIBLE_WEIGHT * world.radius * hidden / count
    )


def _missing_gaps(i: int, x: Array, y: Array, distance: Array, view: LocalView, world: WorldConfig) -> Array:
    """Returns what is missing of the gaps between robot i and the others in view, and of those in the view of i."""
    other = view.seen & view.seen[:, i, None]
    other = other.at[:, i].set(False)
    ix, iy, far = x[:, i, None], y[:, i, None], distance[:, i, None]
    # In the robot's own view each pair occurs twice, once for each of its robots.
    deficit = _missing(x, y, distance, ix, iy, far, other, world) / 2
    jx, jy = x - ix, y - iy
    from_i = _missing(jx, jy, _norm(jx, jy), -ix, -iy, far, other, world)
    return jnp.sum(jnp.where(other, deficit + from_i, 0.0), axis=1)


def _missing(ax: Array, ay: Array, a: Array, bx: Array, by: Array, b: Array, other: Array, world: WorldConfig) -> Array:
    """Returns the square of the share that the angular gap between two discs lacks."""
    # Where there is no pair, an angle that has a gradient.
    ax, bx = jnp.where(other, ax, 1.0), jnp.where(other, bx, 1.0)
    gap = jnp.abs(jnp.arctan2(ax * by - ay * bx, ax * bx + ay * by))
    touching = world.radius / a + world.radius / b
    return jnp.maximum(OPEN_GAP - gap / touching, 0.0) ** 2


def _norm(x: Array, y: Array, soft: float = 1e-3) -> Array:
    """Returns the length of a vector, smoothed at 0 so that it has a gradient there."""
    return jnp.sqrt(x * x + y * y + soft**2)
