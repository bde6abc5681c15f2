"""The clipped objective against loops, with one action a step and with several."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from murmurate.learning import Batch, policy_loss, value_loss
from murmurate.policies import Gaussian
from oracles import learning as oracle

ROBOTS, BATCH = 3, 16


class Fixed(eqx.Module):
    """Actions that observe nothing."""

    mean: jax.Array
    joint: bool = eqx.field(static=True)

    def distribution(self, observation):
        return Gaussian(self.mean, jnp.asarray(-0.5), self.joint)


def batch(policy, seed, shift):
    """Steps that a policy `shift` away collected."""
    rng = np.random.default_rng(seed)
    action = jnp.asarray(rng.normal(size=(ROBOTS, 2, BATCH)), jnp.float32)
    old = Fixed(policy.mean + jnp.asarray(shift * rng.normal(size=policy.mean.shape), jnp.float32), policy.joint)
    log_prob = old.distribution(None).log_prob(action)
    advantage, target = jnp.asarray(rng.normal(size=(2, *log_prob.shape)), jnp.float32)
    return Batch(None, action, log_prob, advantage, target)


@pytest.fixture(params=[True, False], ids=["joint", "each robot"])
def policy(request):
    mean = np.random.default_rng(0).normal(size=(ROBOTS, 2, BATCH))
    return Fixed(jnp.asarray(mean, jnp.float32), request.param)


@pytest.mark.parametrize("clip", [0.05, 0.2, 0.5])
@pytest.mark.parametrize("shift", [0.0, 0.1, 0.5])
def test_the_objective_is_the_oracles(policy, clip, shift):
    steps = batch(policy, 1, shift)
    log_prob = np.asarray(policy.distribution(None).log_prob(steps.action), float)
    old, advantage = np.asarray(steps.log_prob, float), np.asarray(steps.advantage, float)
    # Every action has its own advantage and its own ratio, so that to the oracle each is a step of its own.
    flat = [a.reshape(-1, 1) for a in (log_prob, old)]
    loss, report = policy_loss(policy, steps, clip)
    expected = oracle.clipped_objective(*flat, advantage.reshape(-1), clip)
    np.testing.assert_allclose(loss, -expected, rtol=1e-4, atol=1e-5)
    ratio = np.exp(log_prob - old)
    np.testing.assert_allclose(report["clipped"], (np.abs(ratio - 1) > clip).mean(), atol=1e-6)
    np.testing.assert_allclose(report["kl"], (ratio - 1 - np.log(ratio)).mean(), rtol=1e-3, atol=1e-5)


def test_ratios_of_robots_are_not_the_swarms(policy):
    """Clipping each robot's ratio differs from clipping their product."""
    steps = batch(policy, 2, 0.4)
    assert steps.log_prob.shape == ((1, BATCH) if policy.joint else (ROBOTS, BATCH))
    _, report = policy_loss(policy, steps, 0.2)
    ratios = np.exp(policy.distribution(None).log_prob(steps.action) - steps.log_prob)
    assert 0 < report["clipped"] < 1
    np.testing.assert_allclose(report["clipped"] * ratios.size, (np.abs(ratios - 1) > 0.2).sum(), rtol=1e-5)


def test_gradients_stop_where_the_objective_is_clipped(policy):
    """Steps outside the clip range, on the side that their advantage favours, teach nothing more."""
    steps = batch(policy, 3, 0.5)
    ratio = np.exp(policy.distribution(None).log_prob(steps.action) - steps.log_prob)
    teaches = np.where(steps.advantage > 0, ratio < 1.2, ratio > 0.8)
    gradient = np.asarray(eqx.filter_grad(lambda p: policy_loss(p, steps, 0.2)[0])(policy).mean)
    reached = np.abs(gradient).max(axis=1) > 0
    np.testing.assert_array_equal(reached, np.broadcast_to(teaches, reached.shape))
    assert 0 < teaches.mean() < 1


def test_the_value_loss_is_the_mean_squared_error():
    target = jnp.asarray(np.random.default_rng(4).normal(size=(2, BATCH)), jnp.float32)
    steps = Batch(jnp.arange(BATCH), None, None, None, target)
    loss = value_loss(lambda observation: jnp.stack([observation / 10, observation / 20]), steps)
    guess = np.stack([np.arange(BATCH) / 10, np.arange(BATCH) / 20])
    np.testing.assert_allclose(loss, np.mean((guess - np.asarray(target)) ** 2), rtol=1e-5)
