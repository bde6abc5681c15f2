"""How near robots come during one step, and whether they stay in the world, as distances between shapely's shapes."""

from __future__ import annotations

import numpy as np
import shapely


def closest_approach(positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
    """Returns the least distance of each pair of centres during one step, `(*batch, robots, robots)`.

    Seen from one robot the other moves along a segment; the closest approach is the segment's distance from the origin.
    """
    positions, velocities = np.asarray(positions, np.float64), np.asarray(velocities, np.float64)
    begin = positions[..., None, :, :] - positions[..., :, None, :]
    end = begin + (velocities[..., None, :, :] - velocities[..., :, None, :])
    return shapely.distance(shapely.linestrings(np.stack([begin, end], -2)), shapely.Point(0, 0))


def leaves(positions: np.ndarray, half_width: float, half_height: float) -> np.ndarray:
    """Returns whether any centre is outside the closed rectangle, `(*batch,)`."""
    world = shapely.box(-half_width, -half_height, half_width, half_height)
    return ~shapely.covers(world, shapely.points(np.asarray(positions, np.float64))).all(-1)
