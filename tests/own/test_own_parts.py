"""Parts of a user's own go through every verb, from TOML and from Python, like those of the package."""

from __future__ import annotations

import itertools
import json
import shutil
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import tomli_w

import murmurate
from murmurate.cli.main import main
from murmurate.errors import InputError, RunError
from murmurate.runs import config_io, presets
from murmurate.runs.folder import RunFolder
from tiny import TINY, tiny

HERE = Path(__file__).parent
POLICIES = ("0-base.safetensors", "1-auxiliary.safetensors")
ONE_POLICY = {"min_policies": 1, "max_policies": 1}
MOVING = {"dead_zone": 0.0, "damping": 0.0, "sidestep": 0.0}


@pytest.fixture(scope="module")
def experiment(tmp_path_factory):
    """A folder with the experiment's TOML file and its module."""
    folder = tmp_path_factory.mktemp("experiment")
    for name in ("mine.py", "experiment.toml"):
        shutil.copy(HERE / name, folder / name)
    return folder / "experiment.toml"


@pytest.fixture(scope="module")
def run(experiment):
    """The folder of the finished run."""
    folder = experiment.parent / "run"
    assert main(["discover", str(experiment), "--out", str(folder), "--quiet"]) in (0, 3)
    return folder


def weights(folder):
    return [(folder / "policies" / name).read_bytes() for name in POLICIES]


def in_another_process(*arguments, **options):
    command = [sys.executable, "-m", "murmurate", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, **options)


def test_what_was_trained_is_of_ones_own(run):
    opened = murmurate.load(run, trust=True)
    names = {"start": "mine:Rings", "policy": "mine:Linear", "scheduler": "mine:RoundRobin"}
    assert {part: getattr(opened.experiment, part).name for part in names} == names
    assert opened.experiment.signals["calm"].name == "mine:Calm"
    assert opened.experiment.reward(0)[1]["calm"] == 0.7
    assert opened.experiment.reward(1)[1]["calm"] == 0.5
    trajectories = opened.rollout(4, key=1)
    assert list(trajectories.signals) == ["nclose", "safety", "neighbors", "visible", "calm"]
    # One robot after another.
    moved = (np.diff(trajectories.positions[0, :10], axis=0) != 0).any(axis=2)
    assert (moved.sum(axis=1) <= 1).all()


def test_signals_of_ones_own_are_measured_weighed_and_required(run):
    evaluation = json.loads((run / "evaluation.json").read_text())
    row = json.loads((run / "metrics.jsonl").read_text().splitlines()[0])
    assert 0 < evaluation["signal"]["calm"] < 1
    assert 0 < row["signals"]["calm"] < 1
    total = sum(value for name, value in evaluation["signal"].items() if name not in ("total", "calm"))
    assert evaluation["signal"]["total"] == pytest.approx(total + 0.5 * evaluation["signal"]["calm"], abs=1e-5)
    assert evaluation["gap"] is None


def test_killed_in_the_middle_it_goes_on_to_the_same_weights(experiment, run, tmp_path):
    folder = tmp_path / "killed"
    command = [sys.executable, "-m", "murmurate", "discover", str(experiment), "--out", str(folder)]
    training = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 240
        while not (folder / "checkpoint").exists() and time.monotonic() < deadline and training.poll() is None:
            time.sleep(0.01)
    finally:
        training.kill()
        training.wait()
    assert (folder / "checkpoint").exists()
    assert not (folder / "manifest.json").exists()
    ended = in_another_process("discover", experiment, "--out", folder, "--resume", "--quiet")
    assert ended.returncode in (0, 3), ended.stderr
    assert weights(folder) == weights(run)


def test_every_verb_takes_it_when_it_is_trusted(run, tmp_path, capsys):
    copy = shutil.copytree(run, tmp_path / "run")
    for arguments in (
        ["evaluate", copy, "--episodes", 8, "--trust"],
        ["show", copy, "--trust", "--out", tmp_path / "figures"],
        ["table", copy, "--trust"],
    ):
        assert main([str(word) for word in arguments]) == 0, arguments
    status = main(["catalogue", str(copy), "--trust", "--out", str(tmp_path / "catalogue")])
    assert status == (0 if json.loads((copy / "evaluation.json").read_text())["valid"] else 2)
    assert (tmp_path / "figures" / "discovery.png").stat().st_size > 1000
    capsys.readouterr()


def test_many_begin_with_the_policies_of_a_run(experiment, run, tmp_path, capsys):
    """Two seeds with two values of a field of one's own start."""
    words = ["--seeds", "2", "--vary", "start.gap=4.0,5.0", "--from", str(run), "--out", str(tmp_path / "many")]
    few = ["--discovery.min_policies", "1", "--discovery.max_policies", "1", "--base.ppo.updates", "2", "--quiet"]
    assert main(["discover", str(experiment), *words, *few, "--trust"]) in (0, 3)
    checksums = murmurate.load(run, trust=True).manifest["checksums"]
    for seed, gap in itertools.product((0, 1), (4.0, 5.0)):
        trained = murmurate.load(tmp_path / "many" / f"own-mine_Linear-seed{seed}-gap{gap}", trust=True)
        assert (trained.experiment.seed, trained.experiment.start.gap) == (seed, gap)
        assert trained.manifest["initial"]["checksums"] == {
            name: value for name, value in checksums.items() if name.startswith("policies/")
        }
        # The robot on the inner ring begins there.
        assert np.abs(np.linalg.norm(trained.starts(8)[:, 1], axis=1) - gap).max() <= 2**0.5
    assert capsys.readouterr().out.count("| own | mine:Linear |") == 4


@pytest.mark.usefixtures("quick_conversion")
def test_it_is_exported_when_it_is_trusted(run, tmp_path, capsys):
    assert main(["export", str(run), "--trust", "--onnx", "--out", str(tmp_path / "own.onnx")]) == 0
    # A model of its policies and its scheduler, which was compared with the run before it was written.
    assert "input: positions batch x 3 x 2, float32" in capsys.readouterr().out
    for kind in ("csv", "json"):
        path = tmp_path / f"waypoints.{kind}"
        words = ["--trajectories", kind, "--episodes", "2", "--scale", "0.5", "--out", str(path)]
        assert main(["export", str(run), "--trust", *words]) == 0
    positions = murmurate.plots.Recording.open(run, trust=True).trajectories.positions
    data = json.loads((tmp_path / "waypoints.json").read_text())
    for episode, recorded in zip(data["episodes"], positions[:2], strict=True):
        first = [robot[0][1:] for robot in episode["robots"]]
        np.testing.assert_allclose(first, 0.5 * recorded[0], atol=1e-5)


def test_an_experiment_with_own_parts_is_written_out_as_toml(experiment, capsys):
    assert main(["experiments", str(experiment)]) == 0
    text = capsys.readouterr().out
    (experiment.parent / "written.toml").write_text(text)
    assert presets.resolve(experiment.parent / "written.toml") == presets.resolve(experiment)
    assert tomllib.loads(text)["start"] == {"use": "mine:Rings", "gap": 3.5}


def test_episodes_of_an_evaluation_begin_at_a_start_of_one_s_own(run, tmp_path):
    words = ["--episodes", "4", "--starts", "mine:Rings", "--out", str(tmp_path / "evaluation"), "--quiet"]
    assert main(["evaluate", str(run), "--trust", *words]) == 0
    evaluation = RunFolder(tmp_path / "evaluation").evaluation()
    assert evaluation["starts"] == {"kind": "drawn", "name": "mine:Rings"}
    # Those of the class's defaults, not of the run's.
    folder = RunFolder(tmp_path / "evaluation")
    inner = folder.trajectories(folder.experiment(trust=True)).positions[:, 0, 1]
    assert (np.abs(np.linalg.norm(inner, axis=1) - 4.0) <= 2**0.5).all()


def test_the_search_for_the_best_formation_knows_no_signal_of_ones_own(experiment, capsys):
    assert main(["optimum", str(experiment)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "signals.calm = 'mine:Calm': must be left out" in err


EVERY_VERB = """
import sys
from murmurate.cli.main import main
for verb in ("evaluate", "show", "table", "catalogue", "export", "compare"):
    print(main([verb, sys.argv[1], *(["--onnx"] if verb == "export" else [])]), "mine" in sys.modules)
"""


def test_a_stranger_s_run_imports_nothing(run, tmp_path):
    copy = shutil.copytree(run, tmp_path / "run")
    command = [sys.executable, "-c", EVERY_VERB, str(copy)]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=True)
    assert ended.stdout == "2 False\n" * 6
    lines = ended.stderr.splitlines()
    assert len(lines) == 6, ended.stderr
    assert all("trust" in line for line in lines), ended.stderr


def test_files_that_starts_name_go_along_with_the_run(tmp_path):
    """Those of nested starts too, in fields of any name; the objective has one's own signals alone."""
    source, spots = tmp_path / "source", np.array([[[-5, 0], [0, 0], [5, 1]], [[-6, 3], [0, 2], [6, -4]]])
    (source / "tables").mkdir(parents=True)
    shutil.copy(HERE / "mine.py", source / "mine.py")
    for name, points in zip(("one.csv", "tables/two.csv"), spots, strict=True):
        (source / name).write_text("start,x,y\n" + "".join(f"0,{x},{y}\n" for x, y in points))
    one = {"use": "file", "file": "one.csv", "noise": 0.1}
    parts = {
        "objective": "custom",
        "signals": {"calm": {"use": "mine:Calm", "weight": 0.5}, "visible": {"use": "visible"}},
        "start": {"use": "mixture", "first": one, "second": {"use": "mine:Tables", "table": "tables/two.csv"}},
        "discovery": ONE_POLICY,
    }
    (source / "my.toml").write_text(tomli_w.dumps(config_io.merged(TINY, parts)))
    murmurate.discover(source / "my.toml", out=tmp_path / "run")
    (source / "tables" / "two.csv").write_text("start,x,y\n0,-6,3\n0,0,2\n0,6,-5\n")
    with pytest.raises(RunError, match=r"start\.second\.table"):
        murmurate.discover(source / "my.toml", out=tmp_path / "run", resume=True)
    shutil.rmtree(source / "tables")
    (source / "one.csv").unlink()
    moved = Path(shutil.move(tmp_path / "run", tmp_path / "moved"))
    run = murmurate.load(moved, trust=True)
    assert run.experiment.reward(0)[1] == {"calm": 0.5, "visible": 4.0}
    assert list(run.rollout(2).signals) == ["calm", "visible"]
    off = np.abs(run.starts(16)[:, None] - spots).max(axis=(2, 3))
    assert (off.min(axis=1) <= 0.1).all()
    assert set(off.argmin(axis=1)) == {0, 1}
    # Nothing but the run's own files is read, and none of them without its checksum.
    folder, text = RunFolder(moved), (moved / "experiment.toml").read_text()
    assert {"starts.csv", "starts-2.csv"} < run.manifest["checksums"].keys()
    (moved / "experiment.toml").write_text(text.replace('"starts-2.csv"', '"../source/mine.py"'))
    with pytest.raises(
        RunError, match=r"start\.second\.table = '\.\./source/mine\.py': must be starts\.csv, the run's own"
    ):
        folder.experiment(trust=True)
    (moved / "experiment.toml").write_text(text)
    (moved / "starts-2.csv").rename(moved / "starts-3.csv")
    (moved / "starts-2.csv").symlink_to(moved / "starts-3.csv")
    with pytest.raises(RunError, match=r"starts-2\.csv is a link"):
        folder.experiment(trust=True)
    (moved / "starts-2.csv").unlink()
    shutil.copy(moved / "starts-3.csv", moved / "starts-2.csv")
    with pytest.raises(RunError, match=r"starts-3\.csv has no checksum"):
        folder.verify()


def test_a_start_that_lists_a_field_that_names_no_file_is_refused():
    from own.mine import Tables

    class Misspelled(Tables):
        file_fields = ("tabel",)

    with pytest.raises(InputError, match=r"^start\.tabel = None: must be a field of text: .* lists it in file_fields$"):
        tiny(start=Misspelled())


def test_a_sweep_trains_it_in_processes_of_their_own(experiment, run, tmp_path):
    (tmp_path / "sweep.toml").write_text(f'experiments = ["{experiment}"]\nseeds = [0]\n')
    ended = in_another_process("sweep", tmp_path / "sweep.toml", "--out", tmp_path / "out", "--workers", 1, "--quiet")
    assert ended.returncode == 0, ended.stderr + ended.stdout
    (folder,) = (path for path in (tmp_path / "out").iterdir() if (path / "manifest.json").exists())
    assert weights(folder) == weights(run)


def test_the_same_from_python(experiment, run, tmp_path):
    opened = murmurate.discover(experiment, out=tmp_path / "run")
    assert weights(tmp_path / "run") == weights(run)
    # The classes are those that the experiment's TOML file has imported.
    signal_class, start = type(opened.experiment.signals["calm"]), type(opened.experiment.start)
    config = murmurate.experiment(experiment, start=start(gap=5.0), signals={"calm": signal_class(3.0, weight=0.25)})
    assert config.start.gap == 5.0
    assert config.objective_signals["calm"].weight == 0.25
    assert "\n" not in repr(config) + repr(opened) + repr(config.start)


def test_flags_reach_the_fields_of_ones_own_classes(experiment, tmp_path, capsys):
    assert main(["discover", str(experiment), "--help-all"]) == 0
    text = capsys.readouterr().out
    assert "--start.gap" in text
    assert "Radius of the inner ring" in text
    status = main(["discover", str(experiment), "--out", str(tmp_path / "x"), "--start.gab", "3"])
    assert status == 2
    assert "did you mean --start.gap" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("field", "use", "message"),
    [
        ("signals.calm", "nowhere:Calm", "that can be imported (ModuleNotFoundError"),
        ("signals.calm", "mine:Kalm", "that can be imported (AttributeError"),
        ("signals.calm", "mine:Rings", "this is no subclass of it"),
        ("signals.calm", "mine:not_a_class", "this is no subclass of it"),
        ("signals.calm", "mine:Abstract", "this one lacks __call__"),
        ("signals.calm", "mine:Flat", "__call__ returns float32[3, 2] for 2 configurations, not float32[2]"),
        ("signals.calm", "mine:Undefined", "__call__ returns finite numbers"),
        ("signals.calm", "mine:Broken", "AttributeError: 'Configuration' object has no attribute 'colours'"),
        ("signals.calm", "mine:Listed", "a type that a configuration can hold"),
        ("start", "mine:Crowd", "few enough to fit the mine:Crowd start"),
        (
            "start",
            "rings",
            'symmetric, cluster, corner, tight-grid, wall, walls, surrounded, hard, or "module:Class"',
        ),
    ],
)
def test_a_wrong_part_is_one_line_and_nothing_is_written(experiment, tmp_path, capsys, field, use, message):
    folder = tmp_path / "run"
    status = main(["discover", str(experiment), "--out", str(folder), f"--{field}.use", use])
    line = capsys.readouterr().err.strip()
    assert status == 2, line
    assert message in line
    assert len(line.splitlines()) == 1
    assert not folder.exists()


def test_unknown_fields_are_refused(experiment):
    with pytest.raises(
        InputError, match=r"^start.gab = 3.0: must be a field of \[start\] \(use, gap\); did you mean gap"
    ):
        presets.resolve(experiment, {"start": {"gab": 3.0}})
    with pytest.raises(InputError, match=r"^valid.clam = 0.5: must be for a signal of the objective or the paper"):
        presets.resolve(experiment, {"valid": {"clam": 0.5}})
    with pytest.raises(InputError, match=r"^base.weights.clam = 0.5"):
        presets.resolve(experiment, {"base": {"weights": {"clam": 0.5}}})


def test_a_registered_name_belongs_to_one_class(experiment):
    presets.resolve(experiment)

    @murmurate.Signal.register("only-once")
    class First(murmurate.Signal):
        def __call__(self, configuration):
            return configuration.positions[:, 0]

    with pytest.raises(InputError, match=r"^signals = 'only-once': must be a new name: .*First is registered under it"):

        @murmurate.Signal.register("only-once")
        class Second(murmurate.Signal):
            def __call__(self, configuration):
                return configuration.positions[:, 1]

    assert murmurate.experiment("F", signals={"once": "only-once"}).objective_signals["once"] == First()


def test_a_training_that_diverges_stops_with_the_update_named(experiment, tmp_path, capsys):
    arguments = ["--signals.calm.use", "mine:Exploding", "--scheduler.use", "fsync", "--base.ppo.updates", "40"]
    status = main(["discover", str(experiment), "--out", str(tmp_path / "run"), "--quiet", *arguments])
    line = capsys.readouterr().err.strip()
    assert status == 2
    assert len(line.splitlines()) == 1
    assert "diverged at update" in line
    assert "the reward is NaN or infinite" in line


def test_other_sensing_and_shields(tmp_path):
    """From Python, with classes of the interactive session: they act, and the run is not opened without trust."""
    from own.mine import Half, Nearest

    config = tiny(
        policy={"use": "local", "hidden": [8, 4]}, sensing={"use": "visible"}, discovery=ONE_POLICY, rest=MOVING
    )
    run = murmurate.discover(config, out=tmp_path / "run", sensing=Nearest(rotation=True), shield=Half(0.25))
    view = run.cascade.env.observe(run.cascade.env.state(jnp.asarray(np.moveaxis(run.starts(2), 0, -1)))).view
    assert (np.asarray(view.seen).sum(axis=1) == 1).all()
    moved = np.abs(np.diff(run.rollout(4).positions, axis=1)).max()
    assert 0 < moved <= 0.25 * config.world.max_speed * 2**0.5
    with pytest.raises(RunError, match="trust"):
        in_fresh_interpreter(tmp_path / "run")


@pytest.mark.nightly
def test_networks_of_a_library_are_trained(tmp_path):
    """Their activation functions are leaves that are no arrays."""
    from own.net import Library

    run = murmurate.discover(tiny(discovery=ONE_POLICY), out=tmp_path / "run", policy=Library(width=6))
    first = np.asarray(run.cascade.policies[0].mlp.layers[0].weight)
    assert first.shape == (6, 6)
    again = murmurate.load(tmp_path / "run", trust=True)
    np.testing.assert_array_equal(again.rollout(4, key=2).positions, run.rollout(4, key=2).positions)


def in_fresh_interpreter(folder):
    code = f"import murmurate; murmurate.load({str(folder)!r})"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    if ended.returncode:
        raise RunError(ended.stderr.splitlines()[-1])
