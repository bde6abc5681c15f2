"""Exactly symmetric starts, the hardest for robots that are all alike: nothing tells one from its mirror image.

A deterministic policy that depends on nothing but what is seen keeps every symmetry that all robots share. What breaks
it is rounding, noise, a scheduler that moves some robots and not others, or frames without a common handedness.
"""

from __future__ import annotations

import math
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from murmurate.errors import InputError, check_choice
from murmurate.world.config import WorldConfig

__all__ = ["Family", "family", "symmetric_starts"]

Family = Literal["polygon", "line", "grid", "rings"]

CLOSEST, WIDEST = 1.5, 0.8
"""Neighbours begin at least so many diameters apart, and nobody farther out than this share of the way to the wall."""


def family(name: Family, robots: int) -> Float[np.ndarray, "robots 2"]:
    """Places robots symmetrically, the middle at the origin and nearest neighbours 1 apart.

    Args:
        name: polygon (a regular one), line (evenly spaced), grid (as square as it can be, full rows but for the last,
            which is centred) or rings (two regular polygons, one inside the other, and one robot in the middle where
            the number is odd).
        robots: Number of robots.

    Raises:
        InputError: There is no such family, or too few robots for it.
    """
    check_choice("family", name, get_args(Family))
    if robots < 2 or (name == "rings" and robots < 4):
        raise InputError("robots", robots, f"at least {4 if name == 'rings' else 2} for the start {name}")
    if name == "line":
        points = np.stack([np.arange(robots, dtype=float), np.zeros(robots)], axis=1)
    elif name == "grid":
        across = math.ceil(math.sqrt(robots))
        rows = [min(across, robots - first) for first in range(0, robots, across)]
        points = np.array([[i - (n - 1) / 2, row] for row, n in enumerate(rows) for i in range(n)])
    elif name == "rings":
        inner = _polygon(robots // 2)
        points = np.concatenate([inner, 2 * inner, np.zeros((robots % 2, 2))])
    else:
        points = _polygon(robots)
    points = points - (points.max(axis=0) + points.min(axis=0)) / 2 if name in ("line", "grid") else points
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    return points / apart[~np.eye(robots, dtype=bool)].min()


def symmetric_starts(
    name: Family, world: WorldConfig, count: int, seed: int = 0
) -> Float[np.ndarray, "starts robots 2"]:
    """Draws starts of a family, each of a size and a direction of its own around the origin.

    Raises:
        InputError: There is no such family, or no room for it in the world.
    """
    points = family(name, world.robots)
    reach = np.linalg.norm(points, axis=1).max()
    low, high = CLOSEST * 2 * world.radius, WIDEST * min(world.half_width, world.half_height) / reach
    if low > high:
        raise InputError("robots", world.robots, f"few enough to fit the start {name}")
    rng = np.random.default_rng(seed)
    size, angle = rng.uniform(low, high, count), rng.uniform(0, 2 * np.pi, count)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.einsum("s,rc,cds->srd", size, points, turn)


def _polygon(corners: int) -> Float[np.ndarray, "corners 2"]:
    angle = 2 * np.pi * np.arange(corners) / corners
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)
