"""Obstacles: the kernels against shapely's shapes, their symmetries, and what happens at their edges."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from murmurate import geometry
from murmurate.errors import InputError
from murmurate.geometry import _batch_last
from oracles import obstacles as oracle
from oracles.visibility import FLOAT32_TANGENCY, FLOAT64_TANGENCY

RADIUS = 1.0
NO_DISCS, NO_WALLS = np.zeros((0, 3)), np.zeros((0, 4))


def scene(seed, robots=8, discs=4, walls=3, side=30.0):
    """Robots outside of all obstacles, which may overlap each other."""
    random = np.random.default_rng(seed)
    centres = random.uniform(-side, side, (discs, 2))
    discs = np.concatenate([centres, random.uniform(0.3, 6.0, (discs, 1))], axis=1)
    walls = random.uniform(-side, side, (walls, 4))
    positions = np.zeros((0, 2))
    while len(positions) < robots:
        point = random.uniform(-side, side, (1, 2))
        clear = (oracle.clearances(point, RADIUS, discs, walls) > 0).all()
        if clear and (np.linalg.norm(positions - point, axis=1) > 2 * RADIUS).all():
            positions = np.concatenate([positions, point])
    return positions, discs, walls


def rotated(angle, points):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.concatenate([points[..., i : i + 2] @ turn.T for i in range(0, points.shape[-1] - 1, 2)], axis=-1)


seeds = st.integers(0, 10**6)


@given(seeds)
def test_gaps_agree_with_the_oracle(seed):
    positions, discs, walls = scene(seed)
    velocities = np.random.default_rng(seed).normal(scale=10.0, size=positions.shape)
    expected = oracle.clearances(positions, RADIUS, discs, walls)
    np.testing.assert_allclose(geometry.obstacle_clearances(positions, RADIUS, discs, walls), expected, atol=1e-9)
    moving = oracle.approach(positions, velocities, RADIUS, discs, walls)
    given_discs = geometry.obstacle_approach(positions, velocities, RADIUS, discs, walls)
    np.testing.assert_allclose(given_discs, moving, atol=1e-9)
    still = geometry.obstacle_approach(positions, 0 * velocities, RADIUS, discs, walls)
    np.testing.assert_allclose(still, expected, atol=1e-9)


@pytest.mark.parametrize("scenes", [300, pytest.param(3000, marks=pytest.mark.nightly)])
def test_shadows_agree_with_polygons(scenes):
    """300 scenes have 10^5 relations of an observer, an observed robot and an obstacle."""
    relations = hidden = 0
    kernel = jax.jit(geometry.occluded_by_obstacles)
    for seed in range(scenes):
        positions, discs, walls = scene(seed)
        clearance = oracle.shadow_clearance(positions, RADIUS, discs, walls)
        relations += clearance.size
        edge, expected = np.abs(clearance).min(axis=2), (clearance < 0).any(axis=2)
        hidden += expected.sum()
        for positions_in, occluded, tolerance in (
            (positions, geometry.occluded_by_obstacles, FLOAT64_TANGENCY),
            (jnp.asarray(positions, jnp.float32), kernel, 10 * FLOAT32_TANGENCY),
        ):
            got, decided = np.asarray(occluded(positions_in, RADIUS, discs, walls)), edge > tolerance * RADIUS
            np.testing.assert_array_equal(got[decided], expected[decided], err_msg=str(seed))
            assert decided.mean() > 0.95
    assert relations == scenes * 8 * 8 * 7
    assert 0.2 < hidden / (scenes * 8 * 7) < 0.8


@given(seeds, st.floats(-np.pi, np.pi), st.floats(0.1, 10.0), st.floats(-100, 100))
def test_rotation_translation_and_scale_do_not_matter(seed, angle, scale, shift):
    positions, discs, walls = scene(seed, robots=5)
    clearance = np.abs(oracle.shadow_clearance(positions, RADIUS, discs, walls)).min(axis=2)
    moved = [scale * rotated(angle, x) + shift for x in (positions, np.c_[discs[:, :2], discs[:, :2]], walls)]
    changed = (moved[0], scale * RADIUS, np.c_[moved[1][:, :2], scale * discs[:, 2]], moved[2])
    same = geometry.occluded_by_obstacles(*changed) == geometry.occluded_by_obstacles(positions, RADIUS, discs, walls)
    assert same[clearance > 1e-6].all()
    gaps = geometry.obstacle_clearances(positions, RADIUS, discs, walls)
    np.testing.assert_allclose(geometry.obstacle_clearances(*changed) / scale, gaps, atol=1e-6)


@given(seeds)
def test_a_disc_of_a_robots_size_hides_as_a_robot_does(seed):
    positions, *_ = scene(seed, robots=6, discs=0, walls=0, side=12.0)
    robot = positions[:1]
    others = positions[1:]
    disc = np.concatenate([robot, [[RADIUS]]], axis=1)
    by_anybody = geometry.occluded(positions, RADIUS)[1:, 1:]
    by_others = geometry.occluded(others, RADIUS)
    by_disc = geometry.occluded_by_obstacles(others, RADIUS, disc, NO_WALLS)
    np.testing.assert_array_equal(by_others | by_disc, by_anybody)


PAIR = np.array([[0.0, 0.0], [10.0, 0.0]])


@pytest.mark.parametrize(
    ("discs", "walls", "hidden"),
    [
        ([[5.0, 0.0, 1.0]], [], True),
        ([[13.0, 0.0, 1.0]], [], False),  # behind the observed robot
        ([[-3.0, 0.0, 1.0]], [], False),
        ([[5.0, 3.0, 1.0]], [], False),
        # Much larger than a robot: its centre is 30 cos a - 5 sin a = 29.35 from the shadow's side, sin a = 1/10.
        ([[5.0, 30.0, 29.36]], [], True),
        ([[5.0, 30.0, 29.34]], [], False),
        ([[5.0, 0.0, -np.inf]], [], False),  # absent
        ([], [[5.0, -1.0, 5.0, 1.0]], True),
        ([], [[5.0, 2.0, 5.0, 9.0]], False),
        ([], [[5.0, 0.0, 5.0, 0.0]], True),  # a point
        ([], [[3.0, 0.0, 6.0, 0.0]], True),  # along the way
        ([], [[5.0, 0.2, 5.1, 0.2]], True),  # inside the shadow's triangle, across none of its sides
        ([], [[-5.0, 5.0, 15.0, 5.0]], False),
        ([], [], False),
    ],
)
def test_who_is_hidden(array, discs, walls, hidden):
    discs, walls = (array(np.reshape(rows, (-1, length))) for rows, length in ((discs, 3), (walls, 4)))
    got = np.asarray(geometry.occluded_by_obstacles(array(PAIR), RADIUS, discs, walls))
    assert got[0, 1] == hidden
    assert not got.diagonal().any()


def test_tangency_hides_nobody():
    """A disc that touches the shadow's side from outside: the side rises by 3/4 of a unit with each unit."""
    pair = np.array([[0.0, 0.0], [5.0, 0.0]])
    touching = np.array([[2.0, 1.5 + 2.5, 2.0]])  # the distance of (2, 4) from the line y = 3 x / 4 is 2
    assert not geometry.occluded_by_obstacles(pair, 3.0, touching, NO_WALLS)[0, 1]
    assert geometry.occluded_by_obstacles(pair, 3.0, touching + np.array([0.0, 0.0, 1e-9]), NO_WALLS)[0, 1]


def test_a_thin_wall_is_not_jumped_over():
    walls = [[0.5, -5.0, 0.5, 5.0]]
    gaps = geometry.obstacle_approach([[-10.0, 0.0], [-10.0, 7.0]], [[20.0, 0.0], [20.0, 0.0]], 1.0, NO_DISCS, walls)
    np.testing.assert_allclose(gaps, [[-1.0], [1.0]])


def test_gaps_at_edges(array):
    discs, walls = array([[5.0, 0.0, 2.0], [0.0, 0.0, -np.inf]]), array([[0.0, 3.0, 8.0, 3.0], [0.0, -4.0, 0.0, -4.0]])
    gaps = geometry.obstacle_clearances(array([[0.0, 0.0]]), 1.0, discs, walls)
    np.testing.assert_allclose(gaps, [[2.0, np.inf, 2.0, 3.0]])
    touching = geometry.obstacle_approach(array([[0.0, 0.0]]), array([[2.0, 0.0]]), 1.0, discs, walls)
    np.testing.assert_allclose(touching, [[0.0, np.inf, 2.0, 3.0]])


def test_nearest_points():
    discs, walls = np.array([[5.0, 0.0, 2.0], [0.0, 0.0, -np.inf], [0.0, 0.0, 4.0]]), np.array([[-1.0, 3.0, 8.0, 3.0]])
    points = _batch_last.nearest_points(np.zeros((1, 2)), discs, walls)[0]
    np.testing.assert_allclose(points, [[3.0, 0.0], [np.inf, 0.0], [4.0, 0.0], [0.0, 3.0]])


@given(seeds)
def test_distances_between_walls_agree_with_the_oracle(seed):
    _, _, walls = scene(seed, robots=0, discs=0, walls=4)
    lines = shapely.linestrings(walls.reshape(-1, 2, 2))
    expected = shapely.distance(lines[:, None], lines)
    np.testing.assert_allclose(_batch_last.distances_between_walls(walls, walls), expected, atol=1e-9)


def test_batches_share_obstacles():
    scenes = [scene(seed) for seed in range(3)]
    positions = np.stack([positions for positions, _, _ in scenes])
    _, discs, walls = scenes[0]
    whole = geometry.occluded_by_obstacles(positions, RADIUS, discs, walls)
    each = [geometry.occluded_by_obstacles(points, RADIUS, discs, walls) for points in positions]
    np.testing.assert_array_equal(whole, each)
    own = np.stack([discs for _, discs, _ in scenes]), np.stack([walls for _, _, walls in scenes])
    gaps = geometry.obstacle_clearances(positions, RADIUS, *own)
    np.testing.assert_allclose(gaps, [geometry.obstacle_clearances(x, RADIUS, d, w) for x, d, w in scenes])


def test_coincident_robots_and_gradients_are_finite():
    positions = jnp.zeros((2, 2))
    assert np.asarray(geometry.occluded_by_obstacles(positions, 1.0, [[5.0, 0.0, 1.0]], NO_WALLS)).shape == (2, 2)
    slope = jax.grad(lambda x: geometry.obstacle_clearances(x, 1.0, [[0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0, 0.0]]).sum())
    assert np.isfinite(np.asarray(slope(positions))).all()


def test_a_robot_at_nan_touches_nothing():
    positions = np.full((1, 2), np.nan)
    gaps = _batch_last.obstacle_approach(positions, positions, 1.0, np.array([[0.0, 0.0, 1.0]]), np.zeros((1, 4)))
    assert not (gaps <= 0).any()


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("discs", "walls", "message"),
    [
        ([[0.0, 0.0]], NO_WALLS, "discs"),
        ([[0.0, np.nan, 1.0]], NO_WALLS, "discs"),
        ([[0.0, 0.0, 0.0]], NO_WALLS, "radii > 0"),
        ([[0.0, 0.0, np.inf]], NO_WALLS, "radii > 0"),
        (NO_DISCS, [[0.0, 0.0, 1.0]], "walls"),
        (NO_DISCS, [[0.0, 0.0, 1.0, np.inf]], "walls"),
        ("discs", NO_WALLS, "discs"),
        (np.zeros((5, 1, 3)), NO_WALLS, "discs"),
    ],
)
def test_bad_obstacles_are_refused(discs, walls, message):
    with pytest.raises(InputError, match=message):
        geometry.obstacle_clearances(PAIR, RADIUS, discs, walls)
    with pytest.raises(InputError, match=message):
        geometry.occluded_by_obstacles(PAIR, RADIUS, discs, walls)
