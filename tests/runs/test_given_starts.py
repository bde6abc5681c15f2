"""Evaluations that begin elsewhere than at fresh starts: at sets, starts, files and arrays."""

from __future__ import annotations

from pathlib import Path

import jax
import numpy as np
import pytest

import murmurate
from murmurate.cli.arguments import START_NAMES
from murmurate.cli.main import main
from murmurate.errors import InputError, RunError
from murmurate.runs import files
from murmurate.runs.evaluate import evaluate
from murmurate.runs.folder import RunFolder, describe_starts
from murmurate.runs.given_starts import find_start, given_starts, start_names
from murmurate.world import ClusterStart, Start, SymmetricStart, WorldConfig, read_starts, start_set
from murmurate.world.start_sets import draw_set, set_world

WORLD = set_world(3)
KEY = jax.random.key(0)


def given(starts, world=WORLD, episodes=None, key=KEY):
    return given_starts(starts, world, key, 5, episodes)


def test_a_family_is_its_set_whatever_the_key():
    for key in (KEY, jax.random.key(1)):
        chosen = given("cluster", key=key)
        np.testing.assert_array_equal(chosen.points, start_set("cluster", robots=3, count=5))
        assert chosen.source == {"kind": "set", "name": "murmurate-1/cluster/N3"}
    assert len(given("cluster", episodes=7).points) == 7


def test_in_another_world_a_family_is_drawn_there():
    world = WorldConfig(robots=3, half_width=12.0, half_height=12.0)
    chosen = given("corner", world)
    np.testing.assert_array_equal(chosen.points, draw_set("corner", world, 5))
    assert (np.abs(chosen.points) <= 12).all()
    assert chosen.source == {"kind": "drawn", "name": "corner"}


def test_another_registered_start_is_drawn_with_the_key():
    first, again, other = (given("scattered", key=jax.random.key(seed)) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.points, again.points)
    assert (first.points != other.points).any()
    assert first.source == {"kind": "drawn", "name": "scattered"}
    assert {"hard", "symmetric", "packed", "rings", "tight-grid"} <= set(start_names())
    assert not {"file", "mixture"} & set(start_names())


def test_a_start_is_drawn():
    start = ClusterStart(max_spacing=1.1)
    chosen = given(start)
    assert chosen.source == {"kind": "drawn", "name": "cluster"}
    apart = np.linalg.norm(chosen.points[:, :1] - chosen.points[:, 1:], axis=2).min(axis=1)
    assert (apart < 2 * 1.1 * 1.8).all()


def test_a_file_or_an_array_is_taken_whole_or_in_part(tmp_path):
    points = start_set("walls", robots=3, count=4)
    rows = [f"{number},{x},{y}" for number, start in enumerate(points) for x, y in start]
    path = tmp_path / "mine.csv"
    path.write_text("\n".join(["start,x,y", *rows]))
    for starts in (str(path), path, points):
        kind = {"kind": "given"} if starts is points else {"kind": "file", "name": "mine.csv"}
        assert given(starts).source == kind
        np.testing.assert_array_equal(given(starts).points.astype(np.float32), points)
        assert len(given(starts, episodes=2).points) == 2
        with pytest.raises(InputError, match=r"^episodes = 5: must be at most the 4 starts of "):
            given(starts, episodes=5)


def test_a_registered_name_wins_over_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("cluster").write_text("nonsense", encoding="utf-8")
    assert given("cluster").source["kind"] == "set"
    with pytest.raises(InputError, match="must be a table with the header start,x,y"):
        given("./cluster")


@pytest.mark.parametrize(
    ("starts", "message"),
    [
        ("clustre", r"^starts = 'clustre': must be one of random, .*, or a CSV file; did you mean cluster\?"),
        ("no.csv", "no.csv': must be a readable CSV file"),
        ("rings", "robots = 3: must be at least 4 for the start rings"),
        (3.0, "starts = .*: must be finite numbers of shape"),
        (np.zeros((1, 3, 2)), "overlapping robots"),
    ],
)
def test_no_such_starts(starts, message):
    with pytest.raises(InputError, match=message) as error:
        given(starts)
    assert "\n" not in str(error.value)


def test_an_evaluation_says_where_it_began(tiny_run, tmp_path):
    run = murmurate.load(tiny_run())
    for starts, description in [("cluster", "cluster starts"), ("scattered", "scattered starts")]:
        evaluation = evaluate(run, 4, starts=starts)
        assert describe_starts({"starts": evaluation.starts}) == description
        assert len(evaluation.trajectories.lengths) == 4
    first = run.rollout(starts="cluster").positions[:, 0]
    np.testing.assert_array_equal(first, draw_set("cluster", run.experiment.world, 100))
    assert not (run.rollout(Start.registered()["scattered"]()).positions[:4, 0] == first[:4]).all()
    assert (
        describe_starts({"starts": {"kind": "set", "name": "murmurate-1/wall/N8"}}) == "starts of murmurate-1/wall/N8"
    )


def test_a_folder_says_so_too_and_nothing_else(tiny_run, tmp_path):
    out = tmp_path / "out"
    assert main(["evaluate", str(tiny_run()), "--starts", "wall", "--episodes", "4", "--out", str(out)]) == 0
    folder = RunFolder(out)
    assert folder.evaluation()["starts"] == {"kind": "drawn", "name": "wall"}
    recorded = files.read_npz(out / "trajectories.npz")["positions"][:, 0]
    np.testing.assert_array_equal(recorded, draw_set("wall", folder.experiment().world, 4))
    summary = files.read_json(out / "evaluation.json")
    for wrong in ({"kind": "set"}, {"kind": "drawn", "name": 3}, {"kind": "given", "name": "wall"}, {"kind": "walls"}):
        files.write_json(out / "evaluation.json", {**summary, "starts": wrong})
        with pytest.raises(RunError, match="has starts = "):
            folder.evaluation()


def test_the_verb_writes_a_set_that_reads_back_alike(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["starts", "corner", "--robots", "5", "--count", "70"]) == 0
    np.testing.assert_array_equal(
        read_starts("corner-5.csv", 5).astype(np.float32), start_set("corner", robots=5, count=70)
    )
    output = capsys.readouterr().out
    assert "murmurate-1/corner/N5: 70 starts in |x|, |y| <= 32.5, robots of radius 1\n" in output
    assert "starts: corner-5.csv\n" in output


def test_the_verb_lists_the_sets(capsys):
    assert main(["starts"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 10
    assert "murmurate-1/cluster: N = 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 24, 32, 64, 128" in lines
    assert lines[-1].startswith("murmurate-1/rings: N = 4, 5")


def test_a_class_of_ones_own_is_drawn_with_its_defaults():
    chosen = given("own.mine:Rings", episodes=3)
    assert chosen.source == {"kind": "drawn", "name": "own.mine:Rings"}
    assert chosen.points.shape == (3, 3, 2)
    # On two rings of 8 and 4, up to 1 away in each coordinate.
    radii = np.linalg.norm(chosen.points, axis=2)
    assert (np.abs(radii - np.array([8.0, 4.0, 8.0])) <= 2**0.5).all()


def test_every_verb_takes_the_same_names():
    names = start_names()
    assert f"{', '.join(names)}, or module:Class" == START_NAMES
    assert {find_start(name).name for name in names} == set(Start.registered()) - {"file", "mixture"}
    assert find_start("line") == SymmetricStart("line")


@pytest.mark.parametrize(
    ("words", "field", "also"),
    [
        (["evaluate", "RUN", "--starts"], "starts", '"module:Class", or a CSV file'),
        (["show", "--robots", "3", "--start"], "start", 'or "module:Class"'),
        (["compare", "--robots", "3", "--out", "OUT", "--starts"], "start", 'or "module:Class"'),
    ],
)
def test_every_verb_refuses_starts_in_the_same_words(words, field, also, tiny_run, tmp_path, capsys):
    places = {"RUN": str(tiny_run()), "OUT": str(tmp_path / "out")}
    arguments = [places.get(word, word) for word in words]
    for start, message in (
        ("clustre", f"must be one of {', '.join(start_names())}, {also}; did you mean cluster?"),
        ("nowhere:Start", "must be a class murmurate.Start as module:Class that can be imported (ModuleNotFoundError"),
        ("own.mine:Calm", "must be a class murmurate.Start as module:Class; this is no subclass of it"),
    ):
        assert main([*arguments, start]) == 2
        error = capsys.readouterr().err
        assert error.startswith(f"murmurate: {field} = {start!r}: {message}")
        assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_the_weights_are_shown_from_a_start_of_ones_own(monkeypatch, tmp_path):
    shown = []

    def stop(run, *_, **__):
        shown.append(run.experiment.start)
        raise InputError("episodes", 0, "enough for this test")

    monkeypatch.setattr("murmurate.runs.evaluate.evaluate", stop)
    monkeypatch.chdir(tmp_path)
    for start in ("own.mine:Rings", "polygon"):
        assert main(["show", "--robots", "4", "--start", start, "--quiet"]) == 2
    assert [start.name for start in shown] == ["own.mine:Rings", "symmetric"]
