r"""When two configurations are the same pattern: alike up to moving, turning, relabelling, and scaling or mirroring.

Configurations are centred, and for `scaling` brought to a root mean square radius of 1. As complex numbers p and q
their distance is then

    d(p, q)^2 = min over angles a and relabellings s of the mean of |p_i - exp(ia) q_s(i)|^2,

with the mirror image of q tried as well for `reflection`. Moving, turning, relabelling and mirroring keep distances, so
d is a metric on patterns. It is found exactly, for symmetric patterns too: in any one direction the best relabelling is
a linear assignment, and few directions need be looked at (`_best`).

NumPy and SciPy, in float64: patterns are compared by the hundred, not by the million.
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

__all__ = ["Match", "align", "configuration", "distance", "lower_bound", "profile"]

ROUNDING = 1e-14
"""Differences of overlaps that are only rounding, relative to the sum of all products."""

Points = Float[np.ndarray, "robots 2"]


class Match(NamedTuple):
    """How one configuration is laid onto another.

    Attributes:
        distance: Root mean square distance of the robots laid onto each other.
        angle: By how much the second one is turned, after mirroring.
        mirrored: Whether it is mirrored (y to -y).
        order: Its robot for each robot of the first.
    """

    distance: float
    angle: float
    mirrored: bool
    order: Int[np.ndarray, " robots"]


def configuration(positions: Points) -> Points:
    """Returns a configuration in float64.

    Raises:
        InputError: It is no configuration of finite numbers.
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


def normalized(positions: Points, scaling: bool = True) -> Complex[np.ndarray, " robots"]:
    """Returns a configuration as complex numbers around its centroid, with unit root mean square radius for `scaling`.

    Raises:
        InputError: It is no configuration of finite numbers.
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
    """Measures how far two configurations are from being the same pattern.

    Args:
        first: Centres of the robots, world units.
        second: The other's; as many.
        scaling: Whether size does not matter; the distance is then in root mean square radii, else in world units.
        reflection: Whether mirror images are the same pattern.
        limit: The greatest distance of interest: the search for the best way ends once it is known to be beyond.

    Returns:
        The root mean square distance of the robots, laid onto each other in the best way; inf beyond the limit.

    Raises:
        InputError: The swarms differ in number, or a position is not finite.
    """
    p, q = _pair(first, second, scaling)
    found = _nearest(p, q, reflection, limit).distance
    return found if found <= limit else math.inf


def align(first: Points, second: Points, *, scaling: bool = True, reflection: bool = True) -> Match:
    """Finds the best way to lay one configuration onto another; see `distance`."""
    return _nearest(*_pair(first, second, scaling), reflection)


def lower_bound(first: Points, second: Points, *, scaling: bool = True) -> float:
    """Returns a number that `distance` is never below, from the robots' distances to the centroid alone: fast."""
    p, q = (np.sort(np.abs(z)) for z in _pair(first, second, scaling))
    return float(np.sqrt(np.mean((p - q) ** 2)))


def profile(positions: Points, *, scaling: bool = True) -> Float[np.ndarray, " robots"]:
    """Returns the robots' distances to the centroid in order: two root mean square apart by their `lower_bound`."""
    return np.sort(np.abs(normalized(positions, scaling)))


def _pair(first: Points, second: Points, scaling: bool) -> tuple[Any, Any]:
    p, q = normalized(first, scaling), normalized(second, scaling)
    if len(p) != len(q):
        raise InputError("second", f"{len(q)} robots", f"{len(p)} robots, as the first")
    return p, q


class _Arc(NamedTuple):
    """Directions between two in which the farthest overlaps are known; heapq takes the highest bound first."""

    minus_bound: float
    begin: float
    first: complex
    end: float
    second: complex


def _arc(begin: float, first: complex, end: float, second: complex) -> _Arc:
    """Bounds |c| between two directions: no c lies beyond the corner of the two supporting lines."""
    apart = cmath.exp(1j * (begin - end)).conjugate().imag
    heights = ((first * cmath.exp(-1j * begin)).real, (second * cmath.exp(-1j * end)).real)
    corner = 1j * (heights[0] * cmath.exp(1j * end) - heights[1] * cmath.exp(1j * begin)) / -apart
    return _Arc(-max(abs(corner), abs(first), abs(second)), begin, first, end, second)


def _nearest(p: Any, q: Any, reflection: bool, limit: float = math.inf) -> Match:
    """Lays q onto p, mirrored for `reflection` if that is better; not in the best way if that is beyond the limit."""
    match = _best(p, q, False, limit)
    if reflection:
        image = _best(p, q.conj(), True, min(limit, match.distance))
        match = min(match, image, key=lambda match: match.distance)
    return match


def _best(p: Any, q: Any, mirrored: bool, limit: float) -> Match:
    """Turns and relabels q so that it overlaps p best, or in any way if none brings it within the limit.

    A relabelling s overlaps by c(s) = mean of p_i conj(q_s(i)), best when q is turned by the argument of c(s): then by
    |c(s)|. A linear assignment finds the c(s) farthest in any one direction: a corner of the convex hull of all of
    them. The farthest from 0 is a corner as well, so corners are found between those that are known, first where
    their supporting lines leave room for the farthest.
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
