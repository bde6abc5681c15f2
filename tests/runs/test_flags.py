"""A discovery ends in the same weights, whatever JAX flags the user has set."""

from __future__ import annotations

import os
import subprocess
import sys

import jax
import numpy as np

import murmurate
from tiny import write_toml

FLAGS = {"JAX_ENABLE_X64": "1", "JAX_DEFAULT_PRNG_IMPL": "rbg", "JAX_THREEFRY_PARTITIONABLE": "0"}


def test_the_weights_do_not_depend_on_flags(finished, tmp_path):
    """`finished` is the same run, trained without flags."""
    toml, folder = write_toml(tmp_path / "tiny.toml"), tmp_path / "run"
    command = [sys.executable, "-m", "murmurate", "discover", str(toml), "--out", str(folder)]
    result = subprocess.run(command, env=os.environ | FLAGS, capture_output=True, text=True, check=False)
    assert result.returncode in (0, 3), result.stderr
    files = sorted(path.relative_to(finished) for path in (finished / "policies").iterdir())
    assert files
    for file in [*files, "evaluation.json"]:
        assert (folder / file).read_bytes() == (finished / file).read_bytes(), file


def test_the_weights_of_the_package_act_alike_where_numbers_have_64_bits():
    expected = murmurate.pretrained().of_size(3).rollout(2, key=1)
    with jax.enable_x64(True):
        run = murmurate.pretrained().of_size(3)
        assert {str(leaf.dtype) for leaf in jax.tree.leaves(run.cascade.policies)} == {"float32"}
        np.testing.assert_array_equal(run.rollout(2, key=1).positions, expected.positions)
