"""Workers on a Ray cluster: one that exists, by its address, or one of this machine's own; the extra `ray`."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from murmurate.errors import InputError, RunError
from murmurate.sweeps.backend import Share, cores, missing
from murmurate.sweeps.process import reason, start

__all__ = ["Ray"]

_PATIENCE = 20.0
"""Seconds that a cluster has to answer. Ray itself waits for minutes, and then ends the process."""

_ASK = """
import sys, ray
try:
    ray.init(address=sys.argv[1], log_to_driver=False, logging_level="ERROR")
except BaseException as error:
    sys.exit(str(error) or type(error).__name__)
"""

_STORE = 80 << 20
"""Bytes of Ray's store of objects, about its least: runs pass none."""


class Ray:
    """Has Ray spread runs over its nodes, each in a process of its own.

    The folder of the runs must be the same on all nodes, and murmurate be installed there.

    Args:
        address: Address of a cluster, such as `10.0.0.1:6379` or `auto`; None for one of this machine's own, which
            listens on this machine only and ends with this process.
        workers: How many runs to submit at once; by default all to a cluster, and as many as there are cores to one of
            our own.
        share: What each run has for itself.

    Raises:
        UsageError: Ray is not installed.
        InputError: No cluster answers at that address.
        RunError: Ray does not start.
    """

    def __init__(self, address: str | None, workers: int | None, share: Share) -> None:
        # Before Ray is loaded: it reports nothing to anybody, and what is for one machine is on its loopback alone.
        os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
        if address is None:
            os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"
        try:
            import ray
        except ModuleNotFoundError:
            raise missing("ray", "Ray") from None
        self.workers = workers or (max(1, cores() // share.threads) if address is None else None)
        own: dict[str, Any] = {}
        if address is None:
            own = {"include_dashboard": False, "object_store_memory": _STORE}
            own |= {"num_cpus": share.threads * self.workers} if self.workers else {}
        else:
            _ask(address)
        try:
            with warnings.catch_warnings():
                # JAX warns of every fork; Ray's children at once become other programs.
                warnings.simplefilter("ignore", RuntimeWarning)
                ray.init(address or "local", log_to_driver=False, logging_level=logging.ERROR, **own)
        except Exception as error:
            raise RunError(f"Ray does not start: {error}") from None
        self._ray = ray
        # What failed is tried again by the sweep, which counts; and memory is given back after every run.
        task: Any = ray.remote(max_calls=1, max_retries=0, num_cpus=share.threads, num_gpus=share.gpus)
        self._task, self._share = task(_train), share

    def submit(self, folder: Path) -> Task:
        """Hands a run to Ray's queue."""
        return Task(self._ray, self._task.remote(folder.resolve(), self._share))

    def close(self) -> None:
        """Leaves the cluster, or ends our own."""
        self._ray.shutdown()


@dataclass(frozen=True, eq=False)
class Task:
    """A run at Ray.

    Attributes:
        ray: The module.
        reference: What Ray knows it by.
    """

    ray: Any
    reference: Any

    def poll(self) -> str | None:
        """See `Job`."""
        try:
            if not self.ray.wait([self.reference], timeout=0)[0]:
                return None
            return self.ray.get(self.reference)
        except self.ray.exceptions.WorkerCrashedError:
            return "the worker died"
        except Exception as error:
            return " ".join(f"Ray: {error}".split())

    def cancel(self) -> None:
        """Has Ray kill its process, or take it from the queue."""
        self.ray.cancel(self.reference, force=True)


def _train(folder: Path, share: Share) -> str:
    """What Ray's worker does: has a process train the run, and returns why it is not finished.

    Not in Ray's worker itself, where a compilation by JAX never returns (Ray 2.60, JAX on CPU).
    """
    with start(folder, share) as process:
        return reason(process.wait(), folder)


def _ask(address: str) -> None:
    """Makes sure that a cluster answers, from a process that can be ended when none does."""
    try:
        words = [sys.executable, "-c", _ASK, address]
        asked = subprocess.run(words, timeout=_PATIENCE, capture_output=True, check=False)
        said, trouble = asked.stderr, _last_line(asked.stderr) if asked.returncode else ""
    except subprocess.TimeoutExpired as error:
        said, trouble = error.stderr or b"", f"none answered within {_PATIENCE:g} seconds"
    if trouble:
        if b"InvalidAuthToken" in said:
            trouble = "it refuses us without its token (RAY_AUTH_MODE=token, RAY_AUTH_TOKEN)"
        raise InputError("--address", address, f"the address of a Ray cluster: {trouble}")


def _last_line(said: bytes) -> str:
    return next(reversed(said.decode(errors="replace").strip().splitlines()), "no answer")
