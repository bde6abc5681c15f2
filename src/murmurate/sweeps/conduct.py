"""Carries out a sweep: hands runs to a backend, tries again those that failed, and ends everything when interrupted."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from murmurate.errors import RunError
from murmurate.runs import storage
from murmurate.sweeps.backend import Backend, Job

__all__ = ["Standing", "conduct", "standing"]

_PAUSE = 0.2
"""Seconds between looks at the workers."""


@dataclass(frozen=True)
class Standing:
    """How a run of a sweep stands.

    Attributes:
        status: Waiting for a worker, running, done, or failed as often as it may.
        attempts: How many workers of this sweep have begun at it; 0 when it was finished before. A sweep that goes on
            counts anew.
        error: Why the last of them that failed did.
    """

    status: Literal["waiting", "running", "done", "failed"] = "waiting"
    attempts: int = 0
    error: str = ""


def standing(folder: Path) -> Standing:
    """Returns how a run stands before anything is done for it."""
    return Standing("done" if storage.look(folder, resume=True) == "finished" else "waiting")


def conduct(
    folders: Mapping[str, Path],
    standings: dict[str, Standing],
    backend: Backend,
    retries: int,
    tell: Callable[[str], None],
    look: Callable[[], None] = lambda: None,
) -> None:
    """Trains every run that is not finished; however this ends, no worker is left.

    Args:
        folders: The run folders by name.
        standings: How the runs stand; kept up to date, so that whoever holds it knows even after an interruption.
        backend: Where workers run.
        retries: How often a run that failed is tried again, from its checkpoint.
        tell: Called with the name of a run whenever a worker at it has ended.
        look: Called several times a second.

    Raises:
        RunError: The backend refuses a run.
    """
    waiting = deque(name for name in folders if standings[name].status == "waiting")
    jobs: dict[str, Job] = {}
    try:
        while waiting or jobs:
            while waiting and (backend.workers is None or len(jobs) < backend.workers):
                name = waiting.popleft()
                jobs[name] = backend.submit(folders[name])
                now = standings[name]
                standings[name] = replace(now, status="running", attempts=now.attempts + 1)
            for name, job in list(jobs.items()):
                reason = job.poll()
                if reason is None:
                    continue
                del jobs[name]
                standings[name] = _ended(standings[name], folders[name], reason, retries)
                if standings[name].status == "waiting":
                    waiting.append(name)
                tell(name)
            look()
            if jobs:
                time.sleep(_PAUSE)
    finally:
        for job in jobs.values():
            job.cancel()


def _ended(now: Standing, folder: Path, reason: str, retries: int) -> Standing:
    """Judges by the run folder, whatever the worker said: a run is done when its manifest is there."""
    try:
        finished = storage.look(folder, resume=True) == "finished"
    except RunError as error:
        finished, reason = False, str(error)
    if finished:
        return replace(now, status="done", error="")
    error = reason or "the worker ended, but the run is not finished"
    return replace(now, status="waiting" if now.attempts <= retries else "failed", error=error)
