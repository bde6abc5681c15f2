"""The features of shadows in plain loops, from what they mean."""

from __future__ import annotations

from math import hypot, log

import numpy as np


def shadows(positions: np.ndarray, radius: float, tie: float) -> np.ndarray:
    """Sums the shadows of third robots on each line of sight, `(6, robots, robots)`.

    Args:
        positions: Centres, `(robots, 2)`, no two at one place.
        radius: Of the robots.
        tie: Logarithm of the ratio of two distances, and cosine, from which on a comparison is decided.
    """
    robots = len(positions)
    result = np.zeros((6, robots, robots))
    for k in range(robots):
        for i in range(robots):
            for j in range(robots):
                if len({i, j, k}) < 3:
                    continue
                (ix, iy), (jx, jy) = positions[i] - positions[k], positions[j] - positions[k]
                di, dj = hypot(ix, iy), hypot(jx, jy)
                offset = (ix * jy - iy * jx) / (di * dj) / (radius / di + radius / dj)
                bell = 1 / (1 + offset**2) ** 2
                cosine = (ix * jx + iy * jy) / (di * dj)
                ahead, behind = (min(max(sign * cosine / tie, 0.0), 1.0) for sign in (1, -1))
                nearer = min(max(0.5 + 0.5 * log(di / dj) / tie, 0.0), 1.0)
                for kind, share in enumerate((ahead * nearer, ahead * (1 - nearer), behind)):
                    result[2 * kind, k, i] += bell * share
                    result[2 * kind + 1, k, i] += bell * share * offset
    return result
