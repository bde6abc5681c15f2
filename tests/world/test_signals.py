"""Signals against loops in float64, their bounds, and the objectives that weigh them."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from murmurate import world
from murmurate.errors import InputError
from murmurate.world.signals import shares
from oracles import configurations, visibility
from oracles import signals as oracle

SIZES = {"half_width": 20.0, "half_height": 15.0, "radius": 1.0, "scan_radius": 12.0, "safe_distance": 5.0}
READINGS = [(g, s) for g in ("close", "nclose") for s in ("penalty", "shell")]
seeds = st.integers(0, 2**32 - 1)


def random_configuration(seed, robots, side):
    """Disjoint robots, anywhere in a square: crowded or scattered by its side."""
    drawn = configurations.disjoint(np.random.default_rng(seed), 1, robots, SIZES["radius"], side)
    return drawn[0].astype(float)


def ring(robots, radius):
    angle = 2 * np.pi * np.arange(robots) / robots
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize(("gathering", "safety"), READINGS)
@given(seed=seeds, robots=st.integers(2, 9), side=st.sampled_from([9.0, 14.0, 28.0]))
def test_signals_are_the_oracles(gathering, safety, seed, robots, side):
    positions = random_configuration(seed, robots, side)
    others = ~np.eye(robots, dtype=bool)
    decided = visibility.decided(positions, SIZES["radius"], SIZES["scan_radius"], visibility.FLOAT64_TANGENCY)
    assume(decided[others].all())
    measured = world.signals(positions, gathering=gathering, safety=safety, **SIZES)
    expected = oracle.signals(positions, gathering, safety=safety, **SIZES)
    assert list(measured) == list(expected)
    for name, value in expected.items():
        np.testing.assert_allclose(measured[name], value, rtol=1e-12, atol=1e-12, err_msg=name)


@pytest.mark.parametrize(("gathering", "safety"), READINGS)
def test_float32_batches_are_the_oracles(gathering, safety):
    batch = [random_configuration(seed, 6, 14.0) for seed in range(24)]
    decided = [
        visibility.decided(p, 1.0, 12.0, visibility.FLOAT32_TANGENCY)[~np.eye(6, dtype=bool)].all() for p in batch
    ]
    batch = [p for p, d in zip(batch, decided, strict=True) if d]
    assert len(batch) > 16
    measured = world.signals(
        jnp.asarray(np.stack(batch, axis=-1), jnp.float32), gathering=gathering, safety=safety, **SIZES
    )
    for index, positions in enumerate(batch):
        for name, value in oracle.signals(positions, gathering, safety=safety, **SIZES).items():
            np.testing.assert_allclose(measured[name][index], value, rtol=1e-5, atol=1e-5, err_msg=name)


@given(seed=seeds, robots=st.integers(2, 8))
def test_signals_never_exceed_one(seed, robots):
    """Overlapping robots too: a state in collision is measured before its episode ends."""
    rng = np.random.default_rng(seed)
    box = np.array([SIZES["half_width"], SIZES["half_height"]])
    positions = rng.uniform(-1, 1, (robots, 2, 20)) * box[:, None] * rng.choice([0.02, 0.2, 1.0], 20)
    for gathering, safety in READINGS:
        measured = world.signals(positions, gathering=gathering, safety=safety, **SIZES)
        for name, value in measured.items():
            assert np.isfinite(value).all()
            assert (value <= 1 + 1e-12).all(), name
            # The penalty reading alone may fall below zero: it sums what every close pair is charged.
            assert (value >= -1e-12).all() or (name, safety) == ("safety", "penalty")


def test_close_is_one_at_the_gathering_point_and_zero_in_the_corners():
    box = np.array([SIZES["half_width"], SIZES["half_height"]])
    corners = np.array([[1, 1], [1, -1], [-1, 1]]) * box
    at = [world.signals(p, gathering="close", **SIZES)["close"] for p in (np.zeros((3, 2)), corners)]
    np.testing.assert_allclose(at, [1, 0], atol=1e-12)


def test_nclose_falls_with_the_mean_distance():
    box = np.array([SIZES["half_width"], SIZES["half_height"]])
    at = [world.signals(np.array([-s * box, s * box]), gathering="nclose", **SIZES)["nclose"] for s in (0, 0.5, 1)]
    np.testing.assert_allclose(at, [1, 0.5, 0], atol=1e-12)


@pytest.mark.parametrize(("distance", "penalty"), [(5.0, 1.0), (9.0, 1.0), (4.0, 1 - 1 / 5**0.5), (2.5, 1 - 0.5**0.5)])
def test_penalty_is_one_from_the_safe_distance_on(distance, penalty):
    positions = np.array([[0.0, 0.0], [distance, 0.0]])
    measured = world.signals(positions, gathering="close", safety="penalty", **SIZES)
    np.testing.assert_allclose(measured["safety"], penalty, atol=1e-12)


@pytest.mark.parametrize(
    ("distance", "shell"), [(5.0, 1.0), (8.0, 0.5**0.5), (11.0, 0.0), (30.0, 0.0), (4.999, 0.0), (2.5, 0.0)]
)
def test_shell_is_best_exactly_at_the_safe_distance(distance, shell):
    triangle = ring(3, distance / 3**0.5)
    measured = world.signals(triangle * (1 + 1e-15), gathering="close", safety="shell", **SIZES)
    np.testing.assert_allclose(measured["safety"], shell, atol=1e-6)


def test_a_wide_enough_ring_is_seen_whole_and_a_row_is_not():
    at_best = world.signals(ring(8, 5.9), gathering="close", **SIZES)
    assert at_best["visible"] == at_best["neighbors"] == 1
    row = np.stack([3.0 * np.arange(3), np.zeros(3)], axis=1)
    measured = world.signals(row, gathering="close", **SIZES)
    assert measured["neighbors"] == 1
    np.testing.assert_allclose(measured["visible"], 4 / 6)


@pytest.mark.parametrize(("gathering", "safety"), READINGS)
@given(seed=seeds, robots=st.integers(2, 7), side=st.sampled_from([9.0, 14.0, 28.0]))
def test_shares_are_difference_rewards(gathering, safety, seed, robots, side):
    """When one robot moves, its share changes by N / 2 times what the oracle's signal changes by."""
    rng = np.random.default_rng(seed)
    before = random_configuration(seed, robots, side)
    after, mover = before.copy(), rng.integers(robots)
    after[mover] += rng.uniform(-3, 3, 2)
    between = visibility.pairwise_distances(after)[~np.eye(robots, dtype=bool)]
    assume(between.min() > 2 * SIZES["radius"])
    for positions in (before, after):
        decided = visibility.decided(positions, SIZES["radius"], SIZES["scan_radius"], visibility.FLOAT64_TANGENCY)
        assume(decided[~np.eye(robots, dtype=bool)].all())
    first, then = (shares(p, gathering=gathering, safety=safety, **SIZES) for p in (before, after))
    was, becomes = (oracle.signals(p, gathering, safety=safety, **SIZES) for p in (before, after))
    for name in was:
        change = robots / 2 * (becomes[name] - was[name])
        np.testing.assert_allclose((then[name] - first[name])[mover], change, atol=1e-10, err_msg=name)


@pytest.mark.parametrize(("name", "gathering"), [("C1", "close"), ("C2", "nclose")])
def test_the_objective_is_the_weighted_sum(name, gathering):
    positions = random_configuration(1, 6, 14.0)
    weights = world.WeightsConfig(gathering=0.5, safety=2.0, neighbors=3.0, visible=7.0)
    values = oracle.signals(positions, gathering, safety="penalty", **SIZES)
    measured = world.signals(positions, gathering=gathering, **SIZES)
    expected = 0.5 * values[gathering] + 2 * values["safety"] + 3 * values["neighbors"] + 7 * values["visible"]
    np.testing.assert_allclose(world.Objective.create(name, weights)(measured), expected)
    plain = world.Objective.create(name, world.WeightsConfig())(measured)
    np.testing.assert_allclose(plain, sum(values.values()))
    assert world.signal_names(name) == (gathering, "safety", "neighbors", "visible")


def test_there_is_no_third_objective():
    with pytest.raises(InputError, match=r"^objective = 'C3': must be one of C1, C2$"):
        world.Objective.create("C3", world.WeightsConfig())


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
@pytest.mark.parametrize("field", [f.name for f in dataclasses.fields(world.WeightsConfig)])
def test_weights_are_finite_and_not_negative(field, value):
    with pytest.raises(InputError, match=f"^{field} = "):
        world.WeightsConfig(**{field: value})
