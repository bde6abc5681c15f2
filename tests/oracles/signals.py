"""The signals of one configuration in plain loops, from the design's definitions; visibility is shapely's."""

from __future__ import annotations

from math import hypot, sqrt

import numpy as np

from oracles import visibility


def signals(
    positions: np.ndarray,
    gathering: str,
    half_width: float,
    half_height: float,
    radius: float,
    scan_radius: float,
    safe_distance: float,
    safety: str,
) -> dict[str, float]:
    """Measures one configuration, `(robots, 2)`, of disjoint robots."""
    robots = len(positions)
    reach = sqrt(half_width**2 + half_height**2)
    pairs = [(i, j) for i in range(robots) for j in range(robots) if i != j]
    apart = {(i, j): hypot(*(positions[i] - positions[j])) for i, j in pairs}
    near = visibility.neighbors(positions, scan_radius)
    seen = near & ~visibility.occluded(positions, radius)
    if gathering == "close":
        gathered = 1 - sum(hypot(*p) for p in positions) / (robots * reach)
    else:
        gathered = 1 - sum(apart.values()) / len(pairs) / (2 * reach)
    if safety == "penalty":
        inside = sum(sqrt(max(0.0, safe_distance - d)) for d in apart.values())
        safe = 1 - inside / (robots * sqrt(safe_distance))
    else:
        safe = sum(shell(d, radius, safe_distance) for d in apart.values())
        safe /= len(pairs) * sqrt(safe_distance + radius)
    return {
        gathering: gathered,
        "safety": safe,
        "neighbors": np.mean([sum(row) for row in near]) / (robots - 1),
        "visible": np.mean([sum(row) for row in seen]) / (robots - 1),
    }


def shell(distance: float, radius: float, safe_distance: float) -> float:
    """The printed F_safe of a pair, its radicand floored at zero."""
    excess = distance - safe_distance
    return sqrt(max(0.0, safe_distance + radius - excess)) if excess >= 0 else 0.0
