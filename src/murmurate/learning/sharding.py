"""The devices that a training is spread over: each holds a part of the batch, and all hold the networks.

One device is a mesh of one: nothing below asks how many there are, but for the check that they divide the batch. The
mesh is that of all devices of all hosts (see `hosts`); between two chunks of updates everything is whole on every host.
"""

from __future__ import annotations

import functools
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from murmurate.errors import InputError

__all__ = ["check_divides", "count", "fetched", "parted", "placed", "replicated"]

_AXIS = "batch"


def count() -> int:
    """Returns how many devices a training is spread over."""
    return _mesh().size


def check_divides(field: str, size: int) -> None:
    """Checks that every device gets as large a part of a batch.

    Args:
        field: The field that holds the size, for the message.
        size: The size of the batch.

    Raises:
        InputError: The devices do not divide it; the message names the nearest sizes that they do divide, and the
            greatest number of devices that divides this one.
    """
    devices = count()
    if size % devices:
        below = size // devices * devices
        near = f"{below} or {below + devices}" if below else f"{devices}"
        fewer = max(number for number in range(1, devices) if size % number == 0)
        allowed = f"a multiple of the {devices} devices that share it, such as {near}; {fewer} of them divide it"
        raise InputError(field, size, f"{allowed} (CUDA_VISIBLE_DEVICES says which are used)")


def parted(tree: Any) -> Any:
    """Within a jit: keeps every array split by its last axis, the batch."""
    return jax.tree.map(lambda x: jax.lax.with_sharding_constraint(x, _split(x.ndim)), tree)


def replicated(tree: Any) -> Any:
    """Within a jit: gives every device the whole of every array."""
    return jax.lax.with_sharding_constraint(tree, _everywhere())


def placed(tree: Any, split: bool = False) -> Any:
    """Spreads arrays over the devices, before a jit.

    Args:
        tree: The arrays, whole, and the same on every host.
        split: By the last axis; otherwise every device gets the whole.
    """
    shardings = jax.tree.map(lambda x: _split(np.ndim(x)) if split else _everywhere(), tree)
    if jax.process_count() == 1:
        return jax.device_put(tree, shardings)
    return jax.tree.map(_from_every_host, tree, shardings)


def fetched(tree: Any) -> Any:
    """Takes arrays that every device holds the whole of from this host's first one, after a jit."""
    return jax.tree.map(lambda x: x.addressable_data(0), tree)


def _from_every_host(array: Any, sharding: NamedSharding) -> jax.Array:
    """Makes one array of what each host puts on its own devices; no host asks another what it holds."""
    whole = np.asarray(array)
    return jax.make_array_from_callback(whole.shape, sharding, lambda index: whole[index])


def _everywhere() -> NamedSharding:
    return NamedSharding(_mesh(), PartitionSpec())


def _split(ndim: int) -> NamedSharding:
    return NamedSharding(_mesh(), PartitionSpec(*[None] * (ndim - 1), _AXIS))


@functools.cache
def _mesh() -> Mesh:
    return Mesh(np.asarray(jax.devices()), (_AXIS,))
