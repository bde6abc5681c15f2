"""Sums over robots: loops in Python for NumPy, loops of the program for JAX."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from murmurate.geometry._batch_last.loops import sum_over_third_robots, sum_terms

TERMS = np.random.default_rng(0).normal(size=(15, 3))


@pytest.mark.parametrize("count", [1, 2, 10, 15])
def test_all_terms_are_summed_and_have_a_gradient(count):
    def total(terms):
        first, second = sum_terms(lambda i: (terms[i], terms[i] ** 2), count)
        return first.sum() + second.sum()

    terms = jnp.asarray(TERMS, jnp.float32)
    value, slope = jax.jit(jax.value_and_grad(total))(terms)
    np.testing.assert_allclose(value, (TERMS[:count] + TERMS[:count] ** 2).sum(), rtol=1e-5)
    np.testing.assert_allclose(slope[:count], 1 + 2 * TERMS[:count], rtol=1e-5)
    assert not np.asarray(slope[count:]).any()


def pair_terms(first, other, same):
    """A function of two robots that does not commute, with two results."""
    (x, y), (a, b) = first, other
    return jnp.where(same, 0.0, x * jnp.sin(a) + y * b), jnp.where(same, 1.0, a * a * y)


@pytest.mark.parametrize("robots", [1, 2, 12])
def test_the_gradient_of_a_sum_over_third_robots_is_that_of_the_same_sum_written_out(robots):
    rng = np.random.default_rng(robots)
    arrays = tuple(jnp.asarray(rng.normal(size=(robots, robots, 2)), jnp.float32) for _ in range(2))
    weights = tuple(jnp.asarray(rng.normal(size=(robots, robots, 2)), jnp.float32) for _ in range(2))

    def at_once(arrays):
        first, other = (tuple(axis(a) for a in arrays) for axis in (lambda a: a[:, :, None], lambda a: a[:, None]))
        same = jnp.eye(robots, dtype=bool)[None, :, :, None]
        return tuple(term.sum(axis=2) for term in pair_terms(first, other, same))

    def total(sums, arrays):
        return sum((weight * part).sum() for weight, part in zip(weights, sums(arrays), strict=True))

    kernel = lambda arrays: sum_over_third_robots(pair_terms, arrays)  # noqa: E731
    for mine, expected in zip(jax.jit(kernel)(arrays), jax.jit(at_once)(arrays), strict=True):
        np.testing.assert_allclose(mine, expected, rtol=1e-5, atol=1e-5)
    slopes, expected = (jax.jit(jax.grad(lambda a, sums=sums: total(sums, a)))(arrays) for sums in (kernel, at_once))
    for mine, right in zip(slopes, expected, strict=True):
        np.testing.assert_allclose(mine, right, rtol=1e-4, atol=1e-4)
