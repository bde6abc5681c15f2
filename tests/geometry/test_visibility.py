"""Properties of visibility, and the configurations at its edges."""

from __future__ import annotations

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from murmurate import geometry
from murmurate.geometry import _batch_last
from oracles import visibility as oracle

RADIUS, SCAN = 1.0, 15.0


@st.composite
def configurations(draw, min_robots=2, max_robots=8):
    """Disjoint robots of radius 1 on a lattice, and off it by less than what would let two of them touch."""
    cell = st.integers(-3, 3)
    cells = draw(st.lists(st.tuples(cell, cell), min_size=min_robots, max_size=max_robots, unique=True))
    spacing = draw(st.floats(2.5, 12.0))
    jitter = draw(hnp.arrays(np.float64, (len(cells), 2), elements=st.floats(-1, 1)))
    return spacing * np.array(cells) + 0.49 * (spacing - 2) * jitter


def readings(positions, radius=RADIUS, scan_radius=SCAN, kernels=geometry):
    """Neighbour, occluded and visible, stacked."""
    return np.stack(
        [
            kernels.neighbors(positions, scan_radius),
            kernels.occluded(positions, radius),
            kernels.visible(positions, radius, scan_radius),
        ]
    )


def assert_same(actual, expected, positions):
    """Two readings of what is the same configuration differ at most where precision decides."""
    decided = oracle.decided(positions, RADIUS, SCAN, oracle.FLOAT64_TANGENCY)
    np.testing.assert_array_equal(actual & decided, expected & decided)


def rotation(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


@given(configurations())
def test_lattices_agree_with_the_oracle(positions):
    near, hidden = oracle.neighbors(positions, SCAN), oracle.occluded(positions, RADIUS)
    assert_same(readings(positions), np.stack([near, hidden, near & ~hidden]), positions)


@given(configurations(), st.floats(-np.pi, np.pi))
def test_rotation(positions, angle):
    assert_same(readings(positions @ rotation(angle).T), readings(positions), positions)


@given(configurations())
def test_reflection(positions):
    np.testing.assert_array_equal(readings(positions * [1, -1]), readings(positions))


@given(configurations(), hnp.arrays(np.float64, 2, elements=st.floats(-1e3, 1e3)))
def test_translation(positions, offset):
    assert_same(readings(positions + offset), readings(positions), positions)


@given(configurations(), st.floats(1e-3, 1e3))
def test_scaling(positions, factor):
    scaled = readings(positions * factor, RADIUS * factor, SCAN * factor)
    assert_same(scaled, readings(positions), positions)


@given(configurations(), st.randoms(use_true_random=False))
def test_relabelling(positions, random):
    order = random.sample(range(len(positions)), len(positions))
    np.testing.assert_array_equal(readings(positions[order]), readings(positions)[:, order][:, :, order])


@given(configurations(), st.floats(1e-3, 60))
def test_neighbours_are_mutual(positions, scan_radius):
    near = geometry.neighbors(positions, scan_radius)
    np.testing.assert_array_equal(near, near.T)


@given(configurations(), st.floats(1e-3, 60))
def test_visible_is_neighbour_and_not_occluded(positions, scan_radius):
    near, hidden, seen = readings(positions, scan_radius=scan_radius)
    np.testing.assert_array_equal(seen, near & ~hidden)


@given(configurations())
def test_the_diagonal_is_false(positions):
    assert not readings(positions).diagonal(axis1=1, axis2=2).any()


@given(configurations())
def test_nothing_hides_the_nearest(positions):
    away = geometry.clearances(positions, RADIUS)
    assert not geometry.occluded(positions, RADIUS)[np.arange(len(positions)), away.argmin(axis=1)].any()


@given(configurations(min_robots=3))
def test_a_robot_less_hides_nobody(positions):
    fewer = geometry.occluded(positions[:-1], RADIUS)
    assert (fewer <= geometry.occluded(positions, RADIUS)[:-1, :-1]).all()


def test_two_robots_always_see_each_other(array):
    for distance in (1e-3, 0.5, 1.0, 2.0, 2.001, 1e4):
        positions = array([[0, 0], [distance, 0]])
        assert not geometry.occluded(positions, RADIUS).any()
        assert geometry.visible(positions, RADIUS, 1e5).sum() == 2


def test_one_robot_has_no_neighbours(array):
    for matrix in readings(array([[3.0, 4.0]])):
        np.testing.assert_array_equal(matrix, [[False]])


def test_the_scan_radius_itself_is_within_scan(array):
    positions = array([[0, 0], [3, 4]])
    assert geometry.neighbors(positions, 5.0).sum() == 2
    assert not geometry.neighbors(positions, 4.999).any()


@pytest.mark.parametrize("step", [(2, 0), (3, 0), (0, 5), (3, 1), (-7, 11)], ids=str)
@pytest.mark.parametrize("robots", [3, 6, 16])
def test_in_a_row_each_sees_the_next_alone(array, robots, step):
    """Exactly collinear rows, the first of them of discs that touch."""
    positions = np.arange(robots)[:, None] * np.array(step)
    label = np.arange(robots)
    adjacent = np.abs(label[:, None] - label) == 1
    np.testing.assert_array_equal(geometry.visible(array(positions), RADIUS, 1e3), adjacent)


def test_two_rows_with_gaps(array):
    """On a square lattice of spacing 5 R a knight's move is seen past its neighbours, two along an axis are not."""
    seen = geometry.visible(array([[x, y] for x in (0, 5, 10) for y in (0, 5, 10)]), RADIUS, 100.0)
    np.testing.assert_array_equal(seen[0], [False, True, False, True, True, True, False, True, False])


def test_at_tangency_a_nudge_decides(array):
    """Seen from the origin both discs touch the x axis, one from above, the other, farther, from below."""
    nudge = oracle.FLOAT32_TANGENCY * RADIUS
    for aside, hidden in ((-nudge, False), (nudge, True)):
        positions = array([[0, 0], [5, 1], [9, -1 + aside]])
        assert bool(geometry.occluded(positions, RADIUS)[0, 2]) is hidden
    for aside, hidden in ((-1e-9, False), (1e-9, True)):
        positions = np.array([[0, 0], [5, 1], [9, -1 + aside]])
        assert geometry.occluded(positions, RADIUS)[0, 2] == hidden


def test_three_discs_that_touch(array):
    """In a corner the far disc is cut by the near one; in a triangle, a hair apart, all see all."""
    assert geometry.occluded(array([[0, 0], [2, 0], [2, 2]]), RADIUS)[0].tolist() == [False, False, True]
    triangle = array([[0, 0], [2, 0], [1, np.sqrt(3)]]) * 1.0001
    assert not geometry.occluded(triangle, RADIUS).any()


@pytest.mark.parametrize(("third", "hidden"), [((5, 0), True), ((-0.5, 5), True), ((-5, 0), False), ((-5, 1), False)])
def test_a_disc_over_the_observer_covers_half_of_its_view(array, third, hidden):
    positions = array([[0, 0], [0.5, 0], third])
    assert geometry.occluded(positions, RADIUS)[0].tolist() == [False, False, hidden]


def test_coincident_robots_hide_neither_each_other_nor_the_rest(array):
    positions = array([[0, 0], [0, 0], [5, 0]])
    assert not geometry.occluded(positions, RADIUS).any()
    assert geometry.visible(positions, RADIUS, SCAN).sum() == 6
    assert geometry.visible(array(np.zeros((4, 2))), RADIUS, SCAN).sum(axis=1).tolist() == [3, 3, 3, 3]


@given(hnp.arrays(np.float64, st.tuples(st.integers(1, 6), st.just(2)), elements=st.floats(-3, 3)))
def test_overlapping_robots_have_defined_answers(positions):
    """No warning (here an error), no NaN; and what holds of all booleans holds."""
    near, hidden, seen = readings(positions)
    np.testing.assert_array_equal(seen, near & ~hidden)
    np.testing.assert_array_equal(near, near.T)
    assert not (hidden & np.eye(len(positions), dtype=bool)).any()


@pytest.mark.parametrize("lost", [(np.nan, np.nan), (np.nan, 0.0), (0.0, np.nan)], ids=str)
def test_a_robot_without_a_place_is_nobodys_neighbour_and_hides_nobody(array, lost):
    positions = np.array([[0, 0], [4, 0], [8, 0], [3, 5], [2, 2]], float)
    among = np.ix_(*2 * [[0, 1, 2, 3]])
    whole = [matrix[among] for matrix in readings(array(positions[:4]))]
    positions[4] = lost
    for with_lost, without in zip(readings(array(positions), kernels=_batch_last), whole, strict=True):
        np.testing.assert_array_equal(with_lost[among], without)
        assert not with_lost[4].any()
        assert not with_lost[:, 4].any()


def test_far_from_the_origin(array):
    """Only differences of positions count, so that an offset costs no more than the digits it takes from them."""
    rng = np.random.default_rng(0)
    for offset in ([1e4, -3e4], [1e6, 1e6]):
        far_positions = array(rng.permuted(np.mgrid[:4, :4].reshape(2, -1).T * 5.0, axis=0)[:9] + offset)
        positions = array(np.asarray(far_positions, np.float64) - offset)
        np.testing.assert_array_equal(readings(far_positions), readings(positions))


@pytest.mark.parametrize("exponent", [-12, 12])
def test_world_of_any_size(array, exponent):
    positions = np.array([[0, 0], [4, 1], [9, 3], [-5, 3], [1, 8]], float)
    assert oracle.decided(positions, RADIUS, SCAN, oracle.FLOAT32_TANGENCY).all()
    scaled = readings(array(positions * 10.0**exponent), 10.0**exponent, SCAN * 10.0**exponent)
    np.testing.assert_array_equal(scaled, readings(array(positions)))
    huge = readings(positions * 1e100, 1e100, SCAN * 1e100)
    np.testing.assert_array_equal(huge, readings(positions))


@given(configurations(min_robots=1, max_robots=5))
def test_an_observer_knows_whom_it_occludes_from_each_other(positions):
    """By the oracle: for whoever it sees, who would be occluded if there were no others than these three."""
    robots = len(positions)
    rng = np.random.default_rng(robots)
    seen = rng.random((robots, robots)) < 0.8
    angle, unit = rng.uniform(0, 2 * np.pi, robots), rng.uniform(0.5, 2, robots)
    offsets = (positions[None] - positions[:, None]) @ np.array([[1, 0], [0, -1]])
    cos, sin = unit * np.cos(angle), unit * np.sin(angle)
    x = cos[:, None] * offsets[..., 0] - sin[:, None] * offsets[..., 1]
    y = sin[:, None] * offsets[..., 0] + cos[:, None] * offsets[..., 1]
    between = _batch_last.stands_between(x, y, seen & ~np.eye(robots, dtype=bool), RADIUS * unit)
    for k in range(robots):
        others = [i for i in range(robots) if i != k and seen[k, i]]
        clearances = [
            oracle.shadow_clearance(positions[[j, i, k]], RADIUS)[0, 1] for j in others for i in others if i != j
        ]
        least = min(clearances, default=np.inf)
        if abs(least) > oracle.FLOAT64_TANGENCY:
            assert between[k] == (least < 0)
