"""Catalogues: classes against a plain re-telling of the rule, the laws of merging, and files from strangers."""

from __future__ import annotations

import csv
import io
import json
import math
import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from murmurate.analysis import TOLERANCE, Catalogue, Finding, symmetry
from murmurate.analysis.catalogue import MARGINS
from murmurate.errors import InputError
from murmurate.geometry.similarity import distance


def ring(robots, radius=1.0):
    angle = 2 * np.pi * np.arange(robots) / robots
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def around(robots, radius=1.0):
    return np.vstack([ring(robots - 1, radius), [[0.0, 0.0]]])


def finding(positions, value: Any = 3.0, episode=0, **changes: Any):
    usual: dict[str, Any] = {
        "radius": 1.0,
        "safe_distance": 5.0,
        "scan_radius": 20.0,
        "objective": "C1",
        "gap": None,
        "experiment": "C",
        "policy": "equivariant",
        "start": "scattered",
        "seed": 0,
        "run": "a run",
    }
    return Finding(positions, value=value, episode=episode, **(usual | changes))


def noisy(pattern, count, size, seed=0, **changes):
    """The same pattern many times: turned, shifted, relabelled, mirrored, scaled and displaced."""
    rng = np.random.default_rng(seed)
    findings = []
    for episode in range(count):
        z = (pattern + rng.normal(size=pattern.shape) * size) * rng.choice([-1, 1], size=2) * rng.uniform(0.5, 2)
        angle = rng.uniform(0, 2 * math.pi)
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        findings.append(
            finding(rng.permutation(z) @ turn.T + rng.uniform(-9, 9, 2), rng.uniform(3, 4), episode, **changes)
        )
    return findings


def by_the_rule(findings, tolerance, **how):
    """Classes, as sets of episodes, by the rule and by nothing else: every distance, no bounds."""
    groups = []
    for candidate in sorted(findings, key=lambda candidate: -candidate.value):
        apart = [distance(group[0].positions, candidate.positions, **how) for group in groups]
        if apart and min(apart) <= tolerance:
            groups[apart.index(min(apart))].append(candidate)
        else:
            groups.append([candidate])
    return [[member.episode for member in group] for group in groups]


def episodes(catalogue):
    return [[member.episode for member in pattern.members] for pattern in catalogue.classes]


# Random findings that collide in every way: the same run, episode, value or positions, and near each other.
SHAPES = [ring(4, 9.0), ring(4, 9.0) + 0.5 * np.eye(4, 2), around(4, 9.0), ring(4, 9.0) * [1.0, 1.3]]
FINDINGS = st.lists(
    st.builds(
        lambda shape, turn, value, episode, run, seed, start, gap: finding(
            SHAPES[shape] @ turn, value, episode, run=run, seed=seed, start=start, gap=gap
        ),
        st.integers(0, len(SHAPES) - 1),
        st.sampled_from([np.eye(2), np.array([[0.6, -0.8], [0.8, 0.6]])]),
        st.sampled_from([2.5, 3.0]),
        st.integers(0, 1),
        st.sampled_from(["a", "b"]),
        st.integers(0, 1),
        st.sampled_from(["packed", "scattered"]),
        st.sampled_from([None, 0.0, 0.5]),
    ),
    min_size=1,
    max_size=5,
)


def same(first, second):
    return first.to_dict() == second.to_dict() and first.rows() == second.rows()


@pytest.mark.unchecked
@settings(max_examples=40)
@given(FINDINGS, st.randoms(use_true_random=False))
def test_the_order_of_the_findings_does_not_matter(findings, source):
    shuffled = list(findings)
    source.shuffle(shuffled)
    assert same(Catalogue.from_findings(shuffled), Catalogue.from_findings(findings))
    assert same(Catalogue.from_findings(findings + shuffled), Catalogue.from_findings(findings))


@pytest.mark.unchecked
@settings(max_examples=40)
@given(FINDINGS.map(Catalogue.from_findings))
def test_a_file_loses_nothing(catalogue):
    assert same(Catalogue.from_dict(json.loads(json.dumps(catalogue.to_dict(), allow_nan=False))), catalogue)


def test_floats_are_the_same_after_a_file():
    points = np.random.default_rng(0).normal(size=(7, 2)).astype(np.float32) / 3
    before = Catalogue.from_findings([finding(points, value=np.float32(0.1), gap=1 / 3)])
    (after,) = Catalogue.from_dict(json.loads(json.dumps(before.to_dict()))).findings
    assert (after.positions == points.astype(float)).all()
    assert (after.value, after.gap) == (float(np.float32(0.1)), 1 / 3)


@pytest.mark.parametrize("reflection", [False, True])
@pytest.mark.parametrize("scaling", [False, True])
def test_classes_follow_the_rule(scaling, reflection):
    rng = np.random.default_rng(5)
    shapes = [around(6), ring(6), around(6) * [1, 1.3], rng.normal(size=(6, 2))]
    findings = []
    for episode in range(40):
        shape = shapes[episode % 4] * rng.choice([-1, 1], size=2)
        points = shape + rng.normal(size=(6, 2)) * rng.choice([0.01, 0.1])
        findings.append(finding(points, value=rng.uniform(), episode=episode))
    how = {"scaling": scaling, "reflection": reflection}
    catalogue = Catalogue.from_findings(random.Random(0).sample(findings, 40), tolerance=0.15, **how)
    assert episodes(catalogue) == by_the_rule(findings, 0.15, **how)
    assert 4 <= len(catalogue.classes) < 30
    for pattern in catalogue.classes:
        apart = [distance(pattern.representative.positions, member.positions, **how) for member in pattern.members]
        assert pattern.spread == pytest.approx(max(apart), abs=1e-7)
        assert pattern.spread <= 0.15


def test_noisy_patterns_of_each_kind_are_a_class():
    rings, others = (
        noisy(ring(10), 12, 0.02, start="packed"),
        noisy(around(10), 8, 0.02, seed=1, run="b", experiment="F"),
    )
    catalogue = Catalogue.from_findings(rings + others)
    by_layers = {pattern.layers: pattern for pattern in catalogue.classes}
    assert set(by_layers) == {(10,), (9, 1)}
    ten, nine = by_layers[(10,)], by_layers[(9, 1)]
    assert (ten.symmetry.name, nine.symmetry.name) == ("D_10", "D_9")
    assert (ten.count, nine.count) == (12, 8)
    assert ten.starts == {"packed": 12}
    assert nine.seeds == {"F equivariant 0": 8}
    assert [pattern.name for pattern in catalogue.classes] == ["P1", "P2"]
    assert [pattern.value for pattern in catalogue.classes] == sorted([ten.value, nine.value], reverse=True)
    for pattern, result in ((ten, rings), (nine, others)):
        assert pattern.value == max(member.value for member in result) == pattern.representative.value
        assert pattern.symmetry == symmetry(pattern.representative.positions)
        assert 0 < pattern.spread <= TOLERANCE
    assert [entry.value for entry in catalogue.findings] == sorted(
        (entry.value for entry in rings + others), reverse=True
    )


def test_a_finding_joins_the_nearest_leader():
    """The third lies within the tolerance of both others: of the better one, too, but it is nearer to the worse."""
    shapes = [around(5) * [1.0, 1.0 + stretch] for stretch in (0.0, 0.30, 0.19)]
    catalogue = Catalogue.from_findings(
        [finding(shape, 3.0 - n / 10, n) for n, shape in enumerate(shapes)], tolerance=0.1
    )
    assert distance(shapes[0], shapes[2]) < 0.1 < distance(shapes[0], shapes[1])
    assert episodes(catalogue) == [[0], [1, 2]]


def test_what_was_found_twice_counts_once():
    original = finding(ring(5), 3.0, episode=4)
    assert Catalogue.from_findings([original, finding(ring(5), 2.0, episode=4)]).classes[0].members == (original,)
    assert len(Catalogue.from_findings([original, finding(ring(5), 3.0, episode=5)]).findings) == 2
    assert len(Catalogue.from_findings([original, finding(ring(5), 3.0, episode=4, run="another")]).findings) == 2
    assert len(Catalogue.from_findings([original, finding(2 * ring(5), 3.0, episode=4)]).findings) == 2


def test_two_robots():
    catalogue = Catalogue.from_findings(
        [finding(ring(2), 1.0), finding(3 * ring(2), 2.0), finding(np.ones((2, 2)), 0.0)]
    )
    assert [pattern.count for pattern in catalogue.classes] == [2, 1]
    best = catalogue.classes[0]
    assert (best.symmetry.name, best.layers, best.margin) == ("D_2", (2,), math.inf)


def test_sizes_and_mirror_images_matter_if_one_says_so():
    scalene = np.array([[0.0, 0.0], [4.0, 0.0], [3.0, 2.0]])
    findings = [finding(scalene, episode=0), finding(scalene * [1, -1], episode=1), finding(2 * scalene, episode=2)]
    assert len(Catalogue.from_findings(findings).classes) == 1
    assert len(Catalogue.from_findings(findings, reflection=False).classes) == 2
    assert len(Catalogue.from_findings(findings, tolerance=0.5, scaling=False).classes) == 2
    with pytest.raises(InputError, match=r"^tolerance = None: must be given, in world units"):
        Catalogue.from_findings(findings, scaling=False)


def test_objectives_do_not_compare():
    findings = [finding(ring(5), 3.0, 0), finding(around(5), 4.0, 1, objective="C2")]
    assert [pattern.representative.objective for pattern in Catalogue.from_findings(findings).classes] == ["C1", "C2"]


def test_the_tolerance_of_symmetry():
    findings = noisy(ring(8), 1, 0.02)
    assert Catalogue.from_findings(findings).classes[0].symmetry.name == "D_8"
    assert Catalogue.from_findings(findings, symmetry_tolerance=1e-4).classes[0].symmetry.name == "none"


def test_rows_are_a_csv_file():
    catalogue = Catalogue.from_findings([*noisy(around(10, 9.0), 3, 0.05, gap=0.25), finding(ring(10), 5.0, 9, seed=2)])
    text = io.StringIO()
    csv.writer(text).writerows(catalogue.rows())
    first, second = csv.DictReader(io.StringIO(text.getvalue()))
    assert (first["name"], first["layers"], first["gap"], first["seeds"]) == ("P1", "10", "", "C equivariant 2: 1")
    assert (second["count"], second["symmetry"], second["layers"], second["gap"]) == ("3", "D_9", "9+1", "0.25")
    assert second["starts"] == "scattered: 3"
    assert float(second["nearest_min"]) <= float(second["nearest_mean"]) <= float(second["nearest_max"])
    pattern = catalogue.classes[1]
    assert (float(second["value"]), float(second["margin"])) == (pattern.value, pattern.margin)


# Refused


def test_the_map_has_every_class_in_one_cell():
    aside = around(8, 2.0)
    aside[-1] = 1.2
    patterns = (around(8, 8.0), ring(8, 8.0), ring(8, 8.0) * [2.5, 1.0], aside)
    catalogue = Catalogue.from_findings([finding(p, 3.2 - 0.1 * i, i) for i, p in enumerate(patterns)])
    cells = catalogue.cells()
    assert sorted(p.name for patterns in cells.values() for p in patterns) == ["P1", "P2", "P3", "P4"]
    assert all(pattern.cell == cell for cell, patterns in cells.items() for pattern in patterns)
    around_one, even, oval, _ = (pattern.cell for pattern in catalogue.classes)
    assert (around_one.hull, around_one.symmetry, around_one.elongation) == (7, 14, 0)
    assert (even.hull, even.symmetry, even.elongation) == (8, 16, 0)
    assert (oval.hull, oval.symmetry, oval.elongation) == (8, 4, 0.5)  # it has 0.6
    assert all(p.cell.margin == max(m for m in (0, *MARGINS) if m <= max(p.margin, 0)) for p in catalogue.classes)
    assert len({pattern.cell.margin for pattern in catalogue.classes}) > 1
    header, *rows = catalogue.map_rows()
    assert len(rows) == len(cells)
    assert {len(row) for row in rows} == {len(header)}
    assert {"P1", "P2"} <= {row[header.index("best")] for row in rows}


def test_what_does_not_compare():
    with pytest.raises(InputError, match=r"^robots = \[5, 6\]: must be the same number in all findings"):
        Catalogue.from_findings([finding(ring(5)), finding(ring(6))])
    sizes = [finding(ring(5), radius=0.4), finding(ring(5), radius=1.0, safe_distance=7.0, episode=1)]
    with pytest.raises(InputError, match=r"^radius = \[0.4, 1.0\]: must be the same in all findings"):
        Catalogue.from_findings(sizes, tolerance=1.0, scaling=False)
    assert len(Catalogue.from_findings(sizes).classes) == 1
    with pytest.raises(InputError, match=r"^findings = 0: must be one or more"):
        Catalogue.from_findings([])


@pytest.mark.parametrize("name", ["tolerance", "symmetry_tolerance"])
@pytest.mark.parametrize("bad", [0, -0.1, math.nan, math.inf, "near", True])
def test_no_such_tolerance(name, bad: Any):
    with pytest.raises(InputError, match=rf"^{name} = "):
        Catalogue.from_findings([finding(ring(5))], **{name: bad})


BAD_VALUES = {
    "positions": [[], [[0.0, 0.0]], [[0.0], [1.0, 2.0]], [["a", "b"]] * 3, [[1e300, 0.0]] * 2, None, {}, [[[0, 0]]]],
    "radius": [0, -1, "1", None, True, math.nan, 1e-300],
    "safe_distance": [0.0, []],
    "scan_radius": [math.inf, {}],
    "objective": ["C3", None, ["C1"]],
    "value": [math.nan, "3", None, 10**400],
    "gap": [math.nan, "0"],
    "experiment": ["", 3, None, "two\nlines", "\ud800"],
    "policy": [[]],
    "start": [{}],
    "seed": [-1, 0.5, 2**32, None, True],
    "run": [""],
    "episode": [-1, 1.0, "0"],
}


@pytest.mark.unchecked
@pytest.mark.parametrize(("name", "bad"), [(name, bad) for name, values in BAD_VALUES.items() for bad in values])
def test_a_strangers_finding_is_refused_in_one_line(name, bad):
    data = Catalogue.from_findings([finding(ring(4)), finding(around(4), episode=1)]).to_dict()
    data["findings"][1][name] = bad
    with pytest.raises(InputError) as refusal:
        Catalogue.from_dict(data)
    assert refusal.value.field == f"findings[1].{name}"
    assert "\n" not in str(refusal.value)


BAD_FILES = [
    ("catalogue", lambda data: []),
    ("catalogue", lambda data: None),
    (
        "catalogue.findings",
        lambda data: {"format": 1, "tolerance": 1, "symmetry_tolerance": 1, "scaling": True} | {"reflection": True},
    ),
    ("catalogue.colour", lambda data: data | {"colour": "red"}),
    ("format", lambda data: data | {"format": 2}),
    ("format", lambda data: data | {"format": []}),
    ("scaling", lambda data: data | {"scaling": 1}),
    ("reflection", lambda data: data | {"reflection": None}),
    ("tolerance", lambda data: data | {"tolerance": "0.1"}),
    ("symmetry_tolerance", lambda data: data | {"symmetry_tolerance": None}),
    ("findings", lambda data: data | {"findings": {}}),
    ("findings", lambda data: data | {"findings": []}),
    ("findings[0]", lambda data: data | {"findings": [7]}),
    ("findings[0].colour", lambda data: data | {"findings": [data["findings"][0] | {"colour": "red"}]}),
    ("findings[0].episode", lambda data: data | {"findings": [{"run": "a"}]}),
    ("robots", lambda data: data | {"findings": [*data["findings"], finding(ring(5)).to_dict()]}),
]


@pytest.mark.unchecked
@pytest.mark.parametrize(("field", "broken"), BAD_FILES, ids=[field for field, _ in BAD_FILES])
def test_a_strangers_file_is_refused_in_one_line(field, broken):
    with pytest.raises(InputError) as refusal:
        Catalogue.from_dict(broken(Catalogue.from_findings([finding(ring(4))]).to_dict()))
    assert refusal.value.field == field
    assert "\n" not in str(refusal.value)


def test_a_finding_cannot_be_changed():
    points = ring(4)
    result = finding(points)
    points[0] = 7
    assert result.positions[0] == pytest.approx([1.0, 0.0])
    with pytest.raises(ValueError, match="read-only"):
        result.positions[0] = 7


def test_many_different_patterns_are_told_apart_fast(monkeypatch):
    """Nearly all pairs of different patterns are told apart without superposing them, which takes long."""
    counted = []

    def count(*args: Any, **options: Any):
        counted.append(1)
        return distance(*args, **options)

    monkeypatch.setattr("murmurate.analysis.catalogue.distance", count)
    rng = np.random.default_rng(0)
    result = [finding(rng.normal(scale=10, size=(10, 2)), 4 - i / 1000, i) for i in range(200)]
    assert len(Catalogue.from_findings(result).classes) == 200
    assert len(counted) < 1000  # of 19,900 pairs
