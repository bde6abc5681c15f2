from __future__ import annotations

import jax
import pytest


@pytest.fixture(scope="module", autouse=True)
def _fast_compilation():
    """What runs once is compiled in half of the time."""
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)
