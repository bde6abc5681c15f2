from __future__ import annotations

import pytest

from tiny import write_toml


@pytest.fixture(scope="session")
def finished(tiny_run):
    """A run that nothing interrupted; not to be changed."""
    return tiny_run()


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
