"""The kernels of visibility against polygons: 100,000 random configurations of 2 to 16 robots, dense and sparse."""

from __future__ import annotations

import jax
import numpy as np
import pytest
import shapely

from murmurate import geometry
from murmurate.errors import InputError
from oracles import visibility as oracle
from oracles.configurations import BATCHES, disjoint, scenes


def readings(positions, radius, scan_radius):
    return (
        geometry.neighbors(positions, scan_radius),
        geometry.occluded(positions, radius),
        geometry.visible(positions, radius, scan_radius),
    )


KERNELS = [
    (readings, np.float64, oracle.FLOAT64_TANGENCY),
    (jax.jit(readings), np.float32, oracle.FLOAT32_TANGENCY),
]


@pytest.mark.parametrize("long", [False, pytest.param(True, marks=pytest.mark.nightly)], ids=["short", "long"])
@pytest.mark.parametrize("robots", BATCHES)
def test_kernels_agree_with_polygons(robots, long):
    undecided, occlusions, pairs = {np.float64: 0, np.float32: 0}, 0, 0
    for positions, radius, side in scenes(robots, long):
        scan_radius = 0.5 * side
        clearance = oracle.shadow_clearance(positions, radius)
        near = oracle.neighbors(positions, scan_radius)
        seen = near & (clearance > 0)
        edge = np.minimum(np.abs(clearance), np.abs(oracle.pairwise_distances(positions) - scan_radius))
        occlusions += (clearance < 0).sum()
        pairs += clearance.size
        for kernels, dtype, tolerance in KERNELS:
            answers = kernels(positions.astype(dtype), radius, scan_radius)
            got_near, got_occluded, got_seen = map(np.asarray, answers)
            decided = edge > tolerance * radius
            undecided[dtype] += (~decided).sum()
            np.testing.assert_array_equal(got_near[decided], near[decided])
            np.testing.assert_array_equal(got_occluded[decided], clearance[decided] < 0)
            np.testing.assert_array_equal(got_seen[decided], seen[decided])
    assert undecided[np.float64] == 0
    assert undecided[np.float32] <= 2e-4 * pairs
    assert (0.02 < occlusions / pairs < 0.9) or robots == 2
    assert occlusions == 0 or robots > 2


def test_the_oracle_follows_the_definition():
    """A disc is occluded when a segment from the light to a point of its edge passes through another disc."""
    robots, radius, angles = 5, 1.0, np.linspace(0, 2 * np.pi, 256, endpoint=False)
    positions = disjoint(np.random.default_rng(0), 100, robots, radius, side=10.0).astype(np.float64)
    edge = positions[:, :, None] + radius * np.stack([np.cos(angles), np.sin(angles)], -1)
    light = np.broadcast_to(positions[:, :, None, None], (100, robots, robots, angles.size, 2))
    rays = shapely.linestrings(np.stack([light, np.broadcast_to(edge[:, None], light.shape)], -2))
    blocked = shapely.distance(rays[..., None], shapely.points(positions)[:, None, None, None]) < radius
    observer, observed, occluder = np.ogrid[:robots, :robots, :robots]
    third = (observer != occluder) & (occluder != observed) & (observed != observer)
    expected = (blocked.any(3) & third).any(-1)
    clearance = oracle.shadow_clearance(positions, radius)
    # Between two of the sampled points the edge bulges by less than 1e-4 R.
    decided = np.abs(clearance) > 1e-4 * radius
    np.testing.assert_array_equal(expected[decided], clearance[decided] < 0)
    assert decided.mean() > 0.99
    assert 0.1 < expected.mean() < 0.9


def test_the_drawn_shadow_is_the_polygon():
    robots, radius = 4, 1.0
    for positions in disjoint(np.random.default_rng(1), 50, robots, radius, side=12.0).astype(np.float64):
        expected = oracle.shadows(positions, radius)
        reach = 4 * (np.ptp(positions, axis=0).max() + radius)  # where the oracle's polygons end
        for k, j in np.argwhere(~np.eye(robots, dtype=bool)):
            corners = geometry.shadow(positions[k], positions[j], radius, reach)
            assert shapely.hausdorff_distance(shapely.Polygon(corners), expected[k, j]) < 1e-9 * reach
            np.testing.assert_allclose(np.hypot(*(corners - positions[j]).T)[[0, 3]], radius, rtol=1e-12)
            np.testing.assert_allclose(np.hypot(*(corners - positions[k]).T)[[1, 2]], reach, rtol=1e-12)
            assert not shapely.is_ccw(shapely.LinearRing(corners))


@pytest.mark.parametrize("occluder", [(0.0, 0.0), (0.6, 0.8), (np.nan, 0.0), (np.inf, 0.0)])
def test_no_shadow_of_a_robot_over_the_light(occluder):
    with pytest.raises(InputError, match="occluder"):
        geometry.shadow(np.zeros(2), np.array(occluder), 1.0, 10.0)


@pytest.mark.parametrize("reach", [1.7, np.nan, np.inf])
def test_a_shadow_reaches_beyond_the_tangents_points_of_contact(reach):
    assert len(geometry.shadow(np.zeros(2), np.array([2.0, 0.0]), 1.0, 1.74)) == 4
    with pytest.raises(InputError, match="reach"):
        geometry.shadow(np.zeros(2), np.array([2.0, 0.0]), 1.0, reach)
