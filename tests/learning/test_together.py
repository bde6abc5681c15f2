"""Trainings side by side end where each of them ends alone."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import probes
import pytest
from probes import CONFIG, Line, begin, parabola, train

from murmurate.learning import Chunk, Hyperparameters, PPOConfig, Shape, train_together


def line(horizon):
    return Line(jnp.asarray(horizon))


def chunk(seed=0, horizon=10, updates=5, **numbers):
    config, env = PPOConfig(**{**CONFIG, **numbers}), line(horizon)
    return Chunk(
        begin(env, parabola(), seed), env, Hyperparameters.from_config(config), Shape.from_config(config), updates
    )


def assert_close(result, expected):
    assert jax.tree.structure(result) == jax.tree.structure(expected)
    for a, b in zip(jax.tree.leaves(result), jax.tree.leaves(expected), strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_allclose(a, b, rtol=2e-3, atol=2e-4)


def test_seeds_and_numbers_side_by_side_are_each_alone():
    wanted = [{"seed": 0}, {"seed": 1, "discount": 0.5}, {"seed": 2, "horizon": 4, "policy_rate": 0.02}]
    trained = train_together([chunk(**arguments) for arguments in wanted])
    for arguments, result in zip(wanted, trained, strict=True):
        seed, horizon = arguments.pop("seed"), arguments.pop("horizon", 10)
        env = line(horizon)
        assert_close(result, train(begin(env, parabola(), seed), env, 5, **arguments))
    policies = [np.concatenate([np.ravel(x) for x in jax.tree.leaves(state.policy)]) for state, _ in trained]
    assert np.abs(policies[0] - policies[1]).max() > 1e-3
    assert np.abs(policies[1] - policies[2]).max() > 1e-3


def test_they_are_one_program():
    train_together([chunk(seed) for seed in (0, 1)])
    before = probes.traces
    train_together([chunk(seed, discount=0.7) for seed in (3, 4)])
    assert probes.traces == before


@pytest.mark.parametrize("changed", [{"updates": 3}, {"epochs": 1}, {"steps": 4}])
def test_other_programs_run_apart_and_keep_their_places(changed):
    reference, other = chunk(0), chunk(1, **changed)
    assert reference.program != other.program
    assert reference.program == chunk(5, discount=0.3).program
    first, second, third = train_together([reference, other, chunk(2)])
    assert [int(state.update) for state, _ in (first, second, third)] == [5, changed.get("updates", 5), 5]
    assert_close(first, train(reference.state, reference.env, 5))
    assert_close(third, train(begin(line(10), parabola(), 2), line(10), 5))


def test_copies_stay_copies():
    first, second = train_together([chunk(7), chunk(7)])
    assert_close(first, second)
    assert_close(first, train(begin(line(10), parabola(), 7), line(10), 5))
