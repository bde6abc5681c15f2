"""`murmurate export`, as its user would try it: with real arguments and wrong ones."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from murmurate import interop
from murmurate.cli.main import main

pytestmark = [
    pytest.mark.filterwarnings("ignore:::(jax2onnx|onnx|onnx_ir|flax|orbax|google).*"),
    pytest.mark.usefixtures("quick_conversion"),
]


def complaint(capsys, arguments):
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


def test_a_model_that_onnxruntime_runs(discovered, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["export", str(discovered), "--onnx"]) == 0
    out = capsys.readouterr().out
    assert "input: positions batch x 3 x 2, float32" in out
    assert "greatest difference over 1,000 configurations:" in out
    assert out.endswith("model: central.onnx\n")
    import onnxruntime

    session = onnxruntime.InferenceSession("central.onnx")
    shapes = {model_input.name: model_input.shape for model_input in session.get_inputs()}
    inputs = {"positions": np.zeros((4, 3, 2), np.float32), "memory": np.zeros((4, shapes["memory"][1]), np.float32)}
    assert session.run(None, inputs)[0].shape == (4, 3, 2)
    assert "central.onnx exists: choose another --out" in complaint(capsys, ["export", str(discovered), "--onnx"])


def test_one_policy_has_no_memory(discovered, tmp_path, capsys):
    out = str(tmp_path / "one.onnx")
    assert main(["export", str(discovered), "--onnx", "--policy", "1", "--opset", "17", "--out", out]) == 0
    assert "input: memory" not in capsys.readouterr().out
    from onnx import load

    assert [each.version for each in load(out).opset_import] == [17]


@pytest.mark.parametrize("kind", ["csv", "json"])
def test_waypoints(discovered, tmp_path, monkeypatch, capsys, kind):
    monkeypatch.chdir(tmp_path)
    arguments = ["export", str(discovered), "--trajectories", kind, "--scale", "0.05", "--episodes", "3"]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "metres per world unit: 0.05" in out
    assert out.endswith(f"waypoints: central.{kind}\n")
    assert f"central.{kind} exists" in complaint(capsys, arguments)


def test_wrong_words_are_one_line_and_write_nothing(discovered, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = str(discovered)
    wrong = {
        ("nowhere", "--onnx"): "nowhere holds no run",
        ("nowhere", "--trajectories", "csv"): "nowhere holds no run",
        (run,): "give one of --onnx and --trajectories",
        (run, "--onnx", "--trajectories", "csv"): "give one of --onnx and --trajectories",
        (run, "--trajectories", "xml"): "--trajectories = 'xml': must be one of csv, json",
        ("--trajectories", "csv"): "needs a RUN",
        (run, "--onnx", "--scale", "2"): "--scale is for --trajectories",
        (run, "--trajectories", "csv", "--policy", "0"): "--policy is for --onnx",
        (run, "--trajectories", "csv", "--opset", "17"): "--opset is for --onnx",
        (run, "--onnx", "--opset", "16"): "--opset = 16: must be an integer >= 17 and <= 23",
        (run, "--onnx", "--policy", "7"): "--policy = 7: must be 0 to 1",
        (run, "--trajectories", "csv", "--scale", "-1"): "--scale = -1.0",
        (run, "--trajectories", "csv", "--episodes", "0"): "--episodes = 0",
        (run, "--onnx", "--out", "missing/x.onnx"): "there is no folder missing",
        (run, "--onyx"): "unknown flag --onyx; did you mean --onnx?",
    }
    for arguments, text in wrong.items():
        assert text in complaint(capsys, ["export", *arguments])
    assert list(tmp_path.iterdir()) == []


def test_a_missing_extra_says_how_to_install_it(discovered, tmp_path, monkeypatch, capsys):
    for name in [name for name in sys.modules if name.startswith("murmurate.interop.onnx")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delattr(interop, "onnx", raising=False)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    arguments = ["export", str(discovered), "--onnx", "--out", str(tmp_path / "x.onnx")]
    assert 'pip install "murmurate[onnx]"' in complaint(capsys, arguments)
