"""Pages are tried under the rules that a reader's own programs have: the usual ones."""

from __future__ import annotations

import jax
import pytest


@pytest.fixture(scope="module", autouse=True)
def usual_numerics():
    """Arrays may gain axes, as they do with the batch last."""
    jax.config.update("jax_disable_most_optimizations", True)  # what runs once is compiled in half of the time
    with jax.numpy_rank_promotion("allow"):
        yield
    jax.config.update("jax_disable_most_optimizations", False)
