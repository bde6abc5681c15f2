"""What the baselines bring about, from seeded starts anywhere."""

from __future__ import annotations

import functools

import jax
import numpy as np
import pytest

from murmurate.discovery import Cascade, RestRule, check_validity
from murmurate.geometry import smallest_ring
from murmurate.policies.baselines import Baseline
from murmurate.policies.baselines.circle import enclosing_circle, ring_radius
from murmurate.world import (
    GlobalSensing,
    LocalObservation,
    UniformStart,
    VisibleSensing,
    World,
    WorldConfig,
    draw_starts,
)

CONFIG = WorldConfig(robots=6, half_width=35.0, half_height=35.0, scan_radius=105.0)


@functools.cache
def anywhere():
    world = World.create(CONFIG, UniformStart(), "C2")
    return world, draw_starts(world.start, jax.random.key(5), 32, CONFIG)


@functools.cache
def ran(name, count=16, steps=200):
    world, starts = anywhere()
    policy = Baseline.registered()[name](CONFIG, False)
    sensing = GlobalSensing() if policy.centralised else VisibleSensing(rotation=True)
    trajectories = Cascade((policy,), LocalObservation(world, sensing, CONFIG), RestRule(max_steps=steps)).rollout(
        starts[:count]
    )
    return trajectories, check_validity(trajectories, CONFIG)


def test_a_walk_at_random_goes_nowhere_in_particular():
    trajectories, validity = ran("random", 16, 50)
    moves = np.diff(trajectories.positions[trajectories.lengths >= 10, :11], axis=1)
    speeds = np.linalg.norm(moves, axis=-1)
    assert 0.55 < speeds.mean() < 0.75
    assert np.abs(moves.mean(axis=(0, 1, 2))).max() < 0.1
    assert validity.valid.sum() == 0


def test_the_centroid_gathers_without_collision():
    trajectories, validity = ran("centroid", 32)
    gathered = trajectories.signals["nclose"]
    assert validity.contact_free.all()
    assert validity.safe.all()
    assert (gathered[:, -1] > gathered[:, 0]).all()
    assert gathered[:, -1].mean() > 0.9


@pytest.mark.parametrize(("name", "least"), [("circle-central", 15), ("circle", 13), ("two-color", 12)])
def test_most_starts_end_in_a_valid_pattern(name, least):
    _, validity = ran(name)
    assert validity.valid.sum() >= least


@pytest.mark.parametrize("name", ["circle", "gradient", "two-color"])
def test_more_is_visible_at_the_end(name):
    seen = ran(name)[0].signals["visible"]
    assert seen[:, -1].mean() > max(seen[:, 0].mean(), 0.95)


def test_the_gradient_climbs_the_objective():
    signals = ran("gradient")[0].signals
    objective = sum(signals.values())
    assert objective[:, -1].mean() > objective[:, 0].mean() + 0.1


def inside(points):
    """Counts the robots that are no corner of the convex hull."""
    count = 0
    for i in range(len(points)):
        angle = np.sort(np.arctan2(*np.delete(points - points[i], i, axis=0).T[::-1]))
        gap = np.max(np.diff(np.append(angle, angle[0] + 2 * np.pi)))
        count += gap <= np.pi
    return count


def test_two_colours_leave_nobody_inside():
    trajectories, validity = ran("two-color")
    first = sum(inside(positions[0]) for positions in trajectories.positions)
    last = sum(inside(final) for final in trajectories.final[validity.contact_free])
    assert first > 10
    assert last == 0


@pytest.mark.parametrize("robots", [2, 3, 5, 8, 12, 40])
def test_the_least_ring_is_that_of_the_patterns(robots):
    expected = smallest_ring(robots, CONFIG.radius, CONFIG.safe_distance)
    np.testing.assert_allclose(ring_radius(robots, CONFIG), expected.radius, rtol=1e-5)


def test_the_enclosing_circle_is_the_smallest():
    points = np.random.default_rng(0).normal(size=(3, 7, 4)).astype(np.float32)
    x, y = points, points[::-1]
    member = np.ones(x.shape, bool)
    cx, cy, radius = (np.asarray(a) for a in enclosing_circle(x, y, member, (x.mean(axis=1), y.mean(axis=1))))
    away = np.hypot(x - cx[:, None], y - cy[:, None])
    np.testing.assert_allclose(away.max(axis=1), radius, rtol=1e-5)
    grid = np.linspace(-2, 2, 201)
    for group in range(3):
        for batch in range(4):
            gx, gy = np.meshgrid(grid, grid)
            far = np.hypot(x[group, :, batch, None, None] - gx, y[group, :, batch, None, None] - gy).max(axis=0)
            assert radius[group, batch] <= far.min() * 1.02
