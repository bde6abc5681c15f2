"""The adapters are optional: without them, nothing else notices."""

from __future__ import annotations

import subprocess
import sys

EXTRAS = {
    "gymnasium": "gymnasium",
    "onnx": "jax2onnx",
    "pettingzoo": "pettingzoo",
    "tensorboard": "tensorboardX",
}
"""The package that each of them adapts to."""


def python(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_the_package_loads_no_extra():
    modules = "murmurate, murmurate.world, murmurate.discovery, murmurate.runs.run, murmurate.plots"
    loaded = f"import sys, {modules}, murmurate.cli.main, murmurate.interop; print(*sys.modules)"
    result = python(loaded)
    assert result.returncode == 0, result.stderr
    assert not {*EXTRAS.values(), *(f"murmurate.interop.{extra}" for extra in EXTRAS)} & set(result.stdout.split())


def test_a_missing_extra_says_how_to_install_it():
    result = python(
        "import importlib, sys\n"
        f"for extra, package in {EXTRAS}.items():\n"
        "    sys.modules[package] = None\n"
        "    try:\n"
        "        importlib.import_module(f'murmurate.interop.{extra}')\n"
        "    except ModuleNotFoundError as error:\n"
        "        print(error)\n"
    )
    assert result.stdout.splitlines() == [
        f'murmurate.interop.{extra} needs {extra}: pip install "murmurate[{extra}]"' for extra in EXTRAS
    ], result.stderr


def test_matplotlib_is_loaded_with_the_first_frame():
    result = python("import sys, murmurate.interop.gymnasium, murmurate.interop.pettingzoo; print(*sys.modules)")
    assert result.returncode == 0, result.stderr
    assert "matplotlib" not in result.stdout.split()
