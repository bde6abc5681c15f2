r"""Kernels, batch last: which robots are neighbours, occluded and visible in swarms of fat, opaque robots.

Seen from the centre of robot k, the disc of robot i (radius R, centre at distance d) covers the open angular interval
[theta - alpha, theta + alpha], sin(alpha) = R / d. Robot j occludes i exactly when j is nearer to k than i is and their
intervals overlap: the angle gamma between the two centres is below A = alpha_i + alpha_j. With gamma and A both in
[0, pi] that is sin(A - gamma) > 0, which needs no inverse trigonometry and loses no digits near tangency.

Where discs overlap (no collision-free run gets there) the same formulas hold with sin(alpha) = min(1, R / d): a disc
over the observer's centre covers half of its view. A disc with the same centre has no direction and occludes none.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from murmurate.geometry._batch_last.loops import fori_loop, scatter, sum_terms
from murmurate.geometry._batch_last.sweep import AngularInterval, overlap, sweep

__all__ = [
    "MAX_PAIRWISE_ROBOTS",
    "angular_intervals",
    "as_floating",
    "fold",
    "neighbors",
    "neighbors_and_visible",
    "occluded",
    "occluded_pairwise",
    "off_diagonal",
    "offsets",
    "sole_occluder_counts",
    "stands_between",
    "visible",
]

MAX_PAIRWISE_ROBOTS = 48
"""The largest swarm in which every robot is tested against every other as an occluder; larger ones are swept.

Compiled in float32 for two cores, the pairwise test is 4 times faster at 48 robots. Beyond about 50 robots XLA no
longer fuses it, and the sweep is 2.5 times faster at 56 robots in a batch of 256, 3 times at 64. For a single
configuration the sweep is slower up to 170 robots, by less than half a millisecond.
"""

Array = Any  # a NumPy or a JAX array: the kernels use only what both have
Scalar = Any  # a number, or a traced array without axes


def as_floating(positions: Any) -> tuple[Any, Any]:
    """Returns the array namespace and the positions as a floating-point array of it."""
    if not hasattr(positions, "__array_namespace__"):
        positions = np.asarray(positions)
    xp = positions.__array_namespace__()
    if not xp.isdtype(positions.dtype, "real floating"):
        positions = positions.astype(float)
    return xp, positions


def offsets(xp: Any, positions: Float[Array, "robots 2 *batch"]) -> tuple[Any, Any, Any]:
    """Returns dx, dy and the distance from each observer (row) to each observed robot (column)."""
    dx = positions[None, :, 0] - positions[:, None, 0]
    dy = positions[None, :, 1] - positions[:, None, 1]
    return dx, dy, xp.sqrt(dx * dx + dy * dy)


def off_diagonal(xp: Any, like: Any) -> Bool[Array, "robots robots *ones"]:
    """Returns True off the diagonal, with as many trailing axes of length 1 as `like` has batch axes."""
    robots = like.shape[0]
    return xp.reshape(~xp.eye(robots, dtype=bool), (robots, robots) + (1,) * (like.ndim - 2))


def fold(combine: Callable[[Any, Any], Any], array: Any, axis: int = 0) -> Any:
    """Reduces an axis by combining its slices one after another.

    XLA's CPU backend does not vectorise a reduction over a leading axis once what makes its operand is fused into it.
    Combining slices it does vectorise, along the batch: up to 15 times faster for a swarm of ten. A long axis is folded
    onto itself first, since a program grows with the slices that it combines.
    """
    before = (slice(None),) * axis
    while isinstance(length := array.shape[axis], int) and length > MAX_PAIRWISE_ROBOTS:
        half = length // 2
        rest = array[(*before, slice(2 * half, length))]
        array = combine(array[(*before, slice(half))], array[(*before, slice(half, 2 * half))])
        if length % 2:
            array = rest.__array_namespace__().concat([array, rest], axis=axis)
    return functools.reduce(combine, (array[(*before, index)] for index in range(array.shape[axis])))


def neighbors(positions: Float[Array, "robots 2 *batch"], scan_radius: Scalar) -> Bool[Array, "robots robots *batch"]:
    """Returns which robots (column) are neighbours of which (row); False on the diagonal."""
    xp, positions = as_floating(positions)
    _, _, distance = offsets(xp, positions)
    return (distance <= scan_radius) & off_diagonal(xp, distance)


def occluded(positions: Float[Array, "robots 2 *batch"], radius: Scalar) -> Bool[Array, "robots robots *batch"]:
    """Returns which robots (column) are occluded from which (row) by any third robot; False on the diagonal."""
    xp, positions = as_floating(positions)
    dx, dy, distance = offsets(xp, positions)
    return _occluded(xp, dx, dy, distance, radius)


def visible(
    positions: Float[Array, "robots 2 *batch"], radius: Scalar, scan_radius: Scalar
) -> Bool[Array, "robots robots *batch"]:
    """Returns which robots (column) are visible neighbours of which (row); False on the diagonal."""
    return neighbors_and_visible(positions, radius, scan_radius)[1]


def neighbors_and_visible(
    positions: Float[Array, "robots 2 *batch"], radius: Scalar, scan_radius: Scalar
) -> tuple[Bool[Array, "robots robots *batch"], Bool[Array, "robots robots *batch"]]:
    """Returns `neighbors` and `visible` from one pass over the pairs."""
    xp, positions = as_floating(positions)
    dx, dy, distance = offsets(xp, positions)
    near = (distance <= scan_radius) & off_diagonal(xp, distance)
    return near, near & ~_occluded(xp, dx, dy, distance, radius)


def angular_intervals(xp: Any, dx: Any, dy: Any, distance: Any, radius: Scalar) -> AngularInterval:
    """Returns the interval that each robot (column) covers in the view of each observer (row)."""
    # A robot does not see itself: at an infinite distance it is never the nearer of a pair.
    apparent = xp.where(off_diagonal(xp, distance), distance, xp.inf)
    return _interval(xp, dx, dy, distance, radius)._replace(distance=apparent)


def _interval(xp: Any, dx: Any, dy: Any, distance: Any, radius: Any) -> AngularInterval:
    safe = xp.where(distance > 0, distance, 1)
    sin = xp.where(distance > radius, radius / safe, 1)
    return AngularInterval(dx / safe, dy / safe, sin, xp.sqrt((1 - sin) * (1 + sin)), distance)


def _occluded(xp: Any, dx: Any, dy: Any, distance: Any, radius: Scalar) -> Any:
    intervals, robots = angular_intervals(xp, dx, dy, distance, radius), distance.shape[0]
    # In a program for swarms of any size the number of robots is a symbol, over which no loop can be unrolled.
    if not isinstance(robots, int):
        return xp.any(_occlusion_by(xp, intervals)(slice(None)), axis=1)
    return sweep(xp, intervals) if robots > MAX_PAIRWISE_ROBOTS else occluded_pairwise(xp, intervals)


def occluded_pairwise(xp: Any, intervals: AngularInterval) -> Any:
    """Returns which robots are occluded by testing every robot as an occluder; `sweep` gives the same answer."""
    # One occluder after another instead of a reduction over a third axis: no N^3 array, and XLA's CPU backend
    # vectorises this along the batch, which it does not do for a reduction over a middle axis.
    return functools.reduce(operator.or_, map(_occlusion_by(xp, intervals), range(intervals.distance.shape[0])))


def _occlusion_by(xp: Any, intervals: AngularInterval) -> Callable[[Any], Any]:
    """Returns the function of j that returns which robots i (column) robot j occludes from observer k (row).

    With `slice(None)` in place of a number it answers for every j at once, on an axis between these two.
    """
    other = off_diagonal(xp, intervals.distance)

    def occluded_by(j: Any) -> Any:
        occluder = AngularInterval(*(a[:, j, None] for a in intervals))
        if isinstance(j, slice):
            return overlap(xp, AngularInterval(*(a[:, None] for a in intervals)), occluder) & other[:, None]
        return overlap(xp, intervals, occluder) & other

    return occluded_by


def stands_between(
    x: Float[Array, "observers robots *batch"],
    y: Float[Array, "observers robots *batch"],
    seen: Bool[Array, "observers robots *batch"],
    radius: Float[Array, "observers *batch"],
) -> Bool[Array, "observers *batch"]:
    """Returns which observers occlude, for a robot that they see, another one that they see.

    That they know from their own view: both positions are in it.

    Args:
        x: First coordinate of each robot relative to each observer.
        y: Second coordinate.
        seen: Which robots are seen.
        radius: The robots' radius in each observer's unit of length.
    """
    xp = x.__array_namespace__()

    def interval(dx: Any, dy: Any) -> AngularInterval:
        return _interval(xp, dx, dy, xp.sqrt(dx * dx + dy * dy), radius[:, None])

    def occluded_for(j: int) -> tuple[Any]:
        xj, yj = x[:, j, None], y[:, j, None]
        occluded = overlap(xp, interval(x - xj, y - yj), interval(-xj, -yj))
        return (xp.sum(occluded & seen & seen[:, j, None], axis=1, dtype=np.int32),)

    return sum_terms(occluded_for, x.shape[1])[0] > 0


def sole_occluder_counts(
    positions: Float[Array, "robots 2 *batch"], radius: Scalar, scan_radius: Scalar
) -> Float[Array, "robots *batch"]:
    """Returns for each robot how many ordered pairs of neighbours it alone occludes from each other."""
    xp, positions = as_floating(positions)
    dx, dy, distance = offsets(xp, positions)
    intervals = angular_intervals(xp, dx, dy, distance, radius)
    few = distance.shape[0] <= MAX_PAIRWISE_ROBOTS
    occluder = (_sole_occluder if few else _sole_occluder_in_loop)(xp, intervals)
    occluder = xp.where(distance <= scan_radius, occluder, -1)
    return xp.astype((_frequencies if few else _frequencies_by_scatter)(xp, occluder), positions.dtype)


def _sole_occluder(xp: Any, intervals: AngularInterval) -> Any:
    """Returns the number of the only occluder of each pair, or -1 where there is none or more than one."""
    occluded_by = _occlusion_by(xp, intervals)
    flags = [occluded_by(j).astype(intervals.sin.dtype) for j in range(intervals.distance.shape[0])]
    occluders = functools.reduce(operator.add, flags)
    # Where there is one occluder, the sum of the occluders' numbers is its own.
    number = functools.reduce(operator.add, (j * flag for j, flag in enumerate(flags)))
    return xp.where(occluders == 1, number, -1)


def _sole_occluder_in_loop(xp: Any, intervals: AngularInterval) -> Any:
    """Returns the same by a loop: no N^3 array, and a program whose size does not depend on N."""
    occluded_by = _occlusion_by(xp, intervals)

    def count(j: Any, state: tuple[Any, Any]) -> tuple[Any, Any]:
        occluders, last = state
        flag = occluded_by(j)
        return occluders + xp.astype(flag, xp.int32), xp.where(flag, j, last)

    zeros = xp.zeros(intervals.distance.shape, dtype=xp.int32)
    occluders, last = fori_loop(xp, intervals.distance.shape[0], count, (zeros, zeros))
    return xp.where(occluders == 1, last, -1)


def _frequencies(xp: Any, occluder: Any) -> Any:
    """Returns how often each robot's number occurs."""
    robots, dtype = occluder.shape[0], occluder.dtype
    number = xp.reshape(xp.arange(robots, dtype=dtype), (robots,) + (1,) * (occluder.ndim - 1))
    # Summed over observers first, then over the observed robots.
    counts = functools.reduce(operator.add, ((occluder[None, k] == number).astype(dtype) for k in range(robots)))
    return fold(operator.add, counts, axis=1)


def _frequencies_by_scatter(xp: Any, occluder: Any) -> Any:
    robots, _, *batch = occluder.shape
    rows = xp.reshape(occluder, (robots * robots, -1))
    zeros = xp.zeros((robots, rows.shape[1]), dtype=xp.int32)
    counts = scatter(xp, "add", zeros, xp.maximum(rows, 0), xp.astype(rows >= 0, xp.int32))
    return xp.reshape(counts, (robots, *batch))
