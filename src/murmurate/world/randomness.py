"""Randomness that an episode carries along: one key each, kept as plain numbers with the batch last."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, UInt32

__all__ = ["each", "episode_keys", "following", "plain", "wrapped"]


def episode_keys(seed: Any, positions: Float[Array, "robots 2 *batch"]) -> PRNGKeyArray:
    """Returns a key for the episode that begins at a configuration, or for each of a batch."""
    key = jax.random.key(seed)
    return jax.random.split(key, positions.shape[2:]) if positions.ndim > 2 else key


def each(draw: Callable[[PRNGKeyArray], Any], keys: PRNGKeyArray) -> Any:
    """Draws for one episode, or for each of a batch, which is then the last axis."""
    return draw(keys) if keys.ndim == 0 else jax.vmap(draw, out_axes=-1)(keys)


def following(keys: PRNGKeyArray, number: int = 1) -> PRNGKeyArray:
    """Returns other keys, so that what is drawn next, or for something else, has nothing to do with what was drawn."""
    return jax.random.fold_in(keys, number) if keys.ndim == 0 else jax.vmap(jax.random.fold_in, (0, None))(keys, number)


def plain(keys: PRNGKeyArray) -> UInt32[Array, "two *batch"]:
    """Returns the numbers of keys, as a state holds them."""
    return jnp.moveaxis(jax.random.key_data(keys), -1, 0)


def wrapped(numbers: UInt32[Array, "two *batch"]) -> PRNGKeyArray:
    """Returns the keys that have these numbers."""
    return jax.random.wrap_key_data(jnp.moveaxis(numbers, 0, -1))
