from __future__ import annotations

import shutil
from dataclasses import replace

import jax
import numpy as np
import pytest

import murmurate
from murmurate.errors import InputError, RunError
from murmurate.runs import files
from murmurate.runs.evaluate import evaluate
from murmurate.runs.folder import RunFolder
from murmurate.runs.run import Run
from murmurate.world import SsyncScheduler
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
    assert run.manifest["format"] == 2


def test_the_cascade_does_again_what_was_recorded(run, finished):
    recorded = files.read_npz(finished / "trajectories.npz")
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
    trajectories = run.rollout(start)
    assert trajectories.positions.shape[0] == 1
    assert trajectories.positions[0, 0].tolist() == start


@pytest.mark.parametrize(
    ("starts", "line"),
    [
        (0, "episodes = 0: must be an integer >= 1 and <= 10000"),
        (10_001, "episodes = 10001: must be"),
        (np.zeros((2, 2)), "starts = 'an array (1, 2, 2)': must be of shape (episodes, 3, 2)"),
        ("x", "starts = 'x': must be one of random, polygon, line, grid, rings"),
        (object(), "starts = <object object at "),
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
    for key in (-1, 1.5, "1", True):
        with pytest.raises(InputError, match="seed = "):
            run.starts(8, key)


def test_a_changed_file_is_found(damaged):
    path = damaged / "policies" / "1-auxiliary.safetensors"
    path.write_bytes(path.read_bytes()[:-4] + b"\0\0\0\1")
    with pytest.raises(RunError, match=r"1-auxiliary.safetensors does not match its checksum"):
        Run.open(damaged)


def test_policies_of_another_experiment_are_refused(damaged):
    path = damaged / "experiment.toml"
    path.write_text(path.read_text().replace("robots = 3", "robots = 4"))
    manifest = RunFolder(damaged).manifest()
    manifest["checksums"]["experiment.toml"] = files.checksum(path)
    files.write_json(damaged / "manifest.json", manifest)
    with pytest.raises(RunError, match=r"0-base\.safetensors has '.* is needed"):
        Run.open(damaged)


def test_missing_folders_are_one_line(tmp_path):
    with pytest.raises(RunError, match="holds no run"):
        murmurate.load(str(tmp_path / "none"))


def test_a_saved_run_is_opened_again(run, tmp_path):
    saved = Run.open(run.save(tmp_path / "saved"))
    assert saved.rollout(8).positions.tobytes() == run.rollout(8).positions.tobytes()
    assert saved.experiment == run.experiment
    with pytest.raises(RunError, match="holds another run"):
        run.save(tmp_path / "saved")


def test_runs_and_what_they_do_are_one_line(run):
    assert repr(run) == "Run(tiny: 3 robots, C2, 2 central policies)"
    assert repr(run.rollout(4)).startswith("Trajectories(4 episodes of 3 robots, ")
    assert repr(evaluate(run, 4)).startswith("Evaluation(tiny: ")


def test_notebooks_show_pictures(run):
    other = run.under(replace(run.experiment, scheduler=SsyncScheduler()))
    for shown in (run, other, evaluate(run, 4)):
        assert shown._repr_png_().startswith(b"\x89PNG")


def test_the_key_reaches_scheduler_and_frames(run):
    """With the same starts, other keys activate other robots; a key of jax.random counts as well."""
    restless = replace(run.experiment, rest=replace(run.experiment.rest, dead_zone=0.0))
    half = run.under(replace(restless, scheduler=SsyncScheduler(activation_probability=0.5)))
    starts = run.starts(4)
    keys = (0, 1, jax.random.key(0), jax.random.key(1))
    positions = [half.rollout(starts, key).positions[:, 1].tobytes() for key in keys]
    assert len(set(positions)) == len(keys)
    assert half.rollout(starts, 1).positions[:, 1].tobytes() == positions[1]
    assert half.cascade.rollout(starts).positions[:, 1].tobytes() == positions[0]
    assert evaluate(half, seed=1, starts=starts).trajectories.positions[:, 1].tobytes() == positions[1]


def test_flags_change_no_number(run):
    usual = run.rollout(4, 3)
    with jax.enable_x64(True), jax.default_prng_impl("rbg"):
        unusual = run.rollout(4, 3)
    assert unusual.positions.dtype == np.float32
    assert np.array_equal(usual.positions, unusual.positions)
