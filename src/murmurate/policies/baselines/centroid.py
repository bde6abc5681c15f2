"""Straight to the middle: gathering, and nothing else."""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx
from jaxtyping import Array, Float

from murmurate.policies.baselines.avoidance import avoiding
from murmurate.policies.baselines.sight import mean_of_seen, sight
from murmurate.types import Observation
from murmurate.world.config import WorldConfig

__all__ = ["Centroid"]

GAIN = 0.5
"""Share of the way that is left to do in one step, where the speed limit allows."""


class Centroid(eqx.Module):
    """Moves to the gathering point, or to the centroid of those seen, as near as the safe distance allows."""

    title: ClassVar[str] = "Centroid"
    centralised: ClassVar[bool] = False
    deviations: ClassVar[str] = ""
    world: WorldConfig = eqx.field(static=True)
    landmark: bool = eqx.field(static=True)

    def __call__(self, observation: Observation) -> Float[Array, "robots 2 *batch"]:
        """Returns velocities in each robot's own frame, world units per step."""
        seen = sight(observation.view, self.world)
        x, y = (seen.point_x, seen.point_y) if self.landmark else mean_of_seen(seen)
        return avoiding(GAIN * x, GAIN * y, seen, self.world)
