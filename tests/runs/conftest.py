from __future__ import annotations

import jax
import pytest

from murmurate.runs import train
from tiny import tiny


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
