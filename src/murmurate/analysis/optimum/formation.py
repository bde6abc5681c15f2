"""What a formation is measured by, robots at rest: signals, objective, and whether it is a valid pattern."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from murmurate.geometry import distances, neighbors_and_visible
from murmurate.world import OBJECTIVES, Objective, WeightsConfig, WorldConfig, signals

__all__ = ["Target"]

Points = Float[np.ndarray, "robots 2"]


@dataclass(frozen=True)
class Target:
    """An objective in a world: by what formations are compared.

    Attributes:
        world: Sizes.
        objective: C1 (gathering at the origin) or C2 (at no predefined point).
        weights: Weights of the signals; the paper's are all 1.
    """

    world: WorldConfig
    objective: str
    weights: WeightsConfig = field(default_factory=WeightsConfig)

    @property
    def gathering(self) -> str:
        """The name of the gathering signal."""
        return OBJECTIVES[self.objective]

    def signals(self, positions: Float[np.ndarray, "robots 2 *batch"]) -> dict[str, Float[np.ndarray, "*batch"]]:
        """Measures configurations by the objective's signals; NumPy or JAX, as they come."""
        world = self.world
        return signals(
            positions,
            gathering=self.gathering,
            half_width=world.half_width,
            half_height=world.half_height,
            radius=world.radius,
            scan_radius=world.scan_radius,
            safe_distance=world.safe_distance,
            safety=world.safety,
        )

    def value(self, positions: Points) -> float:
        """Returns the weighted objective of one configuration, in float64."""
        return float(Objective.create(self.objective, self.weights)(self.signals(np.asarray(positions, float))))

    def is_valid(self, positions: Points) -> bool:
        """Says whether a configuration would be a valid pattern: gathered, mutually visible, safe, inside the world."""
        world, positions = self.world, np.asarray(positions, float)
        other = ~np.eye(len(positions), dtype=bool)
        near, seen = neighbors_and_visible(positions, world.radius, world.scan_radius)
        safe = distances(positions) >= world.safe_distance
        inside = np.abs(positions) <= np.array([world.half_width, world.half_height])
        return bool((near & seen & safe)[other].all() and inside.all())
