"""What holds of every baseline: it acts on its own view alone, in any frame, within the speed limit."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from murmurate.policies.baselines import Baseline
from murmurate.world import Observation, Sensing, WorldConfig

R, SCAN, SPEED = 1.0, 120.0, 1.0
STEADY = ["centroid", "circle", "gradient", "two-color"]
LOCAL = ["random", *STEADY]


def make(name, landmark=False, robots=6):
    return Baseline.registered()[name](WorldConfig(robots=robots), landmark)


def configuration(seed=0, robots=6):
    angle = 2 * np.pi * np.arange(robots) / robots
    ring = 2.0 * robots * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return jnp.asarray(ring + np.random.default_rng(seed).uniform(-4, 4, ring.shape), jnp.float32)


@eqx.filter_jit
def look(config, positions, keys):
    frames = config.draw_frames(keys, len(positions))
    view = config.view(positions, frames, keys, WorldConfig(robots=len(positions), radius=R, scan_radius=SCAN))
    return frames, Observation(view, positions, jnp.full_like(positions[:, 0], jnp.inf))


def observed(positions, seed=0, use="global", **fields):
    config = Sensing.registered()[use](**fields)
    keys = jax.random.key(seed)
    keys = jax.random.split(keys, positions.shape[2]) if positions.ndim == 3 else keys
    return look(config, positions, keys)


@eqx.filter_jit
def acted(policy, observation):
    return policy(observation)


def velocities(policy, positions, seed=0, **sensing):
    """Returns what the robots do, in the world's frame."""
    frames, observation = observed(positions, seed, **sensing)
    return np.asarray(frames.to_world(acted(policy, observation)))


@pytest.mark.parametrize("name", STEADY)
def test_no_frame_changes_where_a_robot_goes(name):
    policy = make(name, landmark=True)
    plain = velocities(policy, configuration(), use="visible")
    assert np.abs(plain).max() > 0.1
    turned = velocities(policy, configuration(), 1, use="visible", rotation=True, reflection=True, unit_ratio=5.0)
    np.testing.assert_allclose(turned, plain, atol=2e-3)


@pytest.mark.parametrize("name", STEADY)
def test_turning_the_swarm_turns_its_velocities(name):
    policy = make(name)
    turn = jnp.asarray([[np.cos(1.0), -np.sin(1.0)], [np.sin(1.0), np.cos(1.0)]], jnp.float32)
    plain = velocities(policy, configuration(), use="visible", rotation=True)
    turned = velocities(policy, configuration() @ turn.T, 3, use="visible", rotation=True)
    np.testing.assert_allclose(turned, plain @ np.asarray(turn).T, atol=2e-3)


@pytest.mark.parametrize("name", [*STEADY, "circle-central"])
def test_robots_have_no_number(name):
    policy = make(name)
    order = np.random.default_rng(1).permutation(6)
    plain = velocities(policy, configuration(), use="visible")
    permuted = velocities(policy, configuration()[order], use="visible")
    np.testing.assert_allclose(permuted, plain[order], atol=2e-3)


@pytest.mark.parametrize("name", LOCAL)
def test_what_is_hidden_does_not_move_a_robot(name):
    """Robot 2 stands behind robot 1: wherever it is there, 0 does the same."""
    policy = make(name)
    positions = configuration().at[:3].set(jnp.asarray([[0.0, -20.0], [0.0, -15.0], [0.0, -8.0]]))
    displaced = positions.at[2].set(jnp.asarray([0.3, -6.5]))
    _, observation = observed(positions, use="visible")
    assert not bool(observation.view.seen[0, 2])
    first, second = (velocities(policy, p, use="visible")[0] for p in (positions, displaced))
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("name", STEADY)
def test_who_perceives_a_wall_does_not_cross_it(name):
    """Crowds in a corner, which would spread over the walls."""
    policy = make(name)
    crowds = jnp.stack([0.3 * configuration(seed) for seed in range(20)], axis=-1)
    crowds = crowds + 45.0 - crowds.max(axis=0)
    without_walls, with_walls = (
        velocities(policy, crowds, use="global", rotation=True, reflection=True, walls=walls) + np.asarray(crowds)
        for walls in (False, True)
    )
    assert without_walls.max() > 45.0 or name == "centroid"
    assert with_walls.max() <= 45.0


@pytest.mark.parametrize("name", Baseline.registered())
def test_only_the_centralised_one_looks_at_positions(name):
    policy = make(name)
    _, observation = observed(configuration(), use="visible")
    elsewhere = eqx.tree_at(lambda o: o.positions, observation, observation.positions[::-1] * 0.7 + 3.0)
    same = np.array_equal(acted(policy, elsewhere), acted(policy, observation))
    assert same != policy.centralised
    assert bool(policy.deviations) or name not in ("circle-central", "gradient", "two-color")
    assert policy.title


@pytest.mark.parametrize("landmark", [False, True])
@pytest.mark.parametrize("name", Baseline.registered())
def test_speed_is_limited_and_nothing_is_undefined(name, landmark):
    """In one batch: spread out, crowded, on one line, all in one place, and two together with four out of sight."""
    policy = make(name, landmark)
    line = jnp.stack([6.0 * jnp.arange(6), jnp.zeros(6)], axis=1)
    lonely = jnp.zeros((6, 2)).at[2:, 0].set(1000.0 * jnp.arange(1, 5))
    crowd = 0.25 * configuration(1)
    batch = jnp.stack([configuration(), crowd, line, jnp.zeros((6, 2)), lonely], axis=-1)
    result = velocities(policy, batch, use="visible", rotation=True)
    assert result.shape == batch.shape
    assert np.isfinite(result).all()
    assert (np.linalg.norm(result, axis=1) <= SPEED).all()
    again = velocities(policy, batch, use="visible", rotation=True)
    np.testing.assert_array_equal(result, again)
