"""A worker as a process of its own on this machine, which ends with the one that started it, however that ends."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from murmurate.sweeps.backend import Share
from murmurate.sweeps.worker import LOG

__all__ = ["reason", "start"]


def start(folder: Path, share: Share, environment: Mapping[str, str] | None = None) -> subprocess.Popen[bytes]:
    """Starts a worker at a run folder.

    Args:
        folder: The run folder, absolute.
        share: What the run has for itself.
        environment: More of the environment.

    Returns:
        The process. Its stdin is what it lives by: it ends when that closes, and so when this process ends.
    """
    words = ["--threads", str(share.threads), "--gpus", str(share.gpus)]
    with (folder / LOG).open("ab") as log:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "murmurate.sweeps.worker", str(folder), *words],
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)} | dict(environment or {}),
            stdin=subprocess.PIPE,
            stdout=log,
            stderr=log,
            start_new_session=True,  # an interrupt at the terminal is for the sweep, which ends its workers
        )


def reason(status: int, folder: Path) -> str:
    """Says why a worker ended, by its exit status and its last words; "" when the run is finished."""
    if status < 0:
        with contextlib.suppress(ValueError):
            return f"killed by {signal.Signals(-status).name}"
    return "" if status == 0 else _last_line(folder / LOG) or f"the worker ended with status {status}"


def _last_line(path: Path) -> str:
    """Returns the last words of a worker."""
    try:
        lines = path.read_text(errors="replace").split("\n")
    except OSError:
        return ""
    return next((line.strip() for line in reversed(lines) if line.strip()), "")
