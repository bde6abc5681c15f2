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


def inside(positions, half_width, half_height, margin, radius):
    shares = []
    for x, y in positions:
        beyond = max(abs(x) - half_width + margin, abs(y) - half_height + margin, 0.0)
        shares.append(1 - beyond / (20 * radius))
    return shares


def chain(positions, first, last, reach):
    """Walks from the first point to the last, robot by robot."""
    direction = np.subtract(last, first)
    order = sorted(range(len(positions)), key=lambda robot: float(np.dot(positions[robot], direction)))
    stops = [np.asarray(first), *(positions[robot] for robot in order), np.asarray(last)]
    links = [math.dist(before, after) for before, after in itertools.pairwise(stops)]
    shares = [0.0] * len(positions)
    for place, robot in enumerate(order):
        shares[robot] = 1 - max(max(links[place], links[place + 1]) / reach - 1, 0.0)
    return shares


def two_groups(positions, apart, wide, ring_radius):
    """Cuts the swarm in two along its first singular vector, behind either of the robots in the middle."""
    along, _ = along_and_across(positions)
    order = sorted(range(len(along)), key=lambda robot: along[robot])
    results = []
    for half in (len(order) // 2, (len(order) + 1) // 2):
        shares = [0.0] * len(order)
        for group, others in ((order[:half], order[half:]), (order[half:], order[:half])):
            middle = np.mean(positions[group], axis=0)
            for robot in group:
                far = math.dist(positions[robot], middle) / (wide * ring_radius(max(len(group), 2))) - 1
                nearest = min(math.dist(positions[robot], positions[other]) for other in others)
                shares[robot] = 1 - max(far, 1 - nearest / apart, 0.0)
        results.append(shares)
    return max(results, key=np.mean)


def match(positions, places, radius):
    """Tries every relabelling, each with the best angle of the singular value decomposition (Kabsch)."""
    points, wanted = positions - np.mean(positions, axis=0), np.asarray(places) - np.mean(places, axis=0)
    best, shares = math.inf, []
    for order in itertools.permutations(range(len(points))):
        left, _, right = np.linalg.svd(wanted[list(order)].T @ points)
        turn = left @ np.diag([1.0, np.linalg.det(left @ right)]) @ right
        off = points - wanted[list(order)] @ turn
        if (total := float((off**2).sum())) < best:
            best, shares = total, list(1 - np.linalg.norm(off, axis=1) / (2 * radius))
    return shares


def spread(positions, wanted):
    """Returns the distance of each robot to the nearest other one in parts of the wanted one, 1 at most."""
    shares = []
    for robot, point in enumerate(positions):
        nearest = min(math.dist(point, other) for index, other in enumerate(positions) if index != robot)
        shares.append(min(1.0, nearest / wanted))
    return shares
