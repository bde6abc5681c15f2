"""Large batches, computed in tiles whose arrays of pairs of robots stay in a core's caches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer

__all__ = ["in_tiles", "tile_size"]

OBSERVER_BYTES = 48 << 10
"""Bytes, at most, of the five numbers of every robot in which one observer tests who hides whom, over a tile.

They are read once for each robot, so they should stay in a core's first-level cache, of 32 to 64 KiB today. With caches
of 48 KiB, tiles of 128 episodes of 10 robots took from 0.6 to 0.9 times as long as tiles of 256 on an Intel Xeon, and
up to 1.2 times as long on an AMD EPYC.
"""

LEAST = 64
"""Episodes, at least, of a tile. On the Xeon, half as many took 1.4 times as long with 40 robots, 0.9 times with 48."""

MULTIPLE = 32
"""Tiles have a multiple of so many episodes, so that vector units are full."""


def in_tiles(function: Callable[..., Any], robots: int, *arguments: Any) -> Any:
    """Returns what a function returns for a batch, computed tile by tile: the same numbers, to the last bit.

    A batch stays whole where one tile holds it, outside of a jit, on an accelerator, which large arrays keep busy, on
    several devices, which split it between them, and where a result does not depend on the episode.

    Args:
        function: Computes each episode independently of the others. The last axis of every array that it takes and
            returns is the batch.
        robots: Swarm size.
        *arguments: PyTrees of arrays.
    """
    leaves = jax.tree.leaves(arguments)
    batch = jnp.shape(leaves[0])[-1]
    if (
        not isinstance(batch, int)
        or not isinstance(robots, int)
        or not any(isinstance(leaf, Tracer) for leaf in leaves)
    ):
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

    first = read(0)
    shapes = jax.eval_shape(function, *first)
    if any(like.shape[-1:] != (size,) for like in jax.tree.leaves(shapes)):
        return function(*arguments)
    empty, results = (
        jax.tree.map(lambda like, length=length: jnp.zeros((*like.shape[:-1], length), like.dtype), shapes)
        for length in (size, batch)
    )
    tiles = -(-batch // size)
    _, last, results = jax.lax.fori_loop(0, tiles, turn, (first, empty, results))
    return write(tiles - 1, results, last)


def tile_size(robots: int, batch: int) -> int:
    """Returns how many episodes of a batch are computed at a time: all of them, or parts of nearly equal size."""
    fitting = max(OBSERVER_BYTES // (20 * robots), LEAST)
    most = 1 << fitting.bit_length() - 1
    if batch <= most:
        return batch
    return -(-batch // -(-batch // most) // MULTIPLE) * MULTIPLE
