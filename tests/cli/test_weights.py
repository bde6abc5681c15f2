"""What works at once, without training: the package's weights, shown and compared."""

from __future__ import annotations

import json
import shutil
import warnings
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.pretrained import pack

import murmurate
from murmurate.cli import show
from murmurate.cli.main import main
from murmurate.errors import BeyondTrainingWarning, InputError, RunError
from murmurate.geometry.similarity import distance
from murmurate.runs import files, pretrained
from murmurate.runs.folder import RunFolder
from murmurate.runs.formations import reached


def refused(capsys, arguments, *parts):
    assert main([*map(str, arguments)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    for part in parts:
        assert part in err


def test_the_weights_are_small_and_whole():
    files = [path for path in pretrained.FOLDER.rglob("*") if path.is_file()]
    assert 0 < sum(path.stat().st_size for path in files) <= 1_000_000
    assert pretrained.available() == {"C1": ("global", "visible"), "C2": ("global", "shared", "visible")}
    for objective, sensings in pretrained.available().items():
        for sensing in sensings:
            run = murmurate.pretrained(objective, sensing)
            shared = sensing == "shared"
            perceived = "global" if shared else sensing
            assert (run.experiment.objective, run.experiment.sensing.name) == (objective, perceived)
            assert RunFolder(run.folder).metrics()
            assert run.experiment.sensing.rotation == run.experiment.sensing.reflection == (not shared)
            assert set(run.experiment.sizes) <= set(range(3, 33))


def test_weights_that_are_packed_anew_keep_their_card(tmp_path):
    shutil.copytree(pretrained.FOLDER / "C2", tmp_path / "C2")
    target = tmp_path / "C2" / "visible"
    (target / "left-over").write_text("")
    pack(RunFolder(pretrained.FOLDER / "C1" / "global"), target)
    card = pretrained.FOLDER / "C2" / "visible" / "README.md"
    assert (target / "README.md").read_bytes() == card.read_bytes()
    assert not (target / "left-over").exists()
    packed = RunFolder(target)
    assert packed.experiment().objective == "C1"
    assert packed.inspect(resume=True) == "finished"
    assert packed.verify()


def test_damaged_weights_are_refused(tmp_path, monkeypatch):
    run = murmurate.pretrained()
    run.save(tmp_path / "C2" / "visible")
    monkeypatch.setattr(pretrained, "FOLDER", tmp_path)
    assert pretrained.available() == {"C2": ("visible",)}
    file = tmp_path / "C2" / "visible" / "policies" / "0-base.safetensors"
    file.write_bytes(file.read_bytes()[:-1] + b"\0")
    with pytest.raises(RunError, match=r"0-base\.safetensors"):
        murmurate.pretrained()


@pytest.mark.parametrize("objective", ["C1", "C2"])
@pytest.mark.parametrize("sensing", ["global", "visible"])
def test_they_form_patterns_at_once(objective, sensing):
    run = murmurate.pretrained(objective, sensing).of_size(6)
    trajectories = run.rollout(20, key=3)
    seen = murmurate.geometry.visible(trajectories.final, 1.0, run.experiment.world.scan_radius)
    assert seen.sum() / (20 * 6 * 5) > 0.95
    assert trajectories.at_rest.sum() >= 18
    if objective == "C1":
        assert np.linalg.norm(trajectories.final.mean(axis=1), axis=1).max() < run.experiment.world.safe_distance


def test_those_of_one_shared_frame_form_what_they_are_told(tmp_path, monkeypatch, capsys):
    weights = murmurate.pretrained("C2", "shared")
    assert sorted(weights.cascade.policies[0].sizes) == sorted(weights.experiment.sizes)
    run = weights.of_size(6)
    trajectories = run.rollout(20, key=3)
    assert murmurate.check_validity(trajectories, run.experiment.world).valid.all()
    places = 9.0 * np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 1.0], [2.0, 2.0]])
    told = weights.forming(places)
    assert reached(told, told.rollout(20, key=3)).all()
    with pytest.raises(InputError, match=r"robots = 5: must be 4, 6, 8, 10, 12, 16: .* remembers formations of"):
        weights.of_size(5)
    monkeypatch.setattr(show, "_draw", lambda *_: 0)
    out = tmp_path / "second"
    assert main(["show", "--pattern", "2", "--robots", "6", "--out", str(out), "--quiet"]) == 0
    assert "formed within 0.1 R in 32 of 32 episodes" in capsys.readouterr().out
    second = murmurate.load(out)
    assert second.experiment.world.robots == 6
    best = run.remembered().classes[1].representative.positions
    assert distance(second.rollout(1).final[0], best, scaling=False, reflection=False) < 0.1


def test_training_may_begin_with_them():
    assert pretrained.run_folder("C2-visible") == pretrained.FOLDER / "C2" / "visible"
    for word in ("C2-radar", "C3-visible", "runs/C2-visible", "C2"):
        assert str(pretrained.run_folder(word)) == word


def test_a_scheduler_may_be_chosen():
    run = murmurate.pretrained(scheduler="async").of_size(3)
    assert run.experiment.scheduler.name == "async"
    trajectories = run.under(replace(run.experiment, rest=replace(run.experiment.rest, max_steps=10))).rollout(4)
    assert (trajectories.epochs < trajectories.lengths).all()


@pytest.mark.parametrize(
    ("choice", "line"),
    [
        ({"objective": "C3"}, "objective = 'C3': must be one of"),
        ({"sensing": "radar"}, "sensing = 'radar': must be one of global, visible, chiral, noisy, shared"),
        (
            {"scheduler": "psync"},
            "scheduler = 'psync': must be one of fsync, ssync, adversarial, async, async-nonrigid",
        ),
    ],
)
def test_unknown_weights_list_the_known_ones(choice, line):
    with pytest.raises(InputError) as caught:
        murmurate.pretrained(**choice)
    assert str(caught.value).startswith(line)


def test_a_size_beyond_training_warns_once_and_goes_on():
    run = murmurate.pretrained()
    with pytest.warns(BeyondTrainingWarning, match="robots = 2: trained were swarms of 3 to 24"):
        other = run.of_size(2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert other.rollout(1).positions.shape[2] == 2
        run.of_size(9)


def test_the_command_line_warns_in_one_line(tmp_path, capsys):
    arguments = ["compare", "--methods", "learned", "--robots", "2", "--episodes", "1", "--out", str(tmp_path / "out")]
    assert main([*arguments, "--quiet"]) == 0
    assert (
        capsys.readouterr().err
        == "murmurate: warning: robots = 2: trained were swarms of 3 to 24; others may do worse\n"
    )


def test_show_needs_no_run(tmp_path, capsys):
    out = tmp_path / "shown"
    assert main(["show", "--robots", "3", "--start", "scattered", "--scheduler", "ssync", "--out", str(out)]) == 0
    assert "3 robots, 32 starts: " in capsys.readouterr().out
    assert {"experiment.toml", "manifest.json", "evaluation.json", "figures"} <= {path.name for path in out.iterdir()}
    assert {path.name for path in (out / "figures").iterdir()} == {"discovery.png", "discovery.gif"}
    again = murmurate.load(out)
    assert (again.experiment.world.robots, again.experiment.start.name) == (3, "scattered")
    refused(capsys, ["show", "--robots", "3", "--out", out], "holds another run")


def test_show_writes_the_animation_alone(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for _ in range(2):  # nothing stands in the way of doing it again
        assert main(["show", "--robots", "3", "--start", "packed", "--animation", "new/swarm.webp"]) == 0
    assert "animation: new/swarm.webp\n" in capsys.readouterr().out
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")) == ["new", "new/swarm.webp"]
    assert (tmp_path / "new" / "swarm.webp").read_bytes()[8:12] == b"WEBP"


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["--animation", "a.avi"], "--animation = 'a.avi': must be a name that ends in .gif, .webp, .mp4"),
        (["--animation", "a.gif", "--mp4"], "--animation names the only file to write"),
        (["--animation", "a.gif", "--out", "b"], "--animation names the only file to write"),
        (["run", "other", "--out", "b", "--episode", "1"], "of several runs, only the patterns are drawn"),
    ],
)
def test_flags_of_show_that_do_not_go_together(arguments, part, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    refused(capsys, ["show", *arguments], part)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["--robots", "1"], ["robots = 1: must be an integer >= 2"]),
        (["--start", "file"], ["start = 'file': must be one of random, polygon, line, grid"]),
        (["--objective", "C3"], ["objective = 'C3': must be one of C1, C2"]),
        (["--robots", "many"], ["--robots"]),
    ],
)
def test_show_refuses_what_it_cannot_show(arguments, parts, tmp_path, capsys):
    refused(capsys, ["show", *arguments, "--out", tmp_path / "shown"], *parts)
    assert not (tmp_path / "shown").exists()


def test_the_weights_flags_do_not_go_with_a_run(discovered, capsys):
    refused(capsys, ["show", discovered, "--robots", "5"], "--robots is for the package's weights: give it without RUN")


def compared(out, *arguments):
    return main(
        ["compare", "--methods", "learned,random", "--robots", "3", "--episodes", "6", "--out", str(out), *arguments]
    )


def test_compare_writes_a_table_and_figures_and_goes_on(tmp_path, capsys):
    out, page = tmp_path / "comparison", tmp_path / "results.md"
    page.write_text("# Results\n")
    assert compared(out, "--into", str(page)) == 0
    first = capsys.readouterr().out
    assert first.count(" of 6 valid (") == 2
    names = {path.name for path in out.iterdir()}
    assert names == {"comparison.json", "comparison.md", "comparison.png", "failures.png"}
    assert f"pictures: {out / 'comparison.png'}, {out / 'failures.png'}" in first
    assert "![Valid patterns by method](comparison/comparison.png)" in page.read_text()
    rows = files.read_json(out / "comparison.json")["rows"]
    assert compared(out, "--starts", "random,line", "--into", str(page)) == 0
    assert capsys.readouterr().out.count(" of 6 valid (") == 4
    after = files.read_json(out / "comparison.json")["rows"]
    assert after[:2] == json.loads(json.dumps(rows))
    assert page.read_text().count("## Any swarm") == 1


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["--methods", "orca"], ["method = 'orca': must be one of learned, random, centroid"]),
        (["--sensing", "radar"], ["sensing = 'radar': must be one of global, visible, chiral, noisy"]),
        (["--schedulers", "psync"], ["scheduler = 'psync': must be one of fsync"]),
        (["--starts", "star"], ["start = 'star': must be one of random, polygon, line, grid, rings, cluster, corner"]),
        (["--robots", "3,,4"], ["--robots = '3,,4': must be names or numbers, separated by commas"]),
        (["--robots", "1"], ["robots = 1: must be an integer >= 2"]),
        (["--robots", "-3"], ["--robots = '-3': must be whole numbers"]),
        (["--episodes", "0"], ["episodes = 0: must be an integer >= 1"]),
        (["--into", "nowhere.md"], ["--into nowhere.md: there is no such file"]),
        (["nowhere"], ["nowhere"]),
    ],
)
def test_compare_refuses_what_it_cannot_compare(arguments, parts, tmp_path, capsys):
    refused(capsys, ["compare", *arguments, "--out", tmp_path / "comparison"], *parts)
    assert not (tmp_path / "comparison").exists()


def test_a_policy_without_eyes_is_not_compared(discovered, tmp_path, capsys):
    refused(
        capsys,
        ["compare", discovered, "--out", tmp_path / "c"],
        "policy.use = 'central': must be local",
    )
