"""Peak memory of a case: run once in a process of its own, which remembers nothing of the others."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import jax

from benchmarks.timing import Case, first_run

__all__ = ["peak", "peak_here"]


def peak(case: Case, arguments: Sequence[str]) -> int | None:
    """Measures a case in a fresh process.

    Args:
        case: What is run.
        arguments: By which that process makes the same cases.

    Returns:
        Peak bytes beyond those of an idle process, or None where the case does not fit.
    """
    command = [sys.executable, "-m", "benchmarks", *arguments, "--peak", case.key]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return json.loads(done.stdout.splitlines()[-1])["peak_bytes"] if done.returncode == 0 else None


def peak_here(case: Case) -> int:
    """Runs a case twice in this process, which did nothing yet, and returns the peak bytes that this took.

    On an accelerator these are the bytes on it; on a CPU what the process grew by, its compiler included.
    """
    jax.block_until_ready(jax.jit(lambda x: x + 1)(jax.numpy.ones(8)))
    device, before = jax.devices()[0], _resident()
    run, _ = first_run(case)
    jax.block_until_ready(run())
    stats = device.memory_stats() or {}
    return stats.get("peak_bytes_in_use", _resident() - before)


def _resident() -> int:
    """Returns the greatest size that this process has had in memory."""
    status = Path("/proc/self/status")
    if status.exists():  # the other counts what the process was forked from as well
        line = next(line for line in status.read_text(encoding="ascii").splitlines() if line.startswith("VmHWM"))
        return 1024 * int(line.split()[1])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
