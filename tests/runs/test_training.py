from __future__ import annotations

import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from murmurate import plots
from murmurate.discovery import Search
from murmurate.errors import InputError, RunError
from murmurate.runs import evaluate, files, train
from murmurate.runs.folder import RunFolder
from murmurate.runs.jobs import TrainingJob
from murmurate.runs.run import Run
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
    return RunFolder(folder).metrics()


def timeless(folder):
    return [{k: v for k, v in row.items() if k not in ("seconds", "steps_per_second")} for row in rows(folder)]


def assert_same(folder, other):
    for name in KEPT:
        assert (folder / name).read_bytes() == (other / name).read_bytes(), name
    assert timeless(folder) == timeless(other)


def test_a_finished_run_holds_all_its_parts(finished):
    assert sorted(path.relative_to(finished).as_posix() for path in finished.rglob("*") if path.is_file()) == sorted(
        [*KEPT, "metrics.jsonl", "manifest.json", "figures/discovery.png"]
    )
    manifest = RunFolder(finished).verify()
    assert set(manifest) == {
        *("format", "murmurate", "versions", "platform", "cpu", "threads", "device", "devices", "flags"),
        *("seed", "experiment", "robots", "valid_pattern", "policies", "environment_steps", "train_seconds"),
        "checksums",
    }
    assert manifest["policies"] == ["base", "auxiliary"]
    assert manifest["environment_steps"] == 2 * 4 * 8 * 4
    assert manifest["checksums"].keys() == {*KEPT, "metrics.jsonl"}
    assert RunFolder(finished).experiment() == tiny()
    assert plots.Recording.open(finished).policies == ["base", "auxiliary"]


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
    assert RunFolder(finished).manifest()["train_seconds"] == pytest.approx(seconds[-1], abs=1e-3)


def test_evaluation_and_trajectories_have_the_fields_of_the_contract(finished):
    summary = files.read_json(finished / "evaluation.json")
    fractions = ("contact_free", "inside", "mutually_visible", "gathered", "safe", "at_rest", "stationary", "valid")
    steps = ("base_steps", "auxiliary_steps", "total_steps", "bound_steps")
    assert {"experiment", "robots", "episodes", "seed", "signal", *fractions, *steps} <= summary.keys()
    assert summary["signal"].keys() == {"nclose", "safety", "neighbors", "visible", "total"}
    arrays = files.read_npz(finished / "trajectories.npz")
    episodes, configurations = arrays["positions"].shape[:2]
    assert episodes == summary["episodes"] == evaluate.EPISODES
    expected = {
        "positions": ("float32", (episodes, configurations, 3, 2)),
        "lengths": ("int32", (episodes,)),
        "switch": ("int32", (episodes, 1)),
        "objective": ("float32", (episodes, configurations)),
        "signals": ("float32", (episodes, configurations, 4)),
        "at_rest": ("bool", (episodes,)),
        "terminated": ("bool", (episodes,)),
        "epochs": ("int32", (episodes,)),
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
        RunFolder(folder).manifest()
    with pytest.raises(RunError, match="--resume"):
        train.discover(tiny(), folder)
    train.discover(tiny(), folder, resume=True)
    assert not (folder / "checkpoint").exists()
    assert_same(folder, finished)


def test_rows_beyond_the_checkpoint_are_cut_off(finished, tmp_path, monkeypatch):
    folder, write, left = tmp_path / "run", RunFolder.write_checkpoint, [2]

    def failing(*args):
        left[0] -= 1
        if not left[0]:
            raise StoppedError
        write(*args)

    monkeypatch.setattr(RunFolder, "write_checkpoint", failing)
    with pytest.raises(StoppedError):
        train.discover(tiny(), folder)
    monkeypatch.undo()
    assert len(rows(folder)) == 4
    train.discover(tiny(), folder, resume=True)
    assert_same(folder, finished)


def test_a_run_is_trained_by_one_process_at_a_time(tmp_path):
    folder = tmp_path / "run"

    def resume_again(*_, **__):
        with pytest.raises(RunError, match="is in use: another process trains this run"):
            train.discover(tiny(), folder, resume=True)
        raise StoppedError

    with pytest.raises(StoppedError):
        train.discover(tiny(), folder, on_progress=resume_again)
    assert sorted(path.name for path in folder.iterdir()) == ["experiment.toml"]


def test_a_killed_process_can_be_resumed(finished, tmp_path):
    folder, toml = tmp_path / "run", write_toml(tmp_path / "tiny.toml")
    code = "import sys; from murmurate.cli.main import main; sys.exit(main(sys.argv[1:]))"
    process = subprocess.Popen([sys.executable, "-c", code, "discover", str(toml), "--out", str(folder)])
    deadline = time.monotonic() + 300
    while not (folder / "checkpoint" / "snapshot.safetensors").exists() and time.monotonic() < deadline:
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.wait()
    assert not (folder / "manifest.json").exists()
    train.discover(tiny(), folder, resume=True)
    assert_same(folder, finished)


def test_a_finished_run_is_not_touched_by_resuming(finished):
    before = {path: path.stat().st_mtime_ns for path in finished.rglob("*")}
    assert train.discover(tiny(), finished, resume=True).manifest == RunFolder(finished).manifest()
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
    files.write_tree(path, {}, {"policies": 0})
    with pytest.raises(RunError, match="not a checkpoint of this version"):
        train.discover(tiny(), folder, resume=True)


def test_no_valid_pattern_is_an_honest_outcome(tmp_path):
    # Robots begin 20 units apart, and untrained ones do not come near enough to be neighbours.
    run = train.discover(tiny(world={"scan_radius": 2.5}), tmp_path / "run")
    assert run.manifest["valid_pattern"] is False
    assert files.read_json(tmp_path / "run" / "evaluation.json")["valid"] == 0
    assert len(run.cascade.policies) == 2


def test_an_empty_sigma_ends_the_search(tmp_path, monkeypatch):
    monkeypatch.setattr(Search, "conclude", _everybody_crashed)
    run = train.discover(tiny(), tmp_path / "run")
    assert run.manifest["valid_pattern"] is False
    assert run.manifest["policies"] == ["base"]
    summary = files.read_json(tmp_path / "run" / "evaluation.json")
    assert summary["auxiliary_steps"] == 0
    assert summary["base_steps"] == summary["total_steps"]


def _everybody_crashed(self, snapshot, policy):
    return replace(snapshot, policies=(policy,), sigma=snapshot.sigma[:0], train=None, finished=True)


def test_positions_from_a_file_go_along_with_the_run(tmp_path):
    source = tmp_path / "mine.csv"
    source.write_text("start,x,y\n0,-5,0\n0,0,0\n0,5,1\n")
    wanted = tiny(start={"use": "file", "file": str(source), "noise": 0.1})
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
    run = Run.open(moved)
    assert "starts.csv" in run.manifest["checksums"]
    assert np.abs(run.starts(4) - np.array([[-5, 0], [0, 0], [5, 1]])).max() <= 0.1


def test_a_training_begins_with_the_policies_of_a_run(finished, tmp_path):
    initial, folder = Run.open(finished), tmp_path / "run"
    frozen = {"ppo": {"updates": 2, "policy_rate": 0.0, "policy_rate_end": 0.0}}
    config = tiny(seed=1, base=frozen, auxiliary=frozen)
    run = train.discover(config, folder, initial=initial)
    for before, after in zip(initial.cascade.policies, run.cascade.policies, strict=True):
        assert np.array_equal(before.body.layers[0].weight, after.body.layers[0].weight)
    origin = run.manifest["initial"]
    assert (origin["experiment"], origin["seed"]) == ("tiny", 0)
    assert origin["checksums"].keys() == set(POLICIES)
    assert not (folder / "checkpoint").exists()


def test_a_run_is_refined_by_gradients(finished, tmp_path):
    """With the weights that it begins with where the rate is 0, resumed to the same weights where it is not."""
    initial = Run.open(finished)
    numbers = {"updates": 4, "worlds": 4, "steps": 3, "minibatches": 2, "epochs": 1}
    numbers["weights"] = {"smooth_safety": 0.0, "smooth_visible": 0.0, "exposed": 0.0}
    numbers |= {"policy_rate_end": 0.01}
    stage = {"learner": "gradients", "gradients": numbers}
    single_policy = {"min_policies": 1, "max_policies": 1}
    config = tiny(seed=1, base=stage | {"gradients": numbers | {"average": 2}}, discovery=single_policy)
    run = train.discover(config, tmp_path / "unbroken", initial=initial)
    rows = RunFolder(run.folder).metrics()
    assert [row["update"] for row in rows] == [1, 2, 3, 4]
    assert all(
        row["gradient"] > 0 and row["signals"].keys() == {"nclose", "safety", "neighbors", "visible"} for row in rows
    )
    assert weights(run) != weights(initial)
    with pytest.raises(StoppedError):
        train.discover(config, tmp_path / "run", on_progress=stop_after(2), initial=initial)
    resumed = train.discover(config, tmp_path / "run", resume=True, initial=initial)
    assert weights(resumed) == weights(run)
    last = train.discover(tiny(seed=1, base=stage, discovery=single_policy), tmp_path / "last", initial=initial)
    assert weights(last) != weights(run), "the result is an average"
    still = {"policy_rate": 0.0, "policy_rate_end": 0.0}
    frozen = tiny(seed=1, base=stage | {"gradients": numbers | still}, discovery=single_policy)
    assert weights(train.discover(frozen, tmp_path / "frozen", initial=initial)) == weights(initial)


def test_a_run_refines_what_it_discovers(tmp_path):
    """Stopped in either phase or between them, and resumed, it ends in the same weights."""
    gradients = {"updates": 4, "worlds": 4, "steps": 3, "minibatches": 2, "epochs": 1, "average": 2}
    gradients["weights"] = {"smooth_safety": 0.0, "smooth_visible": 0.0, "exposed": 0.0}
    config = tiny(base={"refine": True, "gradients": gradients}, discovery={"min_policies": 1, "max_policies": 1})
    told = []
    run = train.discover(
        config, tmp_path / "unbroken", on_progress=lambda work, done, total, **_: told.append((work, done, total))
    )
    assert told[:5] == [
        ("base policy", 0, 4), ("base policy", 2, 4), ("base policy", 4, 4),
        ("base policy, refined", 2, 4), ("base policy, refined", 4, 4),
    ]  # fmt: skip
    recorded = [(row["learner"], row["update"], row["environment_steps"]) for row in rows(run.folder)]
    assert recorded == [
        *(("ppo", n, 32 * n) for n in range(1, 5)),
        *(("gradients", n, 128 + 12 * n) for n in range(1, 5)),
    ]
    assert run.manifest["environment_steps"] == 176
    for calls in (2, 3, 4):
        folder = tmp_path / f"run{calls}"
        with pytest.raises(StoppedError):
            train.discover(config, folder, on_progress=stop_after(calls))
        assert weights(train.discover(config, folder, resume=True)) == weights(run)


def weights(run):
    return run.cascade.policies[0].body.layers[0].weight.tolist()


def test_signals_without_a_gradient_do_not_refine(tmp_path):
    for name, reason in (("visible", "it counts"), ("safety", "not finite"), ("blue", "for a signal")):
        with pytest.raises(InputError, match=rf"base\.gradients\.weights\.{name}.*{reason}"):
            train.discover(tiny(base={"learner": "gradients", "gradients": {"weights": {name: 1.0}}}), tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_a_training_that_began_with_a_run_is_resumed_without_it(finished, tmp_path):
    source, folder, unbroken = tmp_path / "source", tmp_path / "run", tmp_path / "unbroken"
    initial, config = Run.open(shutil.copytree(finished, source)), tiny(seed=1)
    train.discover(config, unbroken, initial=initial)
    with pytest.raises(StoppedError):
        train.discover(config, folder, on_progress=stop_after(2), initial=initial)
    shutil.rmtree(source)
    train.discover(config, folder, resume=True)
    assert_same(folder, unbroken)
    assert RunFolder(folder).manifest()["initial"] == RunFolder(unbroken).manifest()["initial"]
    other = replace(initial, manifest={"checksums": {"policies/0-base.safetensors": "other"}})
    with pytest.raises(RunError, match="did not begin with the policies of"):
        train.discover(config, folder, resume=True, initial=other)


def test_a_worker_begins_with_the_policies_of_a_run(finished, tmp_path):
    """It is given the folder alone: what the training begins with is there. So it is when a damaged run is repeated."""
    initial, config = Run.open(finished), tiny(seed=1)
    train.discover(config, tmp_path / "here", initial=initial)
    job = TrainingJob(tmp_path / "worker", config, initial=initial)
    for _ in range(2):
        job.prepare()
        TrainingJob(job.folder).run()
        assert job.is_finished()
        assert_same(job.folder, tmp_path / "here")
        assert RunFolder(job.folder).manifest()["initial"]["seed"] == 0
        (job.folder / "policies" / "0-base.safetensors").write_bytes(b"damaged")
    other = TrainingJob(tmp_path / "here", config, initial=replace(initial, manifest={"checksums": {}}))
    with pytest.raises(RunError, match="did not begin with the policies of"):
        other.prepare()


def test_policies_of_other_shapes_are_refused(finished, tmp_path):
    config = tiny(policy={"hidden": [4, 4]})
    with pytest.raises(RunError, match=r"the base policy to begin with has 'body/layers/0/weight' as float32"):
        train.discover(config, tmp_path / "run", initial=Run.open(finished))
    assert list(tmp_path.iterdir()) == []


def test_a_training_that_diverges_names_the_update_and_keeps_its_checkpoint(tmp_path, monkeypatch):
    folder, advance, calls = tmp_path / "run", train.advance_together, []

    def diverging(searches, snapshots):
        calls.append(advanced := advance(searches, snapshots))
        if len(calls) == 2:
            advanced[0][1][1]["finite"] = 0.0
        return advanced

    monkeypatch.setattr(train, "advance_together", diverging)
    with pytest.raises(RunError, match=r"the training of the base policy diverged at update 4: .* is NaN or infinite"):
        train.discover(tiny(), folder)
    assert len(rows(folder)) == 2
    assert RunFolder(folder).checkpoint_rows() == 2
    assert RunFolder(folder).inspect(resume=True) == "unfinished"
