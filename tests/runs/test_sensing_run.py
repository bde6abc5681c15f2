"""A discovery by robots with their own eyes: trained, kept, resumed and executed like any other."""

from __future__ import annotations

import numpy as np
import pytest
from test_training import KEPT, StoppedError, stop_after

from murmurate.errors import InputError
from murmurate.runs import presets, train
from murmurate.runs.folder import RunFolder
from murmurate.runs.run import Run
from murmurate.world import DeadZone, LocalObservation
from tiny import KINDS, tiny

LOCAL = KINDS["local"]
ONE_POLICY = {"min_policies": 1, "max_policies": 1}


@pytest.fixture(scope="module")
def run(tiny_run):
    return Run.open(tiny_run("local"))


def test_it_is_opened_with_the_eyes_it_was_trained_with(run):
    assert run.experiment == tiny(**LOCAL)
    assert run.experiment.sensing.unit_ratio == 2.0
    assert isinstance(run.cascade.env, DeadZone)
    assert isinstance(run.cascade.env.env, LocalObservation)
    assert run.cascade.env.env.sensing.name == "visible"
    first, second = Run.open(run.folder).rollout(4, key=1), run.rollout(4, key=1)
    np.testing.assert_array_equal(first.positions, second.positions)
    assert first.positions.shape[2:] == (3, 2)
    assert RunFolder(run.folder).evaluation()["contact_free"] > 0.5


def test_resuming_ends_in_the_same_bytes(run, tmp_path):
    folder = tmp_path / "run"
    with pytest.raises(StoppedError):
        train.discover(tiny(**LOCAL), folder, on_progress=stop_after(3))
    train.discover(tiny(**LOCAL), folder, resume=True)
    for name in KEPT:
        assert (folder / name).read_bytes() == (run.folder / name).read_bytes(), name


def test_runs_without_a_word_on_sensing_perceive_everything(tmp_path):
    RunFolder(tmp_path).write_experiment(tiny())
    path = tmp_path / "experiment.toml"
    before, _, after = path.read_text().partition("[sensing]")
    path.write_text(before + after.partition("\n[")[1] + after.partition("\n[")[2])
    assert "sensing" not in path.read_text()
    assert RunFolder(tmp_path).experiment() == tiny()


def test_a_run_has_a_scheduler_of_its_own_and_counts_epochs(tmp_path):
    scheduler = {"use": "async", "max_delay": 1, "max_move_steps": 2, "rigid": False}
    original = train.discover(tiny(scheduler=scheduler, discovery=ONE_POLICY), tmp_path / "run")
    again = Run.open(original.folder)
    assert again.experiment.scheduler == original.experiment.scheduler
    assert again.cascade.rest.window == original.experiment.rest.window * 4
    trajectories = again.rollout(16)
    assert (trajectories.epochs > 0).all()
    assert (trajectories.epochs < trajectories.lengths).all()
    assert RunFolder(original.folder).evaluation()["epochs"] > 0


def test_without_a_scheduler_an_epoch_is_a_step(run):
    trajectories = run.rollout(4)
    assert (trajectories.epochs == trajectories.lengths).all()


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["central", "equivariant", "local"])
def test_every_policy_may_be_scheduled(kind, tmp_path):
    credit = {"credit": "swarm"} if kind == "central" else {}
    scheduler = {"use": "ssync", "adversarial": True}
    policy = {"policy": {"use": kind, "hidden": [8, 4], **credit}}
    config = tiny(**LOCAL if kind == "local" else policy, scheduler=scheduler, discovery=ONE_POLICY)
    trajectories = train.discover(config, tmp_path / "run").rollout(4)
    assert (trajectories.epochs <= trajectories.lengths).all()


@pytest.mark.parametrize(
    ("overlay", "line"),
    [
        ({"sensing": {"use": "visible"}}, "sensing.use = 'visible': must be global: with the policy formation"),
        ({"sensing": {"rotation": True}}, "sensing.rotation = True: must be False: with the policy formation"),
        ({"policy": {"use": "local"}, "sensing": {"landmark": False}}, "sensing.landmark = False: must be true with"),
        ({"policy": {"use": "local", "credit": "swarm"}}, "policy.credit = 'swarm': must be robots: with local"),
        ({"policy": {"use": "local"}, "sensing": {"use": "radar"}}, "sensing.use = 'radar': must be"),
        ({"scheduler": {"use": "psync"}}, "scheduler.use = 'psync': must be one of fsync, ssync, async"),
        ({"scheduler": {"use": "async", "adversarial": True}}, "scheduler.adversarial = True: must be a field of"),
    ],
)
def test_eyes_that_do_not_serve_are_refused(overlay, line):
    with pytest.raises(InputError) as caught:
        presets.resolve("C", overlay)
    assert str(caught.value).startswith(line)


def test_an_undefined_point_needs_no_landmark():
    assert presets.resolve("F", {"policy": {"use": "local"}, "sensing": {"landmark": False}}).objective == "C2"


def test_the_learner_local_is_the_equivariant_one_with_other_eyes():
    local, usual = presets.TRAINING_PRESETS["local"], presets.TRAINING_PRESETS["equivariant"]
    assert local.policy.name == "local"
    assert (local.base, local.auxiliary, local.rest) == (usual.base, usual.auxiliary, usual.rest)
