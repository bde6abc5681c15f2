r"""Kernel, batch last: occlusion in large swarms, with O(N^2 log N) operations and O(N^2) memory.

The answers are exactly those of the pairwise test. Robot i is occluded from k when the interval of a robot nearer to k
overlaps the interval of i. For each i the sweep finds, among all intervals that overlap the interval of i, one that
belongs to the nearest robot: the witness. If the witness is no nearer than i, then i is not occluded. If the pairwise
test says that the witness occludes i, then i is occluded. Otherwise rounding is in the way, because the sweep compares
rounded angles, and `_settle` tests i against every robot.

So that rounding never loses an overlap, intervals are widened. With eps the machine epsilon: the pairwise test, four
products of sums of two products of numbers up to 1, is off by at most 5 eps, and sin(A - gamma) > -5 eps means
gamma < A + 5.2 eps if A > 6 eps. (A farther robot whose sine is below 16 eps is settled pairwise.) The ends of an
interval are its direction turned by +-alpha, each component off by 1 eps. Their angle is measured as y / (|x| + |y|) in
each quadrant, which grows by at most 1 per radian and is then off by at most 5 eps. Two ends may hence appear in the
wrong order by up to 15.2 eps: both intervals are widened by 16 eps at either end, and by one quantum. For an observer
inside another disc, or with a distance that has underflowed, all answers are settled pairwise.

Angles are whole numbers of quanta modulo one turn. Positions among the sorted starts of intervals are modulo their
number, a power of two.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from jaxtyping import Bool, UInt32

from murmurate.geometry._batch_last.loops import fori_loop, map_chunks, scatter, set_row, take, while_loop

__all__ = ["AngularInterval", "overlap", "sweep"]

LANES = 64
"""Observers that are swept together: arrays of 1,024 robots by this many fit a core's cache and fill its vectors."""

SLACK = 16
"""Machine epsilons by which intervals are widened at either end."""


class AngularInterval(NamedTuple):
    """The intervals that discs cover in a view.

    Attributes:
        ux: x of the unit vector to the disc's centre.
        uy: y of it.
        sin: Sine of half the angle that the disc covers.
        cos: Cosine of it.
        distance: Distance of the centre; inf for the observer itself, which is never the nearer of a pair.
    """

    ux: Any
    uy: Any
    sin: Any
    cos: Any
    distance: Any


def overlap(xp: Any, i: AngularInterval, j: AngularInterval) -> Any:
    """Returns whether j is nearer than i and their intervals overlap: the pairwise test."""
    cos_gamma = i.ux * j.ux + i.uy * j.uy
    sin_gamma = xp.abs(i.ux * j.uy - i.uy * j.ux)
    sin_sum, cos_sum = i.sin * j.cos + i.cos * j.sin, i.cos * j.cos - i.sin * j.sin
    return (j.distance < i.distance) & (sin_sum * cos_gamma > cos_sum * sin_gamma)


def sweep(xp: Any, intervals: AngularInterval) -> Bool[Any, "robots robots *batch"]:
    """Returns which robots (column) are occluded from which (row); False on the diagonal."""
    robots, _, *batch = intervals.distance.shape
    columns = intervals.distance.size // robots
    size, lanes = 1 << max(robots - 1, 1).bit_length(), min(LANES, columns)
    wide = -(-columns // lanes) * lanes
    padding = ((0, size - robots), (0, wide - columns))

    def lanewise(values: Any, fill: float) -> Any:
        """Returns values as (observed, observers and batch), in chunks of observers: from i to k, not from k to i."""
        padded = xp.pad(xp.reshape(values, (robots, columns)), padding, constant_values=fill)
        return xp.moveaxis(xp.reshape(padded, (size, -1, lanes)), 1, 0)

    # Reversing a direction is exact, and the other values are the same from either side.
    seen_from = (-intervals.ux, -intervals.uy, intervals.sin, intervals.cos, intervals.distance)
    fills = (1, 0, 0, 1, xp.inf)
    chunks = AngularInterval(*(lanewise(values, fill) for values, fill in zip(seen_from, fills, strict=True)))
    hidden = map_chunks(xp, lambda chunk: _sweep(xp, AngularInterval(*chunk)), chunks)
    hidden = xp.reshape(xp.moveaxis(hidden, 0, 1), (size, wide))[:robots, :columns]
    return xp.moveaxis(xp.reshape(hidden, (robots, robots, *batch)), 0, 1)


def _sweep(xp: Any, intervals: AngularInterval) -> Any:
    """Returns which robots are occluded in one chunk: observed robots (a power of two of them) by observers."""
    slack = SLACK * float(xp.finfo(intervals.distance.dtype).eps)
    # Neither the observer itself, nor padding, nor a robot at NaN.
    present = intervals.distance < xp.inf
    intervals = intervals._replace(distance=xp.where(present, intervals.distance, xp.inf))
    regular = (intervals.sin < 1) & (xp.abs(intervals.ux * intervals.ux + intervals.uy * intervals.uy - 1) < slack)
    fills = (1, 0, 0, 1, xp.inf)
    safe = AngularInterval(*(xp.where(present & regular, a, fill) for a, fill in zip(intervals, fills, strict=True)))
    rank, nearest = _nearest(xp, safe, slack)
    witness = AngularInterval(*(take(xp, a, _row(xp, nearest)) for a in intervals))
    hidden = present & overlap(xp, intervals, witness)
    # A nearer robot overlaps by the rounded angles, but not by the pairwise test.
    unsure = (rank > nearest) & ~hidden
    irregular_view = xp.any(present & ~regular, axis=0)[None]
    return _settle(xp, intervals, hidden, present & (unsure | (intervals.sin < slack) | irregular_view))


def _settle(xp: Any, intervals: AngularInterval, hidden: Any, pending: Any) -> Any:
    """Answers the pending robots of each observer one after another, by the pairwise test against every robot."""
    number = xp.arange(intervals.distance.shape[0], dtype=xp.int32)[:, None]

    def settle_next(state: tuple[Any, Any]) -> tuple[Any, Any]:
        hidden, pending = state
        row = xp.astype(xp.argmax(pending, axis=0), xp.int32)[None]
        i = AngularInterval(*(take(xp, a, row) for a in intervals))
        shadowed = xp.any(overlap(xp, i, intervals), axis=0)[None]
        asked = pending & (number == row)
        return hidden | (asked & shadowed), pending & ~asked

    return while_loop(xp, lambda state: xp.any(state[1]), settle_next, (hidden, pending))[0]


def _nearest(xp: Any, intervals: AngularInterval, slack: float) -> tuple[Any, Any]:
    """Returns the rank of each robot's distance, and the nearest robot among all that overlap it, itself included.

    Both are integers that hold a rank (equal for equal distances) in their upper bits. The lower bits hold the robot's
    number in the latter and 0 in the former.
    """
    size = intervals.distance.shape[0]
    bits = size.bit_length() - 1
    number = xp.broadcast_to(xp.arange(size, dtype=xp.uint32)[:, None], intervals.distance.shape)
    rank = _count_not_above(xp, bitonic_sort(xp, intervals.distance), intervals.distance) - 1
    rank = xp.astype(rank, xp.uint32) << bits
    no_robot = 2**32 - 1
    value = xp.where(intervals.distance < xp.inf, rank | number, xp.asarray(no_robot, dtype=xp.uint32))

    start, end = _interval(xp, intervals, slack, turn=1 << min(32 - bits, 24))
    starts = bitonic_sort(xp, (xp.astype(start, xp.uint32) << bits) | number)
    owner = _row(xp, starts)
    signed = xp.astype(number, xp.int32)
    first = scatter(xp, "max", xp.zeros_like(signed), owner, signed)
    last = _count_not_above(xp, starts, (xp.astype(end, xp.uint32) << bits) | (size - 1))
    # The interval covers `length` of the sorted starts, from its own on, over the end of the turn where it wraps.
    length = last - first + xp.where(end < start, size, 0)
    return rank, _least(xp, value, first, length)


def _least(xp: Any, value: Any, first: Any, length: Any) -> Any:
    """Returns the least value among all intervals (of positions, modulo their number) that overlap each interval."""
    size, lanes = value.shape
    levels = size.bit_length()
    level = xp.zeros_like(length)
    for k in range(1, levels):
        level = level + xp.astype(length >= 1 << k, length.dtype)
    other = (first + length - (1 << level)) & (size - 1)
    # Two blocks of 2^level positions cover an interval. A value that holds for a block holds for both of its halves:
    # pushed down level by level, values reach all the positions that their intervals cover.
    blocks = xp.full((levels * size, lanes), 2**32 - 1, dtype=xp.uint32)
    for position in (first, other):
        blocks = scatter(xp, "min", blocks, level * size + position, value)
    blocks = xp.reshape(blocks, (levels, size, lanes))
    position = xp.arange(size, dtype=xp.int32)

    def rotate(array: Any, rows: Any) -> Any:
        return xp.take(array, rows & (size - 1), axis=0, mode="clip")

    def push(step: Any, covered: Any) -> Any:
        k = levels - 2 - step
        return xp.minimum(xp.minimum(covered, rotate(covered, position - (1 << k))), blocks[k])

    covered = fori_loop(xp, levels - 1, push, blocks[-1])

    def pull(k: Any, least: Any) -> Any:
        return set_row(xp, least, k + 1, xp.minimum(least[k], rotate(least[k], position + (1 << k))))

    # Two intervals overlap when one of them covers the start of the other.
    least = xp.reshape(fori_loop(xp, levels - 1, pull, set_row(xp, blocks, 0, covered)), (levels * size, lanes))
    return xp.minimum(*(take(xp, least, level * size + p) for p in (first, other)))


def _interval(xp: Any, intervals: AngularInterval, slack: float, turn: int) -> tuple[Any, Any]:
    """Returns both ends of each widened interval in quanta, of which a turn has `turn`."""
    ux, uy, sin, cos, _ = intervals
    margin = int(slack * turn / 4) + 1

    def quanta(x: Any, y: Any) -> Any:
        angle = y / (xp.abs(x) + xp.abs(y))
        angle = xp.where(x < 0, 2 - angle, xp.where(y < 0, 4 + angle, angle))
        return xp.astype(angle * (turn // 4), xp.int32)

    start = quanta(ux * cos + uy * sin, uy * cos - ux * sin) - margin
    end = quanta(ux * cos - uy * sin, uy * cos + ux * sin) + margin
    return start & (turn - 1), end & (turn - 1)


def _row(xp: Any, value: UInt32[Any, "..."]) -> Any:
    """Returns the robot's number from the lower bits of a packed integer."""
    return xp.astype(value & (value.shape[0] - 1), xp.int32)


def bitonic_sort(xp: Any, values: Any) -> Any:
    """Sorts the first axis, a power of two long, by a bitonic network, which needs no branches.

    XLA's own sort on a CPU compares one pair at a time and takes three times as long for a thousand robots.
    """
    size = values.shape[0]
    position = xp.arange(size, dtype=xp.int32)
    # Each pass compares every position with the position whose number differs in these bits.
    flips = [bits for k in range(1, size.bit_length()) for bits in (2**k - 1, *(2**j for j in range(k - 2, -1, -1)))]
    passes = xp.asarray(flips, dtype=xp.int32)

    def compare(index: Any, values: Any) -> Any:
        partner = position ^ passes[index]
        others = xp.take(values, partner, axis=0, mode="clip")
        return xp.where((position < partner)[:, None], xp.minimum(values, others), xp.maximum(values, others))

    return fori_loop(xp, len(flips), compare, values)


def _count_not_above(xp: Any, table: Any, keys: Any) -> Any:
    """Returns how many entries of a sorted table (first axis, a power of two long) are not above each key."""
    size = table.shape[0]

    def advance(step: Any, count: Any) -> Any:
        return xp.where(take(xp, table, count + (step - 1)) <= keys, count + step, count)

    count = xp.zeros(keys.shape, dtype=xp.int32)
    return advance(1, fori_loop(xp, size.bit_length() - 1, lambda k, count: advance(size >> (k + 1), count), count))
