from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from murmurate.analysis.optimum.formation import Target
from murmurate.analysis.optimum.polish import _Problem, _repair, polish
from murmurate.geometry import distances, neighbors_and_visible, smallest_ring
from murmurate.world import WorldConfig
from oracles.configurations import disjoint

WORLD = WorldConfig(robots=8, half_width=40, half_height=40)


def scattered(seed, robots=8, side=30.0):
    return disjoint(np.random.default_rng(seed), 1, robots, 1.0, side)[0].astype(float)


@pytest.mark.parametrize("objective", ["C1", "C2"])
@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (2, 3, 4, 5))])
def test_it_gives_nothing_up(objective, seed):
    target = Target(WORLD, objective)
    before = scattered(seed)
    after = polish(before, target)
    assert target.value(after) >= target.value(before)
    for old, new in zip(neighbors_and_visible(before, 1.0, 20.0), neighbors_and_visible(after, 1.0, 20.0), strict=True):
        assert (new | ~old).all()
    was_safe = distances(before) >= 5
    assert (distances(after)[was_safe] >= 5).all()
    assert (np.abs(after) <= 40).all()


@functools.cache
def polished(objective):
    return polish(scattered(0), Target(WORLD, objective))


@pytest.mark.parametrize("size", [1e-8, 1e-5, 1e-3])
@pytest.mark.parametrize("objective", ["C1", "C2"])
def test_a_small_step_outside_the_constraints_is_taken_back(objective, size):
    before = scattered(0)
    problem = _Problem.from_target(before, Target(WORLD, objective))
    best = polished(objective) / WORLD.safe_distance
    rng = np.random.default_rng(0)
    for _ in range(5):
        outside = best + size * rng.normal(size=best.shape)
        assert problem.constraints(outside).slack(outside).min() < -size / 10
        inside = _repair(outside, problem)
        assert problem.constraints(inside).slack(inside).min() > -1e-10
        assert np.abs(inside - outside).max() < 10 * size


@pytest.mark.parametrize("objective", ["C1", "C2"])
def test_a_wide_ring_shrinks_to_one_that_cannot_be_improved(objective):
    target = Target(WORLD, objective)
    result = polish(1.7 * smallest_ring(8, 1.0, 5.0).positions, target)
    assert target.is_valid(result)
    assert target.value(result) >= target.value(smallest_ring(8, 1.0, 5.0).positions) - 1e-9
    rng = np.random.default_rng(0)
    for size in (1e-2, 1e-4, 1e-6):
        for _ in range(200):
            nearby = result + size * rng.normal(size=result.shape)
            assert not target.is_valid(nearby) or target.value(nearby) < target.value(result) + 1e-9


@pytest.mark.parametrize("objective", ["C1", "C2"])
def test_two_and_three_robots_end_where_it_is_proved_best(objective):
    for robots in (2, 3):
        target = Target(replace(WORLD, robots=robots), objective)
        result = polish(scattered(3, robots), target)
        assert target.is_valid(result)
        assert target.value(result) == pytest.approx(target.value(smallest_ring(robots, 1.0, 5.0).positions), abs=1e-8)


def test_a_robot_may_end_on_the_gathering_point():
    star = np.concatenate([[[0.3, 0.2]], 9 * smallest_ring(5, 1.0, 5.0).positions / smallest_ring(5, 1.0, 5.0).radius])
    target = Target(replace(WORLD, robots=6), "C1")
    result = polish(star, target)
    assert target.is_valid(result)
    assert np.hypot(*result.T).min() < 1e-6


@pytest.mark.parametrize("reading", ["penalty", "shell"])
@pytest.mark.parametrize("objective", ["C1", "C2"])
def test_slopes_are_those_of_the_cost(reading, objective):
    world = replace(WORLD, safety=reading)
    target = Target(world, objective, {"gathering": 2.0, "safety": 3.0})
    points = scattered(11, side=22.0) / 5
    problem = _Problem.from_target(5 * points, target)
    _, slope = problem.cost(points, 1e-3)
    constraints = problem.constraints(points)
    jacobian = constraints.linearized(points)[1]
    for coordinate in range(points.size):
        step = np.zeros(points.size)
        step[coordinate] = 1e-6
        ahead, behind = (points + sign * step.reshape(points.shape) for sign in (1, -1))
        assert slope[coordinate] == pytest.approx(
            (problem.cost(ahead, 1e-3)[0] - problem.cost(behind, 1e-3)[0]) / 2e-6, abs=1e-5
        )
        assert jacobian[:, coordinate] == pytest.approx(
            (constraints.slack(ahead) - constraints.slack(behind)) / 2e-6, abs=1e-5
        )
    # What is made small is the objective, up to a constant and a factor.
    other = points * 1.01
    cost = problem.cost(other, 0.0)[0] - problem.cost(points, 0.0)[0]
    parts = [target.signals(5 * x) for x in (points, other)]
    gained = sum(w * (parts[1][n] - parts[0][n]) for n, w in ((target.gathering, 2.0), ("safety", 3.0)))
    reach = np.hypot(40, 40) / 5 * (1 if objective == "C1" else 2)
    assert cost == pytest.approx(-gained * reach / 2, abs=1e-9)
