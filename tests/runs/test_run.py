from __future__ import annotations

import json
import shutil

import jax
import numpy as np
import pytest

import murmurate
from murmurate.errors import InputError, RunError
from murmurate.runs import storage
from murmurate.runs.run import Run
from tiny import tiny


@pytest.fixture(scope="module")
def run(finished):
    return murmurate.load(finished)


@pytest.fixture
def damaged(finished, tmp_path):
    """A copy of the run that a test may break."""
    return shutil.copytree(finished, tmp_path / "run")


def test_a_run_gives_its_parts(run, finished):
    assert run.folder == finished
    assert run.experiment == tiny()
    assert len(run.cascade.policies) == 2
    assert run.world is run.cascade.world
    assert run.manifest["format"] == 1


def test_the_cascade_does_again_what_was_recorded(run, finished):
    recorded = storage.read_npz(finished / "trajectories.npz")
    again = run.rollout(recorded["positions"][:, 0])
    assert again.positions.tobytes() == recorded["positions"].tobytes()
    assert again.switch.tolist() == recorded["switch"].tolist()
    assert run.rollout(200, 0).positions.tobytes() == recorded["positions"].tobytes()


def test_fresh_starts_come_from_the_key(run):
    first = run.starts(8, 1)
    assert first.shape == (8, 3, 2)
    assert np.array_equal(first, run.starts(8, np.int32(1)))
    assert not np.array_equal(first, run.starts(8, 2))
    assert not np.array_equal(first, run.starts(8, jax.random.key(1)))
    assert np.array_equal(run.rollout(8, jax.random.key(1)).positions[:, 0], run.starts(8, jax.random.key(1)))


def test_one_configuration_is_one_episode(run):
    start = [[-5.0, 0.0], [5.0, 0.0], [0.0, 5.0]]
    ran = run.rollout(start)
    assert ran.positions.shape[0] == 1
    assert ran.positions[0, 0].tolist() == start


@pytest.mark.parametrize(
    ("starts", "line"),
    [
        (0, "episodes = 0: must be an integer >= 1 and <= 10000"),
        (10_001, "episodes = 10001: must be"),
        (np.zeros((2, 2)), "starts = 'an array (1, 2, 2)': must be of shape (episodes, 3, 2)"),
        (np.zeros(6), "starts = 'an array (6,)': must be of shape (episodes, 3, 2)"),
        (np.zeros((0, 3, 2)), "episodes = 0"),
        (np.zeros((3, 2)), "starts: start 0 = 'overlapping robots'"),
        ([[0, 0], [5, 0], [50, 0]], "starts: start 0 = 'a robot outside'"),
        ([[0, 0], [5, 0], [np.nan, 0]], "starts: start 0 = 'a robot outside'"),
    ],
)
def test_bad_starts_are_refused(run, starts, line):
    with pytest.raises(InputError) as caught:
        run.rollout(starts)
    assert str(caught.value).startswith(line)


def test_bad_seeds_are_refused(run):
    with pytest.raises(InputError, match="seed = -1"):
        run.starts(8, -1)


def change_manifest(folder, **changes):
    manifest = storage.read_manifest(folder) | changes
    storage.write_json(folder / "manifest.json", manifest)


def test_a_changed_file_is_found(damaged):
    path = damaged / "policies" / "1-auxiliary.safetensors"
    path.write_bytes(path.read_bytes()[:-4] + b"\0\0\0\1")
    with pytest.raises(RunError, match=r"1-auxiliary.safetensors does not match its checksum"):
        Run.open(damaged)


def test_an_unknown_version_is_refused(damaged):
    change_manifest(damaged, format=2)
    with pytest.raises(RunError, match="has format 2; this version of murmurate reads format 1"):
        Run.open(damaged)


@pytest.mark.parametrize("policies", [[], "base", None, ["base"] * 3])
def test_every_policy_needs_a_checksum(damaged, policies):
    change_manifest(damaged, policies=policies)
    with pytest.raises(RunError, match="does not list every policy with its checksum"):
        Run.open(damaged)


def test_policies_of_another_experiment_are_refused(damaged):
    path = damaged / "experiment.toml"
    path.write_text(path.read_text().replace("robots = 3", "robots = 4"))
    change_manifest(damaged, checksums=storage.checksums(damaged, storage.read_manifest(damaged)["checksums"]))
    with pytest.raises(RunError, match=r"0-base.safetensors has 'body/layers/0/weight'"):
        Run.open(damaged)


def test_missing_folders_are_one_line(tmp_path):
    with pytest.raises(RunError, match="holds no run"):
        murmurate.load(str(tmp_path / "none"))


def test_a_copy_is_a_run_of_its_own(run, tmp_path):
    copy = run.copy(tmp_path / "copy")
    assert Run.open(copy).rollout(8).positions.tobytes() == run.rollout(8).positions.tobytes()
    assert run.copy(copy) == copy
    (copy / "manifest.json").write_text(json.dumps({"format": 1}))
    with pytest.raises(RunError, match="holds another run"):
        run.copy(copy)
