from __future__ import annotations

import shutil

import jax
import pytest

from murmurate import plots
from murmurate.cli import reproduce
from murmurate.cli.main import main
from murmurate.report import plan as planning
from murmurate.report.plan import Plan, PlannedRun
from murmurate.runs import files, train
from murmurate.runs.execute import InProcess, LocalProcesses
from murmurate.runs.folder import RunFolder, trained_checksums
from murmurate.runs.paper import EXPERIMENTS
from tiny import tiny

NAMES = ("tiny-central-seed0", "tiny-formation-seed1")


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The two runs of the plan, by `murmurate discover`; not to be changed."""
    from murmurate.runs.train import discover

    folder = tmp_path_factory.mktemp("reproduce")
    for seed, name in enumerate(NAMES):
        discover(tiny(seed=seed), folder / name)
    return folder


@pytest.fixture
def work(tmp_path, monkeypatch):
    """An empty folder to work in, where all experiments are tiny and pictures are blank."""
    from matplotlib.figure import Figure

    def make_plan(seed, quick):
        planning.make_plan.seen = (seed, quick)
        runs = {name.split("-")[1]: PlannedRun(name, name.split("-")[1], tiny(seed=s)) for s, name in enumerate(NAMES)}
        return Plan(seed, quick, dict.fromkeys(EXPERIMENTS, runs), {"scattered": {3: runs["formation"]}})

    monkeypatch.setattr(planning, "make_plan", make_plan)
    for name in ("robot", "visibility", "training", "reward", "formation", "patterns", "growth"):
        monkeypatch.setattr(plots, f"{name}_figure", lambda *_: Figure(figsize=(0.2, 0.1)))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def finished(work, trained):
    shutil.copytree(trained, work / "runs")
    return work


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_finished_runs_become_a_report(finished, capsys):
    before = contents(finished / "runs")
    assert main(["reproduce"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out.startswith("2 runs in runs: 2 finished, 0 to go on with, 0 to train\ndrawing the report\n")
    assert "report: reproduction/report.html, reproduction/report.md\nnumbers: reproduction/report.json\n" in out
    assert contents(finished / "runs") == before
    assert files.read_json("reproduction/report.json")["command"] == "murmurate reproduce"


def test_options_are_in_the_command_of_the_report(finished):
    (finished / "runs").rename(finished / "my runs")
    arguments = ["reproduce", "--quick", "--out", "here", "--runs", "my runs", "--seed", "4"]
    assert main(arguments) == 0
    assert planning.make_plan.seen == (4, True)
    numbers = files.read_json("here/report.json")
    assert (numbers["command"], numbers["quick"]) == (
        "murmurate reproduce --quick --out here --runs 'my runs' --seed 4",
        True,
    )
    assert "`murmurate reproduce --runs 'my runs' --seed 4` measures those" in (finished / "here/report.md").read_text()


def test_a_quick_report_has_a_folder_of_its_own(finished):
    assert main(["reproduce", "--quick"]) == 0
    assert {path.name for path in finished.iterdir()} == {"runs", "reproduction-quick"}


def test_an_interrupted_command_goes_on(work, trained, capsys, monkeypatch):
    advance, left = train.advance_together, [3]

    def interrupted(*args):
        if not left[0]:
            raise KeyboardInterrupt
        left[0] -= 1
        return advance(*args)

    monkeypatch.setattr(train, "advance_together", interrupted)
    monkeypatch.setattr(reproduce, "_executor", lambda workers: InProcess())
    assert main(["reproduce"]) == 130
    out, err = capsys.readouterr()
    assert out == "2 runs in runs: 0 finished, 0 to go on with, 2 to train\n"
    assert err.splitlines()[-1] == "murmurate: interrupted; the same command goes on: murmurate reproduce"
    assert all(": base policy: " in line or ": auxiliary policy: " in line for line in err.splitlines()[:-1])
    monkeypatch.setattr(train, "advance_together", advance)
    assert main(["reproduce"]) == 0
    assert "2 runs in runs: 0 finished, 1 to go on with, 1 to train\n" in capsys.readouterr().out
    for name in NAMES:
        checksums = [trained_checksums(RunFolder(runs / name).manifest()) for runs in (work / "runs", trained)]
        assert checksums[0] == checksums[1]


@pytest.mark.parametrize(
    ("workers", "backend", "executor"),
    [
        (None, "cpu", LocalProcesses(None)),
        (None, "gpu", InProcess()),
        (3, "cpu", LocalProcesses(3)),
        (3, "gpu", LocalProcesses(3)),
    ],
)
def test_cores_train_side_by_side_unless_there_is_an_accelerator(monkeypatch, workers, backend, executor):
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    chosen = reproduce._executor(workers)
    assert type(chosen) is type(executor)
    assert getattr(chosen, "workers", None) == getattr(executor, "workers", None)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ("--out mine", "mine holds other files: choose another --out"),
        ("--out mine/notes.txt", "cannot write to mine/notes.txt: Not a directory"),
        ("--runs mine --out ./mine", "--out and --runs are the same folder: the report needs one of its own"),
        ("--runs bad", "bad/tiny-formation-seed1 holds other files"),
        ("--seed many", "--seed = 'many': must be an integer"),
        ("--sed 1", "unknown flag --sed; did you mean --seed?"),
        ("A", "unrecognized arguments: A"),
    ],
)
def test_refused_before_anything_is_trained(work, capsys, monkeypatch, arguments, line):
    monkeypatch.setattr(train, "advance_together", None)
    for path in ("mine", "bad/tiny-formation-seed1"):
        (work / path).mkdir(parents=True)
        (work / path / "notes.txt").write_text("mine")
    assert main(["reproduce", *arguments.split()]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"murmurate: {line}")
    assert err.count("\n") == 1
    assert sorted(path.name for path in work.rglob("*")) == [
        "bad",
        "mine",
        "notes.txt",
        "notes.txt",
        "tiny-formation-seed1",
    ]


def test_a_bad_seed_is_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["reproduce", "--seed", "-1"]) == 2
    assert "seed = -1: must be an integer from 0 to" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_help(capsys):
    assert main(["reproduce", "--help"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("usage: murmurate reproduce [options]\n")
    for flag in ("--quick", "--out DIR", "--runs DIR", "--seed INT"):
        assert flag in out
