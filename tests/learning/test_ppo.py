"""What an update changes and what it does not, to the bit; and that it solves a small problem."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import probes
import pytest
from probes import Line, begin, fresh, parabola, train

from murmurate.errors import InputError
from murmurate.learning import Batch, Hyperparameters, PPOConfig, Schedule, collect, set_log_std
from murmurate.learning.ppo import _values, split_minibatches

LINE = Line(jnp.asarray(10))


def start(seed=0):
    return begin(LINE, parabola(), seed)


def leaves(tree):
    return [np.asarray(x) for x in jax.tree.leaves(tree)]


def same(first, second):
    """Returns whether two trees are equal to the bit."""
    return all(np.array_equal(a, b) for a, b in zip(leaves(first), leaves(second), strict=True))


def moved(before, after):
    """Returns whether every number of a tree changed."""
    return all((a != b).all() for a, b in zip(leaves(before), leaves(after), strict=True))


def test_training_is_determined_by_its_seed():
    first, second, other = (train(start(seed), LINE, 5)[0] for seed in (0, 0, 1))
    assert same(first, second)
    assert moved(first.policy, other.policy)


def test_chunks_are_the_whole():
    whole, rows = train(start(), LINE, 10)
    half, first = train(start(), LINE, 5)
    parts, second = train(half, LINE, 5)
    assert whole.update == parts.update == 10
    assert same(whole, parts)
    assert same(rows, jax.tree.map(lambda a, b: jnp.concatenate([a, b]), first, second))
    assert not same(half, parts)


def test_a_training_state_survives_the_host():
    """Taken off the device and put back, as a checkpoint is, it continues to the same bits."""
    half, _ = train(start(), LINE, 5)
    restored = jax.tree.map(jnp.asarray, jax.device_get(half))
    assert same(train(restored, LINE, 5)[0], train(half, LINE, 5)[0])


@pytest.mark.parametrize(("frozen", "trained"), [("policy", "value"), ("value", "policy")])
def test_each_network_has_a_rate_of_its_own(frozen, trained):
    before = start()
    after, _ = train(before, LINE, 5, **{f"{frozen}_rate": 0.0, f"{frozen}_rate_end": 0.0})
    assert same(getattr(before, frozen), getattr(after, frozen))
    assert moved(getattr(before, trained), getattr(after, trained))


@pytest.mark.parametrize("name", ["policy", "value"])
def test_schedules_reach_both_ends(name):
    """A rate that is 0 at one end of the schedule leaves its network alone in that update, and only there."""
    for rates, alone in (((0.0, 1e-2), 0), ((1e-2, 0.0), 2)):
        numbers = {f"{name}_rate": rates[0], f"{name}_rate_end": rates[1], "updates": 3}
        state, changed = start(), []
        for _ in range(3):
            before = getattr(state, name)
            state, _ = train(state, LINE, 1, **numbers)
            changed.append(moved(before, getattr(state, name)))
        assert changed == [update != alone for update in range(3)]


def test_a_schedule_is_a_line():
    schedule = Schedule(3.0, 1.0)
    np.testing.assert_allclose([schedule(p) for p in (0.0, 0.25, 1.0)], [3, 2.5, 1])


def test_the_clip_range_is_scheduled():
    """An update whose clip range is all but 0 clips almost every step that a moved policy repeats."""
    numbers = {"updates": 2, "epochs": 2, "policy_rate": 0.05, "policy_rate_end": 0.05}
    shares = {}
    for clips in ((1e-6, 10.0), (10.0, 1e-6)):
        state, first = train(start(), LINE, 1, clip=clips[0], clip_end=clips[1], **numbers)
        _, second = train(state, LINE, 1, clip=clips[0], clip_end=clips[1], **numbers)
        shares[clips] = [float(m["clipped"][0]) for m in (first, second)]
    assert shares[1e-6, 10.0][0] > 0.5 > 0.01 > shares[1e-6, 10.0][1]
    assert shares[10.0, 1e-6][1] > 0.5 > 0.01 > shares[10.0, 1e-6][0]


@pytest.mark.parametrize("name", ["policy", "value"])
def test_the_global_norm_of_gradients_is_clipped(name):
    """After one step Adam's first moment is a tenth of the gradient: all of its numbers shrink by one factor."""
    once = {"updates": 1, "epochs": 1, "minibatches": 1}
    gradients = []
    for bound in (1e6, 1e-3):
        state, _ = train(start(), LINE, 1, max_gradient=bound, **once)
        gradients.append(jax.tree.map(lambda m: m / 0.1, getattr(state, f"{name}_moments").mu))
    free, bounded = gradients
    norm = float(optax.tree.norm(free))
    assert norm > 2e-3, "nothing to clip"
    np.testing.assert_allclose(optax.tree.norm(bounded), 1e-3, rtol=1e-4)
    factors = [b / f for f, b in zip(leaves(free), leaves(bounded), strict=True)]
    np.testing.assert_allclose(factors, 1e-3 / norm, rtol=1e-3)


def test_numbers_change_without_compiling_again():
    train(start(), LINE, 5)
    before = probes.traces
    results = [
        train(start(), env, 5, **numbers)[0]
        for env, numbers in (
            (LINE, {}),
            (Line(jnp.asarray(3)), {}),
            (LINE, {"discount": 0.5, "gae_lambda": 0.3}),
            (LINE, {"policy_rate": 0.2, "value_rate_end": 0.01}),
            (LINE, {"clip": 0.01, "clip_end": 0.5}),
            (LINE, {"reward_scale": 3.0, "max_gradient": 0.01, "updates": 77}),
        )
    ]
    assert probes.traces == before > 0
    assert not any(same(results[0].value, other.value) for other in results[1:])


def test_every_step_is_dealt_into_one_minibatch():
    number = jnp.arange(24)
    steps = Batch(number, jnp.stack([number, -number]), number[None], 10 * number[None], 100 * number[None])
    dealt = split_minibatches(steps, jax.random.key(0), 4)
    assert dealt.observation.shape == (4, 6)
    assert dealt.action.shape == (4, 2, 6)
    np.testing.assert_array_equal(np.sort(dealt.observation.ravel()), number)
    assert (dealt.observation.ravel() != number).any(), "not shuffled"
    for factor, part in ((1, dealt.log_prob), (10, dealt.advantage), (100, dealt.target)):
        np.testing.assert_array_equal(part[:, 0], factor * dealt.observation)
    np.testing.assert_array_equal(dealt.action[:, 1], -dealt.observation)


def distance(policy):
    """How far from 0 a policy's points are after ten steps, exploration and all."""
    fixed = Line(jnp.asarray(1000))
    state = fresh(fixed, jax.random.key(7), 64)
    _, rollout = jax.jit(collect, static_argnums=4)(fixed, policy, state, jax.random.key(8), 10)
    return float(rollout.transition.signals["distance"][-1].mean())


def test_a_point_on_a_line_learns_to_go_home():
    rates = {"policy_rate": 0.05, "policy_rate_end": 0.005, "value_rate": 0.05, "value_rate_end": 0.005}
    state = start()
    for _ in range(30):
        state, _ = train(state, LINE, 5, updates=150, **rates)
    assert distance(probes.linear()) > 0.6
    assert distance(state.policy) < 0.15
    assert state.policy.slope < -1


def test_a_scheduled_spread_is_that_of_its_schedule_and_a_learned_one_is_not():
    numbers = {"updates": 3, "log_std": -1.0, "log_std_end": -2.0}
    state, spreads = start(), []
    for _ in range(3):
        state, _ = train(state, LINE, 1, exploration="scheduled", **numbers)
        spreads.append(float(state.policy.log_std))
    assert spreads == [-1.0, -1.5, -2.0]
    assert moved(start().policy.slope, state.policy.slope), "the rest of the policy learns"
    learned, _ = train(start(), LINE, 3, **numbers)
    assert float(learned.policy.log_std) not in spreads


class Plain(eqx.Module):
    """A policy without the array `log_std`."""

    slope: jax.Array

    def distribution(self, observation):
        return probes.Normal((self.slope * observation)[None], jnp.full((), -1.0))


def test_a_policy_needs_no_log_std():
    policy = Plain(jnp.zeros(()))
    assert set_log_std(policy, -2.0) is policy
    after, metrics = train(begin(LINE, parabola(), policy=policy), LINE, 3)
    assert moved(policy, after.policy)
    assert metrics["finite"].all()
    with pytest.raises(InputError, match=r"^exploration = 'scheduled': must be learned for a policy that has no array"):
        train(begin(LINE, parabola(), policy=policy), LINE, 3, exploration="scheduled")


@pytest.mark.parametrize("broken", ["policy", "value", "reward"])
def test_the_first_update_that_is_not_finite_is_marked(broken):
    state, env = start(), LINE
    if broken == "reward":
        env = Line(jnp.asarray(10), price=jnp.asarray(jnp.inf))
    else:
        state = eqx.tree_at(lambda s: jax.tree.leaves(getattr(s, broken))[0], state, jnp.asarray(jnp.nan))
    assert train(start(), LINE, 3)[1]["finite"].tolist() == [True, True, True]
    assert train(state, env, 3)[1]["finite"].tolist() == [False, False, False]


def test_an_overflow_is_marked_at_its_update():
    """The rate of the second update sends the parameters beyond float32, not that of the first."""
    rates = {"policy_rate": 0.0, "policy_rate_end": 1e30, "updates": 2}
    assert train(start(), LINE, 2, **rates)[1]["finite"].tolist() == [True, False]


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
@pytest.mark.parametrize("field", [f.name for f in dataclasses.fields(PPOConfig) if f.type == "float"])
def test_numbers_are_checked(field, value):
    if field.startswith("log_std") and value == -1.0:
        assert getattr(PPOConfig(**{field: value}), field) == value
        return
    with pytest.raises(InputError, match=f"^{field} = ") as error:
        PPOConfig(**{field: value})
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("field", ["updates", "worlds", "steps", "epochs", "minibatches"])
def test_counts_are_checked(field):
    with pytest.raises(InputError, match=f"^{field} = 0: must be an integer >= 1"):
        PPOConfig(**{field: 0})


@pytest.mark.parametrize(
    "fields",
    [
        {"minibatches": 7},
        {"value_target": "td"},
        {"exploration": "none"},
        {"discount": 1.5},
        {"gae_lambda": 1.1},
    ],
)
def test_no_such_learner(fields):
    with pytest.raises(InputError, match=f"^{next(iter(fields))} = "):
        PPOConfig(**fields)


def test_hyperparameters_are_arrays():
    """As plain numbers they would be compiled in."""
    assert all(isinstance(x, jax.Array) for x in jax.tree.leaves(Hyperparameters.from_config(PPOConfig())))


@pytest.mark.parametrize("horizon", [1, 3, 10, 1000])
def test_every_step_has_the_values_before_and_after_it(horizon):
    """However many episodes end: at every step, at some, or at none."""
    value = probes.Parabola(jnp.asarray(0.7), jnp.asarray(-0.2))
    env = Line(jnp.asarray(horizon))
    state = fresh(env, jax.random.key(3), 5)
    wild = probes.Linear(jnp.asarray(0.0), jnp.asarray(0.3), jnp.asarray(1.0))
    _, rollout = jax.jit(collect, static_argnums=4)(env, wild, state, jax.random.key(4), 12)
    before, after = jax.jit(_values)(wild, value, rollout)
    seen = np.asarray(rollout.observation), np.asarray(rollout.next_observation)
    np.testing.assert_allclose(before[:, 0], 0.7 * seen[0] ** 2 - 0.2, rtol=1e-6)
    goes_on = ~np.asarray(rollout.transition.terminated)
    np.testing.assert_allclose(after[:, 0][goes_on], (0.7 * seen[1] ** 2 - 0.2)[goes_on], rtol=1e-6)
    assert horizon > 10 or np.asarray(rollout.transition.truncated).any()
    assert np.isfinite(after).all()


class Squared(probes.Linear):
    """A policy on the square of the observation, which it computes without its weights."""

    def features(self, observation):
        return {"square": observation**2}

    def __call__(self, seen):
        return super().__call__(seen["square"])


class ValueOfSquare(probes.Parabola):
    """A value network on the features of `Squared`."""

    def __call__(self, seen):
        return (self.curve * seen["square"] + self.offset)[None]


class OnSight(probes.Linear):
    """The same policy, without features."""

    def __call__(self, observation):
        return super().__call__(observation**2)


def test_features_are_computed_once_and_change_nothing():
    numbers = (jnp.zeros(()), jnp.zeros(()), jnp.full((), -1.0))
    value = ValueOfSquare(jnp.zeros(()), jnp.zeros(()))
    with_features, rows = train(begin(LINE, value, policy=Squared(*numbers)), LINE, 5)
    without, others = train(begin(LINE, parabola(), policy=OnSight(*numbers)), LINE, 5)
    assert moved(value, with_features.value)
    for first, second in ((with_features.policy, without.policy), (with_features.value, without.value), (rows, others)):
        for a, b in zip(leaves(first), leaves(second), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-7)
