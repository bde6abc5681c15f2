"""The smooth signals of one configuration in plain loops over robots, from their definitions."""

from __future__ import annotations

from math import acos, asin, atan2, cos, hypot, log1p, pi, sin, tan

import numpy as np


def smooth_visible(positions: np.ndarray, radius: float, margin: float, softness: float = 0.03) -> float:
    """The swarm's share: the logarithm of how much of the others the nearer ones hide or nearly hide, on average."""
    robots, hidden = len(positions), 0.0
    for k in range(robots):
        for i in range(robots):
            total = 0.0
            for j in range(robots):
                if len({i, j, k}) < 3:
                    continue
                lack = _lack(positions[i] - positions[k], positions[j] - positions[k], radius, margin)
                total += lack**2 / (lack + softness)
            hidden += total / (1 + total) / robots
    return 1 - log1p(10 / 3 * hidden) / log1p(10 / 3 * (robots - 1))


def smooth_safety(positions: np.ndarray, safe_distance: float, margin: float) -> list[float]:
    """Each robot's share: the squares of what lacks to the safe distance and its margin."""
    others = [(i, j) for i in range(len(positions)) for j in range(len(positions)) if i != j]
    lack = {pair: 1 + margin - hypot(*(positions[pair[0]] - positions[pair[1]])) / safe_distance for pair in others}
    return [1 - sum(max(0.0, lack[k, i]) ** 2 for k, i in others if k == n) for n in range(len(positions))]


def soft_safety(positions: np.ndarray, safe_distance: float, margin: float, softness: float) -> list[float]:
    """Each robot's share: what lacks to the safe distance and its margin, by its square below the softness."""
    shares = []
    for k, p in enumerate(positions):
        lacks = [1 + margin - hypot(*(p - q)) / safe_distance for i, q in enumerate(positions) if i != k]
        shares.append(1 - sum(lack**2 / (lack + softness) for lack in lacks if lack > 0))
    return shares


def smooth_neighbors(positions: np.ndarray, scan_radius: float, softness: float) -> list[float]:
    """Each robot's share: how far others are beyond the scan radius, by its square below the softness."""
    shares = []
    for k, p in enumerate(positions):
        beyond = [hypot(*(p - q)) / scan_radius - 1 for i, q in enumerate(positions) if i != k]
        shares.append(1 - sum(excess**2 / (excess + softness) for excess in beyond if excess > 0))
    return shares


def compact(positions: np.ndarray, ring_radius: float) -> list[float]:
    """Each robot's share: its mean distance, in that of a robot on the smallest ring."""
    robots = len(positions)
    on_ring = sum(2 * ring_radius * sin(pi * m / robots) for m in range(1, robots))
    assert abs(on_ring - 2 * ring_radius / tan(pi / (2 * robots))) < 1e-9 * on_ring
    return [2 - sum(hypot(*(p - q)) for q in positions) / on_ring for p in positions]


def exposed(positions: np.ndarray, margin: float) -> list[float]:
    """Each robot's share: the widest empty angle around it, up to a half turn and a margin."""
    shares = []
    for k, p in enumerate(positions):
        angles = sorted(atan2(*(q - p)[::-1]) for i, q in enumerate(positions) if i != k)
        gaps = [b - a for a, b in zip(angles, [*angles[1:], angles[0] + 2 * pi], strict=True)]
        shares.append(1 - max(0.0, 1 + margin - max(gaps) / pi))
    return shares


def convex(positions: np.ndarray, ring_radius: float) -> list[float]:
    """Each robot's share: the least distance by which the others reach beyond it, over evenly spaced directions."""
    count, shares = max(64, 4 * len(positions)), []
    for k, p in enumerate(positions):
        others = [q - p for i, q in enumerate(positions) if i != k]
        turns = [2 * pi * turn / count for turn in range(count)]
        depth = min(max(x * cos(turn) + y * sin(turn) for x, y in others) for turn in turns)
        shares.append(1 - max(0.0, depth) / ring_radius)
    return shares


def occluders(positions: np.ndarray, radius: float, ring_radius: float, margin: float) -> list[float]:
    """Each robot's share: its depth inside the hull, by how much of the others it hides from others."""
    shares = []
    for j, depth in enumerate(1 - share for share in convex(positions, ring_radius)):
        hidden = 0.0
        for k in range(len(positions)):
            for i in range(len(positions)):
                if len({i, j, k}) == 3:
                    lack = _lack(positions[i] - positions[k], positions[j] - positions[k], radius, margin)
                    hidden += lack**2 / (lack + 0.03)
        shares.append(1 - depth * hidden / (0.03 + hidden))
    return shares


def _lack(to_i: np.ndarray, to_j: np.ndarray, radius: float, margin: float) -> float:
    """Of a line of sight to i: how much of the room is missing with which it should pass j, if j is nearer."""
    far, near = hypot(*to_i), hypot(*to_j)
    if near >= far:
        return 0.0
    angle = acos(max(-1.0, min(1.0, float(to_i @ to_j) / (far * near))))
    wide = (1 + margin) * (asin(radius / far) + asin(radius / near))
    return max(0.0, 1 - sin(angle / 2) / sin(wide / 2))
