from __future__ import annotations

import jax
import pytest

from murmurate.cli.main import main
from tiny import write_toml


@pytest.fixture(scope="session", autouse=True)
def usual_broadcasting():
    with jax.numpy_rank_promotion("allow"):
        yield


@pytest.fixture(scope="session")
def tiny_toml(tmp_path_factory):
    return write_toml(tmp_path_factory.mktemp("experiments") / "tiny.toml")


@pytest.fixture(scope="session")
def discovered(tiny_toml, tmp_path_factory):
    """The folder of a run that `murmurate discover` made; not to be changed."""
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    assert main(["discover", str(tiny_toml), "--out", str(folder)]) == 0
    return folder
