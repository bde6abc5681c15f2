"""What every test shares: strict numerics, and the same hypothesis examples on every machine."""

from __future__ import annotations

import hypothesis
import jax
import pytest

# No array may gain axes by accident. (Types are as strict only under `strict_numerics`: optax needs the usual rules.)
jax.config.update("jax_numpy_rank_promotion", "raise")

hypothesis.settings.register_profile("ci", derandomize=True, deadline=None, database=None)
hypothesis.settings.load_profile("ci")


@pytest.fixture(scope="module", autouse=True)
def few_programs():
    """Forgets compiled programs after every file: a process that keeps some thousands runs out of memory maps."""
    yield
    jax.clear_caches()


@pytest.fixture(scope="module")
def strict_numerics():
    """No array may change its type by accident either."""
    with jax.numpy_dtype_promotion("strict"):
        yield
