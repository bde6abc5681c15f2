"""The problems that come with the package: every file says what is asked for, and formations by hand are judged."""

from __future__ import annotations

import numpy as np
import pytest

import murmurate
from murmurate.cli.main import main
from murmurate.discovery.validity import check_pattern
from murmurate.geometry import smallest_ring
from murmurate.runs import presets
from murmurate.runs.folder import RunFolder
from murmurate.runs.problems import FOLDER, PROBLEMS
from tiny import tiny


def polygon(robots, radius):
    angles = 2 * np.pi * np.arange(robots) / robots + 0.2
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def judged(name, positions):
    experiment = presets.resolve(name)
    world = experiment.of_size(len(positions)).world
    thresholds = experiment.thresholds
    flags = check_pattern(np.asarray(positions, float)[None], world, thresholds)
    replaced = {"visible": "mutually_visible", "neighbors": "gathered"}
    required = [flag for key, flag in flags.items() if key not in [replaced[n] for n in replaced if n in thresholds]]
    return bool(np.all(required))


def test_every_file_is_a_problem():
    assert sorted(path.stem for path in FOLDER.glob("*.toml")) == sorted(PROBLEMS)


@pytest.mark.parametrize("name", PROBLEMS)
def test_a_problem_is_an_experiment(name, capsys):
    experiment = presets.resolve(name)
    assert experiment.name == name
    assert experiment.sizes == (() if name == "arrow" else tuple(range(4, 11)))
    assert presets.command(experiment) == f"murmurate discover {name} --seed 0"
    assert main(["experiments", name]) == 0
    assert f'name = "{name}"' in capsys.readouterr().out


def test_problems_are_listed(capsys):
    assert main(["experiments"]) == 0
    text = capsys.readouterr().out
    for name, formed in PROBLEMS.items():
        assert f"{name} " in text
        assert formed in text


@pytest.mark.parametrize(
    ("word", "hint"), [("circel", "did you mean circle?"), ("Convex", "did you mean convex?"), ("c", "did you mean C?")]
)
def test_a_problem_that_there_is_not(word, hint, capsys):
    assert main(["discover", word]) == 2
    line = capsys.readouterr().err
    assert line.startswith(f"murmurate: experiment = '{word}': must be one of A, B, C, D, E, F, arrow, chain,")
    assert line.rstrip().endswith(hint)


def zigzag(robots, length, aside):
    """Robots from left to right, every other one aside."""
    return np.stack([np.linspace(-length / 2, length / 2, robots), aside * (np.arange(robots) % 2)], axis=1)


def groups(sizes, apart):
    """Rings of robots, one beside the other, as narrow as can be."""
    rings = [smallest_ring(size, 1.0, 5.0) for size in sizes]
    beside = rings[0].radius + apart + rings[1].radius
    return np.concatenate([rings[0].positions, rings[1].positions + np.array([beside, 0.0])])


def packed(robots):
    """Robots in the square from -1 to 1, the nearest of them as far apart as in the best known packing."""
    return {
        4: np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]),
        5: np.array([[-1, -1], [-1, 1], [0, 0], [1, -1], [1, 1]]),
        9: np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(9, 2),
    }[robots]


@pytest.mark.parametrize("robots", [4, 7, 10])
def test_what_solves_each_problem(robots):
    """Each formation solves the problems that are named with it, and no other one."""
    formations = {
        "circle convex surround visibility": polygon(robots, 20.0),
        "convex visibility": polygon(robots, 20.0) * [1.0, 0.6],
        "line": zigzag(robots, 6.0 * (robots - 1), 0.0) + np.array([0.0, 20.0]),
        "line chain": zigzag(robots, 24.0, 0.0),
        "chain": zigzag(robots, 24.0 if robots == 4 else 32.0, 4.0),
        "groups": groups((robots // 2, (robots + 1) // 2), 21.0),
    }
    if robots > 6:
        del formations["line chain"]  # they would be nearer than the safe distance
    # Robots that make a chain may see each other as well, and four of them may be a convex polygon.
    also = {"visibility", "convex"} if robots == 4 else {"visibility"}
    for names, formation in formations.items():
        solved = {name for name in PROBLEMS if name != "arrow" and judged(name, formation)}
        assert set(names.split()) <= solved <= set(names.split()) | also, names


@pytest.mark.parametrize("robots", [4, 5, 9])
def test_a_packing_is_spread_and_a_narrower_one_is_not(robots):
    world = presets.resolve("spread").of_size(robots).world
    places = packed(robots) * world.half_width
    assert judged("spread", 0.91 * places)
    assert not judged("spread", 0.89 * places)


def test_the_arrow_is_one_wherever_it_lies_and_however_it_points():
    arrow = np.array(presets.resolve("arrow").signals["match"].places)
    angle = 2.0
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    laid = (arrow @ turn)[::-1] + np.array([5.0, -9.0])
    assert judged("arrow", laid)
    laid[3] += [0.0, 0.3]
    assert not judged("arrow", laid)


def test_what_is_just_beyond():
    """Each is off by more than its problem allows, and by less than as much again."""
    ring = polygon(8, 20.0)
    wide = ring.copy()
    wide[0] *= 1.07
    assert not judged("circle", wide)
    assert judged("convex", wide)
    assert judged("surround", 1.04 * ring)
    assert not judged("surround", 1.06 * ring)
    gap = polygon(10, 20.0)[:8]  # a gap of three tenths of a turn, 2.4 even ones of eight robots
    assert not judged("surround", gap)
    dent = ring.copy()
    dent[0] *= 0.6
    assert not judged("convex", dent)


def test_what_a_problem_does_not_ask_for_may_be_missing(tmp_path, capsys):
    """Robots that hardly learned stand still where they began: valid where nobody must be near or see anybody."""
    folder = tmp_path / "run"
    loosened = {"visible": 0.0, "neighbors": 0.0, "safety": 0.0}
    world = {"robots": 4, "scan_radius": 6.0}
    murmurate.discover(tiny(valid=loosened, world=world, rest={"dead_zone": 0.6}), out=folder)
    summary = RunFolder(folder).evaluation()
    assert summary["valid"] == summary["stationary"] == summary["at_rest"] == 1.0
    assert summary["gathered"] < 0.5 > summary["mutually_visible"]
    assert summary["thresholds"] == dict.fromkeys(loosened, 1.0)
    assert main(["evaluate", str(folder), "--episodes", "20", "--out", str(tmp_path / "again")]) == 0
    assert "starts failed" not in capsys.readouterr().out
