"""The kernels of contact against distances between shapes: 100,000 random configurations with random velocities."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from murmurate import geometry
from oracles import contact as oracle
from oracles.configurations import BATCHES, disjoint, scenes
from oracles.visibility import FLOAT32_TANGENCY, FLOAT64_TANGENCY, pairwise_distances


def contacts(positions, velocities, radius, half_side):
    return (
        geometry.closest_approach(positions, velocities),
        geometry.any_contact(positions, velocities, radius),
        geometry.distances(positions),
        geometry.any_outside(positions + velocities, half_side, half_side),
    )


KERNELS = [(contacts, np.float64, FLOAT64_TANGENCY), (jax.jit(contacts), np.float32, FLOAT32_TANGENCY)]


@pytest.mark.parametrize("long", [False, pytest.param(True, marks=pytest.mark.nightly)], ids=["short", "long"])
@pytest.mark.parametrize("robots", BATCHES)
def test_kernels_agree_with_shapes(robots, long):
    rng = np.random.default_rng(robots)
    collisions, departures, total = 0, 0, 0
    undecided, borderline = np.zeros(2), np.zeros(2)  # of each kernel: nearly in contact, nearly at the border
    for positions, radius, side in scenes(robots, long):
        # Steps across a good part of the world, so that many robots pass through one another between the ends.
        velocities = rng.uniform(-0.5, 0.5, positions.shape).astype(np.float32) * np.float32(side / robots)
        approach = oracle.closest_approach(positions, velocities)
        distance = pairwise_distances(positions)
        nearest = np.where(np.eye(robots, dtype=bool), np.inf, approach).min((-2, -1))
        ends = positions.astype(np.float64) + velocities
        departed = oracle.leaves(ends, side / 2, side / 2)
        collisions += (nearest <= 2 * radius).sum()
        departures += departed.sum()
        total += len(positions)
        for number, (kernels, dtype, tolerance) in enumerate(KERNELS):
            answers = kernels(positions.astype(dtype), velocities.astype(dtype), radius, side / 2)
            got_approach, collides, got_distance, leaves = map(np.asarray, answers)
            np.testing.assert_allclose(got_approach, approach, rtol=0, atol=tolerance * radius)
            np.testing.assert_allclose(got_distance, distance, rtol=0, atol=tolerance * radius)
            decided = np.abs(nearest - 2 * radius) > tolerance * radius
            np.testing.assert_array_equal(collides[decided], nearest[decided] <= 2 * radius)
            inside = (np.abs(np.abs(ends) - side / 2) > tolerance * radius).all((-2, -1))
            np.testing.assert_array_equal(leaves[inside], departed[inside])
            undecided[number] += (~decided).sum()
            borderline[number] += (~inside).sum()
    assert (undecided / total < 0.01).all()
    assert (borderline / total < 0.01).all()
    assert 0.01 < collisions / total < 0.99
    assert 0.1 < departures / total < 0.999


def test_the_oracle_follows_the_motion():
    rng = np.random.default_rng(0)
    positions = disjoint(rng, 200, 4, 1.0, side=10.0).astype(np.float64)
    velocities = rng.uniform(-6, 6, positions.shape)
    approach = oracle.closest_approach(positions, velocities)
    moments = np.linspace(0, 1, 2001)
    sampled = np.min([pairwise_distances(positions + t * velocities) for t in moments[::10]], axis=0)
    assert (approach <= sampled + 1e-12).all()
    # Between two moments, 1 / 200 apart, the distance cannot change by more than the relative speed allows.
    assert (sampled - approach <= pairwise_distances(velocities) / 400 + 1e-12).all()
