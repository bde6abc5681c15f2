r"""Who is occluded from whom in a large swarm: O(N^2 log N) operations and O(N^2) memory, and the very same answers.

Robot i is occluded from k when an interval of k's view that belongs to a nearer robot overlaps i's own. Of all the
intervals that overlap i's, the sweep finds one of the nearest robot's. That robot is the witness: either it is no
nearer than i, and nobody hides i; or the direct predicate says that it hides i. Where it says that it does not, for
the sweep sees angles only to within some rounding, the direct predicate is asked of everybody (`_settle`).

So that rounding never loses an overlap, intervals are grown. With eps the machine epsilon: the direct predicate, four
products of sums of two products of numbers up to 1, is off by at most 5 eps, and sin(A - gamma) > -5 eps means
gamma < A + 5.2 eps, if A is beyond 6 eps. (A farther robot whose sine is below 16 eps is settled directly.) The ends
of an interval are the direction turned by +-alpha, each component off by 1 eps, and their angle is measured as
y / (|x| + |y|) in each quadrant, which grows by at most 1 per radian and is then off by at most 5 eps. Two ends may
hence seem up to 15.2 eps apart in the wrong order: both intervals grow by 16 eps at either end, and by a quantum.
Where an observer is not outside every other disc, or a distance has underflowed, all of its answers are settled
directly.

Angles are whole quanta modulo one turn, positions of sorted starts are modulo their number, which is a power of two.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from jaxtyping import Bool, UInt32

from murmurate.geometry.loops import chunked, picked, placed, repeat, updated, whilst

__all__ = ["Sight", "overlap", "sweep"]

LANES = 64
"""Observers that are swept at once: arrays of 1,024 robots by so many stay in a core's cache, and fill its vectors."""

SLACK = 16
"""By how many machine epsilons intervals are grown."""


class Sight(NamedTuple):
    """Where a robot stands in another's view.

    Attributes:
        ux: Direction to it, a unit vector.
        uy: The same.
        sin: Sine of half the angle that it covers.
        cos: Cosine of that.
        reach: Its distance; inf for the observer itself, which is never the nearer of a pair.
    """

    ux: Any
    uy: Any
    sin: Any
    cos: Any
    reach: Any


def overlap(xp: Any, i: Sight, j: Sight) -> Any:
    """The direct predicate: whether j is nearer than i and their intervals overlap."""
    cos_gamma = i.ux * j.ux + i.uy * j.uy
    sin_gamma = xp.abs(i.ux * j.uy - i.uy * j.ux)
    sin_sum, cos_sum = i.sin * j.cos + i.cos * j.sin, i.cos * j.cos - i.sin * j.sin
    return (j.reach < i.reach) & (sin_sum * cos_gamma > cos_sum * sin_gamma)


def sweep(xp: Any, sight: Sight) -> Bool[Any, "robots robots *batch"]:
    """Says who is occluded: True where the robot of the column is from the robot of the row; False on the diagonal."""
    robots, _, *batch = sight.reach.shape
    columns = sight.reach.size // robots
    size, lanes = 1 << max(robots - 1, 1).bit_length(), min(LANES, columns)
    wide = -(-columns // lanes) * lanes
    padding = ((0, size - robots), (0, wide - columns))

    def lanewise(values: Any, fill: float) -> Any:
        """Observed by observers and batch, in chunks of observers: from i to k instead of from k to i."""
        padded = xp.pad(xp.reshape(values, (robots, columns)), padding, constant_values=fill)
        return xp.moveaxis(xp.reshape(padded, (size, -1, lanes)), 1, 0)

    # A direction turns round exactly, and all else is the same from either side.
    turned = (-sight.ux, -sight.uy, sight.sin, sight.cos, sight.reach)
    chunks = Sight(*(lanewise(values, fill) for values, fill in zip(turned, (1, 0, 0, 1, xp.inf), strict=True)))
    hidden = chunked(xp, lambda chunk: _sweep(xp, Sight(*chunk)), chunks)
    hidden = xp.reshape(xp.moveaxis(hidden, 0, 1), (size, wide))[:robots, :columns]
    return xp.moveaxis(xp.reshape(hidden, (robots, robots, *batch)), 0, 1)


def _sweep(xp: Any, sight: Sight) -> Any:
    """The sweep of one chunk: observed robots (a power of two of them) by observers."""
    slack = SLACK * float(xp.finfo(sight.reach.dtype).eps)
    casts = sight.reach < xp.inf
    sight = sight._replace(reach=xp.where(casts, sight.reach, xp.inf))
    regular = (sight.sin < 1) & (xp.abs(sight.ux * sight.ux + sight.uy * sight.uy - 1) < slack)
    safe = Sight(*(xp.where(casts & regular, a, fill) for a, fill in zip(sight, (1, 0, 0, 1, xp.inf), strict=True)))
    rank, nearest = _nearest(xp, safe, slack)
    witness = Sight(*(picked(xp, a, _row(xp, nearest)) for a in sight))
    hidden = casts & overlap(xp, sight, witness)
    unsure = (rank > nearest) & ~hidden
    return _settle(xp, sight, hidden, casts & (unsure | (sight.sin < slack) | xp.any(casts & ~regular, axis=0)[None]))


def _settle(xp: Any, sight: Sight, hidden: Any, pending: Any) -> Any:
    """Asks the direct predicate of everybody about one pending robot of each observer after another."""
    number = xp.arange(sight.reach.shape[0], dtype=xp.int32)[:, None]

    def one(state: tuple[Any, Any]) -> tuple[Any, Any]:
        hidden, pending = state
        row = xp.astype(xp.argmax(pending, axis=0), xp.int32)[None]
        i = Sight(*(picked(xp, a, row) for a in sight))
        shadowed = xp.any(overlap(xp, i, sight), axis=0)[None]
        asked = pending & (number == row)
        return hidden | (asked & shadowed), pending & ~asked

    return whilst(xp, lambda state: xp.any(state[1]), one, (hidden, pending))[0]


def _nearest(xp: Any, sight: Sight, slack: float) -> tuple[Any, Any]:
    """Returns for each robot the rank of its distance, and the nearest robot of all that overlap it, itself included.

    Both are whole numbers: the rank (equal for equal distances) above the robot's number, 0 for the former.
    """
    size = sight.reach.shape[0]
    bits = size.bit_length() - 1
    number = xp.broadcast_to(xp.arange(size, dtype=xp.uint32)[:, None], sight.reach.shape)
    rank = _not_above(xp, ordered(xp, sight.reach), sight.reach) - 1
    rank = xp.astype(rank, xp.uint32) << bits
    nobody = 2**32 - 1
    value = xp.where(sight.reach < xp.inf, rank | number, xp.asarray(nobody, dtype=xp.uint32))

    start, end = _interval(xp, sight, slack, turn=1 << min(32 - bits, 24))
    starts = ordered(xp, (xp.astype(start, xp.uint32) << bits) | number)
    owner = _row(xp, starts)
    everyone = xp.astype(number, xp.int32)
    first = updated(xp, "max", xp.zeros_like(everyone), owner, everyone)
    last = _not_above(xp, starts, (xp.astype(end, xp.uint32) << bits) | (size - 1))
    # Of the sorted starts the interval covers `length`, its own first: from there over the end of the turn, if need be.
    length = last - first + xp.where(end < start, size, 0)
    return rank, _least(xp, value, first, length)


def _least(xp: Any, value: Any, first: Any, length: Any) -> Any:
    """Returns the least value of all intervals (of positions, modulo their number) that overlap each."""
    size, lanes = value.shape
    levels = size.bit_length()
    level = xp.zeros_like(length)
    for k in range(1, levels):
        level = level + xp.astype(length >= 1 << k, length.dtype)
    other = (first + length - (1 << level)) & (size - 1)
    # Two blocks of 2^level positions cover an interval. What covers a block covers both halves of it: pushed down level
    # by level, the values come to all positions that they cover.
    blocks = xp.full((levels * size, lanes), 2**32 - 1, dtype=xp.uint32)
    for position in (first, other):
        blocks = updated(xp, "min", blocks, level * size + position, value)
    blocks = xp.reshape(blocks, (levels, size, lanes))
    position = xp.arange(size, dtype=xp.int32)

    def take(array: Any, rows: Any) -> Any:
        return xp.take(array, rows & (size - 1), axis=0, mode="clip")

    def push(step: Any, covered: Any) -> Any:
        k = levels - 2 - step
        return xp.minimum(xp.minimum(covered, take(covered, position - (1 << k))), blocks[k])

    covered = repeat(xp, levels - 1, push, blocks[-1])

    def pull(k: Any, least: Any) -> Any:
        return placed(xp, least, k + 1, xp.minimum(least[k], take(least[k], position + (1 << k))))

    # An interval overlaps another when it covers the other's start, or the other covers its start.
    least = xp.reshape(repeat(xp, levels - 1, pull, placed(xp, blocks, 0, covered)), (levels * size, lanes))
    return xp.minimum(*(picked(xp, least, level * size + p) for p in (first, other)))


def _interval(xp: Any, sight: Sight, slack: float, turn: int) -> tuple[Any, Any]:
    """Returns both ends of each grown interval in quanta, of which there are `turn` in a turn."""
    ux, uy, sin, cos, _ = sight
    grown = int(slack * turn / 4) + 1

    def quanta(x: Any, y: Any) -> Any:
        angle = y / (xp.abs(x) + xp.abs(y))
        angle = xp.where(x < 0, 2 - angle, xp.where(y < 0, 4 + angle, angle))
        return xp.astype(angle * (turn // 4), xp.int32)

    start = quanta(ux * cos + uy * sin, uy * cos - ux * sin) - grown
    end = quanta(ux * cos - uy * sin, uy * cos + ux * sin) + grown
    return start & (turn - 1), end & (turn - 1)


def _row(xp: Any, value: UInt32[Any, "..."]) -> Any:
    """Returns the robot's number of what is packed above it."""
    return xp.astype(value & (value.shape[0] - 1), xp.int32)


def ordered(xp: Any, values: Any) -> Any:
    """Sorts the first axis, a power of two long, by a bitonic network: lane by lane it needs no branch.

    XLA's own sort on a CPU compares one pair at a time, and takes three times as long for a thousand robots.
    """
    size = values.shape[0]
    position = xp.arange(size, dtype=xp.int32)
    # Every pass compares each position with the one whose number differs in these bits.
    apart = [bits for k in range(1, size.bit_length()) for bits in (2**k - 1, *(2**j for j in range(k - 2, -1, -1)))]
    passes = xp.asarray(apart, dtype=xp.int32)

    def compare(index: Any, values: Any) -> Any:
        partner = position ^ passes[index]
        others = xp.take(values, partner, axis=0, mode="clip")
        return xp.where((position < partner)[:, None], xp.minimum(values, others), xp.maximum(values, others))

    return repeat(xp, len(apart), compare, values)


def _not_above(xp: Any, table: Any, keys: Any) -> Any:
    """Counts the entries of a sorted table (first axis, a power of two long) that are not above each key."""
    size = table.shape[0]

    def advance(step: Any, count: Any) -> Any:
        return xp.where(picked(xp, table, count + (step - 1)) <= keys, count + step, count)

    count = xp.zeros(keys.shape, dtype=xp.int32)
    return advance(1, repeat(xp, size.bit_length() - 1, lambda k, count: advance(size >> (k + 1), count), count))
