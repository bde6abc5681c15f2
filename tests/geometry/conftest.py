from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest


@pytest.fixture(scope="module", params=[np.float64, jnp.float32], ids=["numpy64", "jax32"])
def array(request):
    """Makes the arrays that the kernels get: NumPy's in float64, or JAX's in float32."""
    return lambda values: (np if request.param is np.float64 else jnp).asarray(values, dtype=request.param)
