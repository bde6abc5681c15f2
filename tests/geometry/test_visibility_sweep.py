"""The sweep over large swarms gives exactly the answers of the pairwise test."""

from __future__ import annotations

import functools

import hypothesis.extra.numpy as hnp
import jax
import jax.extend.core
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from murmurate import geometry
from murmurate.geometry import _batch_last
from murmurate.geometry._batch_last import visibility
from murmurate.geometry._batch_last.sweep import sweep
from oracles import visibility as oracle
from oracles.configurations import disjoint

RADIUS = 1.0
SWARMS = {2: 2, 3: 2, 4: 2, 5: 2, 7: 2, 8: 2, 9: 1, 12: 1, 16: 1, 24: 1}
"""Rounds for each number of robots in the long comparison; a round has seven batches, one of each kind."""

LONG, SHORT = 1_000, 100
"""Configurations in a batch: 100,000 in all in the long comparison."""


def kinds(rng, robots, batch):
    """Yields batches of every kind at which rounding or symmetry may mislead."""
    shape = (robots, 2, batch)
    yield rng.uniform(-1, 1, shape) * 3 * np.sqrt(robots)
    yield rng.uniform(-1, 1, shape) * 100 * np.sqrt(robots)
    yield rng.uniform(-1, 1, shape)  # discs over one another
    grid = rng.integers(-4, 5, shape).astype(float)
    yield 2 * grid  # exact tangencies, equal distances, coincident robots, rows
    turn = 2 * np.pi * (np.arange(robots)[:, None] + rng.integers(0, 2, (robots, batch)) / 2) / robots
    ring = np.stack([np.cos(turn), np.sin(turn)], 1) / np.sin(np.pi / robots)
    yield ring * (1 + rng.choice([0, 1e-7, 1e-3], (1, 1, batch)))
    lost = rng.uniform(-1, 1, shape) * 3 * np.sqrt(robots)
    lost[rng.random(shape) < 0.02] = np.nan
    yield lost
    yield 2.5 * grid + rng.choice([-1e-6, 0, 1e-6], shape)


def occluded(positions, by):
    xp, positions = visibility.as_floating(positions)
    return by(xp, visibility.angular_intervals(xp, *visibility.offsets(xp, positions), RADIUS))


direct = functools.partial(occluded, by=visibility.occluded_pairwise)
fast = functools.partial(occluded, by=sweep)
compiled = jax.jit(lambda positions: (direct(positions), fast(positions)))


@pytest.mark.parametrize("long", [False, pytest.param(True, marks=pytest.mark.nightly)], ids=["short", "long"])
@pytest.mark.parametrize("robots", SWARMS)
def test_same_as_the_pairwise_test(robots, long):
    hidden = []
    for round_ in range(SWARMS[robots] if long else 1):
        for positions in kinds(np.random.default_rng([robots, round_]), robots, LONG if long else SHORT):
            expected = direct(positions)
            hidden.append(expected.mean())
            np.testing.assert_array_equal(fast(positions), expected)
            np.testing.assert_array_equal(*compiled(jnp.asarray(positions, jnp.float32)))
    assert robots == 2 or 0.02 < np.mean(hidden) < 0.95


@given(hnp.arrays(np.float64, st.tuples(st.integers(1, 12), st.just(2)), elements=st.floats(-20, 20)))
def test_any_configuration(positions):
    np.testing.assert_array_equal(fast(positions), direct(positions))


@pytest.mark.parametrize("robots", [200, pytest.param(400, marks=pytest.mark.nightly)])
def test_large_swarms(robots):
    rng = np.random.default_rng(robots)
    side = np.sqrt(8 * np.pi * robots)
    crowd = disjoint(rng, 1, robots, RADIUS, side)[0].astype(float)
    square = np.stack(np.divmod(np.arange(robots), 20), -1) * 3.0
    for positions in (crowd, 20 * crowd, square):
        expected = direct(positions)
        assert 0.02 < expected.mean() < 0.99
        np.testing.assert_array_equal(geometry.occluded(positions, RADIUS), expected)
        narrow = positions.astype(np.float32)
        np.testing.assert_array_equal(fast(narrow), direct(narrow))
        if robots == 200:
            np.testing.assert_array_equal(*compiled(jnp.asarray(narrow)))


def test_large_swarms_agree_with_polygons():
    positions = disjoint(np.random.default_rng(0), 1, 150, RADIUS, 90.0)[0].astype(float)
    clearance = oracle.shadow_clearance(positions, RADIUS)
    for kernel, dtype, tolerance in (
        (geometry.occluded, np.float64, oracle.FLOAT64_TANGENCY),
        (jax.jit(geometry.occluded), np.float32, oracle.FLOAT32_TANGENCY),
    ):
        decided = np.abs(clearance) > tolerance
        hidden = np.asarray(kernel(positions.astype(dtype), RADIUS))
        np.testing.assert_array_equal(hidden[decided], clearance[decided] < 0)


def largest(jaxpr):
    """Returns the most elements of any array that a program makes, in loops too."""
    inner = [largest(j) for equation in jaxpr.eqns for j in jax.extend.core.jaxprs_in_params(equation.params)]
    return max([v.aval.size for equation in jaxpr.eqns for v in equation.outvars] + inner)


@pytest.mark.parametrize(
    "kernel",
    [_batch_last.occluded, lambda p, r: _batch_last.sole_occluder_counts(p, r, 1e3)],
    ids=["occluded", "sole_occluder_counts"],
)
def test_memory_grows_with_the_square(kernel):
    robots = 512
    program = jax.make_jaxpr(kernel)(jnp.zeros((robots, 2)), RADIUS)
    assert largest(program.jaxpr) <= 10 * robots**2


@settings(max_examples=20)
@given(st.integers(3, 24), st.integers(0, 2**32 - 1))
def test_sole_occluders_in_a_loop_as_pairwise(robots, seed):
    positions = np.random.default_rng(seed).integers(-9, 10, (robots, 2, 5)).astype(float)
    xp, positions = visibility.as_floating(positions)
    intervals = visibility.angular_intervals(xp, *visibility.offsets(xp, positions), RADIUS)
    occluder = visibility._sole_occluder(xp, intervals)
    np.testing.assert_array_equal(visibility._sole_occluder_in_loop(xp, intervals), occluder)
    counts = visibility._frequencies_by_scatter(xp, occluder.astype(np.int32))
    np.testing.assert_array_equal(counts, visibility._frequencies(xp, occluder))


@pytest.mark.parametrize("length", [129, 300, 1000])
def test_a_long_axis_folds(length):
    values = np.random.default_rng(length).integers(0, 9, (2, length, 3))
    np.testing.assert_array_equal(visibility.fold(np.add, values, axis=1), values.sum(1))
