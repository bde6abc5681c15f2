"""The best-known patterns: a table in the package, whose values are computed again from the positions when it is read.

`make optima` searches again and writes the table; docs/patterns.md explains it, and what is proved.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
from jaxtyping import Float

from murmurate.analysis.optimum.formation import Target
from murmurate.errors import MAX_MAGNITUDE, InputError, check_choice, check_number
from murmurate.representation import short_repr
from murmurate.world import OBJECTIVES, WorldConfig

__all__ = ["TABLE", "BestKnown", "best_known", "is_record", "load", "to_json"]

TABLE = "best_known.json"

RECORD_MARGIN = 1e-6
"""A record is better by more than this, since runs record positions in float32."""


@dataclass(frozen=True, eq=False)
class BestKnown:
    """One entry of the table.

    It has no `WorldConfig`: the table records no speed limit, because a pattern at rest has none.

    Attributes:
        robots: Swarm size.
        objective: C1 or C2.
        radius: The paper's R_bot.
        safe_distance: The paper's delta_s.
        scan_radius: The paper's R_scan.
        half_width: X of the world in which `value` is measured; the pattern itself fits other worlds too.
        half_height: Its Y.
        value: The objective, all weights 1.
        signals: Its signals by name.
        positions: Centres, world units.
        command: The command that found it.
        hop: The value that basin hopping reached, a check by another method; None where it was not tried.
    """

    robots: int
    objective: str
    radius: float
    safe_distance: float
    scan_radius: float
    half_width: float
    half_height: float
    value: float
    signals: Mapping[str, float]
    positions: Float[np.ndarray, "robots 2"]
    command: str
    hop: float | None = None

    __repr__ = short_repr

    @classmethod
    def from_target(
        cls, target: Target, positions: Float[np.ndarray, "robots 2"], command: str, hop: float | None = None
    ) -> BestKnown:
        """Returns the entry of a pattern."""
        sizes = {name: getattr(target.world, name) for name in _SIZES}
        return cls(
            objective=target.objective,
            value=target.value(positions),
            signals=_measured(target, positions),
            positions=np.asarray(positions),
            command=command,
            hop=hop,
            **sizes,
        )

    @classmethod
    def from_dict(cls, entry: Any) -> BestKnown:
        """Reads an entry and computes its values again.

        Raises:
            InputError: A field is missing or unknown, or a value is not that of the positions.
        """
        names = {field.name for field in dataclasses.fields(cls)}
        if not isinstance(entry, dict) or set(entry) != names:
            raise InputError("pattern", sorted(entry) if isinstance(entry, dict) else entry, f"{sorted(names)}")
        check_choice("objective", entry["objective"], tuple(OBJECTIVES))
        sizes = WorldConfig(**{name: entry[name] for name in _SIZES})
        try:
            positions = np.array(entry["positions"], float)
        except (TypeError, ValueError, OverflowError):
            positions = np.empty(0)
        if positions.shape != (sizes.robots, 2) or not (np.abs(positions) <= MAX_MAGNITUDE).all():
            raise InputError("positions", positions.shape, f"finite numbers of shape ({sizes.robots}, 2)")
        if not isinstance(entry["signals"], dict):
            raise InputError("signals", entry["signals"], "an object with the signals by name")
        for name, value in entry["signals"].items():
            check_number(f"signals.{name}", value, -MAX_MAGNITUDE, MAX_MAGNITUDE)
        if entry["hop"] is not None:
            check_number("hop", entry["hop"], -MAX_MAGNITUDE, MAX_MAGNITUDE)
        if not isinstance(entry["command"], str):
            raise InputError("command", entry["command"], "text")
        known = cls(**{**entry, "positions": positions})
        if not isinstance(known.value, float) or abs(known.target.value(positions) - known.value) > 1e-12:
            raise InputError("value", known.value, f"{known.target.value(positions)!r}, as its positions have")
        measured = _measured(known.target, positions)
        given = known.signals
        if given.keys() != measured.keys() or any(abs(given[name] - measured[name]) > 1e-8 for name in given):
            raise InputError("signals", known.signals, f"{measured}, as its positions have")
        return known

    @property
    def target(self) -> Target:
        """The objective that the entry is best for, in its world; nothing in it depends on the speed limit."""
        return Target(WorldConfig(**{name: getattr(self, name) for name in _SIZES}), self.objective)

    def to_dict(self) -> dict[str, Any]:
        """Returns the entry as a dictionary for JSON."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)} | {
            "positions": self.positions.tolist()
        }

    def scaled(self, safe_distance: float) -> Float[np.ndarray, "robots 2"]:
        """Returns the positions for another safe distance (and the radius in the same ratio to it)."""
        return self.positions * (safe_distance / self.safe_distance)


def _measured(target: Target, positions: Float[np.ndarray, "robots 2"]) -> dict[str, float]:
    """Returns the signals, rounded, since their last bits differ between machines."""
    signals = target.signals(np.asarray(positions, float))
    return {name: round(float(value), 9) for name, value in signals.items()}


_SIZES = ("robots", "radius", "safe_distance", "scan_radius", "half_width", "half_height")


@functools.cache
def load() -> tuple[BestKnown, ...]:
    """Reads the table of the package."""
    text = resources.files("murmurate.analysis.optimum").joinpath(TABLE).read_text("utf-8")
    return tuple(BestKnown.from_dict(entry) for entry in json.loads(text))


def to_json(entries: Iterable[BestKnown]) -> str:
    """Returns entries as text that `load` reads, one line each."""
    lines = ",\n".join(json.dumps(entry.to_dict(), allow_nan=False) for entry in entries)
    return f"[\n{lines}\n]\n"


def best_known(target: Target) -> float | None:
    """Returns the greatest objective that a known valid pattern has in a world.

    Args:
        target: The world and the objective; all weights 1 and the `penalty` reading of safety, like the table.

    Returns:
        The objective; None for other weights, and for sizes whose proportions no entry has.
    """
    world = target.world
    if any(target.weight(name) != 1 for name in OBJECTIVES[target.objective]) or world.safety != "penalty":
        return None
    values = [
        target.value(positions)
        for entry in load()
        if (entry.robots, entry.objective) == (world.robots, target.objective)
        and math.isclose(entry.radius * world.safe_distance, world.radius * entry.safe_distance, rel_tol=1e-9)
        # Scaled, a distance may round to just below the safe one, so the pattern is made slightly wider.
        and target.is_valid(positions := entry.scaled(world.safe_distance * (1 + 1e-12)))
    ]
    return max(values, default=None)


def is_record(target: Target, value: float) -> bool:
    """Returns whether the objective of a valid pattern is better than the best known one."""
    known = best_known(target)
    return known is not None and value > known + RECORD_MARGIN
