"""The learner by gradients on environments whose gradients are known."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from learning.probes import Linear, Parabola, Step, linear, parabola
from murmurate.errors import InputError
from murmurate.learning import GradientConfig, GradientHyperparameters, Segment, init
from murmurate.learning.gradients import begin, limit_gradient, segment_return, train_chunk

NUMBERS = {
    "updates": 60, "worlds": 16, "steps": 6, "discount": 0.9, "gae_lambda": 0.9, "reward_scale": 1.0,
    "max_state_gradient": 1e3, "policy_rate": 0.1, "policy_rate_end": 0.01, "value_rate": 0.03, "value_rate_end": 0.01,
}  # fmt: skip


class Slope(eqx.Module):
    """A point on a line that pays the square of its distance from 0 at each step; beyond `edge` it terminates."""

    horizon: jax.Array
    edge: jax.Array

    def reset_batch(self, key, batch):
        return jax.random.uniform(key, (batch,), minval=-1.5, maxval=1.5), jnp.zeros(batch, jnp.int32)

    def step(self, state, action):
        x, age = state
        after = x + action[0]
        terminated = jnp.abs(after) > self.edge
        reward = jnp.where(terminated, -7.0, -(after**2))
        truncated = (age + 1 >= self.horizon) & ~terminated
        return (after, age + 1), Step(reward, terminated, truncated, reward[None], {"distance": jnp.abs(after)})

    def observe(self, state):
        return state[0]


def slope(horizon=12, edge=100.0):
    return Slope(jnp.asarray(horizon), jnp.asarray(edge))


def hyper(**numbers):
    return GradientHyperparameters.from_config(GradientConfig(**{**NUMBERS, **numbers}))


def returned(policy, value, env, x, steps, **numbers):
    state = jnp.asarray(x, jnp.float32), jnp.zeros(len(x), jnp.int32)
    return eqx.filter_jit(segment_return)(policy, value, env, state, hyper(**numbers), steps)


def by_hand(gain, curve, x, steps, discount):
    """The discounted rewards and the value of the end, and their derivative by the gain, in closed form."""
    total = slope_ = 0.0
    for start in x:
        growth = 1 + gain
        for t in range(1, steps + 1):
            total -= discount ** (t - 1) * (growth**t * start) ** 2
            slope_ -= discount ** (t - 1) * start**2 * 2 * t * growth ** (2 * t - 1)
        total += discount**steps * curve * (growth**steps * start) ** 2
        slope_ += discount**steps * curve * start**2 * 2 * steps * growth ** (2 * steps - 1)
    return total / len(x), slope_ / len(x)


@pytest.mark.parametrize(("gain", "steps"), [(-0.5, 1), (-0.3, 5), (0.1, 8)])
def test_the_return_and_its_gradient_are_the_closed_form(gain, steps):
    x, curve = [0.7, -1.2, 0.1], -2.0
    policy = Linear(jnp.asarray(gain), jnp.zeros(()), jnp.zeros(()))
    value = Parabola(jnp.asarray(curve), jnp.zeros(()))

    def total(policy):
        return returned(policy, value, slope(), x, steps)[0]

    result, gradient = eqx.filter_value_and_grad(total)(policy)
    expected = by_hand(gain, curve, x, steps, NUMBERS["discount"])
    np.testing.assert_allclose((result, gradient.slope), expected, rtol=1e-4)


def test_nothing_counts_after_a_termination():
    policy = Linear(jnp.asarray(1.0), jnp.zeros(()), jnp.zeros(()))  # doubles x at every step
    value = Parabola(jnp.asarray(-3.0), jnp.zeros(()))
    # 0.75, 1.5, 3: the second step leaves; 0.1 stays inside for the whole segment.
    total, (_, _, _, transitions, counted) = returned(policy, value, slope(edge=2.0), [0.75, 0.1], 3)
    assert counted.T.tolist() == [[True, True, False], [True, True, True]]
    inside = -(0.2**2) - 0.9 * 0.4**2 - 0.81 * 0.8**2 + 0.729 * -3.0 * 0.8**2
    assert float(total) == pytest.approx((-(1.5**2) + 0.9 * -7.0 + inside) / 2, rel=1e-5)
    assert transitions.terminated[:, 0].tolist() == [False, True, True]


def trained(env, updates, seed=0, **numbers):
    config = GradientConfig(**{**NUMBERS, **numbers})
    reset, key = jax.random.split(jax.random.key(seed))
    state = init(linear(), parabola(), eqx.filter_jit(env.reset_batch)(reset, config.worlds), key)
    numbers = GradientHyperparameters.from_config(config)
    return train_chunk(state, env, numbers, Segment.from_config(config), updates)


def test_the_best_gain_is_learned_and_so_is_its_value():
    state, metrics = trained(slope(), 60)
    # One step to the middle, whatever the discount is: then nothing is left to pay.
    assert float(state.policy.slope) == pytest.approx(-1, abs=0.05)
    assert float(state.policy.offset) == pytest.approx(0, abs=0.02)
    assert float(state.value.curve) == pytest.approx(0, abs=0.1)
    assert metrics["reward"][-1] > metrics["reward"][0]
    assert metrics["finite"].all()
    assert metrics["gradient"].shape == (60,)


def test_the_value_of_a_fixed_policy_is_the_closed_form():
    """A gain of -0.5 halves x at every step: the rewards ahead of x add up to -x^2 / 4 / (1 - discount / 4)."""
    config = GradientConfig(**{**NUMBERS, "policy_rate": 0.0, "policy_rate_end": 0.0, "updates": 200})
    env = slope(horizon=4)
    reset, key = jax.random.split(jax.random.key(1))
    policy = Linear(jnp.asarray(-0.5), jnp.zeros(()), jnp.zeros(()))
    state = init(policy, parabola(), eqx.filter_jit(env.reset_batch)(reset, config.worlds), key)
    state, _ = train_chunk(state, env, GradientHyperparameters.from_config(config), Segment.from_config(config), 200)
    assert float(state.policy.slope) == -0.5
    assert float(state.value.curve) == pytest.approx(-0.25 / (1 - 0.9 / 4), rel=0.05)


def test_episodes_go_on_until_they_end_and_then_begin_anew():
    # A segment has 6 steps: episodes of 12 end with every second one.
    state, _ = trained(slope(horizon=12), 1)
    assert state.env_state[1].tolist() == [6] * 16
    state, _ = trained(slope(horizon=12), 2)
    assert state.env_state[1].tolist() == [0] * 16


def test_chunks_add_up():
    whole, _ = trained(slope(), 4)
    config = GradientConfig(**NUMBERS)
    numbers, shape = GradientHyperparameters.from_config(config), Segment.from_config(config)
    half, _ = train_chunk(trained(slope(), 2)[0], slope(), numbers, shape, 2)
    for leaf, other in zip(jax.tree.leaves(whole), jax.tree.leaves(half), strict=True):
        np.testing.assert_array_equal(leaf, other)


def test_the_result_is_an_average_of_the_weights():
    config = GradientConfig(**{**NUMBERS, "average": 3})
    numbers, shape = GradientHyperparameters.from_config(config), Segment.from_config(config)
    reset, key = jax.random.split(jax.random.key(0))
    states = eqx.filter_jit(slope().reset_batch)(reset, config.worlds)
    state, slopes = begin(linear(), parabola(), states, key, config), []
    expected = None
    for update in range(6):
        state, _ = train_chunk(state, slope(), numbers, shape, 1)
        slopes.append(float(state.policy.slope))
        # The mean of the first three; then each new one counts a third.
        expected = np.mean(slopes) if update < 3 else expected + (slopes[-1] - expected) / 3
        assert float(state.result.slope) == pytest.approx(expected, rel=1e-5)
    assert state.result.slope != state.policy.slope
    # The training itself is that without an average.
    plain, _ = trained(slope(), 6)
    assert float(plain.policy.slope) == slopes[-1]
    assert plain.result is plain.policy


class Wall(Slope):
    """The point's next place depends on where it is without bound, wherever it is beyond 1."""

    def step(self, state, action):
        x, age = state
        steep = jnp.where(x > 1, 1e12 * (x - jax.lax.stop_gradient(x)), 0.0)
        return super().step((x + steep, age), action)


def test_one_episode_does_not_drown_the_others():
    policy, value = Linear(jnp.asarray(-0.1), jnp.zeros(()), jnp.zeros(())), parabola()
    env = Wall(jnp.asarray(12), jnp.asarray(100.0))

    def slope_of(x, **numbers):
        def total(policy):
            return returned(policy, value, env, x, 4, **numbers)[0]

        return float(eqx.filter_grad(total)(policy).slope)

    # Alone it has any gradient; beside another one its part has the norm of at most the bound at each step.
    assert abs(slope_of([1.5, 0.5], max_state_gradient=1e30)) > 1e9
    limited, alone = slope_of([1.5, 0.5], max_state_gradient=0.5), slope_of([0.5, 0.5], max_state_gradient=0.5)
    assert abs(limited - alone / 2) < 10
    # A bound that nothing exceeds changes nothing.
    assert slope_of([0.5, -0.7], max_state_gradient=1e3) == slope_of([0.5, -0.7], max_state_gradient=1e30)


@pytest.mark.parametrize("bound", [0.2, 5.0])
def test_the_gradient_of_each_episode_is_shortened(bound):
    state = jnp.asarray([[3.0, 0.03], [4.0, 0.04]])  # two episodes: norms of 5 and 0.05

    def total(state):
        return jnp.mean(jnp.sum(limit_gradient(state, bound) ** 2 / 2, axis=0))

    gradient = 2 * jax.grad(total)(state)  # of the sum over the episodes
    np.testing.assert_allclose(jnp.linalg.norm(gradient, axis=0), [min(5.0, bound), 0.05], rtol=1e-6)
    np.testing.assert_allclose(gradient[0] / gradient[1], [0.75, 0.75], rtol=1e-6)


class Cliff(Slope):
    """Rewards of which the gradient is infinite at 0."""

    def step(self, state, action):
        after, transition = super().step(state, action)
        reward = -jnp.sqrt(jnp.abs(after[0] * 0))
        return after, transition._replace(reward=reward, credit=reward[None])


def test_a_gradient_that_is_not_finite_moves_nothing():
    state, metrics = trained(Cliff(jnp.asarray(12), jnp.asarray(100.0)), 1)
    assert float(state.policy.slope) == 0
    assert metrics["gradient"].tolist() == [0]
    assert metrics["finite"].all()


@pytest.mark.parametrize(
    ("numbers", "field"),
    [
        ({"updates": 0}, "updates"),
        ({"worlds": 5, "steps": 5, "minibatches": 4}, "minibatches"),
        ({"discount": 1.5}, "discount"),
        ({"policy_rate": -1.0}, "policy_rate"),
        ({"reward_scale": 0.0}, "reward_scale"),
        ({"weights": {"compact": -1.0}}, "weights.compact"),
    ],
)
def test_numbers_that_are_not_allowed_are_named(numbers, field):
    with pytest.raises(InputError, match=field):
        GradientConfig(**{**NUMBERS, **numbers})
