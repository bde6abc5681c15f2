"""What a robot can tell of its swarm is alike in swarms of any size, where they look alike."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from murmurate.policies.features import (
    MEAN_DISTANCE,
    MIN_MEAN_DISTANCE,
    NEIGHBOR_DISTANCE,
    count_weights,
    normalize_distances,
    relative_spread,
)
from murmurate.world import WorldConfig

WORLD = WorldConfig(robots=8, half_width=40.0, half_height=40.0)


def ring(robots, radius):
    angle = 2 * np.pi * np.arange(robots) / robots
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def least_radius(robots):
    """The smallest ring on which all see each other and keep the safe distance, to a percent for ten robots or more."""
    return max(0.0759 * robots**2, 2.5 / np.sin(np.pi / robots))


def mean_distance(points):
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    return apart.sum() / (len(points) * (len(points) - 1))


def spread(points):
    mean = jnp.full((1,), mean_distance(points))
    return np.asarray(relative_spread(mean, jnp.full((1,), len(points) - 1.0), WORLD))[:, 0]


@pytest.mark.parametrize("robots", [4, 6, 8, 12, 16, 24, 64, 256])
def test_the_spread_of_the_smallest_ring_is_the_same_for_any_number_of_robots(robots):
    assert abs(spread(ring(robots, least_radius(robots)))[0]) < 0.12
    assert spread(ring(robots, 2 * least_radius(robots)))[0] == pytest.approx(np.tanh(np.log(2)), abs=0.1)


@given(mean=st.floats(MIN_MEAN_DISTANCE, 500.0), first=st.floats(0.01, 2000.0), second=st.floats(0.01, 2000.0))
def test_normalizing_keeps_the_order_and_puts_the_mean_at_one_place(mean, first, second):
    distances = jnp.log(jnp.asarray([[first, second, mean, 1.0, 0.5]]))
    result = np.asarray(normalize_distances(distances, jnp.asarray([mean])))[0]
    assert (result[0] <= result[1] + 1e-4) == (first <= second) or abs(first - second) < 1e-3 * second
    np.testing.assert_allclose(result[2:], np.log([MEAN_DISTANCE, 1.0, 0.5]), atol=1e-4)


def test_neighbours_on_least_rings_have_nearly_the_same_normalized_distance():
    plain, places = [], []
    for robots in (24, 64, 256):
        points = ring(robots, least_radius(robots))
        plain.append(np.log(np.linalg.norm(points[1] - points[0]) / 5.0))
        mean = jnp.asarray([mean_distance(points) / 5.0])
        places.append(float(normalize_distances(jnp.asarray([[plain[-1]]]), mean)[0, 0]))
    assert np.ptp(places) < np.ptp(plain) / 10
    np.testing.assert_allclose(places, np.log(NEIGHBOR_DISTANCE), atol=0.2)


def test_near_robots_are_counted_and_far_ones_averaged():
    weights = np.asarray(count_weights(jnp.asarray([8.0, 32.0]), 8))
    np.testing.assert_allclose(weights[0], 1.0)
    np.testing.assert_allclose(weights[-1], [1.0, 0.25])
    assert (np.diff(weights[:, 1]) <= 1e-6).all()
