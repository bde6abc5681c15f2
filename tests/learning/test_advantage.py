"""Advantages and value targets against their definitions, with episodes that end anywhere in the batch."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from murmurate.learning import generalized_advantage, rewards_to_go
from oracles import learning as oracle

TIME, BATCH = 12, 5
advantage = jax.jit(generalized_advantage)
to_go = jax.jit(rewards_to_go)


def trajectories(seed):
    """Rewards, values, values after, and ends of both kinds: never both at once."""
    rng = np.random.default_rng(seed)
    reward, value, next_value = rng.normal(size=(3, TIME, BATCH)).astype(np.float32)
    end = rng.choice(3, (TIME, BATCH), p=[0.7, 0.15, 0.15])
    # Where an episode goes on, what comes after a step is what comes before the next.
    next_value[:-1] = np.where(end[:-1] == 0, value[1:], next_value[:-1])
    return reward, value, next_value, end == 1, end == 2


def each(function, arrays, *numbers):
    """An oracle of one trajectory, of every trajectory."""
    columns = [[a[:, member].tolist() for a in arrays] for member in range(BATCH)]
    return np.stack([function(*column, *numbers) for column in columns], axis=1)


@given(
    seed=st.integers(0, 2**32 - 1),
    discount=st.sampled_from([0.0, 0.9, 1.0]) | st.floats(0, 1),
    gae_lambda=st.sampled_from([0.0, 0.95, 1.0]) | st.floats(0, 1),
)
@settings(max_examples=60)
def test_advantages_are_the_oracles(seed, discount, gae_lambda):
    arrays = trajectories(seed)
    expected = each(oracle.generalized_advantage, arrays, discount, gae_lambda)
    np.testing.assert_allclose(advantage(*arrays, discount, gae_lambda), expected, rtol=1e-4, atol=1e-4)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60)
def test_rewards_to_go_are_the_oracles(seed):
    reward, _, *rest = trajectories(seed)
    expected = each(oracle.rewards_to_go, (reward, *rest))
    np.testing.assert_allclose(to_go(reward, *rest), expected, rtol=1e-4, atol=1e-4)


def test_a_terminated_step_has_no_future_and_a_truncated_one_has():
    ones, no = np.ones((3, 2), np.float32), np.zeros((3, 2), bool)
    end = no.copy()
    end[1] = [True, False]
    cut = no.copy()
    cut[1] = [False, True]
    np.testing.assert_allclose(advantage(ones, 0 * ones, 10 * ones, end, cut, 0.5, 0.0)[1], [1, 6])
    np.testing.assert_allclose(to_go(ones, 10 * ones, end, cut), [[2, 12], [1, 11], [11, 11]])


@pytest.mark.parametrize("flag", [3, 4], ids=["terminated", "truncated"])
def test_nothing_leaks_into_the_episode_before(flag):
    arrays = [np.array(a) for a in trajectories(0)]
    arrays[3][:], arrays[4][:] = False, False
    arrays[flag][5] = True
    changed = [a.copy() for a in arrays]
    for a in changed[:3]:
        a[6:] += 100
    before, after = (advantage(*a, 0.9, 0.95) for a in (arrays, changed))
    np.testing.assert_array_equal(before[:6], after[:6])
    assert (before[6:] != after[6:]).all()
    before, after = (to_go(a[0], *a[2:]) for a in (arrays, changed))
    np.testing.assert_array_equal(before[:6], after[:6])


def test_actions_of_a_step_are_a_batch_axis():
    """Flags `(time, 1, batch)` end all actions of a step alike."""
    reward, value, next_value, terminated, truncated = trajectories(1)
    double = [jnp.stack([a, 2 * a], axis=1) for a in (reward, value, next_value)]
    flags = terminated[:, None], truncated[:, None]
    with jax.numpy_rank_promotion("raise"):
        both = advantage(*double, *flags, 0.9, 0.95)
        sums = to_go(double[0], double[2], *flags)
    np.testing.assert_allclose(both[:, 1], 2 * both[:, 0], rtol=1e-5)
    np.testing.assert_allclose(both[:, 0], advantage(*trajectories(1), 0.9, 0.95), rtol=1e-5)
    np.testing.assert_allclose(sums[:, 1], 2 * to_go(reward, next_value, terminated, truncated), rtol=1e-5, atol=1e-6)
