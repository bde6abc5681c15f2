"""Is what was reached a valid pattern, and how well was it reached? All in float64, from recorded positions alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from murmurate.discovery.cascade import Trajectories
from murmurate.geometry import collides, distances, leaves, neighbors_and_visible
from murmurate.world import WorldConfig

__all__ = ["Validity", "bound_steps", "check_validity"]


@dataclass(frozen=True)
class Validity:
    """What holds of each episode (design: valid pattern).

    Attributes:
        collision_free: No two discs touched at any moment, and nobody left the world.
        mutually_visible: Every robot sees every other at the end (as a neighbour that nobody occludes).
        gathered: Every robot neighbours every other at the end.
        safe: No pair is nearer than the safe distance at the end.
        at_rest: The last policy came to rest.
    """

    collision_free: Bool[np.ndarray, " episodes"]
    mutually_visible: Bool[np.ndarray, " episodes"]
    gathered: Bool[np.ndarray, " episodes"]
    safe: Bool[np.ndarray, " episodes"]
    at_rest: Bool[np.ndarray, " episodes"]

    @property
    def valid(self) -> Bool[np.ndarray, " episodes"]:
        """All of them together: a valid pattern."""
        return self.collision_free & self.mutually_visible & self.gathered & self.safe & self.at_rest


def check_validity(trajectories: Trajectories, world: WorldConfig) -> Validity:
    """Judges every episode by its recorded positions."""
    final = np.moveaxis(trajectories.final.astype(float), 0, -1)
    others = ~np.eye(world.robots, dtype=bool)
    near, seen = (flags[others].all(axis=0) for flags in neighbors_and_visible(final, world.radius, world.scan_radius))
    return Validity(
        collision_free=_collision_free(trajectories.positions, world),
        mutually_visible=seen,
        gathered=near,
        safe=(distances(final)[others] >= world.safe_distance).all(axis=0),
        at_rest=trajectories.at_rest,
    )


def _collision_free(positions: Float[np.ndarray, "episodes time robots 2"], world: WorldConfig) -> np.ndarray:
    free = np.ones(positions.shape[0], bool)
    now = np.moveaxis(positions[:, 0].astype(float), 0, -1)
    for step in range(1, positions.shape[1]):
        after = np.moveaxis(positions[:, step].astype(float), 0, -1)
        free &= ~collides(now, after - now, world.radius) & ~leaves(after, world.half_width, world.half_height)
        now = after
    return free


def bound_steps(start: Float[np.ndarray, "robots 2"], final: Float[np.ndarray, "robots 2"], max_speed: float) -> float:
    """The kinematic bound: the fewest steps in which any controller gets from a start to a pattern.

    Robots are interchangeable and each velocity component is bounded, so it is the bottleneck assignment of the
    max-component distances, over the speed limit.

    Returns:
        Steps, not rounded.
    """
    cost = np.abs(start.astype(float)[:, None] - final.astype(float)[None]).max(axis=2)
    values = np.unique(cost)
    low, high = 0, len(values) - 1
    while low < high:
        middle = (low + high) // 2
        matching = maximum_bipartite_matching(csr_array(cost <= values[middle]))
        low, high = (low, middle) if (matching >= 0).all() else (middle + 1, high)
    return float(values[low] / max_speed)
