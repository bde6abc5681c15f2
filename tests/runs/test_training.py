from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from murmurate import plots
from murmurate.discovery import Discovery
from murmurate.errors import InputError, RunError
from murmurate.runs import checkpoint, evaluate, serialization, storage, train
from murmurate.runs.run import METRICS
from tiny import tiny, write_toml

POLICIES = ("policies/0-base.safetensors", "policies/1-auxiliary.safetensors")
KEPT = ("experiment.toml", "evaluation.json", "trajectories.npz", *POLICIES)


class StoppedError(Exception):
    pass


def stop_after(calls):
    """Raises at the given call of `on_progress`."""
    left = [calls]

    def tell(*_, **__):
        left[0] -= 1
        if left[0] == 0:
            raise StoppedError

    return tell


def rows(folder):
    return [json.loads(line) for line in (folder / METRICS).read_text().splitlines()]


def timeless(folder):
    return [{k: v for k, v in row.items() if k not in ("seconds", "steps_per_second")} for row in rows(folder)]


def assert_same(folder, other):
    for name in KEPT:
        assert (folder / name).read_bytes() == (other / name).read_bytes(), name
    assert timeless(folder) == timeless(other)


def test_a_finished_run_holds_all_its_parts(finished):
    assert sorted(path.relative_to(finished).as_posix() for path in finished.rglob("*") if path.is_file()) == sorted(
        [*KEPT, METRICS, "manifest.json"]
    )
    manifest = storage.read_manifest(finished)
    storage.verify(finished, manifest)
    assert set(manifest) == {
        *("format", "murmurate", "versions", "platform", "device", "devices", "seed", "experiment", "robots"),
        *("outcome", "policies", "environment_steps", "train_seconds", "checksums"),
    }
    assert manifest["policies"] == ["base", "auxiliary"]
    assert manifest["environment_steps"] == 2 * 4 * 8 * 4
    assert manifest["checksums"].keys() == {"experiment.toml", *POLICIES}
    assert config.load(finished) == tiny()
    assert plots.Record.open(finished).policies == ("base", "auxiliary")


def test_metrics_are_one_row_an_update(finished):
    written = rows(finished)
    assert [(row["policy"], row["name"], row["update"], row["environment_steps"]) for row in written] == [
        *((0, "base", update, 32 * update) for update in (1, 2, 3, 4)),
        *((1, "auxiliary", update, 128 + 32 * update) for update in (1, 2, 3, 4)),
    ]
    for row in written:
        assert row["signals"].keys() == {"nclose", "safety", "neighbors", "visible"}
        assert row["objective"] == pytest.approx(sum(row["signals"].values()))
        assert {"reward", "terminated", "policy_loss", "value_loss", "kl", "steps_per_second"} <= row.keys()
    seconds = [row["seconds"] for row in written]
    assert seconds == sorted(seconds)
    assert storage.read_manifest(finished)["train_seconds"] == pytest.approx(seconds[-1], abs=1e-3)


def test_evaluation_and_trajectories_have_the_fields_of_the_contract(finished):
    summary = storage.read_json(finished / "evaluation.json")
    fractions = ("collision_free", "mutually_visible", "gathered", "safe", "at_rest", "valid")
    steps = ("base_steps", "auxiliary_steps", "total_steps", "bound_steps")
    assert {"experiment", "robots", "episodes", "seed", "signal", *fractions, *steps} <= summary.keys()
    assert summary["signal"].keys() == {"nclose", "safety", "neighbors", "visible", "total"}
    arrays = storage.read_npz(finished / "trajectories.npz")
    episodes, configurations = arrays["positions"].shape[:2]
    assert episodes == summary["episodes"] == evaluate.EPISODES
    expected = {
        "positions": ("float32", (episodes, configurations, 3, 2)),
        "lengths": ("int32", (episodes,)),
        "switch": ("int32", (episodes, 1)),
        "objective": ("float32", (episodes, configurations)),
        "signals": ("float32", (episodes, configurations, 4)),
        "at_rest": ("bool", (episodes,)),
    }
    assert {name: (str(arrays[name].dtype), arrays[name].shape) for name in expected} == expected
    assert arrays["signal_names"].tolist() == ["nclose", "safety", "neighbors", "visible"]
    last = arrays["lengths"].max()
    assert last == configurations - 1
    for episode, length in enumerate(arrays["lengths"]):
        held = arrays["positions"][episode, length:]
        assert (held == held[0]).all()


@pytest.mark.parametrize("calls", [1, 2, 3, 6])
def test_resuming_ends_in_the_same_bytes(finished, tmp_path, calls):
    folder = tmp_path / "run"
    with pytest.raises(StoppedError):
        train.discover(tiny(), folder, on_progress=stop_after(calls))
    assert not (folder / "manifest.json").exists()
    with pytest.raises(RunError, match="unfinished"):
        storage.read_manifest(folder)
    with pytest.raises(RunError, match="--resume"):
        train.discover(tiny(), folder)
    train.discover(tiny(), folder, resume=True)
    assert not (folder / "checkpoint").exists()
    assert_same(folder, finished)


def test_rows_beyond_the_checkpoint_are_cut_off(finished, tmp_path, monkeypatch):
    folder, save, left = tmp_path / "run", checkpoint.save, [2]

    def failing(*args):
        left[0] -= 1
        if not left[0]:
            raise StoppedError
        save(*args)

    monkeypatch.setattr(checkpoint, "save", failing)
    with pytest.raises(StoppedError):
        train.discover(tiny(), folder)
    monkeypatch.undo()
    assert len(rows(folder)) == 4
    train.discover(tiny(), folder, resume=True)
    assert_same(folder, finished)


def test_a_killed_process_can_be_resumed(finished, tmp_path):
    folder, toml = tmp_path / "run", write_toml(tmp_path / "tiny.toml")
    code = "import sys; from murmurate.cli.main import main; sys.exit(main(sys.argv[1:]))"
    process = subprocess.Popen([sys.executable, "-c", code, "discover", str(toml), "--out", str(folder)])
    deadline = time.monotonic() + 300
    while not (folder / "checkpoint" / "snapshot.safetensors").exists() and time.monotonic() < deadline:
        assert process.poll() is None
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert not (folder / "manifest.json").exists()
    train.discover(tiny(), folder, resume=True)
    assert_same(folder, finished)


def test_a_finished_run_is_not_touched_by_resuming(finished):
    before = {path: path.stat().st_mtime_ns for path in finished.rglob("*")}
    assert train.discover(tiny(), finished, resume=True).manifest == storage.read_manifest(finished)
    assert {path: path.stat().st_mtime_ns for path in finished.rglob("*")} == before


def test_another_experiment_is_not_resumed(finished):
    with pytest.raises(RunError, match=r"another experiment: base\.horizon is 8 there, 9 here"):
        train.discover(tiny(base={"horizon": 9}), finished, resume=True)
    with pytest.raises(RunError, match="holds another run"):
        train.discover(tiny(), finished)


def test_an_impossible_experiment_writes_nothing(tmp_path):
    with pytest.raises(InputError, match=r"world\.robots = 30"):
        train.discover(tiny(world={"robots": 30, "half_width": 5.0, "half_height": 5.0}), tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_checkpoint_is_one_line(tmp_path):
    folder = tmp_path / "run"
    with pytest.raises(StoppedError):
        train.discover(tiny(), folder, on_progress=stop_after(2))
    path = folder / "checkpoint" / "snapshot.safetensors"
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(RunError, match=r"snapshot\.safetensors is not a valid"):
        train.discover(tiny(), folder, resume=True)
    serialization.save(path, {}, {"policies": 0})
    with pytest.raises(RunError, match="not a checkpoint of this version"):
        train.discover(tiny(), folder, resume=True)


def test_no_valid_pattern_is_an_honest_outcome(tmp_path):
    # Robots begin 20 units apart, and untrained ones do not come near enough to be neighbours.
    run = train.discover(tiny(world={"scan_radius": 2.5}), tmp_path / "run")
    assert run.manifest["outcome"] == "no valid pattern was discovered"
    assert storage.read_json(tmp_path / "run" / "evaluation.json")["valid"] == 0
    assert len(run.cascade.policies) == 2


def test_an_empty_sigma_ends_the_search(tmp_path, monkeypatch):
    monkeypatch.setattr(Discovery, "_conclude", _everybody_crashed)
    run = train.discover(tiny(), tmp_path / "run")
    assert run.manifest["outcome"] == "no valid pattern was discovered"
    assert run.manifest["policies"] == ["base"]
    summary = storage.read_json(tmp_path / "run" / "evaluation.json")
    assert summary["auxiliary_steps"] == 0
    assert summary["base_steps"] == summary["total_steps"]


def _everybody_crashed(self, snapshot, policy):
    from dataclasses import replace

    return replace(snapshot, policies=(policy,), sigma=snapshot.sigma[:0], train=None, finished=True)


def test_positions_from_a_file_go_along_with_the_run(tmp_path):
    source = tmp_path / "mine.csv"
    source.write_text("start,x,y\n0,-5,0\n0,0,0\n0,5,1\n")
    wanted = tiny(start={"kind": "file", "file": str(source), "noise": 0.1})
    folder = tmp_path / "run"
    with pytest.raises(StoppedError):
        train.discover(wanted, folder, on_progress=stop_after(2))
    source.write_text("start,x,y\n0,-5,0\n0,0,0\n0,5,2\n")
    with pytest.raises(RunError, match=r"start\.file"):
        train.discover(wanted, folder, resume=True)
    source.write_text("start,x,y\n0,-5,0\n0,0,0\n0,5,1\n")
    train.discover(wanted, folder, resume=True)
    source.unlink()
    moved = Path(shutil.move(folder, tmp_path / "moved"))
    run = train.Run.open(moved)
    assert "starts.csv" in run.manifest["checksums"]
    assert np.abs(run.starts(4) - np.array([[-5, 0], [0, 0], [5, 1]])).max() <= 0.1
