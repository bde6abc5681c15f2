"""Refuses to compute in a process that was forked after JAX had started: JAX would hang there.

JAX runs threads, and a fork copies none of them: the first computation of such a process waits for ever. Processes that
are spawned start JAX anew, and so do those that are forked before anything was computed.
"""

from __future__ import annotations

import os
import sys

from murmurate.errors import ForkError

__all__ = ["can_compute", "check_can_compute"]

_forked_too_late = False


def can_compute() -> bool:
    """Returns whether JAX can compute in this process."""
    return not _forked_too_late


def check_can_compute() -> None:
    """Checks that JAX can compute in this process.

    Raises:
        ForkError: JAX had been started before this process was forked.
    """
    if _forked_too_late:
        raise ForkError(
            "JAX had been started before this process was forked, and cannot compute in it: start processes with "
            'multiprocessing.get_context("spawn"), and Gymnasium\'s AsyncVectorEnv with context="spawn"'
        )


def _note_fork() -> None:
    global _forked_too_late
    bridge = sys.modules.get("jax._src.xla_bridge")
    # JAX's own function for this takes a lock, which another thread may have held when the process was forked.
    _forked_too_late = _forked_too_late or bool(getattr(bridge, "_backends", None))


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note_fork)
