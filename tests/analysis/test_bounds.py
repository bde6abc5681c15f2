from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from murmurate.analysis.optimum.bounds import min_mean_distance, packing_radius, upper_bound
from murmurate.analysis.optimum.formation import Target
from murmurate.geometry import smallest_ring
from murmurate.world import WorldConfig


def regular(robots, radius):
    angles = 2 * np.pi * np.arange(robots) / robots
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def lattice(count):
    """The points of the triangular lattice nearest to one of them: pairwise at least 1 apart."""
    a, b = np.meshgrid(np.arange(-9, 10), np.arange(-9, 10))
    points = np.stack([a + b / 2, b * math.sqrt(3) / 2], axis=-1).reshape(-1, 2)
    return points[np.argsort(np.hypot(*points.T), kind="stable")[:count]]


@pytest.mark.parametrize("count", range(1, 60))
def test_the_densest_lattice_keeps_the_packing_bound(count):
    assert packing_radius(count) <= np.hypot(*lattice(count).T).max() + 1e-9
    if count >= 2:
        points = lattice(count)
        target = Target(WorldConfig(robots=count, half_width=99, half_height=99, scan_radius=300), "C1")
        assert min_mean_distance("C1", count) <= np.hypot(*(points - points.mean(axis=0)).T).mean() + 1e-9
        assert target.value(5 * points) - target.signals(5 * points)["visible"] <= upper_bound(target) - 1 + 1e-12


@given(st.integers(2, 12), st.sampled_from(["C1", "C2"]), st.integers(0, 2**32 - 1))
def test_no_safe_configuration_beats_the_bound(robots, objective, seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(robots, 2))
    apart = np.hypot(*(points[:, None] - points[None]).T)
    points *= 5 / apart[~np.eye(robots, dtype=bool)].min()
    target = Target(WorldConfig(robots=robots, half_width=1e4, half_height=1e4, scan_radius=1e5), objective)
    gathered = target.signals(points)[target.gathering]
    assert gathered + 3 <= upper_bound(target) + 1e-12


def test_two_and_three_robots_reach_the_bound():
    for robots in (2, 3):
        for objective in ("C1", "C2"):
            target = Target(WorldConfig(robots=robots), objective)
            assert target.value(smallest_ring(robots, 1.0, 5.0).positions) == pytest.approx(
                upper_bound(target), abs=1e-10
            )
