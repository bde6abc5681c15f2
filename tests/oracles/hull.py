"""Float64 twin of the hull that robots see: by the angles at which they see others, sorted."""

from __future__ import annotations

import numpy as np


def corner(points: np.ndarray) -> tuple[int, int, float] | None:
    """Returns between which points a robot at the origin is a corner of the hull of itself and them.

    Args:
        points: Where the others are, in general position: no two in one direction.

    Returns:
        The point that nobody is to the left of, the one that nobody is to the right of, and how far the origin stands
        out from the line through both; None inside.
    """
    order = np.argsort(np.arctan2(points[:, 1], points[:, 0]))
    angle = np.arctan2(points[order, 1], points[order, 0])
    gaps = np.diff(np.append(angle, angle[0] + 2 * np.pi))
    widest = int(np.argmax(gaps))
    if gaps[widest] <= np.pi:
        return None
    last, first = order[widest], order[(widest + 1) % len(order)]
    a, b = points[last], points[first]
    width = np.linalg.norm(b - a)
    bulge = abs(a[0] * b[1] - a[1] * b[0]) / width if width > 0 else 0.0
    return int(last), int(first), float(bulge)


def widest_gap(points: np.ndarray) -> tuple[float, float, float]:
    """Returns the mean direction and the mean width of the gaps around the origin, weighted by their sixth power.

    Args:
        points: Where the others are; at least one.
    """
    angles = sorted(float(np.arctan2(y, x)) for x, y in points)
    gaps = [b - a for a, b in zip(angles, [*angles[1:], angles[0] + 2 * np.pi], strict=True)]
    weights = [gap**6 for gap in gaps]
    middles = [a + gap / 2 for a, gap in zip(angles, gaps, strict=True)]
    values = ([np.cos(m) for m in middles], [np.sin(m) for m in middles], [gap / np.pi - 1 for gap in gaps])
    x, y, width = (float(np.dot(weights, v) / np.sum(weights)) for v in values)
    return x, y, width
