r"""What can be proved about formations: regular rings in closed form, and bounds from packing.

All bounds are on valid patterns: pairs at least the safe distance delta apart. A disc of radius r holds at most

    (2 pi / sqrt 3) (r / delta)^2 + pi (r / delta) + 1

points that are pairwise at least delta apart (Oler's inequality, 1961, for a disc). So the k-th nearest robot to any
point is at least `crowding(k)` safe distances away from it, whatever the formation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from murmurate.analysis.optimum.formation import Target

__all__ = ["PROVED", "Ring", "crowding", "least_gathering", "ring", "ring_radius", "upper_bound"]

PROVED = {("C1", 2), ("C1", 3), ("C2", 2), ("C2", 3)}
"""Where the best-known pattern is proved to be the best: see docs/patterns.md."""


class Ring(NamedTuple):
    """A regular ring of robots.

    Attributes:
        positions: Centres, the ring's centre at the origin.
        radius: Of the ring.
        sight: Least radius at which every robot sees every other.
        safe: Least radius at which neighbours on the ring are the safe distance apart.
    """

    positions: Float[np.ndarray, "robots 2"]
    radius: float
    sight: float
    safe: float


def ring_radius(robots: int, radius: float) -> float:
    r"""Returns the least radius of a regular ring of N discs on which everyone sees everyone.

    From one robot, the m-th next is seen at angle m theta, theta = pi / N, from the tangent, at distance 2 r sin(m
    theta): next ones are theta apart, whoever they are. The first two are the nearest, so they are the first to hide
    one another: when asin(R / (2 r sin theta)) + asin(R / (2 r sin 2 theta)) = theta. These two angles and pi - theta
    are the angles of a triangle with sides in the ratio 1 / sin theta : 1 / sin 2 theta : c, which gives r.

    Args:
        robots: N >= 2.
        radius: The paper's R_bot.

    Returns:
        The radius of the ring; for two robots, who cannot hide from each other, that at which they touch.
    """
    if robots == 2:
        return radius
    theta = math.pi / robots
    first, second = math.sin(theta), math.sin(2 * theta)
    third = math.sqrt(first**2 + second**2 + 2 * first * second * math.cos(theta))
    return radius * third / (2 * first * second * math.sin(theta))


def ring(robots: int, radius: float, safe_distance: float) -> Ring:
    """Returns the smallest regular ring that is a valid pattern (where the world and the scan radius allow it).

    Args:
        robots: N >= 2.
        radius: The paper's R_bot.
        safe_distance: The paper's delta_s.
    """
    sight, safe = ring_radius(robots, radius), safe_distance / (2 * math.sin(math.pi / robots))
    # A hair wider than both, so that rounding breaks neither.
    wide = max(sight, safe) * (1 + 1e-12)
    angles = 2 * math.pi * np.arange(robots) / robots
    return Ring(wide * np.stack([np.cos(angles), np.sin(angles)], axis=1), wide, sight, safe)


def crowding(count: int) -> float:
    """Returns the least radius, in safe distances, of a disc that may hold `count` points one safe distance apart."""
    a, b, c = 2 * math.pi / math.sqrt(3), math.pi, 1.0 - count
    return (-b + math.sqrt(b * b - 4 * a * c)) / (2 * a)


def least_gathering(objective: str, robots: int) -> float:
    """Returns a lower bound on a valid pattern's mean distance from the origin (C1) or mean pair distance (C2).

    Args:
        objective: C1 or C2.
        robots: N >= 2.

    Returns:
        The bound in safe distances: crowding alone, nothing of visibility; exact for up to three robots.
    """
    if objective == "C2":
        # Seen from each robot: the m-th nearest other makes m + 1 points in the disc around it.
        return float(np.mean([max(1.0, crowding(count)) for count in range(2, robots + 1)]))
    if robots <= 3:
        # Two: the origin between them. Three: the equilateral triangle's Fermat point (docs/patterns.md).
        return {2: 1 / 2, 3: 1 / math.sqrt(3)}[robots]
    return float(np.mean([crowding(count) for count in range(1, robots + 1)]))


def upper_bound(target: Target) -> float:
    """Returns what no valid pattern's objective can exceed: packing bounds gathering, the other signals are 1."""
    world = target.world
    reach = math.hypot(world.half_width, world.half_height) * (1 if target.gathering == "close" else 2)
    gathered = 1 - least_gathering(target.objective, world.robots) * world.safe_distance / reach
    return target.weight("gathering") * gathered + sum(map(target.weight, ("safety", "neighbors", "visible")))
