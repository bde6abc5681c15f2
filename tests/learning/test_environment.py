"""The one wrapper that begins new episodes."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from probes import Line, clock, fresh, linear

from murmurate.learning import collect, step_with_autoreset
from murmurate.learning.environment import MAX_DRAWN
from murmurate.world import ActionRepeat

restart = jax.jit(step_with_autoreset)


def test_only_episodes_that_ended_begin_anew():
    env = Line(jnp.asarray(5))
    state = jnp.array([1.9, 0.5, -1.9, 0.0]), jnp.array([0, 4, 3, 2])
    action = jnp.array([[1.0, 1.0, -1.0, 1.0]])
    (x, age), transition, last = restart(env, state, action, jax.random.key(0))
    np.testing.assert_array_equal(transition.terminated, [True, False, True, False])
    np.testing.assert_array_equal(transition.truncated, [False, True, False, False])
    np.testing.assert_allclose(last, [2.15, 0.75, -2.15, 0.25], err_msg="the true last observation")
    np.testing.assert_array_equal(age, [0, 0, 0, 3])
    np.testing.assert_allclose(x[3], 0.25)
    drawn, _ = env.reset_batch(jax.random.key(0), 4)
    np.testing.assert_array_equal(x[:3], drawn[:3])


def test_every_start_is_fresh():
    """No start is ever met again: neither within the batch, nor from one end to the next."""
    env = Line(jnp.asarray(2))
    state = fresh(env, jax.random.key(0), 8)
    starts = [state[0]]
    for number in range(8):
        state, transition, _ = restart(env, state, jnp.zeros((1, 8)), jax.random.key(100 + number))
        if transition.truncated.all():
            starts.append(state[0])
    assert len(starts) == 5
    assert len(np.unique(np.stack(starts))) == 5 * 8


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 1.0])
def test_of_a_large_batch_only_episodes_that_ended_begin_anew(share):
    """However many end, each begins at a start of its own, though few are drawn at once."""
    batch = 3 * MAX_DRAWN + 5
    env = Line(jnp.asarray(5))
    ends = np.random.default_rng(0).permutation(batch) < share * batch
    ages = jnp.where(ends, 4, 1)
    (x, age), transition, last = restart(env, (jnp.zeros(batch), ages), jnp.ones((1, batch)), jax.random.key(0))
    np.testing.assert_array_equal(transition.truncated, ends)
    np.testing.assert_array_equal(age, np.where(ends, 0, 2))
    np.testing.assert_allclose(last, 0.25, err_msg="the true last observation")
    np.testing.assert_allclose(x[~ends], 0.25)
    assert len(np.unique(x[ends])) == ends.sum()


def test_nothing_restarts_while_nobody_ends():
    env = clock(1.0, terminates=False, tells=True)
    ages = jnp.arange(3)
    after, transition, last = restart(env, ages, jnp.zeros((1, 3)), jax.random.key(0))
    np.testing.assert_array_equal(after, ages + 1)
    np.testing.assert_array_equal(last, ages + 1)
    assert not (transition.terminated | transition.truncated).any()


def test_a_rollout_goes_on_where_it_stood_and_bootstraps_from_the_end():
    env = clock(np.arange(7), terminates=False, tells=True, horizon=4)
    gather = jax.jit(collect, static_argnums=4)
    state, first = gather(env, linear(), jnp.zeros(2, jnp.int32), jax.random.key(0), 6)
    np.testing.assert_array_equal(first.observation[:, 0], [0, 1, 2, 3, 0, 1])
    np.testing.assert_array_equal(first.next_observation[:, 0], [1, 2, 3, 4, 1, 2])
    np.testing.assert_array_equal(first.transition.reward[:, 0], [0, 1, 2, 3, 0, 1])
    np.testing.assert_array_equal(first.transition.truncated[:, 0], [0, 0, 0, 1, 0, 0])
    np.testing.assert_array_equal(state, [2, 2])
    _, second = gather(env, linear(), state, jax.random.key(1), 6)
    np.testing.assert_array_equal(second.observation[:, 0], [2, 3, 0, 1, 2, 3])
    np.testing.assert_allclose(
        first.log_prob, linear().distribution(first.observation).log_prob(first.action[:, 0])[0][:, None], rtol=1e-5
    )


def test_a_repeated_action_adds_up_until_the_episode_ends():
    env = clock([1.0, 2.0, 4.0, 8.0, 16.0, 32.0], terminates=False, tells=True, horizon=6)
    repeated = ActionRepeat(env, jnp.asarray(4))
    after, transition = jax.jit(ActionRepeat.step)(repeated, jnp.array([0, 3, 5, 1]), jnp.zeros((1, 4)))
    np.testing.assert_array_equal(after, [4, 6, 6, 5])
    np.testing.assert_array_equal(transition.reward, [15, 56, 32, 30])
    np.testing.assert_array_equal(transition.credit, [[15, 56, 32, 30]])
    np.testing.assert_array_equal(transition.truncated, [False, True, True, False])
    np.testing.assert_array_equal(repeated.observe(after), after)


def test_an_action_kept_up_once_is_the_environments_step():
    env = Line(jnp.asarray(10))
    state = fresh(env, jax.random.key(0), 6)
    action = jnp.linspace(-1, 1, 6)[None]
    plain, once = (jax.jit(type(e).step)(e, state, action) for e in (env, ActionRepeat(env, jnp.asarray(1))))
    jax.tree.map(np.testing.assert_array_equal, plain, once)
