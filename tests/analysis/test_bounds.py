from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from murmurate.analysis.optimum.bounds import crowding, least_gathering, ring, ring_radius, upper_bound
from murmurate.analysis.optimum.formation import Target
from murmurate.world import WorldConfig
from oracles import visibility


def regular(robots, radius):
    angles = 2 * np.pi * np.arange(robots) / robots
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


@pytest.mark.parametrize("robots", range(3, 40))
@pytest.mark.parametrize("radius", [0.4, 1.0])
def test_on_the_smallest_ring_everyone_just_sees_everyone(robots, radius):
    least = ring_radius(robots, radius)
    gaps = visibility.shadow_clearance(regular(robots, least * (1 + 1e-6)), radius)
    assert gaps.min() == pytest.approx(0, abs=1e-3 * radius)
    assert gaps.min() > 0
    # The oracle needs disjoint robots: on a ring of three the discs touch before they hide each other.
    if robots > 3:
        assert visibility.shadow_clearance(regular(robots, least * (1 - 1e-6)), radius).min() < 0


def test_three_robots_hide_each_other_when_they_touch():
    assert ring_radius(3, 1.0) == pytest.approx(2 / math.sqrt(3))
    assert ring_radius(2, 1.0) == 1.0


@pytest.mark.parametrize("robots", [2, 3, 8, 10, 16, 30])
def test_a_ring_is_safe_and_visible_and_no_smaller_one_is(robots):
    target = Target(WorldConfig(robots=robots, half_width=90, half_height=90, scan_radius=300), "C1")
    found = ring(robots, 1.0, 5.0)
    assert target.is_valid(found.positions)
    assert not target.is_valid(found.positions * (1 - 1e-9))
    assert found.radius == pytest.approx(max(found.sight, found.safe))


@pytest.mark.parametrize("robots", range(2, 30))
def test_a_ring_has_the_closed_forms_that_the_docs_state(robots):
    found = ring(robots, 1.0, 5.0)
    apart = np.hypot(*(found.positions[:, None] - found.positions[None]).T)
    mean = apart.sum() / (robots * (robots - 1))
    assert mean == pytest.approx(2 * found.radius / math.tan(math.pi / (2 * robots)) / (robots - 1))
    assert np.hypot(*found.positions.T) == pytest.approx(found.radius)


def lattice(count):
    """The points of the triangular lattice nearest to one of them: pairwise at least 1 apart."""
    a, b = np.meshgrid(np.arange(-9, 10), np.arange(-9, 10))
    points = np.stack([a + b / 2, b * math.sqrt(3) / 2], axis=-1).reshape(-1, 2)
    return points[np.argsort(np.hypot(*points.T), kind="stable")[:count]]


@pytest.mark.parametrize("count", range(1, 60))
def test_the_densest_lattice_keeps_the_packing_bound(count):
    assert crowding(count) <= np.hypot(*lattice(count).T).max() + 1e-9
    if count >= 2:
        points = lattice(count)
        target = Target(WorldConfig(robots=count, half_width=99, half_height=99, scan_radius=300), "C1")
        assert least_gathering("C1", count) <= np.hypot(*(points - points.mean(axis=0)).T).mean() + 1e-9
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
            assert target.value(ring(robots, 1.0, 5.0).positions) == pytest.approx(upper_bound(target), abs=1e-10)
