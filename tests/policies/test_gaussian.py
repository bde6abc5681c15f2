"""The action distribution against scipy's."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from murmurate.policies import Gaussian

RNG = np.random.default_rng(0)
MEAN = RNG.normal(size=(3, 2, 7))
ACTION = MEAN + RNG.normal(size=(3, 2, 7))
SPREADS = {"one": np.array(-0.7), "each": RNG.normal(size=(3, 2, 1))}


def gaussian(log_std, joint):
    return Gaussian(jnp.asarray(MEAN, jnp.float32), jnp.asarray(log_std, jnp.float32), joint)


@pytest.mark.parametrize("log_std", SPREADS.values(), ids=SPREADS.keys())
@pytest.mark.parametrize("joint", [True, False])
def test_log_density_is_scipys(log_std, joint):
    density = stats.norm.logpdf(ACTION, MEAN, np.exp(np.broadcast_to(log_std, MEAN.shape)))
    expected = density.sum(axis=(0, 1))[None] if joint else density.sum(axis=1)
    actual = gaussian(log_std, joint).log_prob(jnp.asarray(ACTION, jnp.float32))
    assert actual.shape == ((1, 7) if joint else (3, 7))
    np.testing.assert_allclose(actual, expected, rtol=1e-5, atol=1e-5)


def test_robots_of_a_swarm_together_are_the_joint_action():
    joint, each = (gaussian(SPREADS["each"], j).log_prob(jnp.asarray(ACTION, jnp.float32)) for j in (True, False))
    np.testing.assert_allclose(each.sum(axis=0, keepdims=True), joint, rtol=1e-5)


def test_samples_have_the_mean_and_the_spread():
    log_std = SPREADS["each"]
    drawn = jax.vmap(gaussian(log_std, True).sample)(jax.random.split(jax.random.key(0), 4000))
    score = (np.asarray(drawn) - MEAN) / np.exp(log_std)
    np.testing.assert_allclose(score.mean(axis=0), 0, atol=0.08)
    np.testing.assert_allclose(score.std(axis=0), 1, atol=0.06)
    assert stats.kstest(score[:, 1, 0, 3], "norm").pvalue > 1e-3


def test_one_configuration_needs_no_batch_axis():
    distribution = Gaussian(jnp.zeros((3, 2)), jnp.zeros(()), joint=False)
    expected = stats.norm.logpdf(ACTION[..., 0]).sum(axis=1)
    np.testing.assert_allclose(distribution.log_prob(jnp.asarray(ACTION[..., 0], jnp.float32)), expected, rtol=1e-5)
