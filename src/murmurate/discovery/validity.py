"""Whether what was reached is a valid pattern, and how fast any controller could have reached it.

Everything is computed in float64 from recorded positions alone; the sides of the world are those that it steps with.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from murmurate.errors import InputError, check_number, check_type
from murmurate.geometry import _batch_last
from murmurate.geometry._checks import check_vectors
from murmurate.representation import short_repr
from murmurate.types import Trajectories
from murmurate.world import Configuration, Signal, WorldConfig, check_world

__all__ = [
    "REPLACED",
    "Validity",
    "bound_steps",
    "check_pattern",
    "check_validity",
    "contact_free_and_inside",
    "is_valid_pattern",
    "replaced_conditions",
]

Flags = Bool[np.ndarray, " episodes"]

REPLACED = {"visible": "mutually_visible", "neighbors": "gathered", "safety": "safe"}
"""Each of these conditions says that a signal of the paper is at its best. A threshold of that signal replaces it, so
that a problem may ask for less: 0.5 for half of the pairs, 0 for none."""

DRIFT = 0.25
"""Radii that a robot ends from where it came to rest, at most, in a pattern that is stationary."""


@dataclass(frozen=True, eq=False)
class Validity:
    """Which conditions of a valid pattern hold in each episode.

    Attributes:
        contact_free: No two discs touched at any moment.
        inside: No robot left the world.
        mutually_visible: Every robot sees every other at the end (as a neighbour that nothing occludes).
        gathered: Every robot neighbours every other at the end.
        safe: No pair is nearer than the safe distance at the end.
        at_rest: The last policy came to rest.
        stationary: A pattern formed and stayed: after rest, executed for `STATIONARY_STEPS` more steps with nothing
            frozen, all other conditions hold at every one of them, and no robot ends farther than a quarter of its
            radius from where it came to rest. False where that was not recorded: nobody has seen the pattern stay.
        signals: Whether each signal with a threshold reaches it at the end, by name. In a valid pattern the signals of
            `REPLACED` stand for their conditions.
    """

    contact_free: Flags
    inside: Flags
    mutually_visible: Flags
    gathered: Flags
    safe: Flags
    at_rest: Flags
    stationary: Flags
    signals: Mapping[str, Flags] = field(default_factory=dict)

    __repr__ = short_repr

    @property
    def formed(self) -> Flags:
        """Whether a pattern formed: all of them but that it stayed."""
        names = ("contact_free", "inside", "mutually_visible", "gathered", "safe", "at_rest")
        required = [getattr(self, name) for name in names if name not in self.replaced]
        return np.logical_and.reduce([*required, *self.signals.values()])

    @property
    def replaced(self) -> frozenset[str]:
        """The conditions that a threshold replaces."""
        return replaced_conditions(self.signals)

    @property
    def valid(self) -> Flags:
        """Whether all of them hold: a valid pattern."""
        return self.formed & self.stationary


def replaced_conditions(signals: Iterable[str]) -> frozenset[str]:
    """Returns the conditions of a valid pattern that thresholds of signals replace, by the signals' names."""
    return frozenset(REPLACED[name] for name in signals if name in REPLACED)


def check_validity(
    trajectories: Trajectories, world: WorldConfig, thresholds: Mapping[str, tuple[Signal, float]] | None = None
) -> Validity:
    """Returns which conditions of a valid pattern hold in each recorded episode.

    Args:
        trajectories: The episodes.
        world: Sizes of the world and its robots.
        thresholds: Signals with the least values that a valid pattern must reach, by name; see `Problem.thresholds`.

    Raises:
        InputError: The episodes are those of another number of robots, or not of one shape.
    """
    check_type("trajectories", trajectories, Trajectories, "trajectories, such as run.rollout(20)")
    check_world(world)
    _check(trajectories, world)
    thresholds = {} if thresholds is None else thresholds
    _check_thresholds(thresholds)
    contact_free, inside = contact_free_and_inside(trajectories.positions, world)
    pattern = check_pattern(trajectories.final, world, thresholds)
    validity = Validity(
        contact_free=contact_free,
        inside=inside,
        mutually_visible=pattern["mutually_visible"],
        gathered=pattern["gathered"],
        safe=pattern["safe"],
        at_rest=trajectories.at_rest,
        stationary=np.zeros(len(contact_free), bool),
        signals={name: pattern[f"signals.{name}"] for name in thresholds},
    )
    return replace(validity, stationary=_stationary(trajectories, validity.formed, world, thresholds))


def check_pattern(
    configurations: Float[np.ndarray, "episodes robots 2"],
    world: WorldConfig,
    thresholds: Mapping[str, tuple[Signal, float]] | None = None,
) -> dict[str, Flags]:
    """Returns which conditions of a valid pattern hold of configurations, whatever led to them.

    Args:
        configurations: Centres, world units.
        world: Sizes of the world and its robots.
        thresholds: Signals with the least values that a valid pattern must reach, by name.

    Returns:
        The conditions of `Validity` that a configuration alone decides, by name; those of signals as `signals.` and a
        name. A configuration at rest is a valid pattern where all of them hold that no threshold replaces.
    """
    positions = np.moveaxis(configurations.astype(float), 0, -1)
    others = ~np.eye(len(positions), dtype=bool)
    near, seen = _batch_last.neighbors_and_visible(positions, world.radius, world.scan_radius)
    configuration = Configuration(positions, world)
    return {
        "inside": ~_batch_last.any_outside(positions, *world.limits),
        "mutually_visible": seen[others].all(axis=0),
        "gathered": near[others].all(axis=0),
        "safe": (_batch_last.distances(positions)[others] >= world.safe_distance).all(axis=0),
        **{
            f"signals.{name}": np.asarray(signal.value(configuration)) >= least
            for name, (signal, least) in (thresholds or {}).items()
        },
    }


def is_valid_pattern(
    positions: Float[np.ndarray, "configurations robots 2"],
    world: WorldConfig,
    thresholds: Mapping[str, tuple[Signal, float]] | None = None,
) -> Flags:
    """Returns which configurations are valid patterns; see `check_pattern`, whose conditions thresholds may replace."""
    flags, replaced = check_pattern(positions, world, thresholds), replaced_conditions(thresholds or {})
    return np.logical_and.reduce([flag for name, flag in flags.items() if name not in replaced])


def _stationary(
    trajectories: Trajectories, formed: Flags, world: WorldConfig, thresholds: Mapping[str, tuple[Signal, float]]
) -> Flags:
    """Returns which of the patterns that formed stayed."""
    if trajectories.after_rest is None:
        return np.zeros_like(formed)
    moves = np.concatenate([trajectories.final[:, None], trajectories.after_rest], axis=1)
    contact_free, inside = contact_free_and_inside(moves, world)
    drift = np.linalg.norm(moves[:, -1].astype(float) - moves[:, 0], axis=-1).max(axis=-1)
    stationary = formed & contact_free & inside & (drift <= DRIFT * world.radius)
    for step in range(1, moves.shape[1]):
        changed = np.flatnonzero(stationary & (moves[:, step] != moves[:, step - 1]).any(axis=(1, 2)))
        if len(changed):
            stationary[changed] = is_valid_pattern(moves[changed, step], world, thresholds)
    return stationary


def _check(trajectories: Trajectories, world: WorldConfig) -> None:
    """Checks that the episodes can be those of a world, and that there are as many of everything."""
    arrays = {"positions": ("fiu", "real numbers"), "at_rest": ("b", "booleans"), "after_rest": ("fiu", "real numbers")}
    for name, (kinds, what) in arrays.items():
        array = getattr(trajectories, name)
        if array is None and name == "after_rest":
            continue
        if not isinstance(array, np.ndarray) or array.dtype.kind not in kinds:
            given = f"an array of {array.dtype}" if isinstance(array, np.ndarray) else array
            raise InputError(f"trajectories.{name}", given, f"a NumPy array of {what}")
    shape = np.shape(trajectories.positions)
    if len(shape) != 4 or shape[1] == 0 or shape[2:] != (world.robots, 2):
        allowed = f"of shape (episodes, steps + 1, {world.robots}, 2), as in the world"
        raise InputError("trajectories.positions", f"an array {shape}", allowed)
    if np.shape(trajectories.at_rest) != shape[:1]:
        rest = f"an array {np.shape(trajectories.at_rest)}"
        raise InputError("trajectories.at_rest", rest, f"of shape {shape[:1]}, one for each episode")
    after = shape if trajectories.after_rest is None else np.shape(trajectories.after_rest)
    if len(after) != 4 or (after[0], *after[2:]) != (shape[0], *shape[2:]):
        allowed = f"of shape ({shape[0]}, steps, {world.robots}, 2)"
        raise InputError("trajectories.after_rest", f"an array {after}", allowed)


def _check_thresholds(thresholds: Mapping[str, tuple[Signal, float]]) -> None:
    """Checks the signals that a valid pattern must reach, and their least values."""
    check_type("thresholds", thresholds, Mapping, "a mapping from names to pairs of a signal and its least value")
    for name, pair in thresholds.items():
        field = f"thresholds[{name!r}]"
        if not isinstance(pair, tuple | list) or len(pair) != 2 or not isinstance(pair[0], Signal):
            raise InputError(field, pair, "a pair of a signal and its least value")
        check_number(field, pair[1])


def contact_free_and_inside(
    positions: Float[np.ndarray, "episodes time robots 2"], world: WorldConfig
) -> tuple[Flags, Flags]:
    """Returns in which episodes no two discs touch at any moment, and in which no robot leaves the world.

    Every step is followed along its straight lines. Both hold only where no position is NaN.

    Args:
        positions: Centres, world units, at every step.
        world: Sizes of the world and its robots.
    """
    contact_free = ~np.asarray(np.isnan(positions).any(axis=(1, 2, 3)))
    inside = contact_free.copy()
    # Step by step, because all positions in float64 would take twice the memory of the record.
    now = np.moveaxis(positions[:, 0].astype(float), 0, -1)
    for step in range(1, positions.shape[1]):
        after = np.moveaxis(positions[:, step].astype(float), 0, -1)
        contact_free &= ~_batch_last.any_contact(now, after - now, world.radius)
        inside &= ~_batch_last.any_outside(after, *world.limits)
        now = after
    return contact_free, inside


def bound_steps(start: Float[np.ndarray, "robots 2"], final: Float[np.ndarray, "robots 2"], max_speed: float) -> float:
    """Returns the kinematic bound: the fewest steps in which any controller gets from a start to a pattern.

    Robots are interchangeable and each velocity component is bounded, so it is the bottleneck assignment of the
    max-component distances, over the speed limit.

    Returns:
        Steps, not rounded.

    Raises:
        InputError: The configurations are not of one shape, or the speed is no number > 0.
    """
    start, final = (np.asarray(check_vectors(*pair)[1], float) for pair in (("start", start), ("final", final)))
    if start.ndim != 2 or final.shape != start.shape:
        raise InputError("final", final.shape, f"of the shape of the start, (robots, 2), which is {start.shape}")
    check_number("max_speed", max_speed, 0, exclusive_low=True)
    cost = np.abs(start[:, None] - final[None]).max(axis=2)
    values = np.unique(cost)
    low, high = 0, len(values) - 1
    while low < high:
        middle = (low + high) // 2
        matching = maximum_bipartite_matching(csr_array(cost <= values[middle]))
        low, high = (low, middle) if (matching >= 0).all() else (middle + 1, high)
    return float(values[low] / max_speed)
