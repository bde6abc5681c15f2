"""Signals with a gradient: smooth counterparts of those that count robots, for refinement through the world.

Where these are at their best the paper's signals are too, but they also say in which direction to go. None of them is
part of an objective unless a configuration names it.
"""

from __future__ import annotations

import math
import operator
from typing import Any, ClassVar, Protocol, runtime_checkable

import equinox as eqx
from jaxtyping import Float

from murmurate.errors import MAX_MAGNITUDE, check_number
from murmurate.geometry import _batch_last
from murmurate.geometry._batch_last import other_robots, sum_over_third_robots
from murmurate.geometry.rings import smallest_ring_radius
from murmurate.world.signals import Configuration, Signal

Array = Any  # a NumPy or a JAX array

__all__ = [
    "SMOOTH_SIGNALS",
    "Centered",
    "Compact",
    "Convex",
    "Exposed",
    "Occluders",
    "SmoothNeighbors",
    "SmoothSafety",
    "SmoothVisible",
    "Soft",
]

SMOOTH_SIGNALS = (
    "smooth_visible",
    "smooth_safety",
    "smooth_neighbors",
    "compact",
    "centered",
    "exposed",
    "convex",
    "occluders",
)
"""The signals with a gradient by name: a policy may be rewarded for any of them beside its objective."""


@runtime_checkable
class Soft(Protocol):
    """A signal that says what a configuration lacks, with a softness.

    What is lacking counts by its square up to the softness, as a share of what is needed, and in proportion beyond. A
    soft signal has a gradient that leads far; a hard one allows nothing to be lacking where its weight is large enough.
    """

    def softened(self, configuration: Configuration, softness: Any) -> Float[Array, "robots *batch"]:
        """Returns the shares of the robots with a softness > 0 in place of the signal's own."""
        ...


STEEPNESS = 10 / 3
"""How steeply the first hidden robot counts against all of them."""

SOFTNESS = 0.03
"""Lack of room for a line of sight below which it counts by its square, and beyond which in proportion: a robot that
is barely hidden is hidden."""

LEAST_DIRECTIONS = 64
"""Directions in which the depth inside the convex hull is measured, or four for each robot."""


@Signal.register("smooth_visible")
class SmoothVisible(Signal):
    """How far every line of sight passes from the robots near it.

    A robot i is hidden from k by a nearer robot j when the angle between them is less than the sum w of the half-angles
    that their discs cover. Each such pair counts by how far the chord of the angle is below that of (1 + margin) w, and
    the swarm by the logarithm of what its robots do not see on average: the last hidden robot matters, and so does one
    of many.

    Attributes:
        margin: Share of w by which a line of sight should pass.
    """

    margin: float = eqx.field(default=0.1, kw_only=True)

    def __check_init__(self) -> None:
        check_number("margin", self.margin, 0, MAX_MAGNITUDE)

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns the same for each robot: 1 where all see all others with the margin, 0 where nobody sees anybody."""
        return self.softened(configuration, SOFTNESS)

    def softened(self, configuration: Configuration, softness: Any) -> Float[Array, "robots *batch"]:
        """Returns the same with a softness in place of the signal's own; see `Soft`."""
        xp, robots = configuration.xp, configuration.positions.shape[0]
        (total,) = sum_over_third_robots(*_shadows(configuration, self.margin, softness))
        hidden = total / (1 + total)
        count = xp.mean(_batch_last.fold(operator.add, hidden, 1), axis=0)
        share = 1 - xp.log1p(STEEPNESS * count) / math.log1p(STEEPNESS * (robots - 1))
        return xp.broadcast_to(share, (robots, *share.shape))


@Signal.register("smooth_safety")
class SmoothSafety(Signal):
    """How well the robots keep the safe distance and a margin, without the cusp that `safety` has there.

    Attributes:
        margin: Share of the safe distance by which robots should keep farther apart.
    """

    margin: float = eqx.field(default=0.1, kw_only=True)

    def __check_init__(self) -> None:
        check_number("margin", self.margin, 0, MAX_MAGNITUDE)

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 1 - sum max(0, 1 + margin - d / delta_s)^2 over a robot's pairs."""
        return 1 - _batch_last.fold(operator.add, self._lacks(configuration) ** 2, 1)

    def softened(self, configuration: Configuration, softness: Any) -> Float[Array, "robots *batch"]:
        """Returns 1 - sum l^2 / (l + softness) over a robot's pairs; l is the root of what counts above. See `Soft`."""
        lack = self._lacks(configuration)
        return 1 - _batch_last.fold(operator.add, lack**2 / (lack + softness), 1)

    def _lacks(self, configuration: Configuration) -> Float[Array, "robots others *batch"]:
        xp, world = configuration.xp, configuration.world
        _, _, distance, apart = _pairs(configuration)
        lack = 1 + self.margin - distance / world.safe_distance
        return xp.where(apart & (lack > 0), lack, 0.0)


@Signal.register("smooth_neighbors")
class SmoothNeighbors(Signal):
    """How far robots are beyond the scan radius of each other: 1 where all pairs are neighbours."""

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 1 - sum e^2 / (e + 0.03) over a robot's pairs, where e = max(0, d / scan_radius - 1)."""
        return self.softened(configuration, SOFTNESS)

    def softened(self, configuration: Configuration, softness: Any) -> Float[Array, "robots *batch"]:
        """Returns the same with a softness in place of 0.03; see `Soft`."""
        xp, world = configuration.xp, configuration.world
        _, _, distance, apart = _pairs(configuration)
        excess = distance / world.scan_radius - 1
        excess = xp.where(apart & (excess > 0), excess, 0.0)
        return 1 - _batch_last.fold(operator.add, excess**2 / (excess + softness), 1)


@Signal.register("compact")
class Compact(Signal):
    """How near the robots are to each other: 1 on the smallest regular ring that is a valid pattern, linear beyond."""

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 2 - a robot's mean distance to the others / the same on the smallest ring."""
        xp, robots = configuration.xp, configuration.positions.shape[0]
        _, _, distance, apart = _pairs(configuration)
        total = _batch_last.fold(operator.add, xp.where(apart, distance, 0.0), 1)
        # On a ring of radius 1 the distances to the others add up to 2 cot(pi / 2N).
        return 2 - total * math.tan(math.pi / (2 * robots)) / (2 * _ring_radius(configuration))


@Signal.register("centered")
class Centered(Signal):
    """How near the robots are to the gathering point: 1 on the smallest valid ring around it, linear beyond."""

    needs_landmark: ClassVar[bool] = True

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 2 - ||P_n|| / the radius of the smallest ring."""
        xp, positions = configuration.xp, configuration.positions
        square = positions[:, 0] ** 2 + positions[:, 1] ** 2
        distance = xp.where(square > 0, xp.sqrt(xp.where(square > 0, square, 1.0)), 0.0)
        return 2 - distance / _ring_radius(configuration)


@Signal.register("exposed")
class Exposed(Signal):
    """How far the widest empty angle around each robot is from a half turn, as at a corner of the convex hull.

    A robot that is enclosed by others hides some of them wherever it goes, and no smooth measure of what is hidden says
    where out is. Out is where the gap is widest.

    Attributes:
        margin: Share of the half turn by which the gap should be wider.
    """

    margin: float = eqx.field(default=0.02, kw_only=True)

    def __check_init__(self) -> None:
        check_number("margin", self.margin, 0, MAX_MAGNITUDE)

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 1 - max(0, 1 + margin - gap / pi)."""
        xp = configuration.xp
        dx, dy, _, apart = _pairs(configuration)
        angle = xp.where(apart, xp.atan2(xp.where(apart, dy, 0.0), xp.where(apart, dx, 1.0)), 4 * math.pi)
        # Nothing is sorted in a program for swarms of any size.
        widest_gap = _widest_gap if isinstance(angle.shape[1], int) else _widest_gap_unsorted
        widest = widest_gap(xp, angle)
        lack = 1 + self.margin - widest / math.pi
        return 1 - xp.where(lack > 0, lack, 0.0)


@Signal.register("convex")
class Convex(Signal):
    """How deep each robot is inside the convex hull of the swarm: 1 for those on the hull.

    The widest gap around a robot in the middle of a wide ring hardly grows as the robot moves outwards. Its depth falls
    all the way.
    """

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 1 - depth / the radius of the smallest valid ring."""
        return 1 - _depths(configuration)


@Signal.register("occluders")
class Occluders(Signal):
    """How deep each robot that stands between others is inside the convex hull: 1 for those that hide nobody.

    On the hull of a strictly convex pattern robots hide nobody. But where discs are small, the best pattern may have a
    robot in the middle of all others, which `convex` would drive out.

    Attributes:
        margin: As in `smooth_visible`: share by which a line of sight should pass the robot.
    """

    margin: float = eqx.field(default=0.3, kw_only=True)

    def __check_init__(self) -> None:
        check_number("margin", self.margin, 0, MAX_MAGNITUDE)

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 1 - h / (0.03 + h) * depth / the radius of the smallest valid ring; h is what the robot hides."""
        shadow, arrays = _shadows(configuration, self.margin)
        # Each robot as the third one of all pairs.
        (hidden,) = sum_over_third_robots(lambda first, other, same: shadow(other, first, same), arrays)
        hidden = _batch_last.fold(operator.add, hidden, 0)
        return 1 - hidden / (SOFTNESS + hidden) * _depths(configuration)


def _shadows(configuration: Configuration, margin: float, softness: Any = SOFTNESS) -> tuple[Any, tuple[Any, ...]]:
    """Returns a function of a pair of robots and a third one, and what it takes of each: how much the third hides.

    Of an observer k, another robot i and a third one j: how far the chord of the angle between i and j is below that of
    (1 + margin) w, as a share, where j is the nearer one; 0 where it is not.
    """
    xp, radius = configuration.xp, configuration.world.radius
    dx, dy, distance, apart = _pairs(configuration)
    ux, uy = (xp.where(apart, d / distance, 0.0) for d in (dx, dy))
    half = xp.asin(xp.minimum(radius / distance, 0.999))
    # The chord of an angle a is 2 sin(a / 2), here of half the sum of two such angles: sin(p + q).
    quarter = xp.minimum((1 + margin) * half / 2, math.pi / 4)
    sine, cosine = xp.sin(quarter), xp.cos(quarter)

    def shadow(first: tuple[Any, ...], other: tuple[Any, ...], same: Any) -> tuple[Any]:
        # The observer itself has no direction, which is 0.
        (ux, uy, distance, sine, cosine, *soft), (jx, jy, near, jsine, jcosine, *_) = first, other
        square = (ux - jx) ** 2 + (uy - jy) ** 2
        nearer = (near < distance) & (ux * ux + uy * uy > 0) & (jx * jx + jy * jy > 0) & ~same
        # The gradient of the square root at 0 is not finite.
        chord = xp.where(square > 0, xp.sqrt(xp.where(square > 0, square, 1.0)), 0.0)
        lack = 1 - chord / (2 * (sine * jcosine + cosine * jsine))
        lack = xp.where(nearer & (lack > 0), lack, 0.0)
        return (lack**2 / (lack + (soft[0] if soft else softness)),)

    # Only what is no plain number takes a place among the arrays of each pair.
    soft = () if isinstance(softness, float) else (xp.broadcast_to(softness, distance.shape),)
    return shadow, (ux, uy, distance, sine, cosine, *soft)


def _depths(configuration: Configuration) -> Any:
    """Returns how deep each robot is inside the convex hull, in radii of the smallest valid ring: 0 on the hull.

    The depth is the least over evenly spaced directions of how far the swarm reaches beyond the robot.
    """
    xp, positions = configuration.xp, configuration.positions
    count = max(LEAST_DIRECTIONS, 4 * positions.shape[0])
    turns = xp.reshape(xp.arange(count) * (2 * math.pi / count), (count, *[1] * (positions.ndim - 1)))
    along = xp.cos(turns) * positions[None, :, 0] + xp.sin(turns) * positions[None, :, 1]
    return xp.min(xp.max(along, axis=1, keepdims=True) - along, axis=0) / _ring_radius(configuration)


def _widest_gap(xp: Any, angle: Any) -> Any:
    """Returns the widest gap between the directions in which each robot sees others, 0 where it sees none.

    Args:
        xp: The namespace of the arrays.
        angle: From each robot (row) to each other; 4 pi to one that has no direction, as it is at the same place.
    """
    angle = xp.sort(angle, axis=1)
    # The last of those that have a direction is followed by the first, a turn later.
    first = angle[:, :1] + 2 * math.pi
    following = xp.concat([angle[:, 1:], xp.broadcast_to(xp.asarray(4 * math.pi), first.shape)], axis=1)
    gap = xp.where(following >= 4 * math.pi, first, following) - angle
    return xp.max(xp.where(angle >= 4 * math.pi, 0.0, gap), axis=1)


def _widest_gap_unsorted(xp: Any, angle: Any) -> Any:
    """Returns the same, from all pairs of directions."""
    first = xp.reshape(xp.arange(angle.shape[1]), (1, -1, *[1] * (angle.ndim - 1)))
    ahead, higher = angle[:, None] - angle[:, :, None], xp.swapaxes(first, 1, 2) > first
    is_after = (ahead > 0) | ((ahead == 0) & higher)  # of two in one direction the first, once
    after = xp.where(is_after, ahead, ahead + 2 * math.pi)
    gap = xp.min(xp.where(angle[:, None] >= 4 * math.pi, 2 * math.pi, after), axis=2)
    return xp.max(xp.where(angle >= 4 * math.pi, 0.0, gap), axis=1)


def _pairs(configuration: Configuration) -> tuple[Any, Any, Any, Any]:
    """Returns dx, dy and distance from each robot (row) to each other, and which are at another place.

    The distance of two robots at one place is given as 1: a square root has no gradient at 0.
    """
    xp, positions = configuration.xp, configuration.positions
    dx = positions[None, :, 0] - positions[:, None, 0]
    dy = positions[None, :, 1] - positions[:, None, 1]
    square = dx * dx + dy * dy
    apart = (square > 0) & other_robots(xp, positions)
    return dx, dy, xp.sqrt(xp.where(apart, square, 1.0)), apart


def _ring_radius(configuration: Configuration) -> Any:
    world = configuration.world
    count = configuration.xp.asarray(float(configuration.positions.shape[0]))
    return smallest_ring_radius(count, world.radius, world.safe_distance)
