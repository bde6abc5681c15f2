"""Nearest distances and the margin of visibility: hand-made cases, and the oracle of shadows as polygons."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from murmurate.analysis import elongation, nearest_distances, visibility_margin
from murmurate.analysis.measures import fit_line
from murmurate.errors import InputError
from murmurate.geometry import visible
from oracles.configurations import disjoint
from oracles.visibility import shadow_clearance

CENTRE = np.zeros((1, 2))


def ring(robots, radius=1.0, begin=0.0):
    angle = begin + 2 * np.pi * np.arange(robots) / robots
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def test_nearest_distances():
    points = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 6.0]])
    assert nearest_distances(points) == pytest.approx([5.0, 2.0, 2.0])
    assert nearest_distances(np.ones((2, 2))) == pytest.approx([0.0, 0.0])
    assert nearest_distances(CENTRE) == [np.inf]


def test_elongation():
    assert elongation(ring(7)) == pytest.approx(0.0, abs=1e-12)
    assert elongation(np.arange(5)[:, None] * [[1.0, 2.0]]) == pytest.approx(1.0)
    assert elongation(ring(8) * [3.0, 1.0] + [100.0, -50.0]) == pytest.approx(2 / 3)
    assert elongation(np.ones((4, 2))) == elongation(CENTRE) == 0.0
    with pytest.raises(InputError, match=r"^positions"):
        elongation(np.array([[0.0, np.nan]]))


@given(seed=st.integers(0, 999), robots=st.integers(2, 9), angle=st.floats(0, 7), scale=st.floats(0.1, 10))
def test_elongation_is_that_of_the_covariance_however_turned_and_scaled(seed, robots, angle, scale):
    points = np.random.default_rng(seed).normal(size=(robots, 2))
    small, large = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(points.T, bias=True)), 0))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    assert elongation(scale * points @ turn) == pytest.approx(1 - small / large, abs=1e-6)


@pytest.mark.parametrize("robots", range(3, 13))
def test_the_margin_is_the_oracles(robots):
    rng = np.random.default_rng(robots)
    for radius, side in ((1.0, math.sqrt(2 * math.pi * robots)), (0.4, 70.0)):
        for points in disjoint(rng, 60, robots, radius, side).astype(float):
            margin = visibility_margin(points, radius)
            assert margin == pytest.approx(shadow_clearance(points, radius).min() / radius, abs=1e-8)
            assert abs(margin) < 1e-6 or (margin > 0) == visible(points, radius, 1e3)[~np.eye(robots, dtype=bool)].all()


@pytest.mark.parametrize("height", [0.0, 0.5, 1.0, 1.5, 2.0, 2.5])
def test_margins_by_hand(height):
    """Two robots 8 R apart see each other past one that stands half-way, at some height above their line."""
    past = visibility_margin(np.array([[0.0, 0.0], [8.0, 0.0], [4.0, height]]), 1.0)
    far = math.hypot(4, height)
    tangent = math.atan2(height, 4) - math.asin(1 / far)
    # Below the tangent the other one is by 8 sin(tangent), less its radius; its centre may be in the shadow.
    assert past == pytest.approx(max(8 * math.sin(tangent), 0) - 1)


def test_margins_of_rings():
    """In a ring all robots but the neighbours are seen past a neighbour; in a line, through the next."""
    margins = [visibility_margin(ring(10, radius), 1.0) for radius in (5.0, 8.0, 12.0, 20.0)]
    assert margins == sorted(margins)
    assert margins[0] < 0 < margins[-1]
    assert visibility_margin(np.arange(3)[:, None] * [[4.0, 0.0]], 1.0) == -1


def test_margins_that_need_no_third_robot_or_no_distance():
    assert visibility_margin(CENTRE, 1.0) == math.inf
    assert visibility_margin(ring(2), 0.1) == math.inf
    assert visibility_margin(np.zeros((3, 2)), 1.0) == math.inf
    assert visibility_margin(0.5 * ring(3), 1.0) == -1
    assert visibility_margin(ring(5, 9.0), 1.0) == pytest.approx(visibility_margin(ring(5, 0.9), 0.1))


@pytest.mark.parametrize(
    "bad", [np.zeros(4), np.zeros((0, 2)), np.full((2, 2), np.nan), [[1.0], [1.0, 2.0]], [["a", 1]]]
)
def test_no_such_configuration(bad):
    for measure in (nearest_distances, lambda x: visibility_margin(x, 1.0)):
        with pytest.raises(InputError, match=r"^positions = "):
            measure(bad)


@pytest.mark.parametrize("bad", [0, -1.0, math.nan, None])
def test_no_such_radius(bad):
    with pytest.raises(InputError, match=r"^radius = "):
        visibility_margin(ring(3), bad)


@given(st.floats(-100, 100), st.floats(-100, 100), st.lists(st.integers(2, 40), min_size=3, max_size=8, unique=True))
def test_a_line_is_found(slope, intercept, robots):
    line = fit_line(robots, [slope * n + intercept for n in robots])
    assert line.slope == pytest.approx(slope, abs=1e-6)
    assert line.intercept == pytest.approx(intercept, abs=1e-5)


def test_the_line_explains_what_it_explains():
    assert fit_line([4, 5, 6, 7], [1.0, -1.0, -1.0, 1.0]).r_squared == pytest.approx(0, abs=1e-9)
    assert fit_line([4, 5, 6], [8.0, 10.0, 12.0]).r_squared == pytest.approx(1)


@pytest.mark.parametrize(
    ("robots", "steps"), [([4, 6], [1.0, 2.0]), ([4] * 3, [1.0] * 3), ([4, 5, 6], [1, math.nan, 2])]
)
def test_too_little_makes_no_line(robots, steps):
    assert fit_line(robots, steps) is None
