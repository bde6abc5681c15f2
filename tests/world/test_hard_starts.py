"""Starts that are hard for a controller: never in contact, always inside, and what makes each of them hard."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from murmurate.errors import InputError
from murmurate.geometry._batch_last import clearances, distances
from murmurate.world import (
    ClusterStart,
    CornerStart,
    HardStart,
    Start,
    SurroundedStart,
    TightGridStart,
    WallsStart,
    WallStart,
    WorldConfig,
    check_start,
    draw_starts,
    scaled_to,
)

FAMILIES = {
    "cluster": ClusterStart,
    "corner": CornerStart,
    "wall": WallStart,
    "walls": WallsStart,
    "tight-grid": TightGridStart,
    "surrounded": SurroundedStart,
}
SIZES = (2, 3, 8, 33, 128)
BATCH = 64


def world_of(robots, shape=1.0, size=1.0):
    """A world of the usual sides, or so many times as large, and stretched."""
    world = scaled_to(WorldConfig(), robots)
    half_width, half_height = size * shape * world.half_width, size * world.half_height
    return WorldConfig(robots=robots, half_width=half_width, half_height=half_height, scan_radius=world.scan_radius)


def draw(start, seed, world):
    """Draws a batch, in float64, after checking its shape and that its robots are apart and inside, to the last bit."""
    points = draw_starts(start.prepare(world), jax.random.key(seed), BATCH, world)
    assert points.shape == (BATCH, world.robots, 2)
    assert points.dtype == np.float32
    assert (np.abs(points) <= world.bounds).all()
    points = points.astype(float)
    assert (clearances(np.moveaxis(points, 0, -1), world.radius) > 0).all()
    return points


def nearest(points):
    """The distance of each robot to the one nearest to it, `(batch, robots)`."""
    apart = np.moveaxis(distances(np.moveaxis(points, 0, -1)), -1, 0)
    return np.where(np.eye(points.shape[1], dtype=bool), np.inf, apart).min(axis=2)


def gaps(points, world):
    """The distance of each robot from the vertical and from the horizontal wall next to it, `(batch, robots, 2)`."""
    return world.bounds.astype(float) - np.abs(points)


def span(points):
    """The greatest distance of two robots, `(batch,)`."""
    return distances(np.moveaxis(points, 0, -1)).max(axis=(0, 1))


@pytest.mark.parametrize("robots", SIZES)
@pytest.mark.parametrize("family", FAMILIES)
@given(seed=st.integers(0, 2**31 - 1), shape=st.floats(0.6, 2.0), size=st.floats(1.0, 20.0), radius=st.floats(0.5, 1.5))
@settings(max_examples=5)
def test_never_in_contact_and_always_inside(family, robots, seed, shape, size, radius):
    world = world_of(robots, shape, size)
    world = WorldConfig(robots=robots, half_width=world.half_width, half_height=world.half_height, radius=radius)
    draw(FAMILIES[family](), seed, world)


@pytest.mark.parametrize("robots", SIZES)
def test_a_cluster_is_tight_and_anywhere(robots):
    world = world_of(robots)
    points = draw(ClusterStart(), 1, world)
    # A disc of N points of the loosest lattice, with room for its ragged border and the jitter.
    widest = 2 * 1.8 * (2 * np.sqrt(robots * np.sqrt(0.75) / np.pi) + 3.5)
    assert (span(points) <= widest).all()
    assert nearest(points).min() < 2.15
    assert (nearest(points).min(axis=1) <= 2 * 1.8 + 1e-3).all()
    middle = points.mean(axis=1) / world.bounds
    assert (np.abs(np.quantile(middle, [0.1, 0.9], axis=0)) > 0.4).all(), "placed all over the world"
    assert len(np.unique(points, axis=0)) == BATCH


@pytest.mark.parametrize("robots", [4, 8, 16])
def test_a_ring_surrounds_one_robot_or_a_few(robots):
    points = draw(SurroundedStart(), 3, world_of(robots))
    # A robot inside of a ring is no corner of the convex hull; nor are some of those on the ring, once they are moved.
    inside = np.array([robots - len(ConvexHull(each).vertices) for each in points])
    assert (inside >= 1).all()
    assert (inside == 1).mean() > 0.4
    assert (inside > 1).mean() > 0.15 or robots == 4
    # Neighbours on the ring are 2.2 to 16 units apart.
    tight, wide = np.quantile(span(points), [0.05, 0.95]) * np.sin(np.pi / robots)
    assert tight < 4
    assert wide > 9
    middle = points.mean(axis=1) / world_of(robots).bounds
    assert (np.abs(np.quantile(middle, [0.1, 0.9], axis=0)) > 0.4).all(), "placed all over the world"


@pytest.mark.parametrize("robots", SIZES)
def test_a_corner_cluster_has_robots_at_both_walls(robots):
    world = world_of(robots)
    points = draw(CornerStart(), 2, world)
    least = gaps(points, world).min(axis=1)
    assert (least <= 2 * world.radius + 1e-3).all()
    exactly = (least == 0).mean(axis=0)
    assert ((exactly > 0.3) & (exactly < 0.7)).all(), "half of the time exactly at the wall"
    corners = np.unique(np.sign(points.mean(axis=1)), axis=0)
    assert len(corners) == 4, "every corner"
    side = 2 * 1.8 * (np.sqrt(robots * np.sqrt(0.75)) + 3)
    assert ((points.max(axis=1) - points.min(axis=1)) <= side).all()


@pytest.mark.parametrize("robots", SIZES)
def test_a_line_is_along_one_wall(robots):
    world = world_of(robots)
    points = draw(WallStart(), 3, world)
    distance = gaps(points, world)
    # All robots of a line are equally far from the wall: 0 half of the time, never more than two radii.
    is_line = np.ptp(points, axis=1) == 0
    assert (is_line.sum(axis=1) == 1).all()
    depth = distance[:, 0][is_line]
    assert (depth <= 2 * world.radius + 1e-3).all()
    assert 0.3 < (depth == 0).mean() < 0.7
    walls = {(axis, np.sign(points[i, 0, axis])) for i, axis in enumerate(is_line.argmax(axis=1))}
    assert len(walls) == 4, "every wall"
    if robots > 2:
        along = np.sort(np.where(is_line[:, None, 0], points[..., 1], points[..., 0]), axis=1)
        even = np.ptp(np.diff(along, axis=1), axis=1) < 1e-2
        assert 0.3 < even.mean() < 0.7, "equal gaps half of the time"


def test_where_one_line_is_too_short_there_are_several():
    world = WorldConfig(robots=30, half_width=12.0, half_height=9.0)
    points = draw(WallStart(), 4, world)
    for configuration in points:
        lines = [len(np.unique(configuration[:, axis].round(3))) for axis in (0, 1)]
        assert 2 <= min(lines) <= 4
    assert (nearest(points) < 24 / 9 + 1e-3).all(), "as tight as the walls are short"


@pytest.mark.parametrize("robots", SIZES)
def test_robots_at_the_walls(robots):
    world = world_of(robots)
    points = draw(WallsStart(), 5, world)
    depth = gaps(points, world).min(axis=2)
    assert (depth <= world.radius + 1e-3).all()
    np.testing.assert_allclose((depth == 0).mean(), 0.5, atol=0.15)
    at = gaps(points, world).argmin(axis=2)
    sides = [((at == axis) & (np.sign(points[..., axis]) == sign)).mean() for axis in (0, 1) for sign in (-1, 1)]
    np.testing.assert_allclose(sides, 0.25, atol=0.12)


@pytest.mark.parametrize("robots", [4, 9, 12])
def test_a_grid_is_tight_square_and_turned(robots):
    world = world_of(robots)
    points = draw(TightGridStart(), 6, world)
    near = nearest(points)
    assert (near >= 2.1 - 0.1).all()
    assert (near <= 4 + 0.1).all()
    # Half of the grids have no jitter: all robots are equally far from the nearest one, as far as rounding goes.
    exact = np.ptp(near, axis=1) < 1e-4
    assert 0.3 < exact.mean() < 0.7
    columns = [len(np.unique(configuration[:, 0].round(2))) for configuration in points[exact]]
    parallel = np.array(columns) == np.ceil(np.sqrt(robots))
    parallel |= np.array(columns) == np.ceil(robots / np.ceil(np.sqrt(robots)))
    assert 0.25 < parallel.mean() < 0.75, "parallel to the walls half of the time"


def test_hard_starts_are_all_of_them():
    """Each configuration tells by its walls, its spacing and its symmetry which of them it is of."""
    world = world_of(9)
    start = check_start(HardStart(), world)
    points = draw_starts(start, jax.random.key(7), 512, world).astype(float)
    assert (clearances(np.moveaxis(points, 0, -1), world.radius) > 0).all()
    distance = gaps(points, world)
    shares = {
        "walls": (distance.min(axis=2) <= world.radius + 1e-3).all(axis=1) & (span(points) > 60),
        "wall": (np.ptp(points, axis=1) == 0).any(axis=1),
        "corner": (distance.min(axis=1) <= 2 * world.radius + 1e-3).all(axis=1) & (span(points) < 30),
        "symmetric": np.abs(points.mean(axis=1)).max(axis=1) < 1e-3,
    }
    for name, matches in shares.items():
        np.testing.assert_allclose(matches.mean(), 1 / 7, atol=0.06, err_msg=name)


@pytest.mark.parametrize("family", [*FAMILIES, "hard"])
def test_the_first_are_the_same_whatever_the_count(family):
    world = world_of(33)
    start = Start.registered()[family]()
    many = draw_starts(start, jax.random.key(1), 9, world)
    np.testing.assert_array_equal(draw_starts(start, jax.random.key(1), 1, world), many[:1])
    assert len(np.unique(many, axis=0)) == 9


@pytest.mark.parametrize("family", [*FAMILIES, "hard"])
def test_a_world_without_room_is_refused_in_one_line(family):
    world = WorldConfig(robots=40, half_width=6.0, half_height=6.0)
    with pytest.raises(InputError, match=r"^world.robots = 40: must be few enough to fit the [\w-]+ start") as error:
        check_start(Start.registered()[family](), world)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("family", "field", "value"),
    [
        ("cluster", "min_spacing", 1.0),
        ("cluster", "max_spacing", 1.0),
        ("tight-grid", "min_spacing", float("nan")),
        ("corner", "min_spacing", 0.5),
        ("corner", "max_gap", -1.0),
        ("wall", "max_spacing", float("inf")),
        ("wall", "max_gap", -0.1),
        ("walls", "max_gap", -1.0),
        ("surrounded", "min_spacing", 1.0),
        ("surrounded", "max_spacing", 1.0),
    ],
)
def test_no_such_start(family, field, value):
    with pytest.raises(InputError, match=f"^{field} = "):
        FAMILIES[family](**{field: value})


@pytest.mark.parametrize("family", ["cluster", "corner", "tight-grid", "wall"])
def test_double_precision_places_robots_alike(family):
    """Sets of starts are computed so: the arithmetic is the same, whatever the namespace."""
    world = world_of(8)
    start = FAMILIES[family]()
    numbers = start.uniforms(jax.random.key(3), BATCH, 8)
    single = np.asarray(jax.jit(lambda numbers: start.place(numbers, world))(numbers))
    double = start.place(tuple(np.asarray(array, float) for array in numbers), world)
    assert double.dtype == float
    np.testing.assert_allclose(double, single, atol=2e-4)
    assert (np.abs(double) <= world.bounds).all()
