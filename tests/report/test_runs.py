"""The runs of a plan: reused, continued, or refused before anything is trained."""

from __future__ import annotations

import json
import shutil

import pytest

from murmurate.errors import RunError
from murmurate.report import runs as work
from murmurate.runs import experiment as configuration
from murmurate.runs import train
from murmurate.runs.folder import RunFolder, trained_checksums
from tiny import seal, tiny


@pytest.fixture
def mine(runs, tmp_path):
    """A copy of the finished runs that a test may change."""
    return shutil.copytree(runs, tmp_path / "runs")


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_finished_runs_are_reused_as_they_are(plan, mine, monkeypatch):
    before = contents(mine)
    monkeypatch.setattr(train, "advance_together", None)
    assert work.check(plan, mine) == {planned.name: "finished" for planned in plan.runs}
    assert [result.summary["episodes"] for result in work.train(plan, mine)] == [200, 200]
    assert contents(mine) == before


def test_an_interrupted_run_goes_on_to_the_same_weights(plan, runs, tmp_path, monkeypatch):
    planned, advance, left = plan.runs[0], train.advance_together, [2]

    def interrupted(*args):
        if not left[0]:
            raise KeyboardInterrupt
        left[0] -= 1
        return advance(*args)

    monkeypatch.setattr(train, "advance_together", interrupted)
    with pytest.raises(KeyboardInterrupt):
        work.train(plan, tmp_path)
    monkeypatch.setattr(train, "advance_together", advance)
    assert work.check(plan, tmp_path) == {plan.runs[0].name: "unfinished", plan.runs[1].name: "new"}
    result = work.train(plan, tmp_path)[0]
    whole = RunFolder(runs / planned.name).manifest()
    assert trained_checksums(result.manifest) == trained_checksums(whole)


def broken_checkpoint(folder, other):
    (folder / "manifest.json").unlink()
    (folder / "checkpoint").mkdir()
    (folder / "checkpoint" / "snapshot.safetensors").write_bytes(b"nothing")


def other_experiment(folder, other):
    configuration.save(other, folder)


def broken_policy(folder, other):
    (folder / "policies" / "0-base.safetensors").write_bytes(b"")


def broken_trajectories(folder, other):
    (folder / "trajectories.npz").write_bytes(b"nothing")


def foreign(folder, other):
    shutil.rmtree(folder)
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")


def other_starts(folder, other):
    summary = json.loads((folder / "evaluation.json").read_text())
    (folder / "evaluation.json").write_text(json.dumps(summary | {"starts": "mine.csv"}))
    seal(RunFolder(folder))


def poor_manifest(folder, other):
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({k: v for k, v in manifest.items() if k != "device"}))


@pytest.mark.parametrize(
    ("spoil", "line"),
    [
        (other_experiment, "holds another experiment: seed is 9 there, 1 here"),
        (broken_policy, "does not match its checksum"),
        (broken_trajectories, "is not a valid npz file"),
        (foreign, "holds other files"),
        (other_starts, "was evaluated from other starts: make it again with murmurate evaluate"),
        (poor_manifest, "lacks device"),
        (broken_checkpoint, "snapshot.safetensors"),
    ],
)
def test_what_cannot_be_used_is_refused_before_anything_is_trained(plan, mine, monkeypatch, spoil, line):
    first, last = plan.runs
    shutil.rmtree(mine / first.name)
    spoil(mine / last.name, tiny(seed=9))
    before = contents(mine)
    with pytest.raises(RunError, match=line):
        work.check(plan, mine)
    assert contents(mine) == before
    assert not (mine / first.name).exists()


def test_nothing_is_written_by_checking(plan, tmp_path):
    assert work.check(plan, tmp_path / "none") == {planned.name: "new" for planned in plan.runs}
    assert list(tmp_path.iterdir()) == []
