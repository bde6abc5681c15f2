"""Signals of the formations that swarm robotics asks for: circles, lines, dispersion, a ring around a point.

All of them have gradients almost everywhere, need no label of a robot, and do not depend on how the swarm is turned.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

import equinox as eqx
from jaxtyping import Float

from murmurate.errors import MAX_MAGNITUDE, InputError, check_number, check_type
from murmurate.world.signals import Configuration, Signal

Array = Any  # a NumPy or a JAX array

__all__ = [
    "PACKINGS",
    "EqualRadii",
    "EvenAngles",
    "EvenSpacing",
    "FormationSignal",
    "Spread",
    "Straight",
    "Surround",
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
