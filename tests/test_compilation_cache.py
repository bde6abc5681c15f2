"""The cache of compiled programs: where it is, when it is not, and that it changes no number."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from murmurate import compilation_cache

ROOT = Path(__file__).parents[1]

SMALL = """
{before}
import murmurate.prng
{after}
import jax
print(jax.jit(lambda x: x + 1)(1))
print(jax.config.jax_compilation_cache_dir)
"""

TRAIN = """
import hashlib, sys
import equinox as eqx, jax, jax.numpy as jnp, numpy as np
{train}
weights = jax.tree.leaves(eqx.filter(policy, eqx.is_array))
print(hashlib.sha256(b"".join(np.asarray(leaf).tobytes() for leaf in weights)).hexdigest())
"""

A_LINE = """
sys.path.append("tests/learning")
from probes import Line, begin, parabola, train
environment = Line(jnp.int32(10))
policy = train(begin(environment, parabola()), environment, 5)[0].policy
"""

A_SWARM = """
from murmurate.discovery import Search
from tiny import tiny
search = Search(tiny())
policy = search.advance(search.begin())[0].train.policy
"""


def execute(code, tmp_path, **variables):
    """Runs Python in a process whose home is empty; returns what it wrote."""
    inherited = {
        name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "MURMURATE", "XDG_"))
    }
    environment = inherited | {"HOME": str(tmp_path / "home"), "PYTHONPATH": os.pathsep.join(sys.path)} | variables
    return subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=ROOT, capture_output=True, text=True, check=True
    )


@pytest.mark.parametrize("before", ["", "import jax; jax.jit(lambda x: x - 1)(1)"], ids=["before JAX", "after JAX"])
@pytest.mark.skipif(sys.platform != "linux", reason="another folder")
def test_programs_are_kept_in_the_platforms_folder(before, tmp_path):
    first = execute(SMALL.format(before=before, after=""), tmp_path)
    folder = Path(first.stdout.split()[1])
    assert folder.is_relative_to(tmp_path / "home" / ".cache" / "murmurate")
    entries = {path: path.read_bytes() for path in folder.glob("*-cache")}
    assert entries
    assert execute(SMALL.format(before=before, after=""), tmp_path).stdout == first.stdout
    assert {path: path.read_bytes() for path in folder.glob("*-cache")} == entries
    assert first.stderr == ""


@pytest.mark.parametrize(
    ("variables", "part"),
    [
        ({"MURMURATE_CACHE": "off"}, "None"),
        ({"MURMURATE_CACHE": "{tmp}/mine"}, "{tmp}/mine/compiled-"),
        ({"XDG_CACHE_HOME": "{tmp}/xdg"}, "{tmp}/xdg/murmurate/compiled-"),
        ({"JAX_COMPILATION_CACHE_DIR": "{tmp}/jax", "MURMURATE_CACHE": "{tmp}/mine"}, "{tmp}/jax"),
    ],
)
@pytest.mark.skipif(sys.platform != "linux", reason="another folder")
def test_variables_move_it_or_switch_it_off(variables, part, tmp_path):
    variables = {name: value.format(tmp=tmp_path) for name, value in variables.items()}
    result = execute(SMALL.format(before="", after=""), tmp_path, **variables)
    assert result.stdout.split()[1].startswith(part.format(tmp=tmp_path))
    assert result.stderr == ""


@pytest.mark.parametrize("when", ["before", "after"])
def test_a_cache_that_the_user_chooses_in_python_is_left_alone(when, tmp_path):
    chosen = tmp_path / "chosen"
    choice = f"import jax; jax.config.update('jax_compilation_cache_dir', {str(chosen)!r})"
    code = SMALL.format(**{"before": "", "after": ""} | {when: choice})
    result = execute(code, tmp_path, MURMURATE_CACHE=str(tmp_path / "ours"))
    assert result.stdout == f"2\n{chosen}\n"
    assert not list((tmp_path / "ours").rglob("*-cache"))


@pytest.mark.parametrize("module", ["world", "learning"])
def test_every_module_that_computes_switches_it_on(module, tmp_path):
    code = f"import murmurate.{module}, jax; print(jax.config.jax_compilation_cache_dir)"
    assert execute(code, tmp_path, MURMURATE_CACHE=str(tmp_path)).stdout.startswith(f"{tmp_path}/compiled-")


def test_without_a_writable_folder_one_line_says_so(tmp_path):
    (tmp_path / "file").write_text("")
    result = execute(SMALL.format(before="", after=""), tmp_path, MURMURATE_CACHE=str(tmp_path / "file"))
    assert result.stdout == "2\nNone\n"
    assert result.stderr == (
        "murmurate: programs are compiled anew: Not a directory (set MURMURATE_CACHE to a folder, or off)\n"
    )


def test_a_damaged_entry_is_no_news(tmp_path):
    folder = Path(execute(SMALL.format(before="", after=""), tmp_path).stdout.split()[1])
    for entry in folder.glob("*-cache"):
        entry.write_bytes(entry.read_bytes()[:20])
    result = execute(SMALL.format(before="", after=""), tmp_path)
    assert result.stdout.startswith("2\n")
    assert result.stderr == ""


def test_the_programs_used_longest_ago_are_removed(tmp_path):
    folder = tmp_path / "compiled-x"
    folder.mkdir()
    for number in range(4):
        path = folder / f"program{number}-cache"
        path.write_bytes(bytes(100))
        os.utime(path, (number, number))
    (folder / "notes.txt").write_bytes(bytes(1000))
    compilation_cache._trim(tmp_path, 250)
    assert {path.name for path in folder.iterdir()} == {"program2-cache", "program3-cache", "notes.txt"}


@pytest.mark.nightly  # the tests of several processes compare runs with and without a filled cache too
@pytest.mark.parametrize("train", [A_LINE, A_SWARM], ids=["line", "swarm"])
def test_the_same_seed_gives_the_same_weights_with_and_without_it(train, tmp_path):
    code = TRAIN.format(train=train)
    runs = [execute(code, tmp_path, MURMURATE_CACHE=value) for value in ("off", str(tmp_path), str(tmp_path))]
    assert len({result.stdout for result in runs}) == 1
    assert [result.stderr for result in runs] == [""] * 3


def test_importing_murmurate_does_not_load_jax(tmp_path):
    result = execute("import sys, murmurate; print('jax' in sys.modules, 'numpy' in sys.modules)", tmp_path)
    assert result.stdout == "False False\n"
