"""Random configurations of disjoint robots, dense and sparse: what kernels and oracles are compared on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

# How many configurations of each number of robots make up a comparison: 100,000 in all.
CONFIGURATIONS = {robots: 12_000 if robots <= 8 else 2_000 for robots in range(2, 17)}
BATCH = 1_000


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


def scenes(robots: int) -> Iterator[Scene]:
    """Yields the configurations of that many robots, a batch crowded and a batch scattered in turn."""
    rng = np.random.default_rng(robots)
    crowded = np.sqrt(2 * np.pi * robots)  # discs of radius 1 cover half of the square that holds their centres
    for batch in range(CONFIGURATIONS[robots] // BATCH):
        radius, side = (1.0, crowded) if batch % 2 == 0 else (0.4, 70.0)
        yield Scene(disjoint(rng, BATCH, robots, radius, side), radius, side)
