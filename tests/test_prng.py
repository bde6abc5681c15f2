"""A seed means the same random numbers under every JAX flag, and the numbers that JAX draws by default."""

from __future__ import annotations

import contextlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from murmurate import prng

FLAGS = {
    "none": (),
    "64 bits": (lambda: jax.enable_x64(True),),
    "generator": (lambda: jax.default_prng_impl("rbg"), lambda: jax.threefry_partitionable(False)),
    "all": (
        lambda: jax.enable_x64(True),
        lambda: jax.default_prng_impl("rbg"),
        lambda: jax.threefry_partitionable(False),
    ),
}

# With explicit types, and as JAX draws by default.
DRAWS = {
    "uniform": (lambda key: jax.random.uniform(key, (7,), jnp.float32), lambda key: jax.random.uniform(key, (7,))),
    "bernoulli": (lambda key: prng.bernoulli(key, 0.3, (70,)), lambda key: jax.random.bernoulli(key, 0.3, (70,))),
    "signs": (lambda key: prng.signs(key, (70,)), lambda key: jax.random.rademacher(key, (70,), jnp.float32)),
}


@contextlib.contextmanager
def flags(name):
    with contextlib.ExitStack() as stack:
        for flag in FLAGS[name]:
            stack.enter_context(flag())
        yield


@pytest.mark.parametrize("name", FLAGS)
@pytest.mark.parametrize("draw", DRAWS)
def test_numbers_do_not_depend_on_flags(draw, name):
    named, default = DRAWS[draw]
    expected = np.asarray(default(jax.random.key(5)))
    with flags(name), prng.reproducible():
        drawn = np.asarray(named(prng.key(5)))
    np.testing.assert_array_equal(drawn, expected)
    assert drawn.dtype == expected.dtype


@pytest.mark.parametrize("draw", DRAWS)
def test_types_do_not_depend_on_flags_even_outside_the_context(draw):
    named, default = DRAWS[draw]
    expected = np.asarray(default(jax.random.key(5)))
    with flags("64 bits"):
        drawn = np.asarray(named(prng.key(5)))
    np.testing.assert_array_equal(drawn, expected)
    assert drawn.dtype == expected.dtype


@pytest.mark.parametrize("name", FLAGS)
@pytest.mark.parametrize("seed", [0, 7, -3, 2**31, 2**33 + 5])
def test_keys_do_not_depend_on_flags(seed, name):
    expected = jax.random.key_data(jax.random.key(seed))
    with flags(name):
        key = prng.key(seed)
        np.testing.assert_array_equal(jax.random.key_data(key), expected)
        assert jax.random.key_impl(prng.wrap(jax.random.key_data(key))) == jax.random.key_impl(key)
