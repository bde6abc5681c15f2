"""Signals against loops in float64, their bounds, and the objectives that weigh them."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from murmurate.errors import InputError
from murmurate.world import Configuration, Objective, Signal, WorldConfig, objective_signals
from oracles import configurations, visibility
from oracles import signals as oracle

SIZES = {"half_width": 20.0, "half_height": 15.0, "radius": 1.0, "scan_radius": 12.0, "safe_distance": 5.0}
READINGS = [(g, s) for g in ("close", "nclose") for s in ("penalty", "shell")]
seeds = st.integers(0, 2**32 - 1)


def configuration(positions, safety="penalty"):
    return Configuration(positions, WorldConfig(robots=positions.shape[0], safety=safety, **SIZES))


def objective(gathering, **weights):
    return Objective(objective_signals({"close": "C1", "nclose": "C2"}[gathering]), weights)


def measure(positions, gathering="close", safety="penalty"):
    return objective(gathering).measure(configuration(positions, safety))


def credits_of(positions, gathering, safety):
    signals = objective_signals({"close": "C1", "nclose": "C2"}[gathering])
    return {name: signal.credit(configuration(positions, safety)) for name, signal in signals.items()}


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
    measured = measure(positions, gathering=gathering, safety=safety)
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
    measured = measure(jnp.asarray(np.stack(batch, axis=-1), jnp.float32), gathering=gathering, safety=safety)
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
        measured = measure(positions, gathering=gathering, safety=safety)
        for name, value in measured.items():
            assert np.isfinite(value).all()
            assert (value <= 1 + 1e-12).all(), name
            # The penalty reading alone may fall below zero: it sums what every close pair is charged.
            assert (value >= -1e-12).all() or (name, safety) == ("safety", "penalty")


def test_close_is_one_at_the_gathering_point_and_zero_in_the_corners():
    box = np.array([SIZES["half_width"], SIZES["half_height"]])
    corners = np.array([[1, 1], [1, -1], [-1, 1]]) * box
    at = [measure(p, gathering="close")["close"] for p in (np.zeros((3, 2)), corners)]
    np.testing.assert_allclose(at, [1, 0], atol=1e-12)


def test_nclose_falls_with_the_mean_distance():
    box = np.array([SIZES["half_width"], SIZES["half_height"]])
    at = [measure(np.array([-s * box, s * box]), gathering="nclose")["nclose"] for s in (0, 0.5, 1)]
    np.testing.assert_allclose(at, [1, 0.5, 0], atol=1e-12)


@pytest.mark.parametrize(("distance", "penalty"), [(5.0, 1.0), (9.0, 1.0), (4.0, 1 - 1 / 5**0.5), (2.5, 1 - 0.5**0.5)])
def test_penalty_is_one_from_the_safe_distance_on(distance, penalty):
    positions = np.array([[0.0, 0.0], [distance, 0.0]])
    measured = measure(positions, gathering="close", safety="penalty")
    np.testing.assert_allclose(measured["safety"], penalty, atol=1e-12)


@pytest.mark.parametrize(
    ("distance", "shell"), [(5.0, 1.0), (8.0, 0.5**0.5), (11.0, 0.0), (30.0, 0.0), (4.999, 0.0), (2.5, 0.0)]
)
def test_shell_is_best_exactly_at_the_safe_distance(distance, shell):
    triangle = ring(3, distance / 3**0.5)
    measured = measure(triangle * (1 + 1e-15), gathering="close", safety="shell")
    np.testing.assert_allclose(measured["safety"], shell, atol=1e-6)


def test_a_wide_enough_ring_is_seen_whole_and_a_row_is_not():
    at_best = measure(ring(8, 5.9), gathering="close")
    assert at_best["visible"] == at_best["neighbors"] == 1
    row = np.stack([3.0 * np.arange(3), np.zeros(3)], axis=1)
    measured = measure(row, gathering="close")
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
    first, then = (credits_of(p, gathering, safety) for p in (before, after))
    was, becomes = (oracle.signals(p, gathering, safety=safety, **SIZES) for p in (before, after))
    for name in was:
        change = robots / 2 * (becomes[name] - was[name])
        np.testing.assert_allclose((then[name] - first[name])[mover], change, atol=1e-10, err_msg=name)


@given(seed=seeds, robots=st.integers(2, 8), side=st.sampled_from([9.0, 28.0]))
def test_a_signal_is_the_mean_of_the_robots_shares(seed, robots, side):
    for safety in ("penalty", "shell"):
        measured = configuration(random_configuration(seed, robots, side), safety)
        for name, strategy in Signal.registered().items():
            # A given pattern has a place for each robot, and no default.
            options = {"places": random_configuration(seed + 1, robots, side).tolist()} if name == "match" else {}
            signal = strategy(**options)
            shares = signal(measured)
            assert shares.shape == (robots,)
            np.testing.assert_allclose(shares.mean(axis=0), signal.value(measured), atol=1e-12, err_msg=name)


@pytest.mark.parametrize(("name", "gathering"), [("C1", "close"), ("C2", "nclose")])
def test_the_objective_is_the_weighted_sum(name, gathering):
    positions = random_configuration(1, 6, 14.0)
    values = oracle.signals(positions, gathering, safety="penalty", **SIZES)
    measured = measure(positions, gathering=gathering)
    expected = 0.5 * values[gathering] + 2 * values["safety"] + 3 * values["neighbors"] + 7 * values["visible"]
    weights = {gathering: 0.5, "safety": 2.0, "neighbors": 3.0, "visible": 7.0}
    np.testing.assert_allclose(objective(gathering, **weights)(measured), expected)
    np.testing.assert_allclose(objective(gathering)(measured), sum(values.values()))
    assert tuple(objective_signals(name)) == (gathering, "safety", "neighbors", "visible")


def test_there_is_no_third_objective():
    with pytest.raises(InputError, match=r"^objective = 'C3': must be one of C1, C2, custom$"):
        objective_signals("C3")
    with pytest.raises(InputError, match=r"^signals = \{\}: must be one signal or more with the objective custom$"):
        objective_signals("custom")


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_weights_are_finite_and_not_negative(value):
    for name, strategy in Signal.registered().items():
        with pytest.raises(InputError, match=r"^weight = "):
            strategy(weight=value)
        if name != "nclose":
            with pytest.raises(InputError, match=f"^weights.{name} = "):
                objective("close", **{name: value})
    with pytest.raises(InputError, match=r"^weights.nclose = 1.0: must be of a signal of the objective"):
        objective("close", nclose=1.0)


class Calm(Signal):
    """How slow nothing is: a signal of a user's own, of positions alone."""

    speed: float = 2.0

    def __call__(self, configuration):
        return configuration.positions[:, 0] / self.speed


def test_a_signal_of_ones_own_joins_the_objective():
    positions = random_configuration(3, 5, 14.0)
    signals = objective_signals("C2", {"calm": Calm(4.0, weight=0.5)})
    assert list(signals) == ["nclose", "safety", "neighbors", "visible", "calm"]
    whole = Objective(signals)
    measured = whole.measure(configuration(positions))
    np.testing.assert_allclose(measured["calm"], positions[:, 0].mean() / 4)
    np.testing.assert_allclose(whole(measured), sum(measured.values()) - 0.5 * measured["calm"])
    np.testing.assert_allclose(signals["calm"].credit(configuration(positions)), positions[:, 0] / 4)
