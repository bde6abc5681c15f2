"""The paper's signals, each normalised so that 1 is its best, and the objective: their weighted sum.

Like the geometry, these kernels take `(robots, 2, *batch)` and work in NumPy or JAX, whichever they are given.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import equinox as eqx
from jaxtyping import Bool, Float

from murmurate.errors import GREATEST, InputError, check_number
from murmurate.geometry import distances, hides, neighbors_and_visible
from murmurate.geometry.visibility import Array, as_configuration

__all__ = ["OBJECTIVES", "Objective", "WeightsConfig", "gathering_signal", "shares", "signal_names", "signals"]

OBJECTIVES = {"C1": "close", "C2": "nclose"}
"""The gathering signal of each objective: at the origin (the paper's C1) or at no predefined point (C2)."""


@dataclass(frozen=True)
class WeightsConfig:
    """Weights of the objective's signals; the paper's are all 1.

    Attributes:
        gathering: Weight of the gathering signal: close (C1) or nclose (C2).
        safety: Weight of the safety signal.
        neighbors: Weight of the neighbors signal.
        visible: Weight of the visible signal.
    """

    gathering: float = 1.0
    safety: float = 1.0
    neighbors: float = 1.0
    visible: float = 1.0

    def __post_init__(self) -> None:
        for name in ("gathering", "safety", "neighbors", "visible"):
            check_number(name, getattr(self, name), 0, GREATEST)


class Objective(eqx.Module):
    """The objective C: a weighted sum of signals (paper, equations 4 and 5)."""

    gathering: str = eqx.field(static=True)
    weights: dict[str, Any]

    @classmethod
    def create(cls, name: str, weights: WeightsConfig) -> Objective:
        """Builds objective C1 or C2 with the given weights.

        Raises:
            InputError: There is no objective of that name.
        """
        gathering = gathering_signal(name)
        return cls(
            gathering=gathering,
            weights={
                gathering: weights.gathering,
                "safety": weights.safety,
                "neighbors": weights.neighbors,
                "visible": weights.visible,
            },
        )

    def __call__(self, values: dict[str, Array]) -> Float[Array, "*batch"]:
        """Returns the objective of the named signals."""
        return sum(weight * values[name] for name, weight in self.weights.items())  # type: ignore[return-value]


def gathering_signal(objective: str) -> str:
    """Returns the name of an objective's gathering signal.

    Raises:
        InputError: There is no objective of that name.
    """
    if objective not in OBJECTIVES:
        raise InputError("objective", objective, f"one of {', '.join(OBJECTIVES)}")
    return OBJECTIVES[objective]


def signal_names(objective: str) -> tuple[str, str, str, str]:
    """Returns the names of an objective's signals, in the order in which they are recorded."""
    return (gathering_signal(objective), "safety", "neighbors", "visible")


def signals(
    positions: Float[Array, "robots 2 *batch"],
    *,
    gathering: str,
    half_width: float,
    half_height: float,
    radius: float,
    scan_radius: float,
    safe_distance: float,
    safety: str = "penalty",
) -> dict[str, Float[Array, "*batch"]]:
    """Measures a configuration by the signals of one objective (paper, equations 6 to 10).

    Args:
        positions: Centres of the robots, world units.
        gathering: `close` (nearness to the origin) or `nclose` (nearness to each other).
        half_width: The world's X.
        half_height: The world's Y.
        radius: The paper's R_bot.
        scan_radius: The paper's R_scan.
        safe_distance: The paper's delta_s, between centres.
        safety: Reading of F_safe: `penalty` charges what lies inside the safe distance, `shell` is the printed formula
            with its radicand floored at zero.

    Returns:
        The signals by name.
    """
    xp, positions = as_configuration(positions)
    robots = positions.shape[0]
    pairs = robots * (robots - 1)
    reach = (half_width**2 + half_height**2) ** 0.5
    between = distances(positions)
    near, seen = neighbors_and_visible(positions, radius, scan_radius)
    if gathering == "close":
        gathered = 1 - xp.sum(xp.sqrt(xp.sum(positions**2, axis=1)), axis=0) / (robots * reach)
    else:
        gathered = 1 - xp.sum(between, axis=(0, 1)) / (pairs * 2 * reach)
    return {
        gathering: gathered,
        "safety": _safety(xp, between, radius, safe_distance, safety),
        "neighbors": _fraction(xp, near, positions, pairs),
        "visible": _fraction(xp, seen, positions, pairs),
    }


def shares(
    positions: Float[Array, "robots 2 *batch"],
    *,
    gathering: str,
    half_width: float,
    half_height: float,
    radius: float,
    scan_radius: float,
    safe_distance: float,
    safety: str = "penalty",
) -> dict[str, Float[Array, "robots *batch"]]:
    """Measures what each robot contributes to every signal: all of the signal's terms that depend on where it is.

    These are difference rewards (Wolpert and Tumer, 2002), up to a constant and the factor N / 2: when one robot moves,
    its share of a signal changes by N / 2 times what the signal itself changes by. (A term of the sum belongs to both
    robots of its pair, so the mean share is the signal; hence the factor.) A pair's visibility belongs to the pair and
    to whoever alone hides it.

    Args:
        positions: Centres of the robots, world units.
        gathering: As of `signals`, like every other argument.
        half_width: The world's X.
        half_height: The world's Y.
        radius: The paper's R_bot.
        scan_radius: The paper's R_scan.
        safe_distance: The paper's delta_s.
        safety: Reading of F_safe.

    Returns:
        The shares by name.
    """
    xp, positions = as_configuration(positions)
    robots = positions.shape[0]
    reach = (half_width**2 + half_height**2) ** 0.5
    between = distances(positions)
    near, seen = neighbors_and_visible(positions, radius, scan_radius)
    if gathering == "close":
        gathered = -xp.sqrt(xp.sum(positions**2, axis=1)) / (2 * reach)
    else:
        gathered = -xp.sum(between, axis=1) / ((robots - 1) * 2 * reach)
    dtype = positions.dtype
    own = (xp.sum(seen, axis=1, dtype=dtype) + xp.sum(seen, axis=0, dtype=dtype)) / 2
    return {
        gathering: gathered,
        "safety": _safety_terms(xp, between, radius, safe_distance, safety),
        "neighbors": xp.sum(near, axis=1, dtype=dtype) / (robots - 1),
        "visible": (own - hides(positions, radius, scan_radius) / 2) / (robots - 1),
    }


def _fraction(xp: Any, flags: Bool[Array, "robots robots *batch"], like: Any, pairs: int) -> Any:
    return xp.sum(flags, axis=(0, 1), dtype=like.dtype) / pairs


def _safety(xp: Any, between: Any, radius: float, safe_distance: float, reading: str) -> Any:
    return xp.mean(_safety_terms(xp, between, radius, safe_distance, reading), axis=0)


def _safety_terms(xp: Any, between: Any, radius: float, safe_distance: float, reading: str) -> Any:
    """What each robot's pairs add to the safety signal, so that the signal is their mean."""
    robots = between.shape[0]
    if reading == "penalty":
        charged = xp.sum(xp.sqrt(xp.maximum(safe_distance - between, 0)), axis=1)
        # The diagonal, at distance 0, was charged sqrt(safe_distance): give it back rather than mask it.
        return 2 - charged / safe_distance**0.5
    excess = between - safe_distance
    inside = xp.where(excess >= 0, xp.maximum(safe_distance + radius - excess, 0), 0)
    return xp.sum(xp.sqrt(inside), axis=1) / ((robots - 1) * (safe_distance + radius) ** 0.5)
