"""Several hosts that train as one, by `jax.distributed`.

Each runs the same program with the same numbers, holds a part of every batch (see `devices`), and computes for itself
whatever is not split. What could differ between unlike machines and decides how training goes on is the first host's.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import re
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jax.experimental import multihost_utils

from murmurate.errors import HostError, InputError, RunError, check_number

__all__ = ["agreed", "check", "guarded", "is_first", "join", "sent"]

_MOST = 65536
_PATIENCE = 20.0
"""Seconds that the first host has to answer the others."""

_GATHERING = 300
"""Seconds that all hosts have to come together once it answers."""

_HEARTBEAT = 10
"""Seconds after which a silent host is taken for dead, where nothing else has told of it."""


@dataclass
class _Leaving:
    """How this process leaves the others; a status says that it does not wait for them."""

    status: int | None = None


_leaving = _Leaving()


def check(coordinator: str | None, count: int | None, index: int | None) -> tuple[str, int]:
    """Checks what `join` is told.

    Returns:
        Where the first host listens.

    Raises:
        InputError: It is not possible.
    """
    check_number("--hosts", count, 1, _MOST, integer=True)
    check_number("--host", index, 0, (count or 1) - 1, integer=True)
    host, _, port = (coordinator or "").rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise InputError("--coordinator", coordinator, "HOST:PORT of the first host, the same for all")
    return host.strip("[]"), int(port)


def join(coordinator: str | None, count: int | None, index: int | None) -> None:
    """Makes this process one of several that train together; before JAX has computed anything.

    Args:
        coordinator: HOST:PORT at which the first host listens, the same for all.
        count: How many there are.
        index: Which this is, from 0. Without any of the three the cluster says, as far as JAX knows it: Slurm, Open MPI
            and others.

    Raises:
        InputError: The hosts do not come together, or there is no cluster that JAX knows.
    """
    words: dict[str, Any] = {}
    if coordinator is not None or count is not None or index is not None:
        address = check(coordinator, count, index)
        if index:
            _wait_for(address, coordinator)
        words = {"coordinator_address": coordinator, "num_processes": count, "process_id": index}
        words["cluster_detection_method"] = "deactivate"
    jax.config.update("jax_enable_preemption_service", False)  # it would swallow requests to end
    with _interruptible():
        _initialize(words)
    atexit.register(_leave)


def is_first() -> bool:
    """Says whether this host is the one that keeps and tells what comes of the training; true where it is alone."""
    return jax.process_index() == 0


def agreed(tree: Any) -> Any:
    """Returns the first host's arrays on all hosts, NumPy's."""
    if jax.process_count() == 1:
        return jax.tree.map(np.asarray, tree)
    return jax.tree.map(np.asarray, multihost_utils.broadcast_one_to_all(tree))


def sent(data: bytes) -> bytes:
    """Returns the first host's bytes on all hosts."""
    if jax.process_count() == 1:
        return data
    size = int(agreed(np.int32(len(data))))
    own = np.frombuffer(data, np.uint8) if is_first() else np.zeros(size, np.uint8)
    return agreed(own).tobytes()


@contextlib.contextmanager
def guarded() -> Iterator[None]:
    """Tells of the death of another host as an error of the run, and has this process end without waiting for it.

    Raises:
        HostError: Another host is gone, or has failed.
    """
    if jax.process_count() == 1:
        yield
        return
    try:
        yield
    except KeyboardInterrupt:
        _abandon(130)
        raise
    except (InputError, RunError):
        _abandon(2)
        raise
    except Exception as error:
        if not re.search("gloo|nccl|coordination", str(error), re.IGNORECASE):
            _abandon(1)
            raise
        _abandon(2)
        raise HostError(str(error)) from None


def _abandon(status: int) -> None:
    """Has this process end with a status when Python does, without a goodbye to hosts that may not answer."""
    _leaving.status = status


def _leave() -> None:
    if _leaving.status is None:
        jax.distributed.shutdown()
        return
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(_leaving.status)


def _initialize(words: dict[str, Any]) -> None:
    try:
        jax.distributed.initialize(**words, initialization_timeout=_GATHERING, heartbeat_timeout_seconds=_HEARTBEAT)
    except ValueError as error:
        raise InputError("--hosts", "auto", f"used on a cluster that JAX knows, such as Slurm's: {error}") from None
    except RuntimeError as error:
        _leaving.status = 2
        atexit.register(_leave)
        raise RunError(f"the hosts have not come together: {error}") from None


@contextlib.contextmanager
def _interruptible() -> Iterator[None]:
    """Lets an interrupt end this process where Python, which waits for other hosts in C++, would not get to see it."""
    if threading.current_thread() is not threading.main_thread():  # signals are the main thread's
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _wait_for(address: tuple[str, int], coordinator: str | None) -> None:
    until, reason = time.monotonic() + _PATIENCE, ""
    while time.monotonic() < until:
        try:
            socket.create_connection(address, timeout=max(0.1, until - time.monotonic())).close()
            return
        except OSError as error:
            reason = error.strerror or str(error)
            time.sleep(0.2)
    raise InputError(
        "--coordinator", coordinator, f"the address of the first host: none answered within {_PATIENCE:g} s ({reason})"
    )
