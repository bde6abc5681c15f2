"""The examples run, each with a tiny budget."""

from __future__ import annotations

import ast
import importlib.util
import json
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


def main_of(name):
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.main


def test_random_agent(capsys):
    lengths = main_of("random_agent")(robots=3, episodes=2, horizon=5)
    assert all(1 <= length <= 5 for length in lengths)
    assert capsys.readouterr().out.count("ended") == len(lengths) == 2


def test_vector_loop():
    history = main_of("vector_loop")(updates=12, num_envs=32, robots=3, steps=16)
    assert np.mean(history[-3:]) > np.mean(history[:3])


def test_pettingzoo_loop(capsys):
    assert main_of("pettingzoo_loop")(robots=3, horizon=60) > 0
    assert "visible" in capsys.readouterr().out


@pytest.mark.nightly
def test_the_notebook_runs_from_top_to_bottom(capsys):
    notebook = json.loads((EXAMPLES / "quickstart.ipynb").read_text("utf-8"))
    cells = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    scope, pictures = {}, 0
    for cell in cells:
        *body, last = ast.parse(cell).body
        if not isinstance(last, ast.Expr):
            body, last = [*body, last], None
        exec(compile(ast.Module(body, []), "quickstart.ipynb", "exec"), scope)
        shown = None if last is None else eval(compile(ast.Expression(last.value), "quickstart.ipynb", "eval"), scope)
        if hasattr(shown, "_repr_png_"):
            assert shown._repr_png_().startswith(b"\x89PNG")
            pictures += 1
    assert pictures == 2
    assert "of the 7 others" in capsys.readouterr().out
    assert all(cell.get("outputs", []) == [] for cell in notebook["cells"]), "committed without outputs"


@pytest.mark.nightly
@pytest.mark.filterwarnings("default")
def test_stable_baselines3_ppo():
    pytest.importorskip("stable_baselines3")
    assert np.isfinite(main_of("stable_baselines3_ppo")(robots=3, steps=512, envs=2, horizon=10))


@pytest.mark.parametrize(
    ("name", "package", "extra"),
    [
        ("random_agent", "gymnasium", "gymnasium"),
        ("vector_loop", "gymnasium", "gymnasium"),
        ("pettingzoo_loop", "pettingzoo", "pettingzoo"),
        ("stable_baselines3_ppo", "stable_baselines3", "gymnasium,sb3"),
        ("onnx_robots", "onnxruntime", "onnx"),
    ],
)
def test_without_its_extra_an_example_is_one_line_and_status_2(name, package, extra, monkeypatch, capsys):
    adapters = ("murmurate.interop.gymnasium", "murmurate.interop.pettingzoo", "murmurate.interop.gathering")
    for module in [module for module in sys.modules if module.startswith((f"{package}.", *adapters))]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(SystemExit) as stop:
        runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    out, err = capsys.readouterr()
    assert (stop.value.code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith(f"{name}.py: ")
    assert f'pip install "murmurate[{extra}]"' in err


@pytest.mark.parametrize(("content", "reason"), [(None, "File doesn't exist"), (b"text", "Protobuf parsing failed")])
def test_an_example_whose_file_is_missing_or_damaged_is_one_line_and_status_2(
    content, reason, tmp_path, monkeypatch, capsys
):
    pytest.importorskip("onnxruntime")
    path = tmp_path / "model.onnx"
    if content is not None:
        path.write_bytes(content)
    monkeypatch.setattr(sys, "argv", ["onnx_robots.py", str(path)])
    with pytest.raises(SystemExit) as stop:
        runpy.run_path(str(EXAMPLES / "onnx_robots.py"), run_name="__main__")
    out, err = capsys.readouterr()
    assert (stop.value.code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith(f"onnx_robots.py: cannot open {path}: ")
    assert reason in err


@pytest.mark.parametrize("arguments", [[], ["model.onnx", "many"]])
def test_an_example_without_its_arguments_is_one_line_and_status_2(arguments, monkeypatch, capsys):
    pytest.importorskip("onnxruntime")
    monkeypatch.setattr(sys, "argv", ["onnx_robots.py", *arguments])
    with pytest.raises(SystemExit) as stop:
        runpy.run_path(str(EXAMPLES / "onnx_robots.py"), run_name="__main__")
    assert stop.value.code == 2
    assert capsys.readouterr() == ("", "usage: python examples/onnx_robots.py MODEL.onnx [ROBOTS]\n")
