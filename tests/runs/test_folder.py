"""A run folder is never overwritten, is locked while it is trained in, and is checked whenever it is read."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import jax
import numpy as np
import pytest

from murmurate.cli.main import main
from murmurate.discovery import policy_templates
from murmurate.errors import RunError
from murmurate.runs import catalogues, files
from murmurate.runs.evaluate import evaluate, evaluated
from murmurate.runs.failures import describe_failures
from murmurate.runs.folder import LOCK, MANIFEST, RunFolder, describe_starts, is_fresh, trained_checksums
from murmurate.runs.run import Run
from tiny import seal, tiny


@pytest.fixture
def damaged(finished, tmp_path):
    """A copy of the finished run that a test may break."""
    return RunFolder(shutil.copytree(finished, tmp_path / "run"))


def change(path, **values):
    files.write_json(path, files.read_json(path) | values)


def test_what_a_folder_holds(tmp_path):
    folder = RunFolder(tmp_path / "runs" / "C")
    assert folder.inspect() == "new"
    assert not folder.path.exists()
    assert folder.create(resume=True) == "new"
    assert not list(folder.path.iterdir())
    (folder.path / ".experiment.toml.partial").write_text("killed here")
    assert folder.create() == "new"
    (folder.path / "checkpoint").mkdir()
    assert folder.create() == "new"
    folder.write_experiment(tiny())
    with pytest.raises(RunError, match=r"holds another run: continue it with --resume, or choose another --out$"):
        folder.create()
    assert folder.create(resume=True) == "unfinished"
    files.write_json(folder.path / MANIFEST, {})
    assert folder.create(resume=True) == "finished"
    (tmp_path / "thesis.tex").write_text("")
    for resume in (False, True):
        with pytest.raises(RunError, match="choose another --out"):
            RunFolder(tmp_path).create(resume)


def test_a_lock_keeps_others_out_until_its_process_dies(tmp_path):
    folder = RunFolder(tmp_path)
    with folder.lock():
        with pytest.raises(RunError, match="is in use: another process trains this run"), folder.lock():
            pass
        assert folder.inspect() == "new"
    assert not (tmp_path / LOCK).exists()
    code = "import sys, time; from murmurate.runs.folder import RunFolder\n"
    code += "with RunFolder(sys.argv[1]).lock():\n    print('locked', flush=True)\n    time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "locked\n"
        with pytest.raises(RunError, match="is in use"), folder.lock():
            pass
        process.kill()
    assert (tmp_path / LOCK).exists()
    with folder.lock():
        pass


def test_a_finished_run_is_read(finished):
    folder = RunFolder(finished)
    assert repr(folder) == f"RunFolder({finished})"
    manifest = folder.verify()
    assert manifest["valid_pattern"] is True
    assert folder.experiment() == tiny()
    assert len(folder.policies(policy_templates(tiny(), 2))) == 2
    assert [row["update"] for row in folder.metrics()] == [1, 2, 3, 4] * 2
    summary, trajectories = folder.evaluation(), folder.trajectories(tiny())
    assert is_fresh(summary)
    assert describe_starts(summary) == "fresh starts"
    assert trajectories.positions.shape[::2] == (200, 3)
    assert trajectories.lengths.mean() == pytest.approx(summary["total_steps"])
    assert trajectories.epochs.mean() == pytest.approx(summary["epochs"])
    assert not (trajectories.terminated & trajectories.at_rest).any()
    assert folder.record() is None


def test_the_manifest_records_what_numbers_depend_on(finished):
    manifest = RunFolder(finished).manifest()
    assert manifest["versions"]["jax"] == jax.__version__
    assert manifest["threads"] >= 1
    assert manifest["devices"] == jax.device_count()
    assert manifest["cpu"]
    assert manifest["flags"]["jax_enable_x64"] is False
    assert manifest["flags"]["jax_default_prng_impl"] == "threefry2x32"
    assert "jax_threefry_partitionable" in manifest["flags"]


_LATER = ("terminated", "epochs", "after_rest")


def test_experiments_of_version_0_1_0_have_another_rule_of_rest(tmp_path):
    """`tolerance` is read and means nothing, and robots that knew no dead zone have none."""
    folder = RunFolder(tmp_path)
    still = {"motion_cost": 0.0}
    config = tiny(base=still, auxiliary=still)
    folder.write_experiment(config)
    path = tmp_path / "experiment.toml"
    lines = path.read_text().splitlines()
    old = [line for line in lines if not line.startswith(("dead_zone", "stillness", "motion_cost"))]
    assert len(old) == len(lines) - 6
    path.write_text("\n".join(old).replace("switch_tolerance", "tolerance = 0.0003\nswitch_tolerance"))
    rest = config.rest
    assert folder.experiment() == replace(config, rest=replace(rest, dead_zone=0.0))
    path.write_text(path.read_text().replace("tolerance = 0.0003", "patience = 0.0003", 1))
    with pytest.raises(RunError, match=r"rest\.patience = 0\.0003: must be a field of \[rest\]"):
        folder.experiment()


def test_folders_of_version_0_1_0_are_read(damaged):
    """Written as version 0.1.0 did: sentences for states, and contact and walls counted together."""
    path = damaged.path
    manifest, summary = files.read_json(path / MANIFEST), files.read_json(path / "evaluation.json")
    for name in ("valid_pattern", "cpu", "threads", "flags"):
        del manifest[name]
    manifest |= {"outcome": "no valid pattern was discovered", "format": 1, "checksums": trained_checksums(manifest)}
    files.write_json(path / MANIFEST, manifest)
    for name in ("contact_free", "inside", "thresholds", "stationary"):
        del summary[name]
    files.write_json(path / "evaluation.json", summary | {"collision_free": 1, "starts": "mine.csv"})
    arrays = files.read_npz(path / "trajectories.npz")
    files.write_npz(path / "trajectories.npz", {k: v for k, v in arrays.items() if k not in _LATER})
    assert damaged.verify()["valid_pattern"] is False
    assert (damaged.evaluation()["contact_free"], damaged.evaluation()["inside"]) == (1, 1)
    assert describe_starts(damaged.evaluation()) == "starts of mine.csv"
    assert damaged.trajectories(tiny()).lengths.tolist() == arrays["lengths"].tolist()
    # Whether patterns stay is not known: no summary says so, and no positions show it.
    assert np.isnan(damaged.evaluation()["stationary"])
    assert damaged.trajectories(tiny()).after_rest is None
    judged = evaluated(damaged)
    assert (judged["stationary"], judged["valid"]) == (0.0, 0.0)
    (line,) = describe_failures(damaged.experiment(), damaged.trajectories(tiny()))
    assert line.startswith("200 of 200 starts failed: what follows after rest was not recorded")
    change(path / "evaluation.json", starts="fresh")
    assert is_fresh(damaged.evaluation())
    damaged.write_evaluation(summary, arrays)
    assert damaged.manifest()["format"] == 2
    assert damaged.manifest()["checksums"].keys() >= {"evaluation.json", "trajectories.npz", "metrics.jsonl"}


def test_changed_files_are_found(damaged):
    path = damaged.path / "policies" / "0-base.safetensors"
    data = path.read_bytes()
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    with pytest.raises(RunError, match=r"0-base\.safetensors does not match its checksum in manifest\.json$"):
        damaged.verify()
    path.unlink()
    with pytest.raises(RunError, match="cannot read"):
        damaged.verify()


@pytest.mark.parametrize("manifest", [{"format": 3}, {"format": "1"}, {"format": True}, {}, [], 1])
def test_unknown_formats_are_refused(tmp_path, manifest):
    files.write_json(tmp_path / MANIFEST, manifest)
    with pytest.raises(RunError, match="this version of murmurate reads formats 1 and 2"):
        RunFolder(tmp_path).manifest()


@pytest.mark.parametrize(
    ("checksums", "line"),
    [
        (None, "has no checksums"),
        ([], "has no checksums"),
        ({"x": 3}, "has no checksums"),
        ({}, "does not list every policy with its checksum"),
    ],
)
def test_manifests_need_checksums(damaged, checksums, line):
    change(damaged.path / MANIFEST, checksums=checksums)
    with pytest.raises(RunError, match=line):
        damaged.manifest()


@pytest.mark.parametrize("name", ["../x", "/etc/hostname", "x\0y", "policies/2-auxiliary.safetensors", "figures/a.png"])
def test_checksums_are_of_files_of_a_run_and_no_others(damaged, name):
    change(damaged.path / MANIFEST, checksums={name: "0", **damaged.manifest()["checksums"]})
    with pytest.raises(RunError, match="which is no file of a run"):
        damaged.verify()


@pytest.mark.parametrize(
    ("policies", "line"),
    [
        ([], "does not list the policies"),
        ("base", "does not list the policies"),
        (None, "does not list the policies"),
        (["base"] * 2, "which are not those of a run"),
        (["base", "\x1b]0;x"], "which are not those of a run"),
        (["base", "auxiliary", "auxiliary"], "does not list every policy with its checksum"),
    ],
)
def test_every_policy_needs_a_checksum(damaged, policies, line):
    change(damaged.path / MANIFEST, policies=policies)
    with pytest.raises(RunError, match=line):
        damaged.manifest()


@pytest.mark.parametrize("name", ["evaluation.json", "trajectories.npz", "metrics.jsonl"])
def test_every_file_is_checked_when_it_is_read(damaged, name):
    reads = {
        "evaluation.json": damaged.evaluation,
        "trajectories.npz": lambda: damaged.trajectories(tiny()),
        "metrics.jsonl": damaged.metrics,
    }
    checksums = damaged.manifest()["checksums"]
    change(damaged.path / MANIFEST, checksums=checksums | {name: "0"})
    with pytest.raises(RunError, match=f"{name} does not match its checksum"):
        reads[name]()
    change(damaged.path / MANIFEST, checksums={file: sum_ for file, sum_ in checksums.items() if file != name})
    with pytest.raises(RunError, match=f"{name} does not match its checksum"):
        reads[name]()


def test_an_evaluation_that_was_killed_half_way_is_made_again(damaged):
    """Killed between the files of the evaluation and the manifest: the run opens, and evaluating it mends it."""
    change(damaged.path / "evaluation.json", valid=0.5)
    with pytest.raises(RunError, match="make it again with murmurate evaluate"):
        damaged.evaluation()
    evaluate(Run.open(damaged.path), episodes=4).save(damaged)
    assert damaged.evaluation()["episodes"] == 4
    assert damaged.trajectories(tiny()).positions.shape[0] == 4


def test_validity_is_computed_not_believed(damaged):
    summary = evaluated(damaged)
    assert summary == damaged.evaluation()
    assert summary["valid"] > 0
    arrays = files.read_npz(damaged.path / "trajectories.npz")
    arrays["positions"][:, 1:, 0] = 1e6
    damaged.write_evaluation(damaged.evaluation(), arrays)
    assert (evaluated(damaged)["valid"], evaluated(damaged)["inside"]) == (0, 0)
    assert evaluated(damaged)["failures"] == list(range(200))
    assert catalogues.read_findings(damaged.path) == ()


def test_trajectories_are_of_the_evaluation_beside_them(damaged):
    change(damaged.path / "evaluation.json", episodes=199, failures=[], valid=1.0)
    seal(damaged)
    with pytest.raises(RunError, match="is not of the evaluation beside it"):
        damaged.trajectories(tiny())


def test_nothing_is_claimed_of_positions_that_are_missing(damaged):
    (damaged.path / "trajectories.npz").unlink()
    seal(damaged)
    with pytest.raises(RunError, match=r"cannot read .*trajectories\.npz"):
        evaluated(damaged)
    with pytest.raises(RunError, match=r"cannot read .*trajectories\.npz"):
        catalogues.read_findings(damaged.path)


def test_everything_that_positions_show_is_computed(damaged):
    """Whatever the summary says: bounds, gaps, shares and signals."""
    true = evaluated(damaged)
    forged = {"bound_steps": 1e-9, "gap": -5.0, "best_known": 1e300, "efficiency": -3, "best_found": 1e300}
    forged |= {"signal": {"\x1b": 1e300}, "thresholds": {"\x1b": 1.0}, "experiment": "\x1b", "gathered": 1.0}
    change(damaged.path / "evaluation.json", **forged)
    seal(damaged)
    assert evaluated(damaged) == true


def test_failures_are_computed_too(damaged):
    """Of episodes that all fail nothing is believed either, even where some positions are not finite."""
    arrays = files.read_npz(damaged.path / "trajectories.npz")
    arrays["positions"][:, 1:, 0] = 1e6
    arrays["positions"][0] = arrays["after_rest"][0] = np.nan
    failed = damaged.evaluation() | {"valid": 0.0, "valid_interval": [0.0, 0.1], "failures": [*range(200)]}
    damaged.write_evaluation(failed, arrays)
    assert damaged.evaluation()["inside"] == 1
    summary = evaluated(damaged)
    assert (summary["valid"], summary["inside"], summary["contact_free"]) == (0, 0, 0.995)
    assert np.isnan(summary["bound_steps"])


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"failures": [*range(200)]}, "valid = 1.0 with 200 failures of 200"),
        ({"failures": [3], "valid": 0.99}, "valid = 0.99 with 1 failures of 200"),
        ({"valid": None}, "valid = None with 0 failures of 200"),
        ({"valid_interval": [0.1, 0.2]}, r"valid = 1.0 outside valid_interval = \[0.1, 0.2\]"),
        ({"contact_free": 0.5}, "contact_free = 0.5 below valid = 1.0"),
        ({"stationary": 0.0}, "stationary = 0.0 below valid = 1.0"),
        ({"bound_steps": 1e18}, "bound_steps = 1e[+]18 above total_steps = "),
        ({"base_steps": 2e9}, "total_steps = .* with base_steps = 2000000000.0"),
    ],
)
def test_a_summary_that_contradicts_itself_is_refused(damaged, values, line):
    assert damaged.evaluation()["failures"] == []
    change(damaged.path / "evaluation.json", **values)
    seal(damaged)
    with pytest.raises(RunError, match=f"contradicts itself: {line}") as caught:
        damaged.evaluation()
    assert str(caught.value).endswith(f"with murmurate evaluate {damaged.path}")
    assert main(["table", str(damaged.path)]) == 2


def test_folders_without_a_finished_run(tmp_path):
    with pytest.raises(RunError, match="holds no run"):
        RunFolder(tmp_path).manifest()
    RunFolder(tmp_path).write_experiment(tiny())
    with pytest.raises(RunError, match="holds an unfinished run: finish it with murmurate discover --resume"):
        RunFolder(tmp_path).manifest()


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"valid": "x"}, "has valid = 'x', which is not a share from 0 to 1"),
        ({"valid": 7}, "has valid = 7, which is not a share from 0 to 1"),
        ({"contact_free": -0.1}, "has contact_free = -0.1, which is not a share"),
        ({"thresholds": {"calm": 2}}, "has thresholds = .*, which are not shares by name"),
        ({"valid_interval": [0.9, 0.1]}, r"has valid_interval = \[0.9, 0.1\], which is not an interval"),
        ({"valid_interval": [0, 1.5]}, "which is not an interval inside 0 to 1"),
        ({"episodes": -5}, "has episodes = -5, which is not a number of episodes"),
        ({"episodes": 1e9}, "which is not a number of episodes from 1 to 10000"),
        ({"failures": [200]}, r"has failures = \[200\], which are not of its 200 episodes"),
        ({"failures": [1, 1]}, "which are not of its 200 episodes"),
        ({"total_steps": -1}, "has total_steps = -1, which is not a number of steps"),
        ({"starts": {"kind": "file"}}, "which is unknown"),
        ({"base_steps": True}, "has base_steps = True, which is not a number"),
        ({"valid_interval": "x"}, "has valid_interval = 'x', which is not an interval"),
        ({"valid_interval": [0, "x"]}, r"has valid_interval = \[0, 'x'\]"),
        ({"signal": {"total": "x"}}, "has signal = {'total': 'x'}, which are not numbers by name"),
        ({"episodes": 0}, "has episodes = 0, which is not a number of episodes"),
        ({"failures": 3}, "has failures = 3, which are not episodes"),
        ({"starts": {"kind": "x"}}, "which is unknown"),
        ({"starts": 3}, "has starts = 3, which is unknown"),
    ],
)
def test_evaluations_hold_numbers(damaged, values, line):
    change(damaged.path / "evaluation.json", **values)
    with pytest.raises(RunError, match=line) as caught:
        damaged.evaluation()
    assert str(caught.value).endswith(f"make it again with murmurate evaluate {damaged.path}")


def test_incomplete_evaluations_are_refused(damaged):
    path = damaged.path / "evaluation.json"
    path.write_text("{}")
    with pytest.raises(RunError, match="lacks starts: make it again"):
        damaged.evaluation()
    path.write_text("[]")
    with pytest.raises(RunError, match="does not hold a JSON object"):
        damaged.evaluation()


def test_what_could_not_be_computed_is_nan(damaged):
    change(damaged.path / "evaluation.json", bound_steps=None, valid_interval=[None, None])
    seal(damaged)
    assert np.isnan(damaged.evaluation()["bound_steps"])


@pytest.mark.parametrize(
    ("array", "line"),
    [
        ({"positions": np.zeros((200, 2, 3))}, r"positions as float64\[200, 2, 3\], not as float32\[episodes"),
        ({"positions": np.zeros((200, 2, 3, 2), "U1")}, "has positions as"),
        ({"lengths": np.zeros(199, int)}, r"has lengths as int64\[199\]"),
        ({"lengths": np.zeros(200)}, r"has lengths as float64\[200\]"),
        ({"lengths": np.full(200, 99)}, "has lengths that are not from 0 to"),
        ({"switch": np.zeros(200, int)}, "has switch as"),
        ({"signals": np.zeros((200, 2, 1))}, "has signals as"),
        ({"signal_names": np.array("x")}, "has signal_names as"),
        ({"at_rest": np.zeros(200)}, "has at_rest as"),
        ({"positions": None}, "lacks positions"),
    ],
)
def test_trajectories_fit_together(damaged, array, line):
    path = damaged.path / "trajectories.npz"
    arrays = files.read_npz(path) | array
    files.write_npz(path, {name: value for name, value in arrays.items() if value is not None})
    seal(damaged)
    with pytest.raises(RunError, match=line):
        damaged.trajectories(tiny())


@pytest.mark.parametrize(
    ("name", "forge", "line"),
    [
        ("switch", lambda a: np.full_like(a, 2**31 - 1), "switch that is not from 0 to the length"),
        ("switch", lambda a: a * 0 - 5, "switch that is not from 0 to the length"),
        ("switch", lambda a: np.repeat(a, 50, axis=1), r"switch as int32\[200, 50\]"),
        ("lengths", lambda a: a * 0, "switch that is not from 0 to the length"),
        ("lengths", lambda a: np.full(a.shape, 2**64 - 1, np.uint64), "lengths that are not from 0 to"),
        ("epochs", lambda a: a.astype(int) * 0 - 2**62, "epochs that so few steps can have"),
        ("epochs", lambda a: a + 99, "epochs that so few steps can have"),
        ("interventions", lambda a: np.full_like(a, 2**31 - 1), "interventions that no steps can have"),
        (
            "positions",
            lambda a: a + np.arange(a.shape[1], dtype=a.dtype)[:, None, None],
            "positions that change after the end",
        ),
    ],
)
def test_trajectories_are_possible(damaged, name, forge, line):
    path = damaged.path / "trajectories.npz"
    arrays = files.read_npz(path)
    if name == "positions":  # what follows the last step is after the end
        arrays |= {name: arrays[name] - 1 for name in ("lengths", "switch", "epochs")}
    files.write_npz(path, arrays | {name: forge(arrays[name])})
    seal(damaged)
    with pytest.raises(RunError, match=line):
        damaged.trajectories(tiny())
    assert main(["table", str(damaged.path)]) == 2


def test_robots_that_moved_were_not_at_rest(damaged):
    """At rest no robot moves farther than `stillness` radii in a step, for `window` steps of the last policy."""
    config, path = damaged.experiment(), damaged.path / "trajectories.npz"
    whole, window = files.read_npz(path), config.rest.window
    limit = config.rest.stillness * config.world.radius
    assert whole["at_rest"].all()

    def moved(step, distance, **arrays):
        """Writes episodes in the last of which a robot moves at a step, the last one being 1, and stays there."""
        positions = whole["positions"].copy()
        positions[-1, positions.shape[1] - step :, 0, 0] += distance
        files.write_npz(path, whole | {"positions": positions} | arrays)
        seal(damaged)
        return damaged.trajectories(config)

    for step in (1, window):
        with pytest.raises(RunError, match=f"at_rest in an episode whose robots moved in its last {window} steps$"):
            moved(step, 1.2 * limit)
        # Not farther than robots at rest do, nor than 32 bits tell apart.
        moved(step, 0.8 * limit)
    moved(window + 1, 0.1)
    moved(1, 0.1, at_rest=np.append(whole["at_rest"][:-1], False))
    with pytest.raises(RunError, match=f"at_rest in an episode whose last policy acted for fewer than the {window}"):
        moved(window + 1, 0.0, switch=np.full_like(whole["switch"], whole["lengths"][0] - window + 1))
    moved(1, 0.1, at_rest=np.append(whole["at_rest"][:-1], False))
    with pytest.raises(RunError, match="at_rest in an episode whose robots moved"):
        moved(1, 0.1)
    assert main(["table", str(damaged.path)]) == 2


def test_version_0_1_0_had_another_rule_of_rest(damaged):
    """Its runs stay readable: they recorded nothing after rest, so that nothing counts as valid in them."""
    arrays = files.read_npz(damaged.path / "trajectories.npz")
    arrays["positions"][:, -1, 0] += 0.1
    manifest = damaged.manifest()
    old = manifest | {"format": 1, "checksums": trained_checksums(manifest)}
    files.write_npz(damaged.path / "trajectories.npz", arrays)
    files.write_json(damaged.path / MANIFEST, old)
    with pytest.raises(RunError, match="at_rest in an episode whose robots moved"):
        damaged.trajectories(tiny())
    files.write_npz(damaged.path / "trajectories.npz", {k: v for k, v in arrays.items() if k not in _LATER})
    assert damaged.trajectories(tiny()).at_rest.all()
    assert evaluated(damaged)["valid"] == 0


@pytest.mark.parametrize(
    ("name", "dtype", "shape"),
    [
        ("positions", "<f4", lambda shape: (shape[0], 42, *shape[2:])),
        ("positions", "<f8", lambda shape: shape),
        ("signals", "<f8", lambda shape: shape),
        ("after_rest", "<f4", lambda shape: (shape[0], 201, *shape[2:])),
        ("signal_names", "<U1000000", lambda shape: shape),
        ("signal_names", "<U9", lambda shape: (1000,)),
    ],
)
def test_no_array_is_larger_than_the_experiment_allows(damaged, monkeypatch, name, dtype, shape):
    """Two policies of 20 steps at most, and 200 steps after rest: what is larger is refused before it takes memory."""
    path = damaged.path / "trajectories.npz"
    config, arrays = damaged.experiment(), files.read_npz(path)
    large = np.zeros(shape(arrays[name].shape), dtype)
    arrays[name] = large
    if name == "positions" and large.shape[1] == 42:
        arrays["signals"] = np.zeros((200, 42, 4), np.float32)
    if name == "signal_names" and len(large) == 1000:
        arrays["signals"] = np.zeros((200, arrays["positions"].shape[1], 1000), np.float32)
    files.write_npz(path, arrays)
    seal(damaged)
    monkeypatch.setattr(np.lib.format, "read_array", None)
    with pytest.raises(RunError, match=f"{name} as {re.escape(np.dtype(dtype).name)}|signal_names as"):
        damaged.trajectories(config)


def test_trajectories_are_finite(damaged):
    path = damaged.path / "trajectories.npz"
    arrays = files.read_npz(path)
    arrays["positions"][3, 1] = np.nan
    files.write_npz(path, arrays)
    seal(damaged)
    with pytest.raises(RunError, match="not finite: the training diverged"):
        damaged.trajectories(tiny())


def test_metrics_are_rows_of_numbers(damaged):
    with (damaged.path / "metrics.jsonl").open("a") as file:
        file.write(json.dumps({"policy": 0, "update": 1, "environment_steps": "x", "signals": {}}) + "\n")
    seal(damaged)
    with pytest.raises(RunError, match="line 9 is not a row of metrics"):
        damaged.metrics()


def test_a_copy_is_a_run_of_its_own(finished, tmp_path):
    copy = RunFolder(finished).copy_to(tmp_path / "copy")
    manifest = RunFolder(finished).manifest()
    assert {**copy.verify(), "checksums": trained_checksums(copy.manifest())} == {
        **manifest,
        "checksums": trained_checksums(manifest),
    }
    assert not (copy.path / "evaluation.json").exists()
    rows = RunFolder(finished).metrics()
    assert copy.metrics() == rows
    short = RunFolder(finished).copy_to(tmp_path / "short", metrics_every=3, changes={"platform": "any"})
    assert short.metrics() == [rows[2], rows[5]]
    assert short.verify()["platform"] == "any"
    with pytest.raises(RunError, match="holds another run"):
        RunFolder(finished).copy_to(copy)
