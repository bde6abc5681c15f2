"""What a run's policy remembers, and the same run with another formation to form; from Python and the command line."""

from __future__ import annotations

import csv
import re
import shlex
import shutil
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import murmurate
from murmurate import plots
from murmurate.cli.main import main
from murmurate.discovery import build_cascade
from murmurate.errors import InputError, RunError
from murmurate.geometry import smallest_ring
from murmurate.geometry.similarity import distance
from murmurate.runs import formations, presets
from murmurate.world import FileStart


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Experiment D with formations that were searched for a few hundred updates, and no way that was learned."""
    fields = {
        "policy": {"use": "formation", "formations": 12, "hidden": [8, 4]},
        "base": {"refine": False, "goals": {"updates": 1200}},
        "discovery": {"chunk": 400, "episodes": 16, "sigma": 16},
    }
    return murmurate.discover("D", out=tmp_path_factory.mktemp("formations") / "run", **fields)


def test_its_training_is_drawn_as_the_search_that_it_was(run):
    recording = plots.Recording.open(run.folder)
    assert (recording.training, len(recording.search.environment_steps)) == ([], 1200)
    assert recording.policies == ["base"]


def test_what_is_remembered_are_valid_patterns_best_first_each_once(run):
    classes = run.remembered().classes
    assert len(classes) > 1
    values = [pattern.value for pattern in classes]
    assert values == sorted(values, reverse=True)
    for pattern in classes:
        assert pattern.representative.gap >= -1e-9
        for other in classes:
            if other is not pattern:
                assert distance(pattern.representative.positions, other.representative.positions) > 0.125


def test_the_best_is_what_the_run_forms(run):
    trajectories = run.rollout(8, key=3)
    assert formations.reached(run, trajectories).all()
    assert formations.reached(run.forming(1), trajectories).all()
    assert not formations.reached(run.forming(2), trajectories).any()
    trembling = replace(trajectories, at_rest=np.arange(8) < 3)
    assert formations.reached(run, trembling).tolist() == [True] * 3 + [False] * 5


def test_a_swarm_forms_what_it_is_told(run):
    ring = smallest_ring(6, 0.4, 2.8).positions * 1.3
    for formation in (2, len(run.remembered().classes), ring, ring + 7.0):
        other = run.forming(formation)
        trajectories = other.rollout(8, key=3)
        assert formations.reached(other, trajectories).all()
    assert run.forming(ring).experiment == run.experiment


def test_patterns_keep_their_numbers_whatever_is_formed(run):
    patterns = [pattern.representative.positions for pattern in run.remembered().classes]
    other = run.forming(np.int64(2))
    for formed in (other, other.forming(2), other.forming(1).forming(2)):
        for number in (0, 1, 2):
            assert distance(formations.pattern(formed, number + 1), patterns[number]) < 1e-3


def test_a_least_safety_of_ones_own_is_in_place_of_the_safe_distance(run):
    near = 0.9 * smallest_ring(6, 0.4, 2.8).positions
    with pytest.raises(InputError, match=r"two robots 2\.52 apart': must be at least safe_distance = 2\.8"):
        run.forming(near)
    own = run.under(replace(run.experiment, valid={"safety": 0.5}))
    assert np.asarray(own.forming(near).cascade.policies[-1].goals())[..., 0] == pytest.approx(near, abs=1e-5)
    with pytest.raises(InputError, match=r"at least 2 \* radius = 0\.8"):
        own.forming(0.25 * near)


def test_a_formation_is_inside_the_world_however_it_is_turned(run):
    side = run.experiment.world.half_width
    corners = np.array([[x, y] for x in (-1, 1) for y in (-1, 0, 1)]) * (side - 0.5)
    with pytest.raises(InputError, match="inside the world however it is turned"):
        run.forming(corners)
    assert run.forming(corners / np.sqrt(2)).rollout(2, key=1).at_rest.all()


def test_numbers_and_formations_that_cannot_be_formed_are_refused(run, tmp_path):
    count = len(run.remembered().classes)
    for number in (0, count + 1, True, 1.5, "2"):
        with pytest.raises(InputError, match=rf"pattern = .*a number from 1 to {count}"):
            run.forming(number)
    ring = smallest_ring(6, 0.4, 2.8).positions
    (tmp_path / "starts.csv").write_text("start,x,y\n" + "".join(f"0,{x},{y}\n" for x, y in 1.1 * ring))
    given = run.under(replace(run.experiment, start=FileStart(file=str(tmp_path / "starts.csv"))))
    with pytest.raises(InputError, match="formation = '5 robots': must be of 6, as the start has"):
        given.forming(ring[:5])
    with pytest.raises(InputError, match=r"two robots 2\.52 apart.*safe_distance = 2\.8"):
        run.forming(0.9 * ring)
    with pytest.raises(InputError, match=r"must be at most 35, so that it is inside"):
        run.forming(20 * ring)
    with pytest.raises(InputError, match="finite numbers"):
        run.forming(np.full((6, 2), np.nan))


def test_a_policy_of_another_kind_remembers_nothing(tiny_run):
    other = murmurate.load(tiny_run("central"))
    for ask in (lambda: other.remembered(), lambda: other.forming(1)):
        with pytest.raises(InputError, match="central remembers no formations"):
            ask()


def test_where_no_formation_is_valid_there_are_no_patterns(run):
    network = run.cascade.policies[-1]
    crowd = eqx.tree_at(lambda n: n.places, network, jnp.zeros_like(network.places))
    nothing = replace(run, cascade=build_cascade(run.experiment, [crowd]))
    with pytest.raises(RunError, match="none of the 12 formations"):
        nothing.remembered()


def test_evaluate_writes_a_run_that_forms_what_it_was_told(run, tmp_path, capsys):
    folder = str(run.folder)
    assert main(["evaluate", folder, "--pattern", "2", "--episodes", "8", "--out", str(tmp_path / "second")]) == 0
    assert "formed within 0.1 R in 8 of 8 episodes" in capsys.readouterr().out
    second = murmurate.load(tmp_path / "second")
    best = run.remembered().classes[1].representative.positions
    assert distance(second.rollout(2).final[0], best, scaling=False) < 0.04

    ring = 1.2 * smallest_ring(6, 0.4, 2.8).positions
    table = tmp_path / "ring.csv"
    table.write_text("start,x,y\n" + "".join(f"0,{x},{y}\n" for x, y in ring))
    assert main(["evaluate", folder, "--target", str(table), "--episodes", "8", "--out", str(tmp_path / "ring")]) == 0
    assert "formed within 0.1 R in 8 of 8 episodes" in capsys.readouterr().out

    assert main(["evaluate", folder, "--pattern", "2"]) == 2
    assert "--pattern and --target make a run that forms something else: give --out too" in capsys.readouterr().err
    both = ["--pattern", "2", "--target", str(table), "--out", str(tmp_path / "x")]
    assert main(["evaluate", folder, *both]) == 2
    assert "pattern = 2: must be left out: " in capsys.readouterr().err
    assert main(["evaluate", folder, "--pattern", "99", "--out", str(tmp_path / "x")]) == 2
    assert "pattern = 99: must be a number from 1 to" in capsys.readouterr().err
    table.write_text("start,x,y\n" + "".join(f"{n},{x},{y}\n" for n in (0, 1) for x, y in ring))
    assert main(["evaluate", folder, "--target", str(table), "--out", str(tmp_path / "x")]) == 2
    assert "ring.csv = '2 starts': must be one start, which is the formation" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_a_pattern_of_a_catalogue_is_formed_drawn_and_exported(run, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(plots, "animate", lambda *_: None)  # it takes long, and is tried elsewhere
    patterns, folder = tmp_path / "patterns", str(run.folder)
    assert main(["catalogue", folder, "--remembered", "--out", str(patterns), "--quiet"]) == 0
    third = ["--target", str(patterns), "--pattern", "3"]
    assert main(["show", folder, *third, "--out", str(tmp_path / "third"), "--quiet"]) == 0
    assert "formed within 0.1 R in 32 of 32 episodes" in capsys.readouterr().out
    shown, told = murmurate.load(tmp_path / "third"), run.remembered().classes[2].representative.positions
    assert (shown.folder / "figures" / "discovery.png").is_file()
    assert distance(shown.rollout(2).final[0], told, scaling=False) < 0.04

    table = tmp_path / "third.csv"
    flags = ["--trajectories", "csv", "--episodes", "4", "--out", str(table)]
    assert main(["export", folder, "--pattern", "3", *flags]) == 0
    assert "formed within 0.1 R in 4 of 4 episodes" in capsys.readouterr().out
    assert table.read_text().count("\n") > 4 * 6

    for wrong, line in (
        (["--target", str(patterns), "--pattern", "999"], "pattern = 999: must be a number from 1 to"),
        (["--target", str(tmp_path / "nothing")], "nothing"),
    ):
        assert main(["show", folder, *wrong, "--out", str(tmp_path / "x")]) == 2
        assert line in capsys.readouterr().err
    assert main(["export", folder, "--onnx", "--pattern", "3"]) == 2
    assert "--pattern is for --trajectories" in capsys.readouterr().err


def test_a_table_may_have_another_number_of_robots(run, tmp_path, capsys):
    table, ring = tmp_path / "ring.csv", 1.2 * smallest_ring(7, 0.4, 2.8).positions
    table.write_text("start,x,y\n" + "".join(f"0,{x},{y}\n" for x, y in ring))
    arguments = ["evaluate", str(run.folder), "--target", str(table), "--out", str(tmp_path / "x"), "--episodes", "2"]
    assert main(arguments) == 0
    assert "7 robots: trained were swarms of 6; others" in capsys.readouterr().err
    told = murmurate.load(tmp_path / "x")
    assert told.experiment.world.robots == 7
    assert np.allclose(told.cascade.policies[-1].goals()[..., 0], ring - ring.mean(axis=0), atol=1e-5)


def test_many_patterns_in_one_command(run, tmp_path, capsys):
    shutil.copytree(run.folder, tmp_path / "run")
    _, *flags = shlex.split(presets.command(run.experiment))
    command = [*flags, "--diverse", "40", "--quiet"]
    assert main([*command, "--out", str(tmp_path / "run"), "--resume"]) == 0  # the run is finished: nothing is trained
    output = capsys.readouterr().out
    found = int(
        re.search(r"(\d+) distinct patterns were discovered; swarms were told to form the best \1; 40 were", output)[1]
    )
    with (tmp_path / "run-patterns" / "formed.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["pattern"] for row in rows] == [f"P{number}" for number in range(1, found + 1)]
    assert all(row["formed"] == row["valid"] == row["starts"] == "50" and row["failed"] == "0" for row in rows)
    assert all(float(row["steps"]) >= float(row["bound"]) for row in rows)
    assert (tmp_path / "run-patterns" / "plate.png").exists()

    for flags, words in (
        (["--diverse", "0"], "--diverse = 0: must be an integer >= 1"),
        (["--diverse", "2", "--policy", "central"], "central remembers no formations"),
        (["--diverse", "2", "--seeds", "2"], "without --seeds and --vary"),
        (["--diverse", "2", "--hosts", "2"], "train first, then give --diverse"),
    ):
        assert main(["discover", "D", *flags, "--out", str(tmp_path / "other")]) == 2
        assert words in capsys.readouterr().err
        assert not (tmp_path / "other").exists()
    (tmp_path / "full-patterns").mkdir()
    (tmp_path / "full-patterns" / "mine.txt").write_text("mine")
    assert main([*command, "--out", str(tmp_path / "full")]) == 2
    assert "holds other files" in capsys.readouterr().err
    assert not (tmp_path / "full").exists()


def test_the_catalogue_of_what_is_remembered(run, tmp_path, capsys):
    assert main(["catalogue", str(run.folder), "--remembered", "--out", str(tmp_path / "plate")]) == 0
    output = capsys.readouterr().out
    assert "remembered" in output
    assert (tmp_path / "plate" / "plate.png").exists()
