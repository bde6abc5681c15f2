"""The table of the package, verified with shapely and the signals' oracle: no kernel of ours is trusted here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from murmurate.analysis import symmetry
from murmurate.analysis.optimum.best_known import BestKnown, best_known, is_record, load
from murmurate.analysis.optimum.bounds import PROVED, upper_bound
from murmurate.analysis.optimum.formation import Target
from murmurate.analysis.optimum.polish import polish
from murmurate.errors import InputError
from murmurate.geometry import smallest_ring
from murmurate.runs.presets import preset
from oracles import signals, visibility

TABLE = load()
NAMES = [f"{entry.objective}-{entry.robots}-{entry.radius:g}" for entry in TABLE]


@pytest.mark.parametrize("entry", TABLE, ids=NAMES)
def test_each_entry_is_a_valid_pattern_of_the_stated_value(entry):
    positions, apart = entry.positions, visibility.pairwise_distances(entry.positions)
    other = ~np.eye(entry.robots, dtype=bool)
    assert positions.shape == (entry.robots, 2)
    assert apart[other].min() >= entry.safe_distance
    assert apart.max() <= entry.scan_radius
    assert visibility.shadow_clearance(positions, entry.radius).min() >= 0
    assert (np.abs(positions) <= [entry.half_width, entry.half_height]).all()
    sizes = (entry.half_width, entry.half_height, entry.radius, entry.scan_radius, entry.safe_distance)
    measured = signals.signals(positions, {"C1": "close", "C2": "nclose"}[entry.objective], *sizes, "penalty")
    assert sum(measured.values()) == pytest.approx(entry.value, abs=1e-12)
    assert entry.signals == pytest.approx(measured, abs=1e-8)


@pytest.mark.parametrize("entry", TABLE, ids=NAMES)
def test_each_entry_is_between_the_ring_and_the_bound(entry):
    target = entry.target
    assert entry.value <= upper_bound(target) + 1e-9
    circle = smallest_ring(entry.robots, entry.radius, entry.safe_distance).positions
    if target.is_valid(circle):
        assert entry.value >= target.value(circle) - 1e-9
    if (entry.objective, entry.robots) in PROVED:
        assert entry.value == pytest.approx(upper_bound(target), abs=1e-8)


@pytest.mark.parametrize(
    "entry",
    [pytest.param(entry, marks=[pytest.mark.nightly] if entry.robots >= 12 else []) for entry in TABLE],
    ids=NAMES,
)
def test_no_entry_can_be_polished_further(entry):
    assert entry.target.value(polish(entry.positions, entry.target)) <= entry.value + 1e-8


def test_the_table_has_every_swarm_size():
    have = {(entry.robots, entry.objective, entry.radius) for entry in TABLE}
    wanted = {(n, c, r) for n in range(2, 17) for c in ("C1", "C2") for r in (0.4, 1.0)}
    # With the scan radius of B and C no pattern of twelve or more is known in which everybody neighbours everybody.
    assert have == wanted - {(n, "C1", 1.0) for n in range(12, 17)}
    assert len(have) == len(TABLE)


@pytest.mark.parametrize("name", "ABCDEF")
def test_the_papers_experiments_have_a_best_known_pattern(name):
    config = preset(name)
    target = Target(config.world, config.objective)
    known = best_known(target)
    assert known is not None
    assert 3.8 < known <= upper_bound(target)
    assert not is_record(target, known)
    assert is_record(target, known + 1e-3)


def test_what_is_known_holds_at_any_scale():
    config = preset("C")
    target = Target(config.world, config.objective)
    names = ("half_width", "half_height", "radius", "scan_radius", "safe_distance")
    larger = replace(target.world, **{name: 3 * getattr(target.world, name) for name in names})
    assert best_known(Target(larger, "C1")) == pytest.approx(best_known(target), abs=1e-9)


def test_where_nothing_is_known():
    world = preset("C").world
    assert best_known(Target(world, "C1", {"visible": 2.0})) is None
    assert best_known(Target(replace(world, safety="shell"), "C1")) is None
    assert best_known(Target(replace(world, radius=0.9), "C1")) is None
    assert best_known(Target(replace(world, robots=40), "C1")) is None
    assert best_known(Target(replace(world, scan_radius=6.0), "C1")) is None
    assert not is_record(Target(replace(world, robots=40), "C1"), 4.0)


def test_the_best_ring_of_ten_is_a_little_longer_than_wide():
    entry = next(e for e in TABLE if (e.robots, e.objective, e.radius) == (10, "C2", 1.0))
    assert symmetry(entry.positions, 1e-6).name == "D_2"
    assert symmetry(entry.positions, 0.02).name == "D_10"
    assert entry.value > entry.target.value(smallest_ring(10, 1.0, 5.0).positions) + 1e-5


def entry_with(**changes):
    return TABLE[0].to_dict() | changes


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ([], r"^pattern = "),
        ({"robots": 2}, r"^pattern = \['robots'\]"),
        (entry_with(objective="C3"), r"^objective = 'C3'"),
        (entry_with(positions=[[0, "x"]]), r"^positions = "),
        (entry_with(positions=[[0.0, float("nan")]] * TABLE[0].robots), r"^positions = "),
        (entry_with(value=TABLE[0].value + 1e-9), r"^value = "),
        (entry_with(signals={**TABLE[0].signals, "visible": 0.9}), r"^signals = "),
        (entry_with(signals=3), r"^signals = "),
    ],
)
def test_an_entry_that_is_none_is_refused(data, message):
    with pytest.raises(InputError, match=message):
        BestKnown.from_dict(data)


def test_an_entry_survives_json():
    again = BestKnown.from_dict(TABLE[0].to_dict())
    assert again.to_dict() == TABLE[0].to_dict()
