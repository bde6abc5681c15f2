"""Random configurations of disjoint robots, dense and sparse, on which kernels and oracles are compared."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

BATCHES = {robots: 12 if robots <= 8 else 2 for robots in range(2, 17)}
"""Number of batches for each number of robots in a long comparison."""

LONG, SHORT = 1_000, 100
"""Configurations in a batch: 100,000 in all for a long comparison, 3,000 for a short one of two batches a size."""


class Scene(NamedTuple):
    """A batch of configurations, `(batch, robots, 2)`, with the radius of its robots and the side of its square."""

    positions: np.ndarray
    radius: float
    side: float


def disjoint(rng: np.random.Generator, batch: int, robots: int, radius: float, side: float) -> np.ndarray:
    """Draws centres uniformly in a square, each more than 2 R from every other.

    Args:
        rng: Where the randomness comes from.
        batch: How many configurations.
        robots: How many robots in each.
        radius: Of the robots, world units.
        side: Of the square around the origin, world units.

    Returns:
        Positions, `(batch, robots, 2)` float32: numbers that both precisions hold, so that both are asked the same.
    """
    positions = rng.uniform(-side / 2, side / 2, (batch, robots, 2)).astype(np.float32)
    unfinished = np.arange(batch)
    while unfinished.size:
        drawn = positions[unfinished].astype(np.float64)
        square = ((drawn[:, :, None] - drawn[:, None]) ** 2).sum(-1)
        # Of an overlapping pair the later robot is drawn again.
        clash = np.tril(square <= (2 * radius) ** 2, -1).any(-1)
        row, robot = np.nonzero(clash)
        positions[unfinished[row], robot] = rng.uniform(-side / 2, side / 2, (row.size, 2))
        unfinished = unfinished[clash.any(-1)]
    return positions


def scenes(robots: int, long: bool) -> Iterator[Scene]:
    """Yields batches of configurations of that many robots, crowded and scattered in turn."""
    batches, size = (BATCHES[robots], LONG) if long else (2, SHORT)
    rng = np.random.default_rng(robots)
    crowded = np.sqrt(2 * np.pi * robots)  # discs of radius 1 cover half of the square that holds their centres
    for batch in range(batches):
        radius, side = (1.0, crowded) if batch % 2 == 0 else (0.4, 70.0)
        yield Scene(disjoint(rng, size, robots, radius, side), radius, side)
