"""Properties of contact within a step, and the steps at its edges."""

from __future__ import annotations

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from murmurate import geometry
from murmurate.geometry import _batch_last
from oracles import contact as oracle

RADIUS = 1.0
TOLERANCE = 1e-9

# In thousandths: shapely, unlike the kernels, cannot measure segments so short that their squares underflow.
coordinates = st.integers(-50_000, 50_000).map(lambda thousandths: thousandths / 1000)


@st.composite
def steps(draw):
    """Positions and velocities of up to six robots, whether they overlap or not."""
    shape = (draw(st.integers(2, 6)), 2)
    return [draw(hnp.arrays(np.float64, shape, elements=coordinates)) for _ in range(2)]


def approach(positions, velocities):
    """The closest approach of the first two robots."""
    return float(geometry.closest_approach(positions, velocities)[0, 1])


@given(steps())
def test_approach_agrees_with_the_oracle(step):
    got = geometry.closest_approach(*step)
    np.testing.assert_allclose(got, oracle.closest_approach(*step), rtol=0, atol=TOLERANCE)
    np.testing.assert_array_equal(got, got.T)
    assert not got.diagonal().any()


@given(steps())
def test_approach_is_at_most_the_distance_at_either_end(step):
    positions, velocities = step
    ends = np.minimum(geometry.distances(positions), geometry.distances(positions + velocities))
    assert (geometry.closest_approach(positions, velocities) <= ends + TOLERANCE).all()


@given(steps())
def test_backwards_in_time(step):
    positions, velocities = step
    back = geometry.closest_approach(positions + velocities, -velocities)
    np.testing.assert_allclose(back, geometry.closest_approach(positions, velocities), rtol=0, atol=TOLERANCE)


@given(steps(), hnp.arrays(np.float64, (2, 2), elements=coordinates))
def test_a_common_place_and_a_common_velocity_do_not_matter(step, common):
    positions, velocities = step
    shifted = geometry.closest_approach(positions + common[0], velocities + common[1])
    np.testing.assert_allclose(shifted, geometry.closest_approach(positions, velocities), rtol=0, atol=TOLERANCE)


@given(steps(), st.floats(-np.pi, np.pi), st.floats(1e-3, 1e3))
def test_rotation_and_scaling(step, angle, factor):
    turn = factor * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    turned = geometry.closest_approach(*(a @ turn for a in step)) / factor
    np.testing.assert_allclose(turned, geometry.closest_approach(*step), rtol=0, atol=TOLERANCE)


@given(steps(), st.randoms(use_true_random=False))
def test_relabelling(step, random):
    positions, velocities = step
    order = random.sample(range(len(positions)), len(positions))
    relabelled = geometry.closest_approach(positions[order], velocities[order])
    np.testing.assert_array_equal(relabelled, geometry.closest_approach(positions, velocities)[order][:, order])


@given(steps())
def test_a_swarm_collides_when_any_pair_does(step):
    pairs = geometry.closest_approach(*step)[np.triu_indices(len(step[0]), 1)]
    assert geometry.any_contact(*step, RADIUS) == (pairs <= 2 * RADIUS).any()


@given(steps())
def test_at_rest_the_approach_is_the_distance(step):
    positions, _ = step
    still = geometry.closest_approach(positions, np.zeros_like(positions))
    np.testing.assert_array_equal(still, geometry.distances(positions))
    together = geometry.closest_approach(positions, np.full_like(positions, 0.3))
    np.testing.assert_array_equal(together, geometry.distances(positions))


@given(steps())
def test_clearances_are_distances_between_edges(step):
    positions, _ = step
    clearances, other = geometry.clearances(positions, RADIUS), ~np.eye(len(positions), dtype=bool)
    np.testing.assert_array_equal(clearances[other], geometry.distances(positions)[other] - 2 * RADIUS)
    assert np.isposinf(clearances.diagonal()).all()


@pytest.mark.parametrize(
    ("positions", "velocities", "expected"),
    [
        pytest.param([[0, 0], [4, 0]], [[4, 0], [-4, 0]], 0, id="swapping places"),
        pytest.param([[0, 0], [-9, 0]], [[0, 0], [20, 0]], 0, id="passing through one that stands"),
        pytest.param([[0, 0], [-3, 2]], [[0, 0], [6, 0]], 2, id="grazing at 2 R"),
        pytest.param([[0, 0], [-3, 2.01]], [[0, 0], [6, 0]], 2.01, id="just missing"),
        pytest.param([[0, 0], [3, 0]], [[5, 5], [5, 5]], 3, id="moving together"),
        pytest.param([[0, 0], [3, 0]], [[0, 0], [4, 0]], 3, id="nearest at the beginning"),
        pytest.param([[0, 0], [5, 0]], [[0, 0], [-2, 0]], 3, id="nearest at the end"),
        pytest.param([[0, 0], [-3, 4]], [[0, 0], [4, 0]], 4, id="nearest in the middle"),
        pytest.param([[0, 0], [0, 0]], [[1, 0], [-1, 0]], 0, id="coincident, parting"),
        pytest.param([[0, 0], [0, 0]], [[1, 0], [1, 0]], 0, id="coincident, together"),
    ],
)
def test_closed_form(array, positions, velocities, expected):
    positions, velocities = array(positions), array(velocities)
    np.testing.assert_allclose(approach(positions, velocities), expected, rtol=1e-6, atol=1e-6)
    assert bool(geometry.any_contact(positions, velocities, RADIUS)) is (expected <= 2 * RADIUS)


def test_grazing_is_a_collision_and_a_hair_more_is_none(array):
    for gap, touches in ((0.0, True), (1e-5, False)):
        positions = array([[0, 0], [2 * RADIUS + gap, -5]])
        assert bool(geometry.any_contact(positions, array([[0, 0], [0, 9]]), RADIUS)) is touches
        assert bool(geometry.any_contact(positions, array([[0, 0], [0, 5]]), RADIUS)) is touches
        assert not geometry.any_contact(positions, array([[0, 0], [0, 4.9]]), RADIUS)


def test_third_robots_do_not_matter(array):
    positions, velocities = np.zeros((5, 2)), np.zeros((5, 2))
    positions[:, 0] = 10 * np.arange(5)
    velocities[3:] = [[8, 0], [-2, 0]]
    assert bool(geometry.any_contact(array(positions), array(velocities), RADIUS))
    velocities[3:] = [[7, 0], [-0.9, 0]]
    assert not geometry.any_contact(array(positions), array(velocities), RADIUS)


@pytest.mark.parametrize("speed", [1e-30, 1e-12, 1e-3])
def test_tiny_velocities(array, speed):
    positions = array([[0, 0], [3, 4]])
    velocities = array([[0, 0], [-3 * speed, -4 * speed]])
    np.testing.assert_allclose(approach(positions, velocities), 5 - 5 * speed, rtol=1e-6)


@pytest.mark.parametrize("speed", [1e3, 1e6, 1e15])
def test_huge_velocities(array, speed):
    """Both ends of the step are far from the middle, where the robots come near."""
    across = approach(array([[0, 3], [4, 0]]), array([[0, 0], [-3 * speed, 0]]))
    np.testing.assert_allclose(across, 3, rtol=1e-6)
    apart = approach(array([[0, 3], [4, 0]]), array([[0, 0], [3 * speed, 0]]))
    np.testing.assert_allclose(apart, 5, rtol=1e-6)


@pytest.mark.parametrize("speed", [1e-300, 1e-160, 1e-100, 1e100, 1e150])
def test_velocities_at_the_ends_of_float64(speed):
    positions = np.array([[0.0, 3.0], [4.0, 0.0]])
    expected = 3 if speed > 1 else 5
    np.testing.assert_allclose(approach(positions, np.array([[0, 0], [-speed, 0]])), expected, rtol=1e-15)
    np.testing.assert_allclose(approach(positions, np.array([[0, 0], [speed, 0]])), 5, rtol=1e-15)


def test_far_from_the_origin(array):
    offset = np.array([1e4, -3e4])
    positions, velocities = offset + np.array([[0, 0], [-3, 2]]), array([[0, 0], [6, 0]])
    assert approach(array(positions), velocities) == 2
    assert bool(geometry.any_contact(array(positions), velocities, RADIUS))


def test_the_edge_of_the_world_is_inside(array):
    corners = array([[3, 2], [-3, 2], [3, -2], [-3, -2]])
    assert not geometry.any_outside(corners, 3.0, 2.0)
    assert bool(geometry.any_outside(corners, 3.0, 1.999))
    assert bool(geometry.any_outside(corners, 2.999, 2.0))
    assert bool(geometry.any_outside(array([[0, 0], [0, -2.001]]), 3.0, 2.0))
    assert not geometry.any_outside(array([[0, 0]]), 3.0, 2.0)


def test_for_the_kernels_a_robot_at_nan_is_outside_and_touches_no_other(array):
    for lost in ([np.nan, np.nan], [np.nan, 0], [0, np.nan]):
        positions, still = array([[0, 0], [3, 0], lost]), array(np.zeros((3, 2)))
        assert bool(_batch_last.any_outside(positions, 10.0, 10.0))
        assert not _batch_last.any_contact(positions, still, RADIUS)
        assert bool(_batch_last.any_contact(array([[0, 0], [2, 0], lost]), still, RADIUS))
        assert float(_batch_last.closest_approach(positions, still)[0, 1]) == 3
        assert not _batch_last.any_contact(array([[0, 0], [1, 0]]), array([[0, 0], lost]), RADIUS)
        np.testing.assert_array_equal(_batch_last.clearances(positions, RADIUS).diagonal(), np.inf)
