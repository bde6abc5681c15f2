from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from murmurate.analysis.optimum.annealing import AnnealingConfig, anneal
from murmurate.analysis.optimum.best_known import best_known
from murmurate.analysis.optimum.formation import Target
from murmurate.analysis.optimum.search import Formation, OptimumConfig, annealed, distinct, hop, nested_rings, search
from murmurate.errors import InputError
from murmurate.geometry import smallest_ring
from murmurate.world import WorldConfig

SHORT = AnnealingConfig(chains=32, moves_per_robot=300)
WORLD = WorldConfig(robots=5, half_width=32.5, half_height=32.5)


@pytest.mark.parametrize("objective", ["C1", "C2"])
def test_a_short_search_finds_the_best_known_five(objective):
    config = OptimumConfig(replace(WORLD, scan_radius=100.0), objective, annealing=SHORT, polished=6)
    result = search(config)
    assert result[0].valid
    assert result[0].value == pytest.approx(best_known(config.target), abs=1e-8)
    values = [formation.value for formation in result if formation.valid]
    assert values == sorted(values, reverse=True)


def test_annealing_alone_is_as_many_ends_as_are_polished():
    config = OptimumConfig(replace(WORLD, scan_radius=100.0), "C1", annealing=SHORT, polished=6)
    ends = annealed(config)
    assert len(ends) == 6
    assert max(formation.value for formation in ends if formation.valid) == pytest.approx(
        best_known(config.target), abs=1e-8
    )
    searched = search(config)
    for end in ends:
        assert min(abs(end.value - formation.value) for formation in searched) < 1e-4
    assert annealed(replace(config, polished=0)) == []


@pytest.mark.nightly
def test_basin_hopping_agrees_with_annealing():
    config = OptimumConfig(WORLD, "C1", annealing=SHORT, polished=3, hops=4)
    checked = hop(config)
    assert checked.valid
    assert checked.value == pytest.approx(search(config)[0].value, abs=1e-8)


def test_the_same_seed_gives_the_same_formations():
    config = OptimumConfig(WORLD, "C2", annealing=SHORT, polished=3, seed=3)
    first, second = search(config), search(config)
    assert [formation.value for formation in first] == [formation.value for formation in second]


def test_weights_decide_what_is_given_up():
    """Where gathering weighs much more than sight, the best formation is no valid pattern, but a lattice."""
    weights = {"gathering": 300.0}
    config = OptimumConfig(
        WORLD, "C1", weights=weights, annealing=replace(SHORT, t_start=1.0), polished=3, only_valid=False
    )
    best = search(config)[0]
    ring = search(replace(config, only_valid=True))[0]
    assert ring.valid
    assert best.value > ring.value
    assert not best.valid


def test_chains_never_overlap_and_stay_inside():
    result = anneal(
        lambda positions: -((positions - 7.0) ** 2).sum(axis=(0, 1)),
        WorldConfig(robots=4, half_width=8.0, half_height=9.0),
        seed=0,
        config=SHORT,
    )
    assert result.shape == (32, 4, 2)
    assert (np.abs(result) <= [8.0, 9.0]).all()
    apart = np.hypot(*np.moveaxis(result[:, :, None] - result[:, None], -1, 0)) + 9 * np.eye(4)
    assert apart.min() > 2.0
    scores = -((result - 7.0) ** 2).sum(axis=(1, 2))
    assert (np.diff(scores) <= 1e-3).all()


def test_formations_that_are_the_same_pattern_count_once():
    square = 5.0 * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    turned = square @ np.array([[0.6, -0.8], [0.8, 0.6]])
    other = 5.0 * np.array([[0, 0], [1, 0], [0.5, 0.9], [0, 2]])
    formations = [Formation(other, 1.0, False), Formation(square, 0.9, True), Formation(turned, 0.9, True)]
    assert [formation.value for formation in distinct(formations, 5.0)] == [0.9, 1.0]
    assert [formation.value for formation in distinct(formations, 5.0, only_valid=False)] == [1.0, 0.9]


@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("chains", {"chains": 0}),
        ("chains", {"chains": 2**31 - 1}),
        ("t_end", {"t_end": 1.0}),
        ("step_end", {"step_end": 2.0}),
        ("t_start", {"t_start": float("nan")}),
        ("teleport_fraction", {"teleport_fraction": 1.5}),
    ],
)
def test_impossible_numbers(field, values):
    with pytest.raises(InputError, match=rf"^{field} = "):
        AnnealingConfig(**values)


def test_impossible_searches():
    with pytest.raises(InputError, match=r"^objective = 'C3': must be one of C1, C2"):
        OptimumConfig(WORLD, "C3")
    with pytest.raises(InputError, match=r"^hops = -1"):
        OptimumConfig(WORLD, "C1", hops=-1)


@pytest.mark.parametrize("robots", [3, 4, 7, 9])
def test_rings_to_begin_with_are_of_the_right_size(robots):
    target = OptimumConfig(replace(WORLD, robots=robots), "C1").target
    starts = list(nested_rings(target))
    assert len(starts) == 2 * min(5, robots - 2)
    assert all(positions.shape == (robots, 2) for positions in starts)


def test_around_one_robot_an_odd_ring_with_an_empty_place_is_valid_where_the_even_one_is_not():
    """Six places around one in the middle hide opposite robots from each other, however wide; seven do not."""
    world = replace(WORLD, robots=7, scan_radius=200.0, half_width=100.0, half_height=100.0)
    target = OptimumConfig(world, "C1").target
    full, empty = list(nested_rings(target))[2:4]
    assert not target.is_valid(full)
    assert target.is_valid(empty)


def test_a_formation_is_valid_by_the_rule_that_judges_episodes():
    """A robot may stand on the wall of the world as it is stepped in, and the plane has no walls."""
    wall = float(np.float32(20.1))
    assert wall > 20.1
    world = WorldConfig(robots=5, half_width=20.1, half_height=20.1)
    on_wall = 1.01 * smallest_ring(5, 1.0, 5.0).positions
    on_wall[:, 0] += wall - on_wall[:, 0].max()
    on_wall[:, 0] = np.minimum(on_wall[:, 0], wall)
    beyond = on_wall + np.array([1e-6, 0.0])
    assert Target(world, "C2").is_valid(on_wall)
    assert not Target(world, "C2").is_valid(beyond)
    assert Target(replace(world, bounded=False), "C2").is_valid(beyond)
