"""Kernels, batch last: convex hulls, by which robots have all others on one side of a line through them.

SciPy's ConvexHull does not serve here: it takes one configuration at a time, refuses robots on a line, and leaves out
robots on an edge of the hull, which count as being on the hull.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from jaxtyping import Bool, Float

from murmurate.geometry._batch_last.loops import sum_terms
from murmurate.geometry._batch_last.visibility import Array, as_floating, fold, offsets

__all__ = ["hull_neighbors", "hull_shares", "on_hull"]

SAME_DIRECTION = 1e-6
"""Sine of the angle within which two robots lie in the same direction: positions are recorded in float32."""

COINCIDENT = 1e-9
"""Robots nearer than this share of the swarm's greatest distance have no direction from each other."""


def hull_neighbors(
    ux: Float[Array, "observers robots *batch"],
    uy: Float[Array, "observers robots *batch"],
    seen: Bool[Array, "observers robots *batch"],
) -> tuple[Any, Any]:
    """Returns the robots next to each observer on the convex hull of itself and the robots that it sees.

    Args:
        ux: x of the unit vectors from each observer to the robots that it sees; 0 for the others.
        uy: y of them.
        seen: Which robots each observer sees.

    Returns:
        Which of the robots seen have none to their left, and which have none to their right, `(observers, robots,
        *batch)`. An observer inside the hull has neither; several robots in one direction are all marked.
    """
    last, first = hull_shares(ux, uy, seen, lambda sine: sine > SAME_DIRECTION)
    return last > 0, first > 0


def hull_shares(
    ux: Float[Array, "observers robots *batch"],
    uy: Float[Array, "observers robots *batch"],
    seen: Bool[Array, "observers robots *batch"],
    beside: Callable[[Any], Any],
) -> tuple[Any, Any]:
    """Returns `hull_neighbors` as numbers from 0 to 1, for a notion of beside that may be continuous.

    Args:
        ux: x of the unit vectors from each observer to the robots that it sees; 0 for the others.
        uy: y of them.
        seen: Which robots each observer sees.
        beside: Says how much a robot is to the left of a direction, from 0 to 1, by the sine of the angle between.
    """
    xp, dtype = ux.__array_namespace__(), ux.dtype

    def sides(j: int) -> tuple[Any, Any]:
        sine = ux * uy[:, j, None] - uy * ux[:, j, None]
        return xp.astype(beside(sine), dtype), xp.astype(beside(-sine), dtype)

    left, right = sum_terms(sides, ux.shape[1])
    last, first = (xp.where(seen, xp.maximum(1 - total, xp.zeros_like(total)), 0) for total in (left, right))
    return last, first


def on_hull(positions: Float[Array, "robots 2 *batch"]) -> Bool[Array, "robots *batch"]:
    """Returns which robots are on the convex hull; those on an edge of it are."""
    xp, positions = as_floating(positions)
    dx, dy, distance = offsets(xp, positions)
    apart = distance > COINCIDENT * fold(xp.maximum, fold(xp.maximum, distance))[None, None]
    safe = xp.where(apart, distance, 1)
    ux, uy = (xp.where(apart, d / safe, 0) for d in (dx, dy))
    leftmost, _ = hull_neighbors(ux, uy, apart)
    # All robots at one place are a hull of one point.
    return xp.any(leftmost, axis=1) | ~xp.any(apart, axis=1)
