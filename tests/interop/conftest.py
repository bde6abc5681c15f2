from __future__ import annotations

import jax
import pytest
from matplotlib import pyplot


@pytest.fixture(scope="module", autouse=True)
def _batch_last():
    """With the batch last, one flag an episode meets `(robots, 2, batch)`: axes are gained in front, on purpose."""
    with jax.numpy_rank_promotion("allow"):
        yield


@pytest.fixture(autouse=True)
def _no_display():
    """Windows are drawn without a display, and none stays open."""
    pyplot.switch_backend("Agg")
    yield
    pyplot.close("all")
