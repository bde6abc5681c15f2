from __future__ import annotations

import jax
import pytest

from murmurate.runs import train
from tiny import tiny, write_toml


@pytest.fixture(scope="session", autouse=True)
def usual_broadcasting():
    with jax.numpy_rank_promotion("allow"):
        yield


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """A run that nothing interrupted; not to be changed."""
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    train.discover(tiny(), folder)
    return folder


@pytest.fixture
def write_sweep(tmp_path):
    """Writes a sweep beside three tiny experiments; returns its path."""
    for name in ("one", "two", "three"):
        write_toml(tmp_path / f"{name}.toml", name=name)

    def write(text):
        path = tmp_path / "sweep.toml"
        path.write_text(text)
        return path

    return write
