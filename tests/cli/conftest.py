from __future__ import annotations

import pytest

from tiny import write_toml


@pytest.fixture(scope="session")
def tiny_toml(tmp_path_factory):
    return write_toml(tmp_path_factory.mktemp("experiments") / "tiny.toml")


@pytest.fixture(scope="session")
def discovered(tiny_run):
    """The folder of a run that `murmurate discover` made; not to be changed."""
    return tiny_run()
