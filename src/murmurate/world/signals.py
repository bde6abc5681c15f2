"""The paper's signals, each normalised so that 1 is its best, and the objective: their weighted sum.

A signal measures a configuration robot by robot; the signal is the mean over the robots. Signals take the batch last,
and work in NumPy or JAX, whichever holds the positions.
"""

from __future__ import annotations

import operator
from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar

import equinox as eqx
from jaxtyping import Bool, Float

from murmurate.errors import MAX_MAGNITUDE, InputError, check_choice, check_number, check_type
from murmurate.geometry import _batch_last
from murmurate.geometry._checks import check_squares
from murmurate.registry import Strategy
from murmurate.representation import short_repr
from murmurate.world.config import WorldConfig, check_world

__all__ = ["OBJECTIVES", "Configuration", "Objective", "Signal", "objective_signals"]

Array = Any  # a NumPy or a JAX array


class Configuration:
    """The positions of all robots, with what follows from them: computed when first asked for, and then shared.

    Attributes:
        positions: Centres, world units.
        world: Sizes of the world and its robots.
        xp: The namespace of the arrays: NumPy or JAX.
    """

    __match_args__ = ("positions", "world")
    __repr__ = short_repr

    def __init__(self, positions: Float[Array, "robots 2 *batch"], world: WorldConfig) -> None:
        allowed = "numbers of shape (robots, 2, ...)"
        try:
            self.xp, self.positions = _batch_last.as_floating(positions)
        except (TypeError, ValueError):
            raise InputError("positions", positions, allowed) from None
        if self.positions.ndim < 2 or self.positions.shape[1] != 2:
            raise InputError("positions", self.positions.shape, allowed)
        check_squares("positions", self.positions, allowed)
        check_world(world)
        self.world = world

    @cached_property
    def distances(self) -> Float[Array, "robots robots *batch"]:
        """Distances between centres, world units; 0 on the diagonal."""
        return _batch_last.distances(self.positions)

    @property
    def neighbors(self) -> Bool[Array, "robots robots *batch"]:
        """Which robots (second axis) are neighbours of each robot (first axis)."""
        return self._neighbors_and_visible[0]

    @property
    def visible(self) -> Bool[Array, "robots robots *batch"]:
        """Which robots (second axis) are visible from each robot (first axis)."""
        return self._neighbors_and_visible[1]

    @cached_property
    def sole_occluder_counts(self) -> Float[Array, "robots *batch"]:
        """For each robot, how many ordered pairs of others would see each other if that robot were not there."""
        return _batch_last.sole_occluder_counts(self.positions, self.world.radius, self.world.scan_radius)

    @cached_property
    def _neighbors_and_visible(self) -> tuple[Any, Any]:
        return _batch_last.neighbors_and_visible(self.positions, self.world.radius, self.world.scan_radius)


class Signal(Strategy):
    """A normalised measure of a configuration; 1 is its best.

    A subclass implements `__call__`. Its own fields need defaults and stand in the configuration beside the weight.

    Attributes:
        weight: Weight in the objective; `base.weights` and `auxiliary.weights` override it for one policy.
    """

    section: ClassVar[str] = "signals"

    needs_landmark: ClassVar[bool] = False
    """Whether it is measured from the origin: robots with their own views are then shown that point."""

    weight: float = eqx.field(default=1.0, kw_only=True)

    def __check_init__(self) -> None:
        check_number("weight", self.weight, 0, MAX_MAGNITUDE)

    @abstractmethod
    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns each robot's share of the signal; the signal is their mean."""

    def value(self, configuration: Configuration) -> Float[Array, "*batch"]:
        """Returns the signal: by default the mean of the robots' shares."""
        values = self(configuration)
        return _sum(values) / values.shape[0]

    def credit(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns each robot's potential: the change of it teaches that robot its own action.

        By default this is the robot's share. A difference reward (Wolpert and Tumer, 2002) serves better: a potential
        that changes, when this robot alone moves, in proportion to the signal. The signals of this package return N / 2
        times the terms of the signal that depend on the robot.
        """
        return self(configuration)


@Signal.register("close")
class Close(Signal):
    """Closeness of the robots to the origin (paper, equation 6)."""

    needs_landmark: ClassVar[bool] = True

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 1 - ||P_n|| / sqrt(X^2 + Y^2)."""
        return 1 - self._from_origin(configuration) / _half_diagonal(configuration.world)

    def value(self, configuration: Configuration) -> Float[Array, "*batch"]:
        """Returns 1 - W_close sum ||P_n||: the sum is taken first."""
        total = _sum(self._from_origin(configuration))
        return 1 - total / (configuration.positions.shape[0] * _half_diagonal(configuration.world))

    def credit(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns half of each robot's own term."""
        return -self._from_origin(configuration) / (2 * _half_diagonal(configuration.world))

    def _from_origin(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        x, y = configuration.positions[:, 0], configuration.positions[:, 1]
        return configuration.xp.sqrt(x * x + y * y)


@Signal.register("nclose")
class NeighborClose(Signal):
    """Closeness of the robots to each other (paper, equation 10)."""

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 1 - the mean distance to the others / (2 sqrt(X^2 + Y^2))."""
        return 1 + self.credit(configuration)

    def value(self, configuration: Configuration) -> Float[Array, "*batch"]:
        """Returns 1 - W_nclose sum ||P_i - P_j||: the sum is taken first."""
        robots = configuration.positions.shape[0]
        total = _sum(_sum(configuration.distances, axis=1))
        return 1 - total / (robots * (robots - 1) * 2 * _half_diagonal(configuration.world))

    def credit(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns the terms of every pair that the robot is part of."""
        others = configuration.positions.shape[0] - 1
        total = _sum(configuration.distances, axis=1)
        return -total / (others * 2 * _half_diagonal(configuration.world))


@Signal.register("safety")
class Safety(Signal):
    """How well the robots keep the safe distance (paper, equation 7), in the reading that `world.safety` names."""

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns 1 - sum sqrt(max(0, delta_s - d)) / sqrt(delta_s) over a robot's pairs; or the printed formula."""
        xp, world, between = configuration.xp, configuration.world, configuration.distances
        if world.safety == "penalty":
            charged = _sum(xp.sqrt(xp.maximum(world.safe_distance - between, 0)), axis=1)
            # The diagonal, at distance 0, was charged sqrt(safe_distance): given back here rather than masked above.
            return 2 - charged / world.safe_distance**0.5
        excess = between - world.safe_distance
        radicand = xp.where(excess >= 0, xp.maximum(world.safe_distance + world.radius - excess, 0), 0)
        scale = (world.safe_distance + world.radius) ** 0.5
        return _sum(xp.sqrt(radicand), axis=1) / ((between.shape[0] - 1) * scale)


@Signal.register("neighbors")
class Neighbors(Signal):
    """Share of the others that are neighbours (paper, equation 8)."""

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns G_all / (N - 1)."""
        return _row_share(configuration, configuration.neighbors)

    def value(self, configuration: Configuration) -> Float[Array, "*batch"]:
        """Returns W_neighbors sum G_all: pairs are counted first, which is exact."""
        return _pair_share(configuration, configuration.neighbors)


@Signal.register("visible")
class Visible(Signal):
    """Share of the others that are visible neighbours (paper, equation 9)."""

    def __call__(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns G_vis / (N - 1)."""
        return _row_share(configuration, configuration.visible)

    def value(self, configuration: Configuration) -> Float[Array, "*batch"]:
        """Returns W_visible sum G_vis: pairs are counted first, which is exact."""
        return _pair_share(configuration, configuration.visible)

    def credit(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns the pairs that the robot is part of, less those that it alone hides from each other."""
        xp, dtype = configuration.xp, configuration.positions.dtype
        seen = configuration.visible
        pairs = (xp.sum(seen, axis=1, dtype=dtype) + xp.sum(seen, axis=0, dtype=dtype)) / 2
        return (pairs - configuration.sole_occluder_counts / 2) / (seen.shape[0] - 1)


OBJECTIVES: dict[str, tuple[str, ...]] = {
    "C1": ("close", "safety", "neighbors", "visible"),
    "C2": ("nclose", "safety", "neighbors", "visible"),
    "custom": (),
}
"""The signals of each named objective: gathering at the origin (the paper's C1), anywhere (C2), or only one's own."""


def objective_signals(objective: str, signals: Mapping[str, Signal] | None = None) -> dict[str, Signal]:
    """Returns the signals of an objective by name, in the order in which they are recorded.

    Args:
        objective: C1, C2 or custom.
        signals: Further signals; one with the name of a signal of the objective replaces it.

    Raises:
        InputError: There is no objective of that name, or it has no signal at all.
    """
    check_choice("objective", objective, tuple(OBJECTIVES))
    known = Signal.registered()
    by_name: dict[str, Any] = {name: known[name]() for name in OBJECTIVES[objective]}
    by_name.update(signals or {})
    if not by_name:
        raise InputError("signals", {}, "one signal or more with the objective custom")
    return by_name


class Objective(eqx.Module):
    """The objective C: a weighted sum of signals (paper, equations 4 and 5).

    Attributes:
        signals: The signals by name.
        weights: The weight of each.
        names: The names in the order in which signals are recorded.
    """

    signals: dict[str, Signal]
    weights: dict[str, Any]
    names: tuple[str, ...] = eqx.field(static=True)

    __repr__ = short_repr

    def __init__(self, signals: Mapping[str, Signal], weights: Mapping[str, float] | None = None) -> None:
        """Builds the objective.

        Args:
            signals: The signals by name.
            weights: Weights that replace the signals' own.

        Raises:
            InputError: A weight is not a finite number >= 0, or is for a signal that the objective lacks.
        """
        check_type("signals", signals, Mapping, "signals by name")
        for name, signal in signals.items():
            check_type(f"signals.{name}", signal, Signal, "a signal")
        for name, weight in (weights or {}).items():
            if name not in signals:
                raise InputError(f"weights.{name}", weight, f"of a signal of the objective ({', '.join(signals)})")
            check_number(f"weights.{name}", weight, 0, MAX_MAGNITUDE)
        self.signals = dict(signals)
        self.weights = {name: (weights or {}).get(name, signal.weight) for name, signal in signals.items()}
        self.names = tuple(signals)

    @property
    def needs_landmark(self) -> bool:
        """Whether a signal is measured from the origin; see `Signal`."""
        return any(signal.needs_landmark for signal in self.signals.values())

    def measure(self, configuration: Configuration) -> dict[str, Float[Array, "*batch"]]:
        """Returns the signals of a configuration by name."""
        return {name: self.signals[name].value(configuration) for name in self.names}

    def credit(self, configuration: Configuration) -> Float[Array, "robots *batch"]:
        """Returns each robot's potential: the weighted sum of the signals' credits."""
        return self({name: signal.credit(configuration) for name, signal in self.signals.items()})

    def __call__(self, values: Mapping[str, Any]) -> Any:
        """Returns the weighted sum of values by the signals' names."""
        return sum(weight * values[name] for name, weight in self.weights.items())


def _sum(values: Any, axis: int = 0) -> Any:
    """Returns a sum over robots, always in the same order: XLA's own order depends on the size of the batch."""
    if not isinstance(values.shape[axis], int):  # in a program for swarms of any size
        return values.sum(axis=axis)
    return _batch_last.fold(operator.add, values, axis)


def _half_diagonal(world: WorldConfig) -> Any:
    return (world.half_width**2 + world.half_height**2) ** 0.5


def _row_share(configuration: Configuration, flags: Bool[Array, "robots robots *batch"]) -> Any:
    total = configuration.xp.sum(flags, axis=1, dtype=configuration.positions.dtype)
    return total / (flags.shape[0] - 1)


def _pair_share(configuration: Configuration, flags: Bool[Array, "robots robots *batch"]) -> Any:
    robots = flags.shape[0]
    return configuration.xp.sum(flags, axis=(0, 1), dtype=configuration.positions.dtype) / (robots * (robots - 1))
