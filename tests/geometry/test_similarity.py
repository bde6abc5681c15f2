"""Sameness of patterns: against every relabelling, and the laws that a distance between patterns obeys."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from murmurate.errors import InputError
from murmurate.geometry.similarity import (
    align,
    configuration,
    distance,
    lower_bound,
    neighborhood_bound,
    neighborhoods,
    profile,
)

COORDINATES = st.floats(-10, 10, allow_subnormal=False)
CHOICES = list(itertools.product((False, True), (False, True)))


def configurations(robots):
    return arrays(float, (robots, 2), elements=COORDINATES)


def ring(robots, radius=1.0):
    angle = 2 * np.pi * np.arange(robots) / robots
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def moved(points, rng, scale=1.0, mirror=False):
    """The same pattern elsewhere: turned, shifted, relabelled, scaled, mirrored."""
    angle = rng.uniform(0, 2 * math.pi)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    image = points * [1, -1] if mirror else points
    return scale * rng.permutation(image) @ turn.T + rng.uniform(-30, 30, 2)


def size(points):
    centred = points - points.mean(axis=0)
    return math.sqrt(np.mean(np.sum(centred**2, axis=1)))


def by_every_relabelling(first, second, scaling, reflection):
    """The distance by Kabsch's rotation (a singular value decomposition) for each of the N! relabellings."""
    p, q = (x - x.mean(axis=0) for x in (first, second))
    if scaling:
        p, q = p / size(p), q / size(q)
    least = math.inf
    for order in itertools.permutations(range(len(q))):
        u, values, vt = np.linalg.svd(p.T @ q[list(order)])
        proper = values[0] + np.sign(np.linalg.det(u @ vt)) * values[1]
        overlap = max(proper, values[0] - np.sign(np.linalg.det(u @ vt)) * values[1]) if reflection else proper
        least = min(least, (np.sum(p**2) + np.sum(q**2) - 2 * overlap) / len(p))
    return math.sqrt(max(least, 0.0))


@pytest.mark.parametrize(("scaling", "reflection"), CHOICES)
@pytest.mark.parametrize("robots", [2, 3, 4, 5, 6])
def test_every_relabelling_was_considered(robots, scaling, reflection):
    rng = np.random.default_rng(robots)
    for _ in range(8):
        pair = rng.normal(size=(2, robots, 2)) * [[[1.0]], [[2.0]]]
        expected = by_every_relabelling(*pair, scaling, reflection)
        # Kabsch's formula is the root of a difference: at a distance of 0 it is good to the root of the precision.
        assert distance(*pair, scaling=scaling, reflection=reflection) == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize(
    "pattern", [ring(4), ring(6), np.vstack([ring(5), 2 * ring(5)]), np.vstack([ring(6), [[0, 0]]])]
)
def test_symmetric_patterns_against_every_angle(pattern):
    """All relabellings would be too many; all angles in small steps, each with its best relabelling, are not."""
    from scipy.optimize import linear_sum_assignment

    rng = np.random.default_rng(0)
    other = moved(pattern, rng) + rng.normal(size=pattern.shape) * 0.2
    p, q = (x - x.mean(axis=0) for x in (pattern, other))
    least = math.inf
    for angle in np.linspace(0, 2 * np.pi, 2000, endpoint=False):
        turned = q @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        square = np.sum((p[:, None] - turned[None]) ** 2, axis=2)
        least = min(least, square[linear_sum_assignment(square)].mean())
    result = distance(pattern, other, scaling=False, reflection=False)
    assert result <= math.sqrt(least) + 1e-12
    assert result == pytest.approx(math.sqrt(least), abs=1e-4)


@pytest.mark.parametrize("robots", [1, 2, 3, 7, 10, 16])
def test_the_same_pattern_is_at_no_distance(robots):
    rng = np.random.default_rng(robots)
    for points in (rng.normal(size=(robots, 2)), ring(robots)):
        copy = moved(points, rng, scale=3.7)
        assert distance(points, copy, reflection=False) < 1e-12
        image = moved(points, rng, mirror=True)
        assert distance(points, image, scaling=False) < 1e-11


def test_what_is_said_not_to_matter_matters_not():
    scalene = np.array([[0.0, 0.0], [4.0, 0.0], [3.0, 2.0]])
    assert distance(scalene, 2 * scalene, scaling=False) == pytest.approx(size(scalene))
    assert distance(scalene, scalene * [1, -1], reflection=False) > 0.1


@pytest.mark.parametrize(("scaling", "reflection"), CHOICES)
def test_a_match_is_what_it_says(scaling, reflection):
    rng = np.random.default_rng(3)
    first, second = rng.normal(size=(2, 7, 2))
    match = align(first, second, scaling=scaling, reflection=reflection)
    p, q = (x - x.mean(axis=0) for x in (first, second))
    if scaling:
        p, q = p / size(p), q / size(q)
    q = q * [1, -1] if match.mirrored else q
    turn = np.array([[np.cos(match.angle), -np.sin(match.angle)], [np.sin(match.angle), np.cos(match.angle)]])
    laid = q[match.order] @ turn.T
    assert sorted(match.order) == list(range(7))
    assert math.sqrt(np.mean(np.sum((p - laid) ** 2, axis=1))) == pytest.approx(match.distance)


@given(st.integers(1, 7).flatmap(lambda n: st.tuples(*[configurations(n)] * 3)), st.sampled_from(CHOICES))
def test_it_is_a_distance(three, choice):
    how = {"scaling": choice[0], "reflection": choice[1]}
    first, second, third = three
    ab, ba, bc, ac = (
        distance(x, y, **how) for x, y in ((first, second), (second, first), (second, third), (first, third))
    )
    assert ab == pytest.approx(ba, abs=1e-7)
    assert distance(first, first, **how) < 1e-7
    assert ac <= ab + bc + 1e-7
    assert lower_bound(first, second, scaling=choice[0]) <= ab + 1e-7
    around = [neighborhoods(points, scaling=choice[0]) for points in (first, second)]
    assert neighborhood_bound(*around) <= ab + 1e-7


@given(
    st.integers(1, 7).flatmap(lambda n: st.tuples(configurations(n), configurations(n))),
    st.sampled_from(CHOICES),
    st.floats(0, 2),
)
def test_beyond_a_limit_the_distance_is_only_said_to_be_beyond(pair, choice, times):
    how = {"scaling": choice[0], "reflection": choice[1]}
    whole = distance(*pair, **how)
    limit = times * whole
    within = distance(*pair, **how, limit=limit)
    if limit < whole - 1e-7:
        assert within == math.inf
    elif limit > whole + 1e-7:
        assert within == pytest.approx(whole, abs=1e-7)


@pytest.mark.parametrize("limit", [0.05, 0.2, 0.4])
def test_a_limit_does_not_change_distances_within_it(limit):
    rng = np.random.default_rng(2)
    pattern, inside = np.vstack([ring(9), [[0, 0]]]), 0
    for _ in range(40):
        pair = pattern, moved(pattern, rng) + rng.normal(size=pattern.shape) * rng.uniform(0, 0.5)
        whole, within = distance(*pair), distance(*pair, limit=limit)
        assert within == (whole if whole <= limit else math.inf)
        inside += whole <= limit
    assert 0 < inside < 40


@pytest.mark.parametrize("scaling", [False, True])
def test_profiles_are_as_far_apart_as_the_lower_bound(scaling):
    first, second = np.random.default_rng(4).normal(size=(2, 6, 2))
    profiles = profile(first, scaling=scaling) - profile(second, scaling=scaling)
    assert math.sqrt(np.mean(profiles**2)) == pytest.approx(lower_bound(first, second, scaling=scaling))


def test_coincident_robots_and_huge_coordinates_are_defined():
    assert distance(np.zeros((3, 2)), np.ones((3, 2))) == 0
    assert distance(np.zeros((3, 2)), ring(3)) == pytest.approx(1.0)
    assert distance(1e200 * ring(5), ring(5)) < 1e-12
    assert distance(ring(5) + 1e6, ring(5)) < 1e-9


NO_NUMBERS = ([[1.0], [1.0, 2.0]], [["1", "2"]], [[True, False]], [[None, 1.0]], [[1 << 70, 0]], "text", None, {})


@pytest.mark.unchecked
@pytest.mark.parametrize("bad", [np.zeros(4), np.zeros((3, 3)), np.zeros((0, 2)), np.full((2, 2), np.nan), *NO_NUMBERS])
def test_no_such_configuration(bad):
    for call in (configuration, profile, lambda x: distance(x, x), lambda x: lower_bound(x, x)):
        with pytest.raises(InputError, match=r"^positions = "):
            call(bad)


@pytest.mark.unchecked
def test_swarms_of_different_size_cannot_be_compared():
    with pytest.raises(InputError, match=r"^second = '4 robots': must be 3 robots, as the first"):
        distance(ring(3), ring(4))
