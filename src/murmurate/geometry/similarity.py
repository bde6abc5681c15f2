r"""Distance of two configurations as patterns: up to translation, rotation, relabelling, scaling and reflection.

Configurations are centred, and for `scaling` brought to a root mean square radius of 1. As complex numbers p and q
their distance is then

    d(p, q)^2 = min over angles a and relabellings s of the mean of |p_i - exp(ia) q_s(i)|^2,

with the mirror image of q tried as well for `reflection`. These operations keep distances, so d is a metric on
patterns. It is computed exactly, for symmetric patterns too: in any one direction the best relabelling is a linear
assignment, and few directions need to be examined (`_best`).

Configurations are compared one pair at a time, `(robots, 2)`, in float64 by NumPy and SciPy: patterns are compared by
the hundred, not by the million.
"""

from __future__ import annotations

import cmath
import heapq
import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.optimize import linear_sum_assignment

from murmurate.errors import InputError
from murmurate.representation import short_repr

__all__ = [
    "Match",
    "align",
    "configuration",
    "distance",
    "lower_bound",
    "neighborhood_bound",
    "neighborhoods",
    "profile",
]

ROUNDING = 1e-14
"""Differences of overlaps that count as rounding, relative to the sum of all products."""

Points = Float[np.ndarray, "robots 2"]


class Match(NamedTuple):
    """The best superposition of one configuration on another.

    Attributes:
        distance: Root mean square distance of the matched robots.
        angle: Rotation of the second configuration, after mirroring, radians.
        mirrored: Whether it is mirrored (y to -y).
        order: The robot of the second configuration that is matched with each robot of the first.
    """

    distance: float
    angle: float
    mirrored: bool
    order: Int[np.ndarray, " robots"]

    __repr__ = short_repr


def configuration(positions: Any) -> Points:
    """Returns one configuration, checked, in float64.

    Raises:
        InputError: The positions are not finite numbers of shape (robots, 2).
    """
    allowed = "finite numbers of shape (robots, 2)"
    try:
        points = np.asarray(positions)
    except ValueError:  # NumPy's error for rows of different lengths
        raise InputError("positions", type(positions).__name__, allowed) from None
    shaped = points.ndim == 2 and points.shape[1] == 2 and len(points) > 0
    if points.dtype.kind not in "iuf" or not shaped or not np.isfinite(points).all():
        raise InputError("positions", points.shape, allowed)
    return points.astype(float)


def normalized(positions: Any, scaling: bool = True) -> Complex[np.ndarray, " robots"]:
    """Returns a configuration as complex numbers around its centroid, with unit root mean square radius for `scaling`.

    Raises:
        InputError: The positions are not finite numbers of shape (robots, 2).
    """
    points = configuration(positions)
    # Scaled down before centring, so that huge coordinates do not overflow when squared.
    largest = np.abs(points).max() or 1.0
    z = (points[:, 0] + 1j * points[:, 1]) / largest
    z = z - z.mean()
    if not scaling:
        return z * largest
    radius = math.sqrt(np.mean(np.abs(z) ** 2))
    # Coincident robots have no size to be scaled to.
    return z / radius if radius > 1e-12 else np.zeros_like(z)


def distance(
    first: Points, second: Points, *, scaling: bool = True, reflection: bool = True, limit: float = math.inf
) -> float:
    """Returns the distance of two configurations as patterns; 0 for the same pattern.

    Args:
        first: Centres of the robots, world units.
        second: Centres of as many other robots, world units.
        scaling: Ignore size: the distance is then in root mean square radii, otherwise in world units.
        reflection: Count mirror images as the same pattern.
        limit: Greatest distance of interest: the search ends once the distance is known to be beyond it.

    Returns:
        The root mean square distance of the robots in the best superposition; inf beyond the limit.

    Raises:
        InputError: The swarms differ in number, or a position is not finite.
    """
    p, q = _pair(first, second, scaling)
    nearest = _nearest(p, q, reflection, limit).distance
    return nearest if nearest <= limit else math.inf


def align(first: Points, second: Points, *, scaling: bool = True, reflection: bool = True) -> Match:
    """Returns the best superposition of one configuration on another; for the arguments see `distance`."""
    return _nearest(*_pair(first, second, scaling), reflection)


def lower_bound(first: Points, second: Points, *, scaling: bool = True) -> float:
    """Returns a fast lower bound on `distance`, from the robots' distances to the centroid alone."""
    p, q = (np.sort(np.abs(z)) for z in _pair(first, second, scaling))
    return float(np.sqrt(np.mean((p - q) ** 2)))


def profile(positions: Points, *, scaling: bool = True) -> Float[np.ndarray, " robots"]:
    """Returns the sorted distances to the centroid; `lower_bound` is the root mean square difference of two."""
    return np.sort(np.abs(normalized(positions, scaling)))


def neighborhoods(positions: Points, *, scaling: bool = True) -> Float[np.ndarray, "robots robots"]:
    """Returns each robot's sorted distances to all robots, for `neighborhood_bound`."""
    z = normalized(positions, scaling)
    return np.sort(np.abs(z[:, None] - z[None]), axis=1)


def neighborhood_bound(first: Float[np.ndarray, "robots robots"], second: Float[np.ndarray, "robots robots"]) -> float:
    """Returns a lower bound on `distance` from the `neighborhoods` of two configurations, by one linear assignment.

    In the best superposition let e_i be the displacement of robot i; their mean is 0, so the mean of |e_i - e_j|^2 over
    all pairs is twice the square of the distance. Two robots' distance from each other changes by |e_i - e_j| at most,
    and sorting a row brings rows together, never apart.
    """
    squares = ((first[:, None] - second[None]) ** 2).sum(axis=2)
    rows, columns = linear_sum_assignment(squares)
    return math.sqrt(squares[rows, columns].sum() / 2) / len(first)


def _pair(first: Any, second: Any, scaling: bool) -> tuple[Any, Any]:
    p, q = normalized(first, scaling), normalized(second, scaling)
    if len(p) != len(q):
        raise InputError("second", f"{len(q)} robots", f"{len(p)} robots, as the first")
    return p, q


class _Arc(NamedTuple):
    """The directions between two for which the farthest overlaps are known; heapq takes the highest bound first."""

    minus_bound: float
    begin: float
    first: complex
    end: float
    second: complex


def _arc(begin: float, first: complex, end: float, second: complex) -> _Arc:
    """Returns the arc between two directions: no c between them lies beyond the corner of the two supporting lines."""
    apart = cmath.exp(1j * (begin - end)).conjugate().imag
    heights = ((first * cmath.exp(-1j * begin)).real, (second * cmath.exp(-1j * end)).real)
    corner = 1j * (heights[0] * cmath.exp(1j * end) - heights[1] * cmath.exp(1j * begin)) / -apart
    return _Arc(-max(abs(corner), abs(first), abs(second)), begin, first, end, second)


def _nearest(p: Any, q: Any, reflection: bool, limit: float = math.inf) -> Match:
    """Returns the best superposition of q on p, or any if the best is beyond the limit."""
    match = _best(p, q, False, limit)
    if reflection:
        image = _best(p, q.conj(), True, min(limit, match.distance))
        match = min(match, image, key=lambda match: match.distance)
    return match


def _best(p: Any, q: Any, mirrored: bool, limit: float) -> Match:
    """Returns the best rotation and relabelling of q on p, or any if the best is beyond the limit.

    A relabelling s has the overlap c(s) = mean of p_i conj(q_s(i)). It is best when q is rotated by the argument of
    c(s): the overlap is then |c(s)|. A linear assignment gives the c(s) farthest in any one direction, which is a
    corner of the convex hull of all c(s). The c(s) farthest from 0 is a corner as well. So further corners are computed
    between known ones, first where their supporting lines leave room for the farthest.
    """
    # |p - q|^2 = |p|^2 + |q|^2 - 2 |c|: a shorter c is beyond the limit.
    least = (np.mean(np.abs(p) ** 2) + np.mean(np.abs(q) ** 2) - limit**2) / 2
    products = p[:, None] * q.conj()[None] / len(p)
    tolerance = ROUNDING * float(np.abs(products).sum())
    best, order = 0j, np.arange(len(p))

    def farthest(direction: float) -> complex:
        nonlocal best, order
        rows, columns = linear_sum_assignment((products * cmath.exp(-1j * direction)).real, maximize=True)
        corner = complex(products[rows, columns].sum())
        if abs(corner) > abs(best):
            best, order = corner, columns
        return corner

    quarters = [(k * math.pi / 2, farthest(k * math.pi / 2)) for k in range(4)]
    ends = [*quarters[1:], (2 * math.pi, quarters[0][1])]
    queue = [_arc(*begin, *end) for begin, end in zip(quarters, ends, strict=True)]
    heapq.heapify(queue)
    while queue and -queue[0].minus_bound > max(abs(best) + tolerance, least - tolerance):
        _, begin, first, end, second = heapq.heappop(queue)
        chord = second - first
        if abs(chord) <= tolerance:
            continue
        # Perpendicular to the chord, outwards: between the two directions, because the hull is convex.
        direction = begin + (cmath.phase(-1j * chord) - begin) % (2 * math.pi)
        corner = farthest(direction)
        if ((corner - first) * cmath.exp(-1j * direction)).real > tolerance:
            heapq.heappush(queue, _arc(begin, first, direction, corner))
            heapq.heappush(queue, _arc(direction, corner, end, second))
    angle = cmath.phase(best)
    apart = np.abs(p - q[order] * cmath.exp(1j * angle))
    return Match(math.sqrt(np.mean(apart**2)), angle, mirrored, np.asarray(order))
