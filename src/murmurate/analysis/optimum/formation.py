"""The target of a search: the signals, the objective and the validity of a formation of robots at rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from murmurate.discovery.validity import check_pattern
from murmurate.errors import check_choice
from murmurate.representation import short_repr
from murmurate.world import OBJECTIVES, Configuration, Objective, WorldConfig, objective_signals

__all__ = ["Target"]

Points = Float[np.ndarray, "robots 2"]


@dataclass(frozen=True)
class Target:
    """An objective of the paper in a world, by which formations are compared.

    Attributes:
        world: Sizes of the world and its robots.
        objective: C1 (gathering at the origin) or C2 (at no predefined point).
        weights: Weights of the signals by name, gathering for close or nclose; the paper's are all 1.
    """

    world: WorldConfig
    objective: str
    weights: Mapping[str, float] = field(default_factory=dict)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_choice("objective", self.objective, ("C1", "C2"))

    @property
    def gathering(self) -> str:
        """The name of the gathering signal."""
        return OBJECTIVES[self.objective][0]

    def weight(self, signal: str) -> float:
        """Returns the weight of a signal; gathering is that of close or nclose."""
        default = self.weights.get("gathering", 1.0) if signal in (self.gathering, "gathering") else 1.0
        return self.weights.get(self.gathering if signal == "gathering" else signal, default)

    def signals(self, positions: Float[np.ndarray, "*batch robots 2"]) -> dict[str, Float[Any, "*batch"]]:
        """Returns the signals of the objective by name, in float64.

        Args:
            positions: One configuration, or a batch of them, batch first; world units.
        """
        batch_last = np.moveaxis(np.asarray(positions, float), (-2, -1), (0, 1))
        return self._objective().measure(Configuration(batch_last, self.world))

    def value(self, positions: Points) -> float:
        """Returns the weighted objective of one configuration, in float64."""
        return float(self.score_batch_last(np.asarray(positions, float)))

    def score_batch_last(self, positions: Float[Any, "robots 2 *batch"]) -> Float[Any, "*batch"]:
        """Returns the weighted objective of configurations, in their library and precision; for the annealer."""
        objective = self._objective()
        return objective(objective.measure(Configuration(positions, self.world)))

    def is_valid(self, positions: Points) -> bool:
        """Returns whether a configuration at rest is a valid pattern: gathered, mutually visible, safe and inside."""
        return all(holds.all() for holds in check_pattern(np.asarray(positions, float)[None], self.world).values())

    def _objective(self) -> Objective:
        signals = objective_signals(self.objective)
        return Objective(signals, {name: self.weight(name) for name in signals})
