"""The adapters are optional: without them, nothing else notices."""

from __future__ import annotations

import subprocess
import sys

import pytest

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


@pytest.mark.parametrize("extra", EXTRAS)
def test_a_missing_extra_says_how_to_install_it(extra):
    result = python(f"import sys; sys.modules[{EXTRAS[extra]!r}] = None; import murmurate.interop.{extra}")
    assert result.returncode == 1
    assert result.stderr.splitlines()[-1] == (
        f'ModuleNotFoundError: murmurate.interop.{extra} needs {extra}: pip install "murmurate[{extra}]"'
    )


def test_matplotlib_is_loaded_with_the_first_frame():
    result = python("import sys, murmurate.interop.gymnasium, murmurate.interop.pettingzoo; print(*sys.modules)")
    assert result.returncode == 0, result.stderr
    assert "matplotlib" not in result.stdout.split()
