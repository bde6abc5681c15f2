"""Who trains the runs of a sweep: the one interface that this machine, Ray and Slurm have in common.

What a worker is told is the path of a run folder, and all that it has to say stands in that folder: the backend only
starts it, says when it has ended, and ends it early.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from murmurate.errors import UsageError, check_number

__all__ = ["Backend", "Job", "Share", "cores", "missing"]


@dataclass(frozen=True)
class Share:
    """What of a machine one run has for itself.

    Attributes:
        threads: Cores, and threads that compute on them. Their number changes the last bits of sums of floats.
        gpus: GPUs; without any a run uses the CPU alone.
    """

    threads: int = 1
    gpus: int = 0

    def __post_init__(self) -> None:
        check_number("--threads", self.threads, 1, 1024, integer=True)
        check_number("--gpus", self.gpus, 0, 64, integer=True)


class Job(Protocol):
    """A worker under way, at one run."""

    def poll(self) -> str | None:
        """Says how it ended: "" when it says that the run is finished, or else why not; None while it goes on."""
        ...

    def cancel(self) -> None:
        """Ends it; the run folder stays as one that can be resumed."""
        ...


class Backend(Protocol):
    """Where workers run."""

    @property
    def workers(self) -> int | None:
        """How many jobs to submit at once; None for all, where the backend has a queue of its own."""
        ...

    def submit(self, folder: Path) -> Job:
        """Starts a worker at a run folder, or has it wait for its turn.

        Raises:
            RunError: The backend refuses.
        """
        ...

    def close(self) -> None:
        """Lets go of whatever the backend holds; all jobs have ended or been cancelled."""
        ...


def cores() -> int:
    """Counts the cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def missing(backend: str, package: str) -> UsageError:
    """Returns the error that names the command which installs what a backend needs."""
    return UsageError(f'--backend {backend} needs {package}: pip install "murmurate[{backend}]"')
