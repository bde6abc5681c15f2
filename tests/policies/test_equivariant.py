"""Blind to numbering, place and direction: proven in float64, where nothing but the last digits may differ."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from murmurate.policies import EquivariantPolicy
from murmurate.policies.layers import bounded_by_component
from murmurate.world import WorldConfig

WORLD = WorldConfig(robots=5, max_speed=0.7)
BOTH = pytest.mark.parametrize("landmark", [False, True], ids=["C2", "C1"])
call = eqx.filter_jit(lambda network, positions: network(positions))
seeds = st.integers(0, 2**32 - 1)
angles = st.floats(-np.pi, np.pi)


def networks(landmark, scale=1.0, dtype=jnp.float64, whole_square=False):
    """Networks far from their initial weights, as training would leave them: no coefficient is small or zero."""
    built = EquivariantPolicy(hidden=(16, 8), whole_square=whole_square).networks(WORLD, landmark, jax.random.key(0))
    leaves, structure = jax.tree.flatten(built)
    rng = np.random.default_rng(1)
    leaves = [jnp.asarray(scale * (np.asarray(x) + 0.3 * rng.normal(size=x.shape)), dtype) for x in leaves]
    return jax.tree.unflatten(structure, leaves)


@pytest.fixture(scope="module", autouse=True)
def _double_precision():
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def trained():
    return {landmark: networks(landmark) for landmark in (False, True)}


def swarm(seed, robots=5, batch=4):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (robots, 2, batch)) * rng.choice([4.0, 15.0, 40.0], batch)


def turned(vectors, angle):
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.einsum("dc,rcb->rdb", rotation, vectors)


def assert_equal(actual, expected):
    np.testing.assert_allclose(actual, expected, rtol=1e-8, atol=1e-9)


@BOTH
def test_the_networks_below_do_something(trained, landmark):
    """Otherwise every invariance would hold trivially."""
    policy, value = trained[landmark]
    velocities, worth = call(policy, swarm(0)), call(value, swarm(0))
    assert np.abs(velocities).min() > 1e-4
    assert np.std(worth, axis=(0, 1) if worth.ndim > 1 else None).min() > 1e-4


@BOTH
@given(seed=seeds, order=st.permutations(range(5)))
@settings(max_examples=20)
def test_relabelling(trained, landmark, seed, order):
    policy, value = trained[landmark]
    positions = swarm(seed)
    assert_equal(call(policy, positions[order]), call(policy, positions)[np.array(order)])
    assert_equal(call(value, positions[order]), call(value, positions)[np.array(order)])


@BOTH
@given(seed=seeds, angle=angles)
@settings(max_examples=20)
def test_rotation_about_the_origin(trained, landmark, seed, angle):
    policy, value = trained[landmark]
    positions = swarm(seed)
    assert_equal(call(policy, turned(positions, angle)), turned(call(policy, positions), angle))
    assert_equal(call(value, turned(positions, angle)), call(value, positions))


@given(seed=seeds, shift=st.tuples(st.floats(-50, 50), st.floats(-50, 50)))
@settings(max_examples=20)
def test_translation_without_a_gathering_point(trained, seed, shift):
    policy, value = trained[False]
    positions = swarm(seed)
    moved = positions + np.array(shift)[:, None]
    assert_equal(call(policy, moved), call(policy, positions))
    assert_equal(call(value, moved), call(value, positions))


def test_a_gathering_point_is_something_that_a_robot_sees(trained):
    policy, value = trained[True]
    positions, moved = swarm(0), swarm(0) + np.array([3.0, -2.0])[:, None]
    assert np.abs(call(policy, moved) - call(policy, positions)).max() > 1e-3
    assert np.abs(call(value, moved) - call(value, positions)).max() > 1e-3


@BOTH
@pytest.mark.parametrize("robots", [2, 9])
def test_any_number_of_robots_has_the_same_weights(trained, landmark, robots):
    policy, value = trained[landmark]
    positions = swarm(7, robots)
    order = np.random.default_rng(2).permutation(robots)
    velocities, worth = call(policy, positions), call(value, positions)
    assert velocities.shape == (robots, 2, 4)
    assert worth.shape == (robots, 4)
    assert_equal(call(policy, turned(positions, 1.0)[order]), turned(velocities, 1.0)[order])
    assert_equal(call(value, turned(positions, 1.0)[order]), worth[order])


@BOTH
def test_a_batch_is_its_members_one_by_one(trained, landmark):
    policy, value = trained[landmark]
    positions = swarm(3)
    for network in (policy, value):
        ones = [call(network, positions[..., i]) for i in range(4)]
        assert_equal(call(network, positions), np.stack(ones, axis=-1))


@BOTH
@given(seed=seeds, scale=st.sampled_from([1e-6, 1e-3, 1.0, 10.0, 100.0, 1e4]))
@settings(max_examples=15)
def test_the_norm_of_velocities_is_bounded(trained, landmark, seed, scale):
    speed = np.linalg.norm(call(trained[landmark][0], scale * swarm(seed)), axis=1)
    assert np.isfinite(speed).all()
    assert (speed <= WORLD.max_speed * (1 + 1e-12)).all()


@BOTH
def test_the_bound_holds_in_float32_for_extreme_weights(landmark):
    policy, _ = networks(landmark, scale=1e3, dtype=jnp.float32)
    speed = np.linalg.norm(call(policy, swarm(0, batch=64).astype(np.float32)), axis=1)
    assert speed.max() > 0.99 * WORLD.max_speed, "nothing comes near the bound"
    assert (speed <= WORLD.max_speed * (1 + 1e-6)).all()


@BOTH
@given(seed=seeds, scale=st.sampled_from([1e-6, 1e-3, 1.0, 10.0, 100.0, 1e4]))
@settings(max_examples=15)
def test_the_whole_square_has_the_same_directions(trained, landmark, seed, scale):
    """A velocity is longer by what the square reaches beyond the disc: as far as sqrt(2) along a diagonal."""
    positions = scale * swarm(seed)
    disc, square = (
        np.asarray(call(policy, positions))
        for policy in (trained[landmark][0], networks(landmark, whole_square=True)[0])
    )
    reach = np.linalg.norm(disc, axis=1) / np.abs(disc).max(axis=1)
    assert_equal(square, disc * reach[:, None])
    assert (np.abs(square) <= WORLD.max_speed * (1 + 1e-12)).all()


def test_a_diagonal_velocity_is_sqrt_2_times_as_fast_in_the_whole_square():
    vx, vy = np.array([[30.0, 0.0, 30.0], [30.0, -30.0, 15.0]])[..., None]
    expected = [[2.0, 2.0], [0.0, -2.0], [2.0, 1.0]]
    np.testing.assert_allclose(bounded_by_component(vx, vy, 2.0)[..., 0], expected)
    still = jax.jacobian(lambda v: bounded_by_component(v[:, :1], v[:, 1:], 2.0))(np.zeros((1, 2)))
    assert np.isfinite(still).all(), "a robot that wishes nothing leaves a gradient"


def coincidences():
    """Robots on one another, at the gathering point, in a row, and all of it at once."""
    scene = swarm(4)
    scene[1, :, 0] = scene[0, :, 0]
    scene[2, :, 1] = 0
    scene[..., 2] = 0
    scene[..., 3] = 3.0 * np.arange(-2, 3)[:, None] * np.array([1.0, 0.0])
    return scene


@BOTH
def test_coincident_robots_are_no_nan(trained, landmark):
    policy, value = trained[landmark]
    velocities, worth = call(policy, coincidences()), call(value, coincidences())
    assert np.isfinite(velocities).all()
    assert np.isfinite(worth).all()
    np.testing.assert_array_equal(velocities[..., 2], np.zeros((5, 2)), err_msg="a robot that sees no direction")


@BOTH
def test_gradients_are_finite_and_reach_every_weight(landmark):
    built = networks(landmark, dtype=jnp.float32)
    positions = jnp.asarray(np.concatenate([coincidences(), swarm(5)], axis=-1), jnp.float32)

    def loss(built):
        policy, value = built
        return policy.distribution(positions).log_prob(positions / 100).mean() + (value(positions) ** 2).mean()

    for path, gradient in jax.tree_util.tree_flatten_with_path(jax.jit(jax.grad(loss))(built))[0]:
        name = jax.tree_util.keystr(path)
        assert np.isfinite(gradient).all(), name
        if name.endswith("weight"):
            assert np.any(gradient) == (landmark or "to_point" not in name), name


@BOTH
def test_each_robot_draws_an_action_of_its_own(trained, landmark):
    policy, _ = trained[landmark]
    positions = swarm(6)
    distribution = eqx.filter_jit(lambda policy, positions: policy.distribution(positions))(policy, positions)
    assert distribution.log_prob(positions).shape == (5, 4)
    np.testing.assert_allclose(distribution.mean, call(policy, positions), rtol=1e-10)
    np.testing.assert_allclose(distribution.log_std, policy.log_std + np.log(WORLD.max_speed))


@BOTH
def test_the_networks_take_the_features_of_positions_in_their_place(trained, landmark):
    policy, value = trained[landmark]
    positions = np.concatenate([coincidences(), swarm(7)], axis=-1)
    features = eqx.filter_jit(lambda policy, positions: policy.features(positions))(policy, positions)
    np.testing.assert_array_equal(features.positions, positions)
    assert features.shadows.shape == (6, 5, 5, positions.shape[-1])
    for network in (policy, value):
        np.testing.assert_allclose(call(network, features), call(network, positions), rtol=1e-12, atol=1e-13)
