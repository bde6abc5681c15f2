"""Signals of formations against loops in float64; exact formations; their gradients against differences."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from murmurate.errors import InputError
from murmurate.geometry.rings import smallest_ring
from murmurate.world import (
    PACKINGS,
    Chain,
    Configuration,
    EqualRadii,
    EvenAngles,
    EvenSpacing,
    Inside,
    Match,
    Spread,
    Straight,
    Surround,
    TwoGroups,
    WorldConfig,
)
from oracles import configurations, formations

SIGNALS = [
    EvenAngles(),
    EqualRadii(),
    EqualRadii(radius=7.0),
    Surround(distance=8.0),
    Straight(),
    EvenSpacing(),
    Spread(),
    TwoGroups(apart=8.0, wide=1.2),
]
IN_THE_WORLD = [Inside(margin=30.0), Chain(first=(-9.0, 3.0), last=(8.0, 5.0), reach=4.0)]
named = pytest.mark.parametrize("signal", SIGNALS, ids=lambda signal: signal.name)
everywhere = pytest.mark.parametrize("signal", [*SIGNALS, *IN_THE_WORLD], ids=lambda signal: signal.name)


def configuration(positions, half_side=40.0):
    world = WorldConfig(robots=positions.shape[0], half_width=half_side, half_height=half_side, scan_radius=120.0)
    return Configuration(positions, world)


def drawn(seed, robots, side):
    return configurations.disjoint(np.random.default_rng(seed), 1, robots, 1.0, side)[0].astype(float)


def turned(positions, angle):
    cosine, sine = math.cos(angle), math.sin(angle)
    return positions @ np.array([[cosine, sine], [-sine, cosine]])


def polygon(robots, radius=9.0):
    angles = 2 * np.pi * np.arange(robots) / robots + 0.3
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


@given(seed=st.integers(0, 2**32 - 1), robots=st.integers(2, 9), side=st.sampled_from([9.0, 14.0, 28.0]))
def test_shares_are_the_oracles(seed, robots, side):
    positions = drawn(seed, robots, side)
    expected = [
        formations.even_angles(positions),
        formations.equal_radii(positions),
        formations.equal_radii(positions, 7.0),
        formations.surround(positions, 8.0, 1.5, 0.05),
        formations.straight(positions, 1.0),
        formations.even_spacing(positions),
        formations.spread(positions, PACKINGS[robots - 2] * 80),
        formations.two_groups(positions, 8.0, 1.2, lambda count: smallest_ring(count, 1.0, 5.0).radius),
        formations.inside(positions, 40.0, 40.0, 30.0, 1.0),
        formations.chain(positions, (-9.0, 3.0), (8.0, 5.0), 4.0),
    ]
    for signal, shares in zip([*SIGNALS, *IN_THE_WORLD], expected, strict=True):
        np.testing.assert_allclose(signal(configuration(positions)), shares, rtol=1e-9, atol=1e-9, err_msg=signal.name)
        assert signal.value(configuration(positions)) == pytest.approx(np.mean(shares))
        every = replace(signal, every=True)
        assert every.value(configuration(positions)) == pytest.approx(np.min(shares), abs=1e-9)


@named
@given(seed=st.integers(0, 2**32 - 1), angle=st.floats(-3, 3))
def test_neither_labels_nor_a_turn_change_a_formation(signal, seed, angle):
    positions = drawn(seed, 6, 14.0)
    relabelled = np.random.default_rng(seed).permutation(6)
    before = signal(configuration(positions))
    after = signal(configuration(turned(positions, angle)[relabelled]))
    np.testing.assert_allclose(after, before[relabelled], atol=1e-7)


@everywhere
def test_a_batch_is_measured_one_by_one(signal):
    batch = np.stack([drawn(seed, 5, 14.0) for seed in range(3)], axis=-1)
    together = np.asarray(jax.jit(lambda p: signal(configuration(p)))(jnp.asarray(batch)))
    for index in range(3):
        np.testing.assert_allclose(together[:, index], signal(configuration(batch[..., index])), atol=1e-5)


ALL = [*SIGNALS, *IN_THE_WORLD, Match(places=((0.0, 0.0), (6.0, 0.0), (0.0, 7.0), (5.0, 9.0), (-8.0, 3.0)))]
SLOPES = [jax.jit(lambda positions, signal=signal: gradient(signal, positions)) for signal in ALL]


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1))
def test_gradients_are_the_differences(seed):
    positions = drawn(seed, 5, 14.0)
    direction = np.random.default_rng(seed).normal(size=positions.shape)
    step = 1e-5
    for signal, slopes in zip(ALL, SLOPES, strict=True):
        around = [signal.value(configuration(positions + sign * step * direction)) for sign in (-2, -1, 0, 1, 2)]
        sides = [(around[2] - around[0]) / (2 * step), (around[4] - around[2]) / (2 * step)]
        assume(abs(sides[0] - sides[1]) < 1e-4)  # not at a kink, such as that of the wider of two gaps
        slope = float(jnp.sum(slopes(jnp.asarray(positions, jnp.float32)) * direction))
        assert slope == pytest.approx((around[3] - around[1]) / (2 * step), rel=2e-3, abs=2e-4), signal.name


def gradient(signal, positions):
    return jax.grad(lambda p: jnp.sum(signal.value(configuration(p))))(jnp.asarray(positions, jnp.float32))


@everywhere
@pytest.mark.parametrize(
    "positions",
    [
        np.zeros((3, 2)),
        np.array([[0.0, 0.0], [3.0, 0.0], [-3.0, 0.0]]),
        np.array([[2.0, 2.0], [2.0, 2.0], [5.0, 2.0], [-9.0, 2.0]]),
        np.array([[-4.0, 0.0], [4.0, 0.0]]),
    ],
    ids=["all at one place", "one in the middle", "two at one place", "two robots"],
)
def test_degenerate_configurations_are_finite(signal, positions):
    for every in (False, True):
        chosen = replace(signal, every=every)
        assert np.isfinite(chosen.value(configuration(positions)))
        assert jnp.isfinite(gradient(chosen, positions)).all()


@pytest.mark.parametrize("robots", [2, 3, 4, 7, 12])
def test_a_regular_polygon_is_a_uniform_circle(robots):
    ring = polygon(robots)
    for signal in (EvenAngles(every=True), EqualRadii(every=True), EqualRadii(every=True, radius=9.0)):
        assert signal.value(configuration(ring)) == pytest.approx(1.0)
    assert Surround(every=True, distance=9.0).value(configuration(ring)) == pytest.approx(1.0)
    assert EqualRadii(every=True, radius=10.0).value(configuration(ring)) == pytest.approx(0.9)


def test_by_how_much_one_robot_is_off():
    """Moved by 5% of the radius outwards, it is off by nearly that: the mean radius and the centroid move too."""
    ring = polygon(8)
    ring[3] *= 1.05
    value = EqualRadii(every=True).value(configuration(ring))
    assert 0.95 < value < 0.965
    angles = 2 * np.pi * np.arange(8) / 8
    angles[2] += 0.05 * 2 * np.pi / 8
    moved = 9 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    assert Surround(every=True, distance=9.0).value(configuration(moved)) == pytest.approx(1 - 0.05 * 0.05 / 0.5)


def test_half_a_circle_does_not_surround():
    """Seven of eight places of 14: the gap is 8 of 14 turns, 4.57 even gaps of 8."""
    half = polygon(14)[:7]
    share = Surround(every=True, distance=9.0).value(configuration(half))
    assert share == pytest.approx(1 - 0.05 * (8 / 14 * 7 - 1) / 0.5)
    assert share < 0.95


@pytest.mark.parametrize("robots", [2, 3, 8])
def test_evenly_spaced_robots_are_a_line_in_any_direction(robots):
    line = turned(np.stack([6.0 * np.arange(robots), np.zeros(robots)], axis=1), 1.1) + np.array([3.0, -2.0])
    assert EvenSpacing(every=True).value(configuration(line)) == pytest.approx(1.0)
    assert Straight(every=True).value(configuration(line)) == pytest.approx(1.0)


def test_a_robot_of_a_line_that_is_off_by_a_radius():
    line = np.array([[-6.0, 0.0], [0.0, 1.5], [6.0, 0.0]])  # the line through the centroid, half of a unit higher
    assert Straight(every=True).value(configuration(line)) == pytest.approx(0.95)


def test_packings_are_packings():
    """Three that are easy to draw have their distance, and more points never more than fewer."""
    assert PACKINGS[0] == pytest.approx(math.sqrt(2))
    assert PACKINGS[2] == 1.0
    assert PACKINGS[3] == pytest.approx(math.sqrt(0.5))
    assert PACKINGS[7] == 0.5
    assert all(more < fewer for fewer, more in itertools.pairwise(PACKINGS))
    corners = 40 * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1], [0, 0]])
    assert Spread(every=True).value(configuration(corners)) == pytest.approx(1.0, abs=1e-9)
    assert Spread(every=True).value(configuration(corners[:4])) == pytest.approx(1.0)


@pytest.mark.parametrize("robots", range(2, 17))
def test_a_circle_packing_leaves_room_for_its_discs(robots):
    """N discs of diameter m in the square of side 1 + m do not cover more than the densest packing of the plane."""
    m = PACKINGS[robots - 2]
    assert robots * math.pi / 4 * m**2 / (1 + m) ** 2 < math.pi / math.sqrt(12)


def test_a_zigzag_that_reaches_both_points_is_a_chain_and_a_gap_is_none():
    """Links of 5 from (-20, 0) to (20, 0); the third robot is missing in the second."""
    zigzag = np.array([[-20.0 + 4 * number, 3.0 * (number % 2)] for number in range(1, 10)])
    assert Chain(every=True, reach=5.0).value(configuration(zigzag)) == pytest.approx(1.0)
    gap = math.dist(zigzag[1], zigzag[3])
    shares = Chain(reach=5.0)(configuration(np.delete(zigzag, 2, axis=0)))
    assert sorted(shares)[:3] == pytest.approx([1 - (gap / 5 - 1)] * 2 + [1.0])
    # No reach of its own: the scan radius, here 120.
    assert Chain(every=True).value(configuration(zigzag[::8])) == pytest.approx(1.0)


def test_two_rings_far_apart_are_two_groups():
    ring = smallest_ring(4, 1.0, 5.0)
    for size in (3, 4):
        both = np.concatenate([ring.positions, ring.positions[:size] + np.array([30.0, 4.0])])
        assert TwoGroups(every=True, wide=1.6).value(configuration(both)) == pytest.approx(1.0)
        nearer = TwoGroups(every=True, wide=1.6, apart=40.0).value(configuration(both))
        assert nearer == pytest.approx(1 - (1 - (min(math.dist(a, b) for a in both[:4] for b in both[4:]) / 40)))


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), robots=st.integers(2, 6), angle=st.floats(-3, 3))
def test_a_pattern_is_matched_wherever_it_lies(seed, robots, angle):
    places = drawn(seed, robots, 14.0)
    signal = Match(places=places)
    order = np.random.default_rng(seed).permutation(robots)
    laid = turned(places, angle)[order] + np.array([7.0, -3.0])
    assert Match(places=signal.places, every=True).value(configuration(laid)) == pytest.approx(1.0, abs=1e-6)
    # Near the pattern, the best superposition is found; the oracle tries all.
    near = laid + np.random.default_rng(seed + 1).normal(scale=0.2, size=laid.shape)
    np.testing.assert_allclose(signal(configuration(near)), formations.match(near, places, 1.0), atol=1e-6)


def test_patterns_are_neither_scaled_nor_mirrored():
    hook = np.array([[0.0, 0.0], [6.0, 0.0], [12.0, 0.0], [12.0, 6.0]])
    signal = Match(places=hook)
    for other in (1.1 * hook, hook * [1, -1]):
        assert signal.value(configuration(other)) < 0.95
    with pytest.raises(InputError, match=r"^places = '4 places': must be 3, one for each robot"):
        signal(configuration(hook[:3]))


def test_bad_numbers_are_one_line():
    with pytest.raises(InputError, match=r"^last = \[1, 2\]: must be another point than first"):
        Chain(first=(1, 2), last=(1, 2))
    with pytest.raises(InputError, match=r"^places = .*nan.*: must be finite numbers"):
        Match(places=((0.0, math.nan),))
    for places in (3, "abc", [1.0, 2.0], [[1.0, 2.0, 3.0]]):
        with pytest.raises(InputError, match=r"^places = .*: must be pairs of numbers"):
            Match(places=places)
    with pytest.raises(InputError, match=r"^every = 1: must be true or false"):
        EvenAngles(every=1)
    with pytest.raises(InputError, match=r"^distance = 0: must be"):
        Surround(distance=0)
    with pytest.raises(InputError, match=r"^widest = 1: must be"):
        Surround(widest=1)
    with pytest.raises(InputError, match=r"^robots = 17: must be at most 16 with the signal spread"):
        Spread()(configuration(drawn(0, 17, 40.0)))


def test_who_comes_first_of_robots_in_one_direction_changes_nothing():
    """Two robots of a ring stand at one place: exactly, or one of them a hair before or behind the other."""
    for signal in (EvenAngles(), Surround(distance=9.0)):
        shares = []
        for hair in (-1e-9, 0.0, 1e-9):
            angles = np.array([0.3, 0.3 + hair, 2.0, 2.5, 3.9])
            ring = 9 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
            shares.append(np.sort(signal(configuration(ring))))
        np.testing.assert_allclose(shares[0], shares[1], atol=1e-6)
        np.testing.assert_allclose(shares[2], shares[1], atol=1e-6)


def test_robots_side_by_side_are_not_evenly_spaced():
    rows = np.array([[0.0, 0.0], [0.0, 3.0], [6.0, 0.0], [6.0, 3.0], [12.0, 0.0], [12.0, 3.0]])
    assert EvenSpacing(every=True).value(configuration(rows)) < 0.1
