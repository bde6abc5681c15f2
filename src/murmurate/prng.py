"""Random numbers that depend on the seed alone, not on the JAX flags of the user.

`JAX_ENABLE_X64` changes JAX's default types, and with them every number drawn. `JAX_DEFAULT_PRNG_IMPL` and
`JAX_THREEFRY_PARTITIONABLE` change the generator. So keys come from `key` and `wrap`, and calls of `jax.random` name
the type; `bernoulli` and `signs` are for those that cannot. Whole computations, such as a training, run inside
`reproducible()`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key, PRNGKeyArray

from murmurate import compilation_cache, forks

__all__ = ["GENERATOR", "MAX_SEED", "bernoulli", "key", "reproducible", "signs", "wrap"]

GENERATOR = "threefry2x32"
MAX_SEED = 2**32 - 1

# Whatever computes with JAX imports this module, so that its programs are kept whichever function is called first.
compilation_cache.configure()


@contextlib.contextmanager
def reproducible() -> Iterator[None]:
    """Computes with JAX's default number types and generator, whatever the user's flags say.

    A context manager, and a decorator as `@reproducible()`. It acts while programs are traced and compiled, so it
    belongs around the calls of jitted functions, not inside them.

    Raises:
        ForkError: JAX had been started before this process was forked: a computation would wait for ever.
    """
    forks.check_can_compute()
    with jax.enable_x64(False), jax.threefry_partitionable(True), jax.default_prng_impl(GENERATOR):
        yield


def key(seed: Any) -> PRNGKeyArray:
    """Returns the key of a seed, of which the lowest 32 bits count (as in JAX without 64-bit types)."""
    number = np.uint32(int(seed) & 0xFFFFFFFF) if isinstance(seed, int | np.integer) else jnp.asarray(seed, jnp.uint32)
    return jax.random.key(number, impl=GENERATOR)


def wrap(data: Any) -> Key[Array, "*batch"]:
    """Returns the keys whose `jax.random.key_data` is given."""
    return jax.random.wrap_key_data(data, impl=GENERATOR)


def bernoulli(key: PRNGKeyArray, probability: Any, shape: Sequence[int] = ()) -> Bool[Array, "..."]:
    """Returns booleans, each true with a probability."""
    return jax.random.bernoulli(key, jnp.asarray(probability, jnp.float32), shape)


def signs(key: PRNGKeyArray, shape: Sequence[int] = ()) -> Float[Array, "..."]:
    """Returns -1 or 1, as float32, with equal probabilities."""
    return 2 * bernoulli(key, 0.5, shape).astype(jnp.float32) - 1
