"""Symmetry groups: of exact patterns, of noisy ones, and the residual against every relabelling and axis."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from murmurate.analysis import symmetry
from murmurate.errors import InputError

CENTRE = np.zeros((1, 2))
LINE = np.array([[-1.0, 0.0], [0.0, 0.0], [1.0, 0.0]])


def ring(robots, radius=1.0, begin=0.0):
    angle = begin + 2 * np.pi * np.arange(robots) / robots
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def moved(points, seed):
    """The same pattern elsewhere: turned, shifted, relabelled, scaled."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 2 * math.pi)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    return rng.uniform(0.1, 10) * rng.permutation(points) @ turn.T + rng.uniform(-30, 30, 2)


def complex_and_normal(points):
    z = points[:, 0] + 1j * points[:, 1]
    z = z - z.mean()
    return z / math.sqrt(np.mean(np.abs(z) ** 2))


PATTERNS = {
    "D_1 of two sides": (np.array([[0.0, 0.0], [4.0, 0.0], [2.0, 5.0]]), "D_1"),
    "D_2 rectangle": (np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [0.0, 2.0]]), "D_2"),
    "D_2 line": (LINE, "D_2"),
    "C_2 parallelogram": (np.array([[0.0, 0.0], [4.0, 0.0], [6.0, 2.0], [2.0, 2.0]]), "C_2"),
    "C_3 pinwheel": (np.vstack([ring(3), ring(3, 2.0, 0.5)]), "C_3"),
    "C_4 pinwheel around one": (np.vstack([ring(4), ring(4, 2.0, 0.4), CENTRE]), "C_4"),
    "D_3 in two rings": (np.vstack([ring(3), ring(3, 2.0, math.pi / 3)]), "D_3"),
    "D_5 in two rings": (np.vstack([ring(5), ring(5, 2.0)]), "D_5"),
    "no order": (np.array([[0.0, 0.0], [4.0, 0.0], [3.0, 2.0], [-2.0, 5.0]]), "none"),
}


@pytest.mark.parametrize(("points", "name"), PATTERNS.values(), ids=PATTERNS)
@pytest.mark.parametrize("seed", range(3))
def test_exact_patterns(points, name, seed):
    result = symmetry(moved(points, seed))
    assert result.name == name
    assert result.residual < 1e-7


@pytest.mark.parametrize("around", [False, True])
@pytest.mark.parametrize("robots", range(2, 16))
def test_rings(robots, around):
    result = symmetry(moved(np.vstack([ring(robots), CENTRE]) if around else ring(robots), robots))
    assert (result.rotations, result.mirrored, result.name) == (robots, True, f"D_{robots}")
    assert result.residual < 1e-7


@pytest.mark.parametrize("robots", [6, 9])
def test_a_ring_around_a_robot_is_no_ring_of_one_more(robots):
    """A turn by 2 pi / 10 moves 9 + 1 robots by 0.07 only; still it is no symmetry of theirs."""
    pattern = np.vstack([ring(robots), CENTRE])
    assert symmetry(pattern, tolerance=0.12).name == f"D_{robots}"
    assert symmetry(pattern + np.random.default_rng(0).normal(size=pattern.shape) * 0.01, 0.12).name == f"D_{robots}"


@pytest.mark.parametrize("robots", [5, 8, 10])
def test_noise_is_tolerated_and_measured(robots):
    rng = np.random.default_rng(robots)
    for size in (0.003, 0.01, 0.03):
        result = symmetry(moved(ring(robots) + rng.normal(size=(robots, 2)) * size, robots))
        assert result.name == f"D_{robots}"
        # Two images, each displaced in two directions, apart.
        assert 0.3 * size < result.residual < 3 * 2 * size
    assert symmetry(ring(robots) + rng.normal(size=(robots, 2)) * 0.03, tolerance=1e-3).name == "none"


@given(st.integers(2, 5), st.integers(1, 3), st.booleans(), st.integers(0, 1000))
def test_what_was_built_symmetric_is_found_so(k, orbits, around, seed):
    rng = np.random.default_rng(seed)
    turned = [np.exp(2j * np.pi * np.arange(k) / k) * complex(*rng.normal(size=2)) for _ in range(orbits)]
    z = np.concatenate([*turned, np.zeros(int(around))])
    result = symmetry(moved(np.stack([z.real, z.imag], axis=1), seed), tolerance=1e-6)
    assert result.rotations % k == 0
    # One orbit is a regular polygon (or two robots).
    assert result.mirrored or orbits > 1


@given(st.integers(2, 6), st.integers(0, 1000))
def test_the_residual_against_every_relabelling(robots, seed):
    points = np.random.default_rng(seed).normal(size=(robots, 2))
    z, orders = complex_and_normal(points), list(itertools.permutations(range(robots)))
    result = symmetry(points, tolerance=10)
    squares = [np.mean(np.abs(z - z[list(s)] * np.exp(2j * np.pi / result.rotations)) ** 2) for s in orders]
    # The mirror whose axis is at half the angle a takes z to exp(ia) conj(z); the best angle overlaps best.
    overlap = max(abs(np.mean(z * z[list(order)])) for order in orders)
    mirror = math.sqrt(max(2 - 2 * overlap, 0))
    turn = math.sqrt(min(squares)) if result.rotations > 1 else 0.0
    assert result.mirrored
    assert result.residual == pytest.approx(max(turn, mirror), abs=1e-7)


def test_the_mirror_against_every_axis():
    points = np.vstack([ring(7), CENTRE]) + np.random.default_rng(1).normal(size=(8, 2)) * 0.1
    z, least = complex_and_normal(points), math.inf
    for angle in np.linspace(0, 2 * np.pi, 4000, endpoint=False):
        squares = np.abs(z[:, None] - np.exp(1j * angle) * z.conj()[None]) ** 2
        least = min(least, math.sqrt(squares[linear_sum_assignment(squares)].mean()))
    assert not symmetry(points, tolerance=least - 1e-3).mirrored
    assert symmetry(points, tolerance=least + 1e-6).mirrored


def test_a_robot_alone_and_coincident_robots_are_defined():
    assert symmetry(CENTRE).name == "D_1"
    assert symmetry(CENTRE).symbol == "D₁"
    assert symmetry(ring(12)).symbol == "D₁₂"
    coincident = symmetry(np.ones((4, 2)))
    assert coincident.mirrored
    assert coincident.residual == 0


@pytest.mark.parametrize("bad", [np.zeros(4), np.zeros((0, 2)), np.full((2, 2), np.nan)])
def test_no_such_configuration(bad):
    with pytest.raises(InputError, match=r"^positions = "):
        symmetry(bad)


@pytest.mark.parametrize("bad", [0, -1.0, math.nan, math.inf, "wide"])
def test_no_such_tolerance(bad):
    with pytest.raises(InputError, match=r"^tolerance = .* must be a finite number > 0"):
        symmetry(ring(3), bad)
