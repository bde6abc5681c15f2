"""Who is a corner of the hull that it sees, between whom, and how far it stands out."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from murmurate.policies.hull import ANGLE, FAR_OUT, hull, widest_gap
from oracles.hull import corner
from oracles.hull import widest_gap as widest_gap_oracle

measure = jax.jit(hull)


def seen_hull(positions, seen=None):
    """Measures the hull in radii of 1 from absolute positions, whoever is seen."""
    positions = np.asarray(positions, np.float32)
    seen = ~np.eye(len(positions), dtype=bool) if seen is None else np.asarray(seen)
    x, y = (positions[None, :, a] - positions[:, None, a] for a in (0, 1))
    distance = np.where(seen, np.hypot(x, y), np.float32(1))
    apart = seen & (distance > 0)
    ux, uy = (np.where(apart, a / np.where(distance > 0, distance, 1), 0).astype(np.float32) for a in (x, y))
    return measure(ux, uy, distance, apart)


def bulges(result):
    """Inverts the two channels that say how far robots stand out."""
    near, far = np.asarray(result.robot[1]), np.asarray(result.robot[2])
    return np.sqrt(np.maximum(1 / np.sqrt(np.maximum(near, 1e-12)) - 1, 0)), FAR_OUT * far / (1 - far)


@given(seed=st.integers(0, 2**32 - 1), robots=st.sampled_from([3, 4, 7, 12]))
def test_it_is_what_sorted_angles_say(seed, robots):
    positions = np.random.default_rng(seed).uniform(-20, 20, (robots, 2))
    result = seen_hull(positions)
    edge, side, is_corner = np.asarray(result.pair[0]), np.asarray(result.pair[1]), np.asarray(result.robot[0])
    near, far = bulges(result)
    for k in range(robots):
        others = np.delete(np.arange(robots), k)
        offsets = (positions[others] - positions[k]).astype(np.float32).astype(float)
        lines = np.sort(np.arctan2(offsets[:, 1], offsets[:, 0]) % np.pi)
        if np.diff(np.append(lines, lines[0] + np.pi)).min() < 2 * ANGLE:
            continue  # Two robots all but in line are partly in one direction.
        expected = corner(offsets)
        assert is_corner[k] == (expected is not None)
        if expected is None:
            assert not edge[k].any()
            continue
        last, first, bulge = others[expected[0]], others[expected[1]], expected[2]
        assert set(np.flatnonzero(edge[k])) == {last, first}
        assert (side[k, last], side[k, first]) == (1.0, -1.0)
        np.testing.assert_allclose(far[k], bulge, rtol=1e-2, atol=2e-2)
        if 0.2 < bulge < 5:
            np.testing.assert_allclose(near[k], bulge, rtol=1e-2)


def test_neighbours_on_the_smallest_ring_stand_out_alike_whatever_their_number():
    heights = []
    for robots in (16, 256):
        angle = 2 * np.pi * np.arange(robots) / robots
        ring = 0.0759 * robots**2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        heights.append(float(bulges(seen_hull(ring))[1].mean()))
    np.testing.assert_allclose(heights, 1.5, rtol=0.05)


def test_who_is_not_seen_is_no_part_of_it():
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0], [-30.0, -31.0]])
    seen = ~np.eye(5, dtype=bool)
    assert not seen_hull(square, seen).robot[0, 0]
    seen[0, 4] = False
    result = seen_hull(square, seen)
    assert result.robot[0, 0] == 1
    assert set(np.flatnonzero(np.asarray(result.pair[0, 0]))) == {1, 3}


@pytest.mark.parametrize(
    "positions",
    [
        [[0.0, 0.0], [5.0, 0.0]],
        [[0.0, 0.0], [5.0, 0.0], [10.0, 0.0], [20.0, 0.0]],
        [[0.0, 0.0], [0.0, 0.0], [3.0, 1.0]],
        [[1.0, 1.0]] * 3,
    ],
    ids=["two", "a line", "two at one place", "all at one place"],
)
def test_degenerate_swarms_have_finite_ones(positions):
    result = seen_hull(positions)
    for part in (result.pair, result.robot):
        assert np.isfinite(np.asarray(part)).all()
    near, _ = bulges(result)
    on_line = len(positions) != 3
    if on_line:
        assert result.robot[0].all()
        np.testing.assert_allclose(near, 0, atol=1e-3)


def test_on_a_line_nobody_stands_out_not_even_by_rounding():
    rng = np.random.default_rng(3)
    along = np.sort(rng.uniform(-300, 300, (4, 50)), axis=0)
    angle = rng.uniform(0, 2 * np.pi, 50)
    positions = np.stack([along * np.cos(angle), along * np.sin(angle)], axis=1).astype(np.float32)
    for robots in (2, 4):
        dx, dy = (positions[None, :robots, axis] - positions[:robots, None, axis] for axis in (0, 1))
        distance = np.sqrt(dx**2 + dy**2)
        seen = distance > 0
        safe = np.where(seen, distance, np.float32(1))
        corner, near, far = measure(dx / safe, dy / safe, safe, seen).robot
        if robots == 2:
            np.testing.assert_array_equal(corner, 1)
            np.testing.assert_array_equal(near, 1)
            np.testing.assert_array_equal(far, 0)
        assert float(jnp.abs(far).max()) < 0.05


gaps_of = jax.jit(widest_gap)


def seen_gaps(positions, seen=None):
    """Measures the gap of every robot from absolute positions."""
    positions = np.asarray(positions, np.float32)
    seen = ~np.eye(len(positions), dtype=bool) if seen is None else np.asarray(seen)
    x, y = (positions[None, :, a] - positions[:, None, a] for a in (0, 1))
    distance = np.hypot(x, y)
    seen = seen & (distance > 0)
    ux, uy = (np.where(seen, a / np.where(distance > 0, distance, 1), 0).astype(np.float32) for a in (x, y))
    return np.stack(gaps_of(ux, uy, seen), axis=1)


@given(seed=st.integers(0, 2**32 - 1), robots=st.sampled_from([2, 3, 4, 7, 12]))
def test_gaps_are_what_sorted_angles_say(seed, robots):
    positions = np.random.default_rng(seed).uniform(-20, 20, (robots, 2))
    expected = [widest_gap_oracle(np.delete(positions, k, axis=0) - positions[k]) for k in range(robots)]
    np.testing.assert_allclose(seen_gaps(positions), expected, atol=2e-4)


def test_an_enclosed_robot_is_shown_the_way_out():
    angle = np.pi / 3 * np.arange(1, 6)  # A hexagon without its corner in direction x.
    enclosed = np.concatenate([np.zeros((1, 2)), 5 * np.stack([np.cos(angle), np.sin(angle)], axis=1)])
    x, y, width = seen_gaps(enclosed)[0]
    assert x > 0.9
    assert abs(y) < 1e-6
    assert -0.45 < width < -1 / 3


def test_a_corner_is_shown_outwards():
    x, y, width = seen_gaps([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]])[0]
    # Three times as wide as the other gap, which lies the other way: weights 3^6 and 1.
    np.testing.assert_allclose((x, y), (-np.sqrt(0.5) * 728 / 730,) * 2, atol=1e-5)
    np.testing.assert_allclose(width, (729 * 0.5 - 0.5) / 730, atol=1e-5)


def test_where_no_gap_is_wider_than_another_there_is_no_direction():
    angle = 2 * np.pi * np.arange(7) / 7 + 0.3
    middle = np.concatenate([np.zeros((1, 2)), 5 * np.stack([np.cos(angle), np.sin(angle)], axis=1)])
    np.testing.assert_allclose(seen_gaps(middle)[0], [0, 0, 2 / 7 - 1], atol=1e-5)


def test_who_sees_nobody_has_no_gap():
    assert not seen_gaps([[0.0, 0.0], [5.0, 0.0]], np.zeros((2, 2), bool)).any()


def test_gaps_turn_with_the_swarm_and_do_not_depend_on_numbers():
    line = np.stack([np.arange(6.0) * 4, np.zeros(6)], axis=1)
    grid = np.stack(np.meshgrid(np.arange(4.0), np.arange(4.0)), axis=-1).reshape(-1, 2) * 4
    turned = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    for positions in (line, grid):
        expected = seen_gaps(positions)
        order = np.random.default_rng(0).permutation(len(positions))
        result = seen_gaps((positions @ turned.T)[order])
        np.testing.assert_allclose(result[:, :2], (expected[:, :2] @ turned.T)[order], atol=1e-5)
        np.testing.assert_allclose(result[:, 2], expected[order, 2], atol=1e-5)


def test_gradients_by_the_gap_are_finite_where_robots_are_in_line():
    x = jnp.asarray([[1.0, 1.0, -1.0, 0.0]])
    seen = jnp.asarray([[True, True, True, False]])
    slope = jax.grad(lambda x: sum(part.sum() for part in widest_gap(x, jnp.zeros_like(x), seen)))(x)
    assert np.isfinite(slope).all()
