"""The paper's network over all positions: shapes, spread, and that it knows its robots by number."""

from __future__ import annotations

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from murmurate.errors import InputError
from murmurate.policies import CentralPolicy, EquivariantPolicy, LocalPolicy
from murmurate.world import WorldConfig

WORLD = WorldConfig(robots=3, half_width=20.0, half_height=15.0, max_speed=0.5)


@pytest.fixture(scope="module")
def networks():
    return CentralPolicy(hidden=(8, 6)).networks(WORLD, True, jax.random.key(0))


@pytest.mark.parametrize("batch", [(), (2, 5)])
@pytest.mark.parametrize(("credit", "actions"), [("robots", 3), ("swarm", 1)])
def test_shapes(credit, actions, batch):
    policy, value = CentralPolicy(hidden=(8, 6), credit=credit).networks(WORLD, True, jax.random.key(0))
    positions = jax.random.normal(jax.random.key(1), (3, 2, *batch))
    distribution = policy.distribution(positions)
    assert policy(positions).shape == positions.shape
    assert value(positions).shape == (actions, *batch)
    assert distribution.sample(jax.random.key(2)).shape == positions.shape
    assert distribution.log_prob(positions).shape == (actions, *batch)
    np.testing.assert_array_equal(distribution.mean, policy(positions))


def test_a_batch_is_its_members_one_by_one(networks):
    positions = jax.random.normal(jax.random.key(1), (3, 2, 4))
    for network in networks:
        ones = [network(positions[..., i]) for i in range(4)]
        np.testing.assert_allclose(network(positions), jnp.stack(ones, axis=-1), rtol=1e-4, atol=1e-7)


def test_velocities_scale_with_the_speed_limit(networks):
    policy, _ = networks
    fast = dataclasses.replace(WORLD, max_speed=2.0)
    faster, _ = CentralPolicy(hidden=(8, 6)).networks(fast, True, jax.random.key(0))
    positions = jax.random.normal(jax.random.key(1), (3, 2, 4))
    np.testing.assert_allclose(faster(positions), 4 * policy(positions), rtol=1e-5)
    spread = [p.distribution(positions).log_std for p in (policy, faster)]
    np.testing.assert_allclose(spread[1] - spread[0], np.log(4), rtol=1e-5)


def test_policy_and_value_are_two_networks(networks):
    policy, value = networks
    assert not np.allclose(policy.body.layers[0].weight, value.body.layers[0].weight)
    again = CentralPolicy(hidden=(8, 6)).networks(WORLD, True, jax.random.key(0))
    other = CentralPolicy(hidden=(8, 6)).networks(WORLD, True, jax.random.key(1))
    np.testing.assert_array_equal(again[0].body.layers[0].weight, policy.body.layers[0].weight)
    assert not np.allclose(other[0].body.layers[0].weight, policy.body.layers[0].weight)


def test_hidden_layers_have_the_configured_widths(networks):
    for network in networks:
        assert [layer.weight.shape for layer in network.body.layers] == [(8, 6), (6, 8)]


@pytest.mark.parametrize(
    ("policy", "fields"),
    [
        (CentralPolicy, {"hidden": ()}),
        (CentralPolicy, {"hidden": (8, 0)}),
        (EquivariantPolicy, {"hidden": (-1,)}),
        (EquivariantPolicy, {"hidden": (8, 8, 8)}),
        (LocalPolicy, {"basis": 1}),
        (CentralPolicy, {"credit": "team"}),
        (EquivariantPolicy, {"credit": "swarm"}),
    ],
)
def test_no_such_policy(policy, fields):
    with pytest.raises(InputError) as error:
        policy(**fields)
    assert error.value.field in fields
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("policy", [CentralPolicy, EquivariantPolicy])
def test_wider_networks_begin_with_what_they_computed(policy):
    def build(hidden, robots=3):
        world = dataclasses.replace(WORLD, robots=robots)
        return policy(hidden=hidden).networks(world, True, jax.random.key(0))[0]

    narrow = eqx.filter_jit(build)((8, 6))
    template = functools.partial(eqx.filter_eval_shape, build)
    wide = narrow.widened_to(template((12, 10)))
    assert jax.tree.map(jnp.shape, wide) == jax.tree.map(jnp.shape, template((12, 10)))
    positions = jax.random.uniform(jax.random.key(1), (3, 2, 4), minval=-15.0, maxval=15.0)
    act = eqx.filter_jit(lambda network, positions: network(positions))
    np.testing.assert_allclose(act(wide, positions), act(narrow, positions), atol=1e-6)
    for hidden in ((6, 10), (8, 6)):
        assert narrow.widened_to(template(hidden)) is narrow
    # Only a network that knows its robots by number is for so many.
    changed = narrow.widened_to(template((12, 10), robots=4)) is not narrow
    assert changed == (policy is EquivariantPolicy)
