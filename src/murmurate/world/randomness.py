"""Randomness that an episode carries along: one key each, kept as plain numbers with the batch last.

The generator is that of `murmurate.prng`, so that a seed means the same numbers whatever JAX's flags are.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key, UInt32

from murmurate import prng

__all__ = ["draw_each", "episode_keys", "key_data", "next_keys", "wrap_keys"]


def episode_keys(seed: Any, positions: Float[Array, "robots 2 *batch"]) -> Key[Array, "*batch"]:
    """Returns a key for the episode that begins at a configuration, or for each of a batch.

    Args:
        seed: A seed, or the keys themselves.
        positions: The configuration, or the batch of them.
    """
    if isinstance(seed, jax.Array) and jnp.issubdtype(seed.dtype, jax.dtypes.prng_key):
        return seed
    key = prng.key(seed)
    return jax.random.split(key, positions.shape[2:]) if positions.ndim > 2 else key


def draw_each(draw: Callable[..., Any], *arguments: Any) -> Any:
    """Draws for one episode, or for each of a batch, which is then the last axis.

    Args:
        draw: Called with the arguments of one episode, the first of them its key.
        *arguments: The keys, then PyTrees of arrays with the batch last.
    """
    if arguments[0].ndim == 0:
        return draw(*arguments)
    return jax.vmap(draw, in_axes=(0, *[-1] * (len(arguments) - 1)), out_axes=-1)(*arguments)


def next_keys(keys: Key[Array, "*batch"], number: int = 1) -> Key[Array, "*batch"]:
    """Returns other keys, so that what is drawn next, or for another purpose, is independent of what was drawn."""
    return jax.random.fold_in(keys, number) if keys.ndim == 0 else jax.vmap(jax.random.fold_in, (0, None))(keys, number)


def key_data(keys: Key[Array, "*batch"]) -> UInt32[Array, "two *batch"]:
    """Returns the numbers of keys, as a state holds them."""
    return jnp.moveaxis(jax.random.key_data(keys), -1, 0)


def wrap_keys(numbers: UInt32[Array, "two *batch"]) -> Key[Array, "*batch"]:
    """Returns the keys that have these numbers."""
    return prng.wrap(jnp.moveaxis(numbers, 0, -1))
