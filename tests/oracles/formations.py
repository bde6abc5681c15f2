"""How exact a formation is, robot by robot: plain loops and linear algebra of NumPy, in float64."""

from __future__ import annotations

import itertools
import math

import numpy as np


def gaps_around(positions, point):
    """Returns for each robot the angles to its predecessor and its successor around a point."""
    angles = [math.atan2(y - point[1], x - point[0]) for x, y in positions]
    turn = sorted(range(len(angles)), key=lambda robot: angles[robot])
    result = {}
    for place, robot in enumerate(turn):
        before, after = turn[place - 1], turn[(place + 1) % len(turn)]
        gap_before = angles[robot] - angles[before] + (2 * math.pi if place == 0 else 0)
        gap_after = angles[after] - angles[robot] + (2 * math.pi if place == len(turn) - 1 else 0)
        result[robot] = gap_before, gap_after
    return [result[robot] for robot in range(len(positions))]


def even_angles(positions):
    even = 2 * math.pi / len(positions)
    return [1 - max(abs(gap / even - 1) for gap in gaps) for gaps in gaps_around(positions, np.mean(positions, axis=0))]


def equal_radii(positions, radius=None):
    distances = [math.dist(point, np.mean(positions, axis=0)) for point in positions]
    wanted = np.mean(distances) if radius is None else radius
    return [1 - abs(distance / wanted - 1) for distance in distances]


def surround(positions, distance, widest, tolerance):
    even = 2 * math.pi / len(positions)
    shares = []
    for point, gaps in zip(positions, gaps_around(positions, (0.0, 0.0)), strict=True):
        wide = max(max(gaps) / even - 1, 0) / (widest - 1)
        shares.append(1 - max(abs(math.hypot(*point) / distance - 1), tolerance * wide))
    return shares


def along_and_across(positions):
    """Returns coordinates in the frame of the singular vectors."""
    centred = positions - np.mean(positions, axis=0)
    _, _, axes = np.linalg.svd(centred, full_matrices=False)
    return centred @ axes[0], centred @ axes[1]


def straight(positions, radius):
    return [1 - abs(across) / (20 * radius) for across in along_and_across(positions)[1]]


def even_spacing(positions):
    along, _ = along_and_across(positions)
    turn = sorted(range(len(along)), key=lambda robot: along[robot])
    gaps = [along[after] - along[before] for before, after in itertools.pairwise(turn)]
    off = [abs(gap / np.mean(gaps) - 1) for gap in gaps]
    result = {}
    for place, robot in enumerate(turn):
        result[robot] = 1 - max(off[max(place - 1, 0) : place + 1])
    return [result[robot] for robot in range(len(positions))]


def spread(positions, wanted):
    """Returns the distance of each robot to the nearest other one in parts of the wanted one, 1 at most."""
    shares = []
    for robot, point in enumerate(positions):
        nearest = min(math.dist(point, other) for index, other in enumerate(positions) if index != robot)
        shares.append(min(1.0, nearest / wanted))
    return shares
