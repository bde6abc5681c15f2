"""Probe environments: the value network must find values that are known in closed form."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from probes import LONGEST, begin, clock, table, train

UPDATES = 150
NUMBERS = {
    "updates": UPDATES,
    "value_rate": 0.3,
    "value_rate_end": 1e-3,
    "policy_rate": 0.0,
    "policy_rate_end": 0.0,
    "max_gradient": 1e6,
}


def learned(env, **numbers):
    state, _ = train(begin(env, table()), env, UPDATES, **{**NUMBERS, **numbers})
    return np.asarray(state.value.values)


def to_come(rewards, discount, cut=0.0):
    """The discounted sums of what is still to come; `cut` follows after the last reward."""
    values = [cut]
    for reward in reversed(rewards):
        values.insert(0, reward + discount * values[0])
    return values[:-1]


@pytest.mark.parametrize("discount", [0.0, 0.5, 0.9])
def test_a_truncated_constant_reward_goes_on_for_ever(discount):
    env = clock(1.0, terminates=False, tells=False)
    np.testing.assert_allclose(learned(env, discount=discount)[0], 1 / (1 - discount), rtol=0.01)


@pytest.mark.parametrize("discount", [0.0, 0.9, 1.0])
def test_a_terminated_constant_reward_is_a_finite_sum(discount):
    env = clock(1.0, terminates=True, tells=True)
    values = learned(env, discount=discount)[:LONGEST]
    np.testing.assert_allclose(values, to_come([1.0] * LONGEST, discount), rtol=0.02)


def test_of_two_steps_only_the_second_pays():
    env = clock([0.0, 1.0], terminates=True, tells=True, horizon=2)
    np.testing.assert_allclose(learned(env, discount=0.8)[:2], [0.8, 1.0], rtol=0.01)


def test_rewards_are_scaled():
    env = clock(1.0, terminates=False, tells=False)
    np.testing.assert_allclose(learned(env, discount=0.5, reward_scale=3.0)[0], 6, rtol=0.01)


@pytest.mark.parametrize("gae_lambda", [0.0, 1.0])
def test_values_do_not_depend_on_lambda(gae_lambda):
    env = clock([1.0, -2.0, 0.5, 3.0, 0.0, 1.0], terminates=True, tells=True)
    values = learned(env, discount=0.9, gae_lambda=gae_lambda)[:LONGEST]
    np.testing.assert_allclose(values, to_come([1.0, -2.0, 0.5, 3.0, 0.0, 1.0], 0.9), atol=0.06)


def test_rewards_to_go_are_undiscounted():
    env = clock([1.0, -2.0, 0.5, 3.0, 0.0, 1.0], terminates=True, tells=True)
    values = learned(env, discount=0.5, value_target="rewards-to-go")[:LONGEST]
    np.testing.assert_allclose(values, to_come([1.0, -2.0, 0.5, 3.0, 0.0, 1.0], 1.0), atol=0.06)


def test_metrics_report_what_was_collected():
    env = clock([0.0, 1.0], terminates=True, tells=True, horizon=2)
    _, metrics = train(begin(env, table()), env, UPDATES, **NUMBERS)
    assert jax.tree.leaves(metrics)[0].shape == (UPDATES,)
    np.testing.assert_allclose(metrics["reward"], 0.5)
    np.testing.assert_allclose(metrics["terminated"], 0.5)
    np.testing.assert_allclose(metrics["signals"]["age"], 0.5)
    assert metrics["value_loss"][-1] < 1e-3 < metrics["value_loss"][0]
