r"""Bounds on the objective of valid patterns, from packing.

In a valid pattern all pairs are at least the safe distance delta apart. A disc of radius r holds at most

    (2 pi / sqrt 3) (r / delta)^2 + pi (r / delta) + 1

points that are pairwise at least delta apart (Oler's inequality, 1961, for a disc). So in any pattern the k-th nearest
robot to any point is at least `packing_radius(k)` safe distances away from it.
"""

from __future__ import annotations

import math

import numpy as np

from murmurate.analysis.optimum.formation import Target

__all__ = ["PROVED", "min_mean_distance", "packing_radius", "upper_bound"]

PROVED = {("C1", 2), ("C1", 3), ("C2", 2), ("C2", 3)}
"""Objectives and swarm sizes whose best-known pattern is proved to be the best; see docs/patterns.md."""


def packing_radius(count: int) -> float:
    """Returns a lower bound on the radius, in safe distances, of a disc that holds `count` points one of them apart."""
    a, b, c = 2 * math.pi / math.sqrt(3), math.pi, 1.0 - count
    return (-b + math.sqrt(b * b - 4 * a * c)) / (2 * a)


def min_mean_distance(objective: str, robots: int) -> float:
    """Returns a lower bound on a valid pattern's mean distance from the origin (C1) or mean pair distance (C2).

    Args:
        objective: C1 or C2.
        robots: N >= 2.

    Returns:
        The bound in safe distances, by packing alone, without visibility; exact for up to three robots.
    """
    if objective == "C2":
        # The disc around a robot that reaches to its m-th nearest other one holds m + 1 points.
        return float(np.mean([max(1.0, packing_radius(count)) for count in range(2, robots + 1)]))
    if robots <= 3:
        # Two: the origin between them. Three: the equilateral triangle's Fermat point (docs/patterns.md).
        return {2: 1 / 2, 3: 1 / math.sqrt(3)}[robots]
    return float(np.mean([packing_radius(count) for count in range(1, robots + 1)]))


def upper_bound(target: Target) -> float:
    """Returns an upper bound on the objective of valid patterns: packing bounds gathering, the other signals are 1."""
    world = target.world
    scale = math.hypot(world.half_width, world.half_height) * (1 if target.gathering == "close" else 2)
    gathered = 1 - min_mean_distance(target.objective, world.robots) * world.safe_distance / scale
    return target.weight("gathering") * gathered + sum(map(target.weight, ("safety", "neighbors", "visible")))
