"""Large batches, computed in tiles whose arrays of pairs fit in a core's second-level cache."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

__all__ = ["in_tiles", "tile_size"]

TILE_BYTES = 1 << 17
"""Bytes of one array of all pairs of robots in a tile, about; a step has some five of them in use at a time."""

VECTOR = 32
"""Tiles are of a multiple of so many episodes, which leaves no part of a vector unit idle."""


def in_tiles(function: Callable[..., Any], robots: int, *arguments: Any) -> Any:
    """Returns what a function returns for a batch, computed tile by tile: the same numbers, to the last bit.

    Batches are whole where one tile holds them, outside of a jit, on an accelerator, which large arrays keep busy, and
    on several devices, which split the batch between them.

    Args:
        function: Computes each episode by itself. The last axis of all arrays that it takes and returns is the batch.
        robots: Swarm size.
        *arguments: PyTrees of arrays.
    """
    leaves = jax.tree.leaves(arguments)
    batch = jnp.shape(leaves[0])[-1] if jnp.ndim(leaves[0]) else 1
    if not isinstance(batch, int) or not any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
        return function(*arguments)
    size = tile_size(robots, batch)
    if size == batch or jax.default_backend() != "cpu" or jax.device_count() > 1:
        return function(*arguments)

    # The last tile begins sooner where it would reach beyond the batch: what it shares is computed twice, alike.
    def read(index: Any) -> Any:
        return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, index * size, size, -1), arguments)

    def write(index: Any, results: Any, tile: Any) -> Any:
        def update(whole: Any, part: Any) -> Any:
            return jax.lax.dynamic_update_slice_in_dim(whole, part, index * size, whole.ndim - 1)

        return jax.tree.map(update, results, tile)

    # Tiles are read a turn ahead, written a turn later, and carried along between: XLA would fuse reading and writing
    # into the loops over all pairs of robots, which it then does not vectorise.
    def turn(index: Any, carry: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
        now, before, results = carry
        return read(index + 1), function(*now), write(jnp.maximum(index - 1, 0), results, before)

    def zeros(like: Any) -> Any:
        return jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(function, *like))

    first, tiles = read(0), -(-batch // size)
    _, last, results = jax.lax.fori_loop(0, tiles, turn, (first, zeros(first), zeros(arguments)))
    return write(tiles - 1, results, last)


def tile_size(robots: int, batch: int) -> int:
    """Returns how many episodes of a batch are computed at a time: all of them, or parts of nearly equal size."""
    fitting = max(TILE_BYTES // (4 * robots**2), 1)
    most = max(1 << fitting.bit_length() - 1, VECTOR)
    if batch <= most:
        return batch
    return -(-batch // -(-batch // most) // VECTOR) * VECTOR
