"""Worker processes: each does one job, in any process of any machine that shares the job's folder.

`python -m murmurate.runs.worker SPEC` is a worker of this machine's cores and of Ray; Slurm calls `work`.

Nothing that loads JAX is imported at the top: JAX reads the environment when it is loaded.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import os
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from murmurate import untrusted
from murmurate.errors import InputError, RunError, one_line

__all__ = ["LOG", "end_reason", "start_process", "work"]

LOG = "worker.log"
"""What a worker writes on stderr, in the job's folder; removed when the job is finished."""

LOCK = ".worker.lock"
"""What the worker at a job locks, in the job's folder."""

MAX_LOG_BYTES = 1 << 24


def start_process(
    spec: str, threads: int, gpus: int, environment: Mapping[str, str] | None = None
) -> subprocess.Popen[bytes]:
    """Starts a worker process at a job.

    Args:
        spec: The job, as `Job.spec` writes it.
        threads: Threads that it computes with.
        gpus: GPUs that it has.
        environment: More of its environment.

    Returns:
        The process. It ends when its stdin closes, and so when this process ends.
    """
    arguments = [spec, "--threads", str(threads), "--gpus", str(gpus)]
    log_path = Path(json.loads(spec)["folder"]) / LOG
    untrusted.detach(log_path, MAX_LOG_BYTES)
    with untrusted.append(log_path) as log:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "murmurate.runs.worker", *arguments],
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)} | dict(environment or {}),
            stdin=subprocess.PIPE,
            stdout=log,
            stderr=log,
            # Ctrl-C is for the driver, which ends its workers. The second is the first for Windows.
            start_new_session=True,
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        )


def end_reason(status: int, folder: Path) -> str:
    """Returns why a worker ended, by its exit status and the last line of its log; "" when it did its job.

    The log of a job that is done is removed.
    """
    if status < 0:
        with contextlib.suppress(ValueError):
            return f"killed by {signal.Signals(-status).name}"
    if status == 0:
        _remove_log(folder)
        return ""
    try:
        lines = untrusted.read(folder / LOG, MAX_LOG_BYTES).decode(errors="replace").split("\n")
    except OSError:
        lines = []
    last = next((line.strip() for line in reversed(lines) if line.strip()), "")
    return one_line(last) or f"the worker ended with status {status}"


def work(spec: str, threads: int = 1, gpus: int = 0) -> str:
    """Does a job, or continues it.

    Only one worker is ever at a job: another one, left over from a driver that was killed, is waited for.

    Args:
        spec: The job, as `Job.spec` writes it.
        threads: Threads to compute with.
        gpus: GPUs that the worker was given.

    Returns:
        Why the job is not finished; "" when it is.
    """
    folder = Path(json.loads(spec)["folder"])
    _set_environment(threads, gpus)
    try:
        with untrusted.locked(folder / LOCK, wait=True):
            untrusted.detach(folder / LOG, MAX_LOG_BYTES)
            with untrusted.append(folder / LOG) as log:
                log.truncate(0)
                with _stderr_to(log.fileno()):
                    reason = _run(spec)
                log.write(f"{reason}\n".encode(errors="replace"))
            if not reason:
                _remove_log(folder)
    except OSError as error:
        return f"{folder}: {error.strerror or error}"
    return reason


def _remove_log(folder: Path) -> None:
    """Removes the log of a job that is done."""
    with contextlib.suppress(OSError):  # Windows removes no file that is open: the driver tries again after the worker
        (folder / LOG).unlink(missing_ok=True)


def _set_environment(threads: int, gpus: int) -> None:
    """Limits what JAX and NumPy use of the machine, before they are loaded."""
    os.environ["NPROC"] = os.environ["OMP_NUM_THREADS"] = str(threads)
    if not gpus:
        os.environ["JAX_PLATFORMS"] = "cpu"


@contextlib.contextmanager
def _stderr_to(descriptor: int) -> Iterator[None]:
    """Redirects what this process and its libraries write on stderr."""
    saved = os.dup(2)
    os.dup2(descriptor, 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)


def _run(spec: str) -> str:
    try:
        fields: dict[str, Any] = json.loads(spec)
        module, _, name = fields.pop("class").partition(":")
        getattr(importlib.import_module(module), name).from_spec(fields).run()
    except (InputError, RunError) as error:
        return str(error)
    except Exception as error:
        traceback.print_exc()
        return one_line(f"{type(error).__name__}: {error}")
    return ""


def _end_with_parent() -> None:
    """Ends this process when the one that started it is gone, even by kill -9: its end of the pipe closes."""
    # Not `sys.stdin`: its lock, held by this thread, would abort the interpreter when the worker ends.
    while os.read(0, 1024):
        pass
    os._exit(1)


def main() -> int:
    """Runs the worker process."""
    parser = argparse.ArgumentParser("murmurate.runs.worker")
    parser.add_argument("spec")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--gpus", type=int, default=0)
    options = parser.parse_args()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    return 1 if work(options.spec, options.threads, options.gpus) else 0


if __name__ == "__main__":
    sys.exit(main())
