"""Smooth signals against loops in float64; their gradients against differences; where they are at their best."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from murmurate.errors import InputError
from murmurate.geometry import smallest_ring
from murmurate.world import (
    Centered,
    Compact,
    Configuration,
    Convex,
    Exposed,
    Occluders,
    SmoothNeighbors,
    SmoothSafety,
    SmoothVisible,
    WorldConfig,
)
from murmurate.world.smooth import Soft, _widest_gap, _widest_gap_unsorted
from oracles import configurations, smooth

RADIUS, SAFE, SCAN = 1.0, 5.0, 120.0
SIGNALS = [SmoothVisible(), SmoothSafety(), SmoothNeighbors(), Compact(), Centered(), Convex(), Exposed(), Occluders()]
named = pytest.mark.parametrize("signal", SIGNALS, ids=lambda signal: signal.name)


def configuration(positions):
    world = WorldConfig(
        robots=positions.shape[0], half_width=40.0, half_height=40.0, radius=RADIUS, scan_radius=SCAN,
        safe_distance=SAFE, max_speed=1.0,
    )  # fmt: skip
    return Configuration(positions, world)


def ring(robots, wider):
    return wider * smallest_ring(robots, RADIUS, SAFE).positions


def drawn(seed, robots, side):
    return configurations.disjoint(np.random.default_rng(seed), 1, robots, RADIUS, side)[0].astype(float)


@given(seed=st.integers(0, 2**32 - 1), robots=st.integers(2, 9), side=st.sampled_from([9.0, 14.0, 28.0]))
def test_signals_are_the_oracles(seed, robots, side):
    positions = drawn(seed, robots, side)
    radius = float(np.hypot(*smallest_ring(robots, RADIUS, SAFE).positions[0]))
    expected = {
        "smooth_visible": [smooth.smooth_visible(positions, RADIUS, 0.1)] * robots,
        "smooth_safety": smooth.smooth_safety(positions, SAFE, 0.1),
        "smooth_neighbors": smooth.smooth_neighbors(positions, SCAN, 0.03),
        "compact": smooth.compact(positions, radius),
        "centered": [2 - np.hypot(*p) / radius for p in positions],
        "convex": smooth.convex(positions, radius),
        "exposed": smooth.exposed(positions, 0.02),
        "occluders": smooth.occluders(positions, RADIUS, radius, 0.3),
    }
    for signal in SIGNALS:
        shares = signal(configuration(positions[:, :, None]))[:, 0]
        np.testing.assert_allclose(shares, expected[signal.name], rtol=1e-9, atol=1e-9, err_msg=signal.name)


@given(
    seed=st.integers(0, 2**32 - 1),
    robots=st.integers(2, 8),
    softness=st.sampled_from([1e-3, 0.1, 1.0]),
    stretch=st.sampled_from([1.0, 12.0]),
)
def test_softened_signals_are_the_oracles(seed, robots, softness, stretch):
    positions = stretch * drawn(seed, robots, 9.0)
    expected = {
        "smooth_visible": [smooth.smooth_visible(positions, RADIUS, 0.1, softness)] * robots,
        "smooth_safety": smooth.soft_safety(positions, SAFE, 0.1, softness),
        "smooth_neighbors": smooth.smooth_neighbors(positions, SCAN, softness),
    }
    soft = [signal for signal in SIGNALS if isinstance(signal, Soft)]
    assert {signal.name for signal in soft} == set(expected)
    for signal in soft:
        # A number of Python takes another way through the program than an array does.
        for given_as in (softness, np.asarray(softness)):
            shares = signal.softened(configuration(positions[:, :, None]), given_as)[:, 0]
            np.testing.assert_allclose(shares, expected[signal.name], rtol=1e-9, atol=1e-9, err_msg=signal.name)


def test_no_robot_is_apart_from_itself_where_a_compiler_rounds_one_of_two_products():
    """With all optimisations, which tests do without, in a process of its own."""
    program = """
import jax, jax.numpy as jnp, numpy as np
from murmurate.policies.features import offsets_between
from murmurate.world import Configuration, Exposed, Occluders, SmoothSafety, SmoothVisible, WorldConfig
points = 0.7 * jax.random.normal(jax.random.key(0), (24, 6, 2))
def configuration(points, scale=2.8):
    return Configuration(scale * jnp.moveaxis(points, 0, -1), WorldConfig(robots=6))
def values(points):
    return [signal.value(configuration(points)) for signal in (SmoothSafety(), SmoothVisible(), Exposed(), Occluders())]
for now, later in zip(values(points), jax.jit(values)(points)):
    np.testing.assert_allclose(later, now, rtol=1e-4, atol=1e-4)
apart = jax.jit(lambda points: offsets_between(configuration(points).positions)[2])(points)
assert not np.asarray(apart)[np.eye(6, dtype=bool)].any()
"""
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    subprocess.run([sys.executable, "-c", program], env=environment, check=True)


@given(seed=st.integers(0, 2**32 - 1))
def test_gradients_are_the_differences(seed):
    positions = drawn(seed, 5, 14.0)
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=positions.shape)
    step = 1e-5
    for signal in SIGNALS:
        around = [signal.value(configuration(positions + sign * step * direction)) for sign in (-2, -1, 0, 1, 2)]
        central = (around[3] - around[1]) / (2 * step)
        # At a kink, such as that of the widest of two gaps, the two sides differ.
        sides = [(around[2] - around[0]) / (2 * step), (around[4] - around[2]) / (2 * step)]
        assume(abs(sides[0] - sides[1]) < 1e-4)
        slope = float(jnp.sum(gradient(signal, jnp.asarray(positions, jnp.float32)) * direction))
        np.testing.assert_allclose(slope, central, rtol=1e-3, atol=1e-4, err_msg=signal.name)


@jax.jit
def _gradients(positions):
    return [jax.grad(lambda p, signal=signal: signal.value(configuration(p)))(positions) for signal in SIGNALS]


def gradient(signal, positions):
    return _gradients(positions)[SIGNALS.index(signal)]


@named
@pytest.mark.parametrize("robots", [2, 3, 8, 20])
def test_a_valid_pattern_with_room_to_spare_is_the_best(signal, robots):
    value = signal.value(configuration(ring(robots, 1.16)[:, :, None]))[0]
    if signal.name in ("compact", "centered"):
        assert value == pytest.approx(2 - 1.16)
    else:
        assert value == 1


@named
def test_the_smallest_ring_is_as_compact_as_it_gets(signal):
    if signal.name in ("compact", "centered"):
        assert signal.value(configuration(ring(7, 1.0))) == pytest.approx(1)


def test_what_is_hidden_counts_by_its_logarithm():
    """In a row everybody sees the next robots only; moved aside far enough, the second one hides nobody."""
    row = np.array([[0.0, 0.0], [6.0, 0.0], [12.0, 0.0], [18.0, 0.0]])
    aside, barely = row + np.array([[0, 0], [0, 9], [0, 0], [0, 0]]), row + np.array([[0, 0], [0, 0], [0, 0], [0, 3]])
    whole, part, last = (SmoothVisible()(configuration(p[:, :, None]))[0, 0] for p in (row, aside, barely))
    assert 0 < whole < last < part < 1
    assert part - whole > 1 / 6  # One of three pairs that see no more of each other than half of what they should.


def test_an_enclosed_robot_is_led_out_through_the_widest_gap():
    around = ring(6, 1.3)
    enclosed = np.concatenate([np.array([[0.3, 0.0]]), np.delete(around, 0, axis=0)])  # the gap is in direction x
    share_of = jax.jit(jax.value_and_grad(lambda p: Exposed()(configuration(p))[0]))
    share, slope = share_of(jnp.asarray(enclosed, jnp.float32))
    assert share < 1
    assert slope[0, 0] > 0.1 * abs(slope[0, 1])
    assert slope[0, 0] > 0


@pytest.mark.parametrize("robots", [5, 24])
def test_a_robot_in_the_middle_of_a_ring_is_as_deep_as_its_nearest_edge_whatever_the_ring(robots):
    radius = float(np.hypot(*smallest_ring(robots + 1, RADIUS, SAFE).positions[0]))
    for wider in (1.2, 3.0):
        around = ring(robots, wider)
        shares = Convex()(configuration(np.concatenate([np.zeros((1, 2)), around])[:, :, None]))[:, 0]
        depth = np.hypot(*around[0]) * np.cos(np.pi / robots)
        assert 1 - shares[0] == pytest.approx(depth / radius, rel=2e-3)
        assert (shares[1:] == 1).all()


def test_a_robot_in_the_middle_is_driven_out_only_where_it_hides_others():
    """Five robots around one: with small discs, nobody is hidden, and it is the best pattern of six."""
    positions = np.concatenate(
        [np.zeros((1, 2)), 6.0 * np.stack([np.cos(a := 0.4 * np.pi * np.arange(5)), np.sin(a)], 1)]
    )
    for radius, is_hiding in ((0.4, False), (2.0, True)):
        world = replace(configuration(positions).world, radius=radius)
        shares = Occluders()(Configuration(positions, world))
        assert (shares[0] < 0.9) == is_hiding
        assert (shares[1:] == 1).all()
        assert Convex()(Configuration(positions, world))[0] < 0.5


@named
def test_robots_at_one_place_give_finite_numbers(signal):
    for positions in (np.zeros((4, 2)), np.array([[0.0, 0.0], [0.0, 0.0], [5.0, 0.0], [0.0, 7.0]])):
        value = signal.value(configuration(positions))
        assert np.isfinite(value)
        assert np.isfinite(gradient_of(signal, jnp.asarray(positions, jnp.float32))).all()


def gradient_of(signal, positions):
    return jax.jit(jax.grad(lambda p: signal.value(configuration(p))))(positions)


@pytest.mark.parametrize("strategy", [SmoothVisible, SmoothSafety, Exposed, Occluders])
def test_margins_below_zero_are_refused(strategy):
    with pytest.raises(InputError, match="margin"):
        strategy(margin=-0.1)


@given(seed=st.integers(0, 2**32 - 1), robots=st.integers(2, 9))
def test_the_widest_gap_is_the_same_unsorted(seed, robots):
    """Also where robots stand in one direction, and where some have none."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-np.pi, np.pi, (robots, robots, 3))
    angle[..., 1] = np.round(angle[..., 1])
    none = np.eye(robots, dtype=bool) | (rng.random((robots, robots)) < 0.2)
    angle = np.where(none[:, :, None], 4 * np.pi, angle)
    np.testing.assert_allclose(_widest_gap_unsorted(np, angle), _widest_gap(np, angle), atol=1e-12)
