"""Training curves for TensorBoard: the same points as in metrics.jsonl, each once."""

from __future__ import annotations

import json
import struct

import pytest

from murmurate.cli.main import main
from murmurate.errors import RunError
from murmurate.interop.tensorboard import FOLDER, Events, scalars
from murmurate.runs import train
from murmurate.runs.folder import METRICS
from tiny import tiny, write_toml


def read(folder):
    """Reads events back: (curve, step, value, time), by the format itself (a length, its checksum, a message, its)."""
    from tensorboardX.proto.event_pb2 import Event

    points = []
    for path in sorted((folder / FOLDER).iterdir()):
        data = path.read_bytes()
        while data:
            (length,) = struct.unpack("<Q", data[:8])
            event = Event.FromString(data[12 : 12 + length])
            points += [(value.tag, event.step, value.simple_value, event.wall_time) for value in event.summary.value]
            data = data[16 + length :]
    return points


def expected(folder):
    rows = [json.loads(line) for line in (folder / METRICS).read_text().splitlines()]
    return [(name, row["environment_steps"], value) for row in rows for name, value in scalars(row)]


def test_every_point_is_there_once(tmp_path):
    with Events() as events:
        train.discover(tiny(), tmp_path / "run", on_metrics=events)
    points = read(tmp_path / "run")
    assert len(points) == len(expected(tmp_path / "run")) > 20
    for (name, step, value, _), (true_name, true_step, true_value) in zip(
        sorted(points), sorted(expected(tmp_path / "run")), strict=True
    ):
        assert (name, step) == (true_name, true_step)
        assert value == pytest.approx(true_value, rel=1e-6)
    assert {"reward", "objective", "signals/visible", "steps_per_second"} <= {name for name, *_ in points}
    assert len({step for _, step, *_ in points}) == 8  # four updates of each policy, one after the other


def test_what_an_interruption_lost_is_not_there_twice(tmp_path):
    folder = tmp_path / "run"

    calls = []
    first = Events()

    def stop(folder):
        first(folder)
        calls.append(folder)
        if len(calls) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train.discover(tiny(), folder, on_metrics=stop)
    with Events() as events:
        train.discover(tiny(), folder, resume=True, on_metrics=events)
    keys = [(name, step) for name, step, *_ in read(folder)]
    assert len(keys) == len(set(keys)) == len(expected(folder))


def test_a_finished_run_gets_its_curves_afterwards(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    arguments = ["discover", str(write_toml(tmp_path / "tiny.toml")), "--out", "run"]
    assert main(arguments) == 0
    assert not (tmp_path / "run" / FOLDER).exists()
    assert main([*arguments, "--resume", "--tensorboard"]) == 0
    assert len(read(tmp_path / "run")) == len(expected(tmp_path / "run"))


def test_many_runs_have_their_curves_each(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = ["discover", str(write_toml(tmp_path / "tiny.toml")), "--seeds", "2", "--out", "runs", "--tensorboard"]
    assert main(arguments) == 0
    for seed in (0, 1):
        folder = tmp_path / "runs" / f"tiny-central-seed{seed}"
        assert len(read(folder)) == len(expected(folder))


def test_what_is_not_finite_has_no_point():
    assert dict(scalars({"a": None, "b": 1, "signals": {"c": None, "d": 0.5}, "name": "base"})) == {
        "b": 1.0,
        "signals/d": 0.5,
    }


def test_damaged_metrics_are_one_line(tmp_path):
    (tmp_path / METRICS).write_text("{\n")
    with Events() as events, pytest.raises(RunError, match="is damaged"):
        events(tmp_path)


def test_metrics_of_a_stranger_have_the_points_that_they_can_have(tmp_path):
    row = {"policy": 0, "name": "base", "update": 1, "environment_steps": 8.5, "signals": {"a": 0.5}, "x": 10**399}
    (tmp_path / METRICS).write_text(json.dumps(row) + "\n")
    with Events() as events:
        events(tmp_path)
    points = {(name, step, value) for name, step, value, _ in read(tmp_path)}
    assert points == {("policy", 8, 0.0), ("update", 8, 1.0), ("signals/a", 8, 0.5)}


def test_a_linked_folder_is_refused(tmp_path):
    run, elsewhere = tmp_path / "run", tmp_path / "elsewhere"
    run.mkdir()
    for target in (elsewhere, tmp_path):  # one that is not there, and one that is
        (run / FOLDER).unlink(missing_ok=True)
        (run / FOLDER).symlink_to(target)
        with pytest.raises(RunError, match="tensorboard is a link"), Events() as events:
            events(run)
    assert not elsewhere.exists()
