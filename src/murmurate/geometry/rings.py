"""Regular rings of robots: the smallest on which all see each other, or keep the safe distance."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from murmurate.errors import check_number
from murmurate.geometry._checks import check_length
from murmurate.representation import short_repr

__all__ = ["Ring", "safe_ring_radius", "smallest_ring", "smallest_ring_radius", "visible_ring_radius"]


class Ring(NamedTuple):
    """A regular ring of robots.

    Attributes:
        positions: Centres of the robots; the ring's centre is the origin.
        radius: Radius of the ring.
        visible: Least radius at which every robot sees every other.
        safe: Least radius at which neighbours on the ring keep the safe distance.
    """

    positions: Float[np.ndarray, "robots 2"]
    radius: float
    visible: float
    safe: float

    __repr__ = short_repr


def visible_ring_radius(robots: Any, radius: Any) -> Any:
    r"""Returns the least radius of a regular ring of N discs on which all see each other.

    From one robot the m-th next is seen at distance 2 r sin(m theta), theta = pi / N, at the angle m theta from the
    tangent. So successive robots are theta apart in view. The first two are the nearest, so they are the first to
    occlude one another: when asin(R / (2 r sin theta)) + asin(R / (2 r sin 2 theta)) = theta. These two angles and
    pi - theta are the angles of a triangle with sides in the ratio 1 / sin theta : 1 / sin 2 theta : c, which gives r.

    Args:
        robots: N: a number or an array, NumPy or JAX; fewer than two robots count as two.
        radius: The paper's R_bot.

    Returns:
        The radius of the ring; for two robots, which cannot be occluded, the radius at which they touch.
    """
    xp, count = _namespace(robots)
    theta = math.pi / xp.maximum(count, 3)
    first, second = xp.sin(theta), xp.sin(2 * theta)
    third = xp.sqrt(first**2 + second**2 + 2 * first * second * xp.cos(theta))
    return xp.where(count > 2, radius * third / (2 * first * second * first), radius)


def safe_ring_radius(robots: Any, safe_distance: Any) -> Any:
    """Returns the least radius of a regular ring on which neighbours are `safe_distance` apart.

    Args:
        robots: N: a number or an array, NumPy or JAX; fewer than two robots count as two.
        safe_distance: The paper's delta_s.
    """
    xp, count = _namespace(robots)
    return safe_distance / (2 * xp.sin(math.pi / xp.maximum(count, 2)))


def smallest_ring_radius(robots: Any, radius: Any, safe_distance: Any) -> Any:
    """Returns the least radius of a regular ring on which all see each other and keep the safe distance."""
    xp, _ = _namespace(robots)
    return xp.maximum(visible_ring_radius(robots, radius), safe_ring_radius(robots, safe_distance))


def smallest_ring(robots: int, radius: float, safe_distance: float) -> Ring:
    """Returns the smallest regular ring that is a valid pattern, where the world and the scan radius allow it.

    Args:
        robots: N >= 2.
        radius: The paper's R_bot, world units.
        safe_distance: The paper's delta_s, world units.

    Raises:
        InputError: There are fewer than two robots, or a length is not positive.
    """
    check_number("robots", robots, 2, integer=True)
    check_length("radius", radius)
    check_length("safe_distance", safe_distance)
    visible, safe = float(visible_ring_radius(robots, radius)), float(safe_ring_radius(robots, safe_distance))
    # Slightly wider than both, so that rounding breaks neither.
    wide = max(visible, safe) * (1 + 1e-12)
    angles = 2 * math.pi * np.arange(robots) / robots
    return Ring(wide * np.stack([np.cos(angles), np.sin(angles)], axis=1), wide, visible, safe)


def _namespace(robots: Any) -> tuple[Any, Any]:
    """Returns the array namespace and the number of robots as a floating-point array of it."""
    if not hasattr(robots, "__array_namespace__"):
        robots = np.asarray(robots, dtype=float)
    return robots.__array_namespace__(), robots
