"""Training spread over devices and hosts: each device holds a part of the batch, and all hold the networks.

One device is a mesh of one, so nothing below asks how many there are, except the check that they divide the batch. With
several hosts (`initialize`) each process runs the same program. Between two chunks of updates everything is whole on
every host. Process 0 alone writes files (`run_on_first`).
"""

from __future__ import annotations

import functools
import zlib
from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from murmurate.errors import InputError, RunError, check_number

__all__ = [
    "broadcast",
    "broadcast_bytes",
    "check_address",
    "check_agreement",
    "check_divides",
    "device_count",
    "device_put",
    "initialize",
    "is_first",
    "replicate",
    "run_on_first",
    "shard_batch",
    "to_host",
]

Result = TypeVar("Result")

_AXIS = "batch"
_MAX_HOSTS = 65536


# Hosts.


def check_address(coordinator: str | None, hosts: Any, host: Any) -> None:
    """Checks what the command line says about the hosts.

    Args:
        coordinator: HOST:PORT of the first host.
        hosts: Number of hosts.
        host: Index of this host.

    Raises:
        InputError: A value is missing or out of range; the message names the flag.
    """
    check_number("--hosts", hosts, 1, _MAX_HOSTS, integer=True)
    check_number("--host", host, 0, (hosts or 1) - 1, integer=True)
    address, _, port = (coordinator or "").rpartition(":")
    if not address or not port.isdecimal() or not 0 < int(port) < 65536:
        raise InputError("--coordinator", coordinator, "HOST:PORT of the first host, the same on all hosts")


def initialize(coordinator: str | None = None, hosts: int | None = None, host: int | None = None) -> None:
    """Makes this process one of several that train together. Call it before JAX computes anything.

    Without arguments JAX asks the cluster (Slurm, Open MPI and others). A host that does not come, or that dies later,
    makes JAX end the other processes with a message of its own.

    Args:
        coordinator: HOST:PORT where the first host listens, the same on all hosts.
        hosts: Number of hosts.
        host: Index of this host, from 0.

    Raises:
        InputError: A value is out of range, or JAX knows no cluster here.
        RunError: JAX cannot set up the connection.
    """
    arguments: dict[str, Any] = {}
    if coordinator is not None or hosts is not None or host is not None:
        check_address(coordinator, hosts, host)
        arguments = {"coordinator_address": coordinator, "num_processes": hosts, "process_id": host}
        arguments["cluster_detection_method"] = "deactivate"
    # JAX's preemption service would swallow SIGTERM.
    jax.config.update("jax_enable_preemption_service", False)
    try:
        # Short timeouts: after a failure the other processes end within seconds, not after JAX's five minutes.
        jax.distributed.initialize(**arguments, heartbeat_timeout_seconds=10, shutdown_timeout_seconds=60)
    except ValueError as error:
        raise InputError("--hosts", "auto", f"used on a cluster that JAX knows, such as Slurm: {error}") from None
    except RuntimeError as error:
        raise RunError(f"the hosts cannot be connected: {error}") from None


def is_first() -> bool:
    """Returns whether this is process 0, the only one that writes files and prints."""
    return jax.process_index() == 0


def broadcast(tree: Any) -> Any:
    """Returns the arrays of process 0 on every process, as NumPy arrays."""
    if jax.process_count() == 1:
        return jax.tree.map(np.asarray, tree)
    return jax.tree.map(np.asarray, multihost_utils.broadcast_one_to_all(tree))


def broadcast_bytes(data: bytes) -> bytes:
    """Returns the bytes of process 0 on every process."""
    if jax.process_count() == 1:
        return data
    # All processes need arrays of the same shape, so the length travels first.
    size = int(broadcast(np.int32(len(data))))
    return broadcast(np.frombuffer(data.ljust(size, b"\0")[:size], np.uint8)).tobytes() if size else b""


def run_on_first(action: Callable[[], Result]) -> Result | None:
    """Runs an action on process 0 only, while the others wait.

    Returns:
        The action's result on process 0, None on the others.

    Raises:
        RunError: The action failed on process 0, which itself raises the original exception.
    """
    if jax.process_count() == 1:
        return action()
    result, failure = None, None
    if is_first():
        try:
            result = action()
        except Exception as error:
            failure = error
    # The others would wait forever for a process that stopped alone.
    message = broadcast_bytes(b"" if failure is None else (str(failure) or repr(failure)).encode())
    if failure is not None:
        raise failure
    if message:
        raise RunError(f"host 0 failed: {message.decode()}")
    return result


def check_agreement(what: str, data: bytes) -> None:
    """Checks that every process was given the same data.

    Args:
        what: Name of the data and the remedy, for the message.
        data: The data of this process.

    Raises:
        RunError: One process differs; raised on every process.
    """
    if jax.process_count() > 1:
        sums = multihost_utils.process_allgather(np.uint32(zlib.crc32(data)))
        if np.any(sums != sums[0]):
            raise RunError(f"the hosts do not agree on {what}")


# Devices.


def device_count() -> int:
    """Returns the number of devices that a training is spread over."""
    return _mesh().size


def check_divides(field: str, size: int) -> None:
    """Checks that the number of devices divides a batch.

    Args:
        field: Name of the field that holds the size, for the message.
        size: The size of the batch.

    Raises:
        InputError: It does not. The message names the nearest possible sizes, and the largest number of devices that
            divides this size.
    """
    devices = device_count()
    if size % devices:
        below = size // devices * devices
        near = f"{below} or {below + devices}" if below else f"{devices}"
        fewer = max(number for number in range(1, devices) if size % number == 0)
        allowed = f"a multiple of the {devices} devices that share it, such as {near}; {fewer} of them divide it"
        raise InputError(field, size, f"{allowed} (CUDA_VISIBLE_DEVICES says which are used)")


def shard_batch(tree: Any) -> Any:
    """Splits every array by its last axis, the batch; for use inside a jit."""
    return jax.tree.map(lambda x: jax.lax.with_sharding_constraint(x, _split(x.ndim)), tree)


def replicate(tree: Any) -> Any:
    """Gives every device the whole of every array; for use inside a jit."""
    arrays, rest = eqx.partition(tree, eqx.is_array)
    return eqx.combine(jax.lax.with_sharding_constraint(arrays, _whole()), rest)


def device_put(tree: Any, split: bool = False) -> Any:
    """Puts arrays on the devices, before a jit.

    Args:
        tree: The arrays, whole, and the same on every host.
        split: Split them by the last axis; otherwise every device gets the whole.
    """
    arrays, rest = eqx.partition(tree, lambda x: isinstance(x, jax.Array | np.ndarray))
    shardings = jax.tree.map(lambda x: _split(np.ndim(x)) if split else _whole(), arrays)
    if jax.process_count() == 1:
        return eqx.combine(jax.device_put(arrays, shardings), rest)
    # Every host holds the whole array already: each fills its own devices, and nothing is sent.
    return eqx.combine(jax.tree.map(_put_on_own_devices, arrays, shardings), rest)


def to_host(tree: Any) -> Any:
    """Returns replicated arrays as this process's first device holds them, after a jit."""
    return jax.tree.map(lambda x: x.addressable_data(0) if isinstance(x, jax.Array) else x, tree)


def _put_on_own_devices(array: Any, sharding: NamedSharding) -> jax.Array:
    whole = np.asarray(array)
    return jax.make_array_from_callback(whole.shape, sharding, lambda index: whole[index])


def _whole() -> NamedSharding:
    return NamedSharding(_mesh(), PartitionSpec())


def _split(ndim: int) -> NamedSharding:
    return NamedSharding(_mesh(), PartitionSpec(*[None] * (ndim - 1), _AXIS))


@functools.cache
def _mesh() -> Mesh:
    return Mesh(np.asarray(jax.devices()), (_AXIS,))
