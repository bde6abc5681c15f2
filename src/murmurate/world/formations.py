"""Signals of the formations that swarm robotics asks for: circles, lines, dispersion, a chain, a given pattern, ...

All of them have gradients almost everywhere and need no label of a robot. But for `inside` and `chain`, which are
measured in the world, none depends on how the swarm is turned.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from murmurate.errors import MAX_MAGNITUDE, InputError, check_number, check_type
from murmurate.geometry.rings import smallest_ring_radius
from murmurate.geometry.superposition import superposition
from murmurate.world.signals import Configuration, Signal

Array = Any  # a NumPy or a JAX array

__all__ = [
    "PACKINGS",
    "Chain",
    "EqualRadii",
    "EvenAngles",
    "EvenSpacing",
    "FormationSignal",
    "Inside",
    "Match",
    "Spread",
    "Straight",
    "Surround",
    "TwoGroups",
]

PACKINGS = (
    *(1.4142135624, 1.0352761804, 1.0, 0.7071067812, 0.6009252126, 0.5358983849, 0.5176380902, 0.5, 0.4212795440),
    *(0.3982073102, 0.3887301263, 0.3660960077, 0.3489152604, 0.3410813774, 0.3333333333),
)
"""The greatest least distance of 2, 3, ... 16 points in a square of side 1, best known: circles packed in a square
(Specht, The best known packings of equal circles in a square)."""


CENTRAL = 1e-3
"""Radii from the middle within which a robot has no direction."""


class FormationSignal(Signal):
    """How exactly every robot has its place in a formation; 1 is exact.

    A share of 0.95 says that what the formation asks of that robot is off by 5%.

    Attributes:
        every: The signal is the least share of all robots, by which a formation is judged, instead of their mean, by
            which it is learned.
    """

    every: bool = eqx.field(default=False, static=True, kw_only=True)

    def __check_init__(self) -> None:
        check_type("every", self.every, bool, "true or false")

    def value(self, configuration: Configuration) -> Float[Array, "*batch"]:
        """Returns the mean of the robots' shares, or the least of them."""
        return self(configuration).min(axis=0) if self.every else super().value(configuration)


@Signal.register("even_angles")
class EvenAngles(FormationSignal):
    """How even the angles between the robots are, seen from their centroid."""

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 1 - |gap / (2 pi / N) - 1|, of the two gaps beside a robot the one that is farther off."""
        robots = configuration.positions.shape[0]
        x, y = _from_centroid(configuration)
        before, after = _angular_gaps(configuration, x, y)
        off = [abs(gap * robots / (2 * math.pi) - 1) for gap in (before, after)]
        return 1 - configuration.xp.maximum(*off)


@Signal.register("equal_radii")
class EqualRadii(FormationSignal):
    """How equal the distances of the robots from their centroid are.

    Attributes:
        radius: What they should be, world units; 0: their mean, whatever it is.
    """

    radius: float = eqx.field(default=0.0, kw_only=True)

    def __check_init__(self) -> None:
        super().__check_init__()
        check_number("radius", self.radius, 0, MAX_MAGNITUDE)

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 1 - |r / radius - 1|."""
        xp = configuration.xp
        distance = _length(xp, *_from_centroid(configuration))
        mean = xp.maximum(distance.mean(axis=0), configuration.world.radius)
        # Numbers of signals are leaves, so which of the two it is cannot decide what is compiled.
        return 1 - abs(distance / xp.where(xp.asarray(self.radius) > 0, self.radius, mean) - 1)


@Signal.register("surround")
class Surround(FormationSignal):
    """How well the robots surround the origin: at a distance from it, with no wide gap between them.

    Attributes:
        distance: Distance from the origin, world units.
        widest: Width of the widest gap at which the signal is as low as at a distance that is off by `tolerance`, in
            parts of an even one.
        tolerance: Share by which the distance may be off.
    """

    needs_landmark: ClassVar[bool] = True

    distance: float = eqx.field(default=20.0, kw_only=True)
    widest: float = eqx.field(default=1.5, kw_only=True)
    tolerance: float = eqx.field(default=0.05, kw_only=True)

    def __check_init__(self) -> None:
        super().__check_init__()
        check_number("distance", self.distance, 0, MAX_MAGNITUDE, exclusive_low=True)
        check_number("widest", self.widest, 1, MAX_MAGNITUDE, exclusive_low=True)
        check_number("tolerance", self.tolerance, 0, 1, exclusive_low=True)

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 1 - |r / distance - 1| or, if less, 1 - tolerance (gap / (2 pi / N) - 1) / (widest - 1)."""
        xp, positions = configuration.xp, configuration.positions
        x, y = positions[:, 0], positions[:, 1]
        gap = xp.maximum(*_angular_gaps(configuration, x, y)) * positions.shape[0] / (2 * math.pi)
        off = abs(_length(xp, x, y) / self.distance - 1)
        return 1 - xp.maximum(off, self.tolerance * xp.maximum(gap - 1, 0) / (self.widest - 1))


@Signal.register("straight")
class Straight(FormationSignal):
    """How near the robots are to the straight line that fits them best (total least squares)."""

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 1 - distance from the line / (20 R): 0.95 within a radius of it."""
        _, across = _along_and_across(configuration)
        return 1 - abs(across) / (20 * configuration.world.radius)


@Signal.register("even_spacing")
class EvenSpacing(FormationSignal):
    """How even the robots are spaced along the straight line that fits them best."""

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 1 - |gap / mean gap - 1|, of the two gaps beside a robot the one that is farther off."""
        xp = configuration.xp
        along, _ = _along_and_across(configuration)
        mean = (along.max(axis=0) - along.min(axis=0)) / (along.shape[0] - 1)
        mean = xp.maximum(mean, configuration.world.radius)
        ahead = _differences(along)
        itself, higher = _itself(xp, ahead)
        is_after = (ahead > 0) | ((ahead == 0) & higher)
        after, before = xp.where(is_after, ahead, xp.inf), xp.where(is_after | itself, xp.inf, -ahead)
        gaps = [after.min(axis=1), before.min(axis=1)]
        # The first and the last robot have one gap.
        off = [xp.where(xp.isfinite(gap), abs(xp.where(xp.isfinite(gap), gap, mean) / mean - 1), 0.0) for gap in gaps]
        return 1 - xp.maximum(*off)


@Signal.register("spread")
class Spread(FormationSignal):
    """How far each robot is from the nearest other one: 1 in the best known packing of as many points in the world.

    A world that is no square counts as the square of its shorter side.
    """

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns min(1, distance to the nearest robot / that of the best known packing).

        Raises:
            InputError: No packing of so many robots is known here.
        """
        xp, world, robots = configuration.xp, configuration.world, configuration.positions.shape[0]
        if robots > len(PACKINGS) + 1:
            raise InputError("robots", robots, f"at most {len(PACKINGS) + 1} with the signal spread")
        side = 2 * xp.minimum(xp.asarray(world.half_width), xp.asarray(world.half_height))
        squares = sum(_differences(configuration.positions[:, axis]) ** 2 for axis in (0, 1))
        nearest = xp.where(_itself(xp, squares)[0], xp.inf, squares).min(axis=1)
        return xp.minimum(_root(xp, nearest) / (PACKINGS[robots - 2] * side), 1)


@Signal.register("inside")
class Inside(FormationSignal):
    """How far each robot is from the walls: 1 where it is at least a margin away from all of them.

    Attributes:
        margin: The margin, in radii.
    """

    # A place in the world is a place from its middle.
    needs_landmark: ClassVar[bool] = True

    margin: float = eqx.field(default=1.2, kw_only=True)

    def __check_init__(self) -> None:
        super().__check_init__()
        check_number("margin", self.margin, 0, MAX_MAGNITUDE)

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 1 - how far the robot is beyond the margin, along either axis the farther, / (20 R)."""
        xp, positions, world = configuration.xp, configuration.positions, configuration.world
        x, y = (abs(positions[:, axis]) + self.margin * world.radius for axis in (0, 1))
        beyond = xp.maximum(xp.maximum(x - world.half_width, y - world.half_height), 0)
        return 1 - beyond / (20 * world.radius)


@Signal.register("chain")
class Chain(FormationSignal):
    """How well the robots are a chain of links from one point to another.

    The links are from each robot to the next one in the direction from the first point to the last, and from the points
    to the robots at the ends.

    Attributes:
        first: The point at which the chain begins, world units.
        last: The point at which it ends.
        reach: Length of the longest link, world units; 0: the scan radius.
    """

    needs_landmark: ClassVar[bool] = True

    first: tuple[float, float] = eqx.field(default=(-20.0, 0.0), kw_only=True)
    last: tuple[float, float] = eqx.field(default=(20.0, 0.0), kw_only=True)
    reach: float = eqx.field(default=0.0, kw_only=True)

    def __check_init__(self) -> None:
        super().__check_init__()
        for name in ("first", "last"):
            for value in getattr(self, name):
                check_number(name, value, -MAX_MAGNITUDE, MAX_MAGNITUDE)
        if tuple(self.first) == tuple(self.last):
            raise InputError("last", list(self.last), "another point than first")
        check_number("reach", self.reach, 0, MAX_MAGNITUDE)

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 1 - max(0, length / reach - 1), of the two links of a robot the longer one."""
        xp, positions = configuration.xp, configuration.positions
        x, y = positions[:, 0], positions[:, 1]
        (x0, y0), (x1, y1) = self.first, self.last
        along = x * (x1 - x0) + y * (y1 - y0)
        ahead = _differences(along)
        itself, higher = _itself(xp, ahead)
        is_after = (ahead > 0) | ((ahead == 0) & higher)
        length = _root(xp, _differences(x) ** 2 + _differences(y) ** 2)
        ends = (_length(xp, x - x0, y - y0), _length(xp, x - x1, y - y1))
        links = []
        for others, end in ((~is_after & ~itself, ends[0]), (is_after, ends[1])):
            # Of robots that are as far along, those of the nearest number.
            order = xp.where(others, abs(ahead), xp.inf)
            nearest = others & (order == order.min(axis=1, keepdims=True))
            link = xp.where(nearest, length, xp.inf).min(axis=1)
            links.append(xp.where(others.any(axis=1), link, end))
        scan = xp.asarray(configuration.world.scan_radius)
        # Numbers of signals are leaves, so which of the two it is cannot decide what is compiled.
        reach = xp.where(xp.asarray(self.reach) > 0, self.reach, scan)
        return 1 - xp.maximum(xp.maximum(*links) / reach - 1, 0)


@Signal.register("two_groups")
class TwoGroups(FormationSignal):
    """How well the robots are two groups of equal size, each close together and both far apart.

    The groups are the halves of the swarm along the line that fits it best; of an odd number, that half has one more
    for which the signal is better.

    Attributes:
        apart: Distance that a robot keeps from all of the other group, world units.
        wide: How far from the middle of its group it may be, in radii of the smallest valid ring of as many robots.
    """

    apart: float = eqx.field(default=20.0, kw_only=True)
    wide: float = eqx.field(default=1.5, kw_only=True)

    def __check_init__(self) -> None:
        super().__check_init__()
        check_number("apart", self.apart, 0, MAX_MAGNITUDE, exclusive_low=True)
        check_number("wide", self.wide, 0, MAX_MAGNITUDE, exclusive_low=True)

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 1 - max(0, 1 - d / apart, r / wide - 1).

        d is the distance to the nearest of the other group, r that from the middle of the robot's own.
        """
        xp, robots = configuration.xp, configuration.positions.shape[0]
        along, _ = _along_and_across(configuration)
        ahead = _differences(along)
        itself, higher = _itself(xp, ahead)
        place = ((ahead < 0) | ((ahead == 0) & ~higher & ~itself)).sum(axis=1)
        shares = [self._of_groups(configuration, place < size) for size in (robots // 2, (robots + 1) // 2)]
        return xp.where(shares[0].mean(axis=0) >= shares[1].mean(axis=0), *shares)

    def _of_groups(self, configuration: Configuration, is_first: Any) -> Any:
        xp, positions, world = configuration.xp, configuration.positions, configuration.world
        x, y = positions[:, 0], positions[:, 1]
        same = is_first[None] == is_first[:, None]
        members = xp.where(same, xp.ones_like(x)[None], xp.zeros_like(x)[None])
        count = members.sum(axis=1)
        middle = [(members * axis[None]).sum(axis=1) / count for axis in (x, y)]
        ring = smallest_ring_radius(xp.maximum(count, 2.0), world.radius, world.safe_distance)
        far = _length(xp, x - middle[0], y - middle[1]) / (self.wide * ring) - 1
        squares = _differences(x) ** 2 + _differences(y) ** 2
        nearest = _root(xp, xp.where(same, xp.inf, squares).min(axis=1))
        return 1 - xp.maximum(xp.maximum(far, 1 - nearest / self.apart), 0)


def _pairs(places: Any) -> tuple[tuple[float, float], ...]:
    """Returns places as what can be compared and hashed.

    Raises:
        InputError: They are no pairs of numbers.
    """
    try:
        points = np.asarray(places, float).reshape(len(places), 2)
    except (TypeError, ValueError):
        raise InputError("places", places, "pairs of numbers, x and y for each robot") from None
    if not (np.abs(points) <= MAX_MAGNITUDE).all():
        raise InputError("places", places, f"finite numbers from {-MAX_MAGNITUDE:g} to {MAX_MAGNITUDE:g}")
    return tuple((x, y) for x, y in points.tolist())


# Outside of a jit, its loops would be compiled anew at every call.
_superposition = jax.jit(superposition)


@Signal.register("match")
class Match(FormationSignal):
    """How near each robot is to its place in a given pattern, which is laid on the swarm as suits it best.

    It is moved, turned and its places are given to robots, but neither scaled nor mirrored.

    Attributes:
        places: The places of the pattern, world units: one pair of coordinates for each robot.
    """

    places: tuple[tuple[float, float], ...] = eqx.field(default=(), converter=_pairs, static=True, kw_only=True)

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 1 - distance from the place / (2 R): 0.95 within 0.1 R.

        Raises:
            InputError: The pattern has another number of places than the swarm has robots.
        """
        xp, positions = configuration.xp, configuration.positions
        if len(self.places) != positions.shape[0]:
            raise InputError("places", f"{len(self.places)} places", f"{positions.shape[0]}, one for each robot")
        places = np.asarray(self.places, float)
        places = xp.asarray(places - places.mean(axis=0), dtype=positions.dtype)
        x, y = (axis.reshape(len(places), -1) for axis in _from_centroid(configuration))
        # Which place is whose has no gradient, and is found in JAX.
        _, order = _superposition(jnp.stack([jnp.asarray(x), jnp.asarray(y)], axis=1), jnp.asarray(places))
        px, py = (places[:, axis][xp.asarray(order)] for axis in (0, 1))
        real, imaginary = (px * x + py * y).sum(axis=0), (px * y - py * x).sum(axis=0)
        length = _length(xp, real, imaginary)
        cosine, sine = (xp.where(length > 0, z / xp.where(length > 0, length, 1.0), 1.0) for z in (real, imaginary))
        distance = _length(xp, x - cosine * px + sine * py, y - sine * px - cosine * py)
        return (1 - distance / (2 * configuration.world.radius)).reshape((len(places), *positions.shape[2:]))


def _from_centroid(configuration: Configuration) -> tuple[Any, Any]:
    positions = configuration.positions
    return tuple(positions[:, axis] - positions[:, axis].mean(axis=0) for axis in (0, 1))  # type: ignore[return-value]


def _angular_gaps(configuration: Configuration, x: Any, y: Any) -> tuple[Any, Any]:
    """Returns the angles from each robot to the one before it and to the one after it, counter-clockwise.

    Each is the least of the angles to all others: programs for swarms of any size cannot sort. Of robots in one
    direction, that of the lower number comes first.
    """
    xp = configuration.xp
    # A robot that is next to the middle has no direction: it would follow from how positions are rounded.
    somewhere = x * x + y * y > (CENTRAL * configuration.world.radius) ** 2
    ahead = _differences(xp.atan2(xp.where(somewhere, y, 0.0), xp.where(somewhere, x, 1.0)))
    itself, higher = _itself(xp, ahead)
    is_after = (ahead > 0) | ((ahead == 0) & higher)
    after = xp.where(is_after, ahead, ahead + 2 * math.pi)
    before = xp.where(is_after, 2 * math.pi - ahead, -ahead)
    return tuple(xp.where(itself, 2 * math.pi, gaps).min(axis=1) for gaps in (before, after))  # type: ignore[return-value]


def _along_and_across(configuration: Configuration) -> tuple[Any, Any]:
    """Returns the coordinates of the robots along the line of least squares, and across it, from their centroid."""
    xp = configuration.xp
    x, y = _from_centroid(configuration)
    # The principal axis has the direction t with tan 2t = 2 sxy / (sxx - syy): no eigenvector is needed.
    difference, mixed = (x * x - y * y).mean(axis=0), 2 * (x * y).mean(axis=0)
    known = (difference != 0) | (mixed != 0)
    turn = xp.atan2(xp.where(known, mixed, 0.0), xp.where(known, difference, 1.0)) / 2
    cosine, sine = xp.cos(turn), xp.sin(turn)
    return x * cosine + y * sine, y * cosine - x * sine


def _differences(values: Any) -> Any:
    """Returns by how much the value of each robot (second axis) exceeds that of each robot (first axis)."""
    return values[None] - values[:, None]


def _itself(xp: Any, pairs: Any) -> tuple[Any, Any]:
    """Returns which of all pairs are a robot and itself, and in which the second one has the higher number."""
    first = xp.reshape(xp.arange(pairs.shape[0]), (-1, *[1] * (pairs.ndim - 1)))
    second = xp.swapaxes(first, 0, 1)
    return first == second, second > first


def _length(xp: Any, x: Any, y: Any) -> Any:
    return _root(xp, x * x + y * y)


def _root(xp: Any, square: Any) -> Any:
    """Returns the square root, whose gradient at 0 is taken as 0."""
    return xp.where(square > 0, xp.sqrt(xp.where(square > 0, square, 1.0)), 0.0)
