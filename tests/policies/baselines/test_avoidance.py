"""No two robots that see each other collide, whatever they want."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from murmurate.geometry import _batch_last
from murmurate.policies.baselines.avoidance import SAFETY_FACTOR, avoid_collisions, full_view
from murmurate.world import WorldConfig

WORLD = WorldConfig(robots=6)


@jax.jit
def avoided(positions, wanted):
    return avoid_collisions(wanted[:, 0], wanted[:, 1], full_view(positions), WORLD)


def apart(seed, robots, spread, batch=64):
    """Draws configurations of robots that do not touch."""
    points = np.random.default_rng(seed).uniform(-spread, spread, (robots, 2, 40 * batch))
    least = np.stack([np.linalg.norm(points[i] - points[j], axis=0) for i in range(robots) for j in range(i)]).min(0)
    return points[..., least > 2.001][..., :batch].astype(np.float32)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**6), st.floats(0.0, 30.0))
def test_two_robots_that_see_each_other_never_collide(seed, speed):
    positions = apart(seed, 2, 3.0)
    wanted = np.random.default_rng(seed + 1).normal(size=positions.shape) * speed
    # Half of them head for each other.
    wanted[..., ::2] = speed * (positions[::-1] - positions)[..., ::2]
    result = np.asarray(avoided(positions, wanted.astype(np.float32)), float)
    assert not _batch_last.any_contact(positions.astype(float), result, WORLD.radius).any()


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 10**6))
def test_a_crowd_does_not_collide_either(seed):
    positions = apart(seed, 4, 5.0)
    wanted = -3 * positions
    result = np.asarray(avoided(positions, wanted), float)
    assert (np.linalg.norm(result, axis=1) <= WORLD.max_speed).all()
    assert not _batch_last.any_contact(positions.astype(float), result, WORLD.radius).any()


def test_somebody_in_the_shadow_of_another_is_reckoned_with():
    """Robot 0 sees robot 1 and not robot 2, which is nearly as near: it goes no farther than it may towards either."""
    positions = np.array([[0.0, 0.0], [2.2, 0.0], [2.05, 2.2]], np.float32)[..., None]
    seen = full_view(jnp.asarray(positions))
    mask = np.ones((3, 3, 1), bool)
    mask[0, 2] = mask[2, 0] = False
    hidden = seen._replace(seen=seen.seen & mask, x=seen.x * mask, y=seen.y * mask)
    towards = jnp.asarray(positions[[2, 1, 0]] - positions)
    result = np.asarray(avoid_collisions(towards[:, 0], towards[:, 1], hidden, WORLD), float)
    assert np.abs(result).max() > 0
    assert not _batch_last.any_contact(positions.astype(float), result, WORLD.radius).any()


def test_wanted_velocities_that_are_free_are_kept():
    positions = 20.0 * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], np.float32)[..., None]
    wanted = np.array([[0.3, 0.4], [-0.5, 0.0], [0.0, 0.7]], np.float32)[..., None]
    np.testing.assert_allclose(avoided(positions, wanted), wanted, atol=1e-5)


def test_pairs_come_to_the_safe_distance_and_no_nearer():
    positions = np.array([[0.0, 0.0], [9.0, 0.0]], np.float32)[..., None]
    inwards = np.array([[1.0, 0.0], [-1.0, 0.0]], np.float32)[..., None]
    for _ in range(10):
        positions = positions + np.asarray(avoided(positions, inwards))
    np.testing.assert_allclose(positions[1, 0] - positions[0, 0], SAFETY_FACTOR * WORLD.safe_distance, atol=1e-3)
    crowded = np.array([[0.0, 0.0], [3.0, 0.0]], np.float32)[..., None]
    apart = _batch_last.closest_approach(crowded, np.asarray(avoided(crowded, 0 * crowded)))[0, 1]
    assert apart == 3.0
    assert avoided(crowded, 0 * crowded)[1, 0, 0] > 0.1
