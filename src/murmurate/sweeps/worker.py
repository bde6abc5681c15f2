"""What a worker does, on whatever machine: it trains one run, whose folder says all that there is to know.

`python -m murmurate.sweeps.worker FOLDER` is a worker of the backends `local` and `ray`; Slurm calls `train`.

Nothing is imported at the top that loads JAX, which reads the environment when it is loaded.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import os
import platform
import sys
import threading
import traceback
from collections.abc import Iterator
from pathlib import Path

from murmurate.errors import InputError, RunError

__all__ = ["COMPILED", "LOG", "train"]

LOG = "worker.log"
"""What a worker writes on stderr, inside of the run folder; removed when the run is finished."""

COMPILED = ".compiled"
"""Compiled programs, which runs of the same shapes have in common, beside the run folders: a folder a machine."""


def train(folder: str, threads: int = 1, gpus: int = 0) -> str:
    """Trains, or goes on with, the run that a folder holds, as `murmurate discover --resume` does.

    Only one worker is ever at a run: another, left behind by a sweep that was killed, is waited for.

    Args:
        folder: The run folder, with its experiment.toml.
        threads: How many threads to compute with.
        gpus: How many GPUs it was given.

    Returns:
        Why the run is not finished; "" when it is.
    """
    path = Path(folder)
    _share(path, threads, gpus)
    try:
        with (path / LOG).open("a") as log:
            fcntl.flock(log, fcntl.LOCK_EX)
            log.truncate(0)
            with _stderr_to(log.fileno()):
                reason = _train(path)
            print(reason, file=log)
        if not reason:
            (path / LOG).unlink(missing_ok=True)
    except OSError as error:
        return f"{path}: {error.strerror or error}"
    return reason


def _share(folder: Path, threads: int, gpus: int) -> None:
    """Says in the environment what of the machine is the run's, before JAX and NumPy are loaded."""
    os.environ["NPROC"] = os.environ["OMP_NUM_THREADS"] = str(threads)
    if not gpus:
        os.environ["JAX_PLATFORMS"] = "cpu"
    # Not across machines: what is compiled for one processor may stop another.
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(folder.parent / COMPILED / platform.node()))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")


@contextlib.contextmanager
def _stderr_to(descriptor: int) -> Iterator[None]:
    """Sends what this process and the libraries in it complain of elsewhere."""
    saved = os.dup(2)
    os.dup2(descriptor, 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)


def _train(folder: Path) -> str:
    try:
        from murmurate.runs import experiment
        from murmurate.runs.train import discover

        discover(experiment.load(folder), folder, resume=True)
    except (InputError, RunError) as error:
        return str(error)
    except Exception as error:
        traceback.print_exc()
        return " ".join(f"{type(error).__name__}: {error}".split())
    return ""


def _leave_with_parent() -> None:
    """Ends this process when the one that started it is gone, killed even: its end of the pipe closes."""
    sys.stdin.buffer.read()
    os._exit(1)


def _main() -> int:
    parser = argparse.ArgumentParser("murmurate.sweeps.worker")
    parser.add_argument("folder")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--gpus", type=int, default=0)
    options = parser.parse_args()
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    return 1 if train(options.folder, options.threads, options.gpus) else 0


if __name__ == "__main__":
    sys.exit(_main())
