from __future__ import annotations

import jax
import pytest

from tiny import write_toml


@pytest.fixture(scope="session", autouse=True)
def usual_broadcasting():
    with jax.numpy_rank_promotion("allow"):
        yield


@pytest.fixture
def written(tmp_path):
    """Writes a sweep beside three tiny experiments; returns its path."""
    for name in ("one", "two", "three"):
        write_toml(tmp_path / f"{name}.toml", name=name)

    def write(text):
        path = tmp_path / "sweep.toml"
        path.write_text(text)
        return path

    return write
