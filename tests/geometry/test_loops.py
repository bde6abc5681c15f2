"""Sums over robots, unrolled for few robots and looped for many."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from murmurate.geometry._batch_last.loops import MAX_UNROLLED, sum_terms

TERMS = np.random.default_rng(0).normal(size=(MAX_UNROLLED + 5, 3))


@pytest.mark.parametrize("count", [1, 2, MAX_UNROLLED, MAX_UNROLLED + 1, MAX_UNROLLED + 5])
def test_all_terms_are_summed_and_have_a_gradient(count):
    def total(terms):
        first, second = sum_terms(lambda i: (terms[i], terms[i] ** 2), count)
        return first.sum() + second.sum()

    terms = jnp.asarray(TERMS, jnp.float32)
    value, slope = jax.value_and_grad(total)(terms)
    np.testing.assert_allclose(value, (TERMS[:count] + TERMS[:count] ** 2).sum(), rtol=1e-5)
    np.testing.assert_allclose(slope[:count], 1 + 2 * TERMS[:count], rtol=1e-5)
    assert not np.asarray(slope[count:]).any()
