from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binomtest

from murmurate.analysis.optimum import best_known
from murmurate.analysis.optimum.best_known import BestKnown
from murmurate.discovery import Trajectories, Validity, check_validity
from murmurate.errors import RunError
from murmurate.runs import files, table
from murmurate.runs.evaluate import Evaluation, wilson
from murmurate.runs.failures import describe_failures
from murmurate.runs.folder import RunFolder
from tiny import tiny

NAMES = ("nclose", "safety", "neighbors", "visible")


def made_up(switch, lengths, valid, bound=(10.0, 30.0)):
    """Two episodes of three robots that stand still."""
    lengths, valid = np.array(lengths, np.int32), np.array(valid)
    steps = lengths.max() + 1
    alphabetical = enumerate(sorted(NAMES), 1)
    signals = {name: np.full((2, steps), 0.1 * rank, np.float32) for rank, name in alphabetical}
    still = np.zeros((2, steps, 3, 2), np.float32)
    trajectories = Trajectories(
        still, lengths, np.array(switch, np.int32).reshape(2, -1), valid, ~valid, signals, lengths
    )
    yes = np.ones(2, bool)
    return Evaluation(
        tiny(), 5, {"kind": "fresh"}, trajectories, Validity(yes, yes, yes, yes, yes, valid, valid), np.array(bound)
    )


def test_means_are_over_all_episodes():
    summary = made_up([[20], [40]], [30, 70], [True, False]).summary()
    assert {name: summary[name] for name in ("experiment", "robots", "episodes", "seed", "starts")} == {
        "experiment": "tiny",
        "robots": 3,
        "episodes": 2,
        "seed": 5,
        "starts": {"kind": "fresh"},
    }
    assert (summary["contact_free"], summary["inside"], summary["at_rest"], summary["valid"]) == (1.0, 1.0, 0.5, 0.5)
    assert (summary["base_steps"], summary["auxiliary_steps"], summary["total_steps"]) == (30, 20, 50)
    assert (summary["bound_steps"], summary["efficiency"]) == (20, 0.4)
    assert summary["failures"] == [1]
    # Of where the robots are, all in one place, whatever was recorded beside it.
    assert summary["signal"] == {"nclose": 1, "safety": -1, "neighbors": 1, "visible": 1, "total": 2}


def test_auxiliary_steps_are_those_of_all_later_policies():
    summary = made_up([[20, 25], [40, 65]], [30, 70], [True, True]).summary()
    assert (summary["base_steps"], summary["auxiliary_steps"]) == (30, 20)
    alone = made_up([[], []], [30, 70], [True, True]).summary()
    assert (alone["base_steps"], alone["auxiliary_steps"], alone["total_steps"]) == (50, 0, 50)


def test_signals_are_recorded_in_the_order_of_their_names():
    arrays = made_up([[20], [40]], [30, 70], [True, False]).arrays()
    assert arrays["signal_names"].tolist() == list(NAMES)
    assert arrays["signals"][0, 0].tolist() == pytest.approx([0.1, 0.3, 0.2, 0.4])
    assert arrays["objective"][0, 0] == pytest.approx(1.0)


def test_what_cannot_be_computed_is_null(tmp_path):
    made_up([[20], [40]], [30, 70], [False, False], bound=(np.nan, 1.0)).save(tmp_path)
    text = (tmp_path / "evaluation.json").read_text()
    assert json.loads(text)["bound_steps"] is None
    assert "NaN" not in text
    assert files.read_npz(tmp_path / "trajectories.npz")["lengths"].tolist() == [30, 70]


@pytest.mark.parametrize(("successes", "trials"), [(0, 200), (1, 7), (198, 200), (200, 200)])
def test_wilson_interval(successes, trials):
    expected = binomtest(successes, trials).proportion_ci(method="wilson")
    assert wilson(successes, trials) == pytest.approx((expected.low, expected.high), abs=1e-4)


def stands_still(positions, **world):
    """One valid episode in which three robots stand at the given positions."""
    signals = {name: np.ones((1, 1), np.float32) for name in NAMES}
    none, yes = np.zeros(1, bool), np.ones(1, bool)
    zero = np.zeros(1, np.int32)
    trajectories = Trajectories(
        np.array(positions, np.float32)[None, None], zero, np.zeros((1, 0), np.int32), yes, none, signals, zero
    )
    validity = Validity(yes, yes, yes, yes, yes, yes, yes)
    return Evaluation(
        tiny(world={"safe_distance": 5.0, **world}), 0, {"kind": "fresh"}, trajectories, validity, np.array([0.0])
    )


TRIANGLE = 2.9 * np.array([[1, 0], [-0.5, np.sqrt(0.75)], [-0.5, -np.sqrt(0.75)]])


def test_the_gap_is_to_the_best_known_pattern():
    evaluation = stands_still(TRIANGLE)
    summary = evaluation.summary()
    reach = 2 * np.hypot(12, 12)
    assert summary["best_known"] == pytest.approx(4 - 5 / reach)
    assert summary["best_found"] == pytest.approx(4 - 2.9 * np.sqrt(3) / reach, abs=1e-6)
    assert summary["gap"] == pytest.approx(summary["best_known"] - summary["signal"]["total"])
    assert evaluation.record() is None
    unknown = stands_still(TRIANGLE, radius=0.9).summary()
    assert (unknown["best_known"], unknown["gap"]) == (None, None)


def test_a_pattern_that_beats_the_table_is_offered_as_a_record(tmp_path, monkeypatch):
    evaluation = stands_still(TRIANGLE)
    evaluation.save(tmp_path)
    assert not (tmp_path / "record.json").exists()
    worse = BestKnown.from_target(evaluation.target, 1.1 * TRIANGLE, "by hand")
    monkeypatch.setattr(best_known, "load", lambda: (worse,))
    evaluation.save(tmp_path)
    record = BestKnown.from_dict(files.read_json(tmp_path / "record.json"))
    assert record.positions == pytest.approx(TRIANGLE, abs=1e-6)
    assert record.value == pytest.approx(evaluation.summary()["best_found"])
    assert record.command == "murmurate discover tiny.toml --seed 0"
    monkeypatch.undo()
    evaluation.save(tmp_path)
    assert not (tmp_path / "record.json").exists()


def test_interventions_of_a_shield_are_recorded_and_shown(tmp_path):
    evaluation = made_up([[10], [15]], [20, 30], [True, False])
    assert "interventions" not in evaluation.summary()
    trajectories = replace(evaluation.trajectories, interventions=np.array([3, 4], np.int32))
    evaluation = replace(evaluation, trajectories=trajectories)
    folder = RunFolder(tmp_path)
    folder.write_experiment(evaluation.experiment)
    evaluation.save(folder)
    np.testing.assert_array_equal(folder.trajectories(folder.experiment()).interventions, [3, 4])
    summary = folder.evaluation()
    assert summary["interventions"] == 3.5
    assert ("moves shortened by the shield, an episode", "3.5") in table.comparison(summary, None)[1]


def test_what_follows_after_rest_is_recorded_and_shown(tmp_path):
    """Of two patterns one stays; the other's robots drift apart."""
    square = np.array([[0.0, 0.0], [5.0, 0.0], [0.0, 5.0]])
    evaluation = made_up([[10], [15]], [20, 30], [True, True])
    after = np.stack([[square] * 3, [square, 1.1 * square, 1.2 * square]]).astype(np.float32)
    positions = np.broadcast_to(square.astype(np.float32), evaluation.trajectories.positions.shape)
    trajectories = replace(evaluation.trajectories, positions=positions, after_rest=after)
    experiment = evaluation.experiment
    validity = check_validity(trajectories, experiment.world)
    evaluation = replace(evaluation, trajectories=trajectories, validity=validity)
    folder = RunFolder(tmp_path)
    folder.write_experiment(experiment)
    evaluation.save(folder)
    np.testing.assert_array_equal(folder.trajectories(folder.experiment()).after_rest, after)
    summary = folder.evaluation()
    assert list(summary).index("stationary") == list(summary).index("at_rest") + 1
    assert (summary["at_rest"], summary["stationary"], summary["valid"], summary["failures"]) == (1.0, 0.5, 0.5, [1])
    assert ("stationary", "1 of 2") in table.comparison(summary, None)[1]
    assert describe_failures(experiment, trajectories)[0] == "1 of 2 starts failed: 1 not stationary"
    arrays = files.read_npz(tmp_path / "trajectories.npz")
    files.write_npz(tmp_path / "trajectories.npz", arrays | {"after_rest": after[:, :, :2]})
    with pytest.raises(RunError, match="has after_rest as"):
        folder.trajectories(folder.experiment())
    files.write_npz(tmp_path / "trajectories.npz", arrays | {"after_rest": after * np.nan})
    with pytest.raises(RunError, match="not finite"):
        folder.trajectories(folder.experiment())
