"""Obstacles from the definition, of one configuration: shadows as polygons, distances between shapely's shapes."""

from __future__ import annotations

import numpy as np
import shapely


def clearances(positions: np.ndarray, radius: float, discs: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """Returns the gaps between robots and obstacles, `(robots, discs + walls)`."""
    return _gaps(shapely.points(np.asarray(positions, np.float64)), radius, discs, walls)


def approach(
    positions: np.ndarray, velocities: np.ndarray, radius: float, discs: np.ndarray, walls: np.ndarray
) -> np.ndarray:
    """Returns the least gaps during a step, `(robots, discs + walls)`: of the segments that centres move along."""
    positions = np.asarray(positions, np.float64)
    paths = shapely.linestrings(np.stack([positions, positions + np.asarray(velocities, np.float64)], axis=1))
    return _gaps(paths, radius, discs, walls)


def shadow_clearance(positions: np.ndarray, radius: float, discs: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """Measures how far each disc (second axis) keeps from the shadow of each obstacle, for each observer (first axis).

    Args:
        positions: Centres, `(robots, 2)`, outside of all obstacles.
        radius: Of the robots, world units.
        discs: `(discs, 3)`.
        walls: `(walls, 4)`, none of them in line with an observer.

    Returns:
        `(robots, robots, discs + walls)`, world units: negative where the disc reaches into the shadow; inf on the
        diagonal.
    """
    positions = np.asarray(positions, np.float64)
    reach = 1e3 * (np.abs(positions).max() + np.abs(discs).max(initial=1.0) + np.abs(walls).max(initial=1.0))
    centres, robots = shapely.points(positions), len(positions)
    result = np.full((robots, robots, len(discs) + len(walls)), np.inf)
    for k, light in enumerate(positions):
        edges = [_touching(light, disc) for disc in discs] + [wall.reshape(2, 2) - light for wall in walls]
        for number, (first, second) in enumerate(edges):
            # Between the two rays from the light, beyond the segment between their ends; its far edges are far.
            far = [point / np.linalg.norm(point) for point in (first, second)]
            middle = far[0] + far[1]
            corners = [first, reach * far[0], reach * middle / np.linalg.norm(middle), reach * far[1], second]
            shadow = shapely.Polygon(np.array(corners) + light)
            result[k, :, number] = shapely.distance(shadow, centres) - radius
        result[k, k] = np.inf
    return result


def _touching(light: np.ndarray, disc: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns where the two tangents from a light touch a disc, relative to the light."""
    towards = disc[:2] - light
    distance = np.hypot(*towards)
    angle, length = np.arcsin(disc[2] / distance), np.sqrt(distance**2 - disc[2] ** 2)
    direction = np.arctan2(towards[1], towards[0])
    return tuple(length * np.array([np.cos(turn), np.sin(turn)]) for turn in (direction + angle, direction - angle))


def _gaps(shapes: np.ndarray, radius: float, discs: np.ndarray, walls: np.ndarray) -> np.ndarray:
    discs, walls = np.asarray(discs, np.float64), np.asarray(walls, np.float64)
    from_discs = shapely.distance(shapes[:, None], shapely.points(discs[:, :2])[None]) - discs[:, 2]
    from_walls = shapely.distance(shapes[:, None], shapely.linestrings(walls.reshape(-1, 2, 2))[None])
    return np.concatenate([from_discs, from_walls], axis=1) - radius
