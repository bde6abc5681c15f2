from __future__ import annotations

import pytest
from matplotlib import pyplot


@pytest.fixture(autouse=True)
def _no_display():
    """Windows are drawn without a display, and none stays open."""
    pyplot.switch_backend("Agg")
    yield
    pyplot.close("all")
