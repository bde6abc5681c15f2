"""Workers on this machine: processes of their own, one at a time for each of its cores."""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass
from pathlib import Path

from murmurate.errors import InputError, check_number
from murmurate.sweeps.backend import Share, cores
from murmurate.sweeps.process import reason, start

__all__ = ["Local"]

_PATIENCE = 5.0
"""Seconds that a worker has for ending by itself."""


class Local:
    """Spawns a process for every run. They end with the process that holds this, however it ends.

    Args:
        workers: How many at once; by default as many as there are cores, or GPUs, for all they have for themselves.
        share: What each has for itself.

    Raises:
        InputError: There are not so many GPUs, or no room for one worker.
    """

    def __init__(self, workers: int | None, share: Share) -> None:
        devices = _devices() if share.gpus else []
        if share.gpus > len(devices):
            raise InputError("--gpus", share.gpus, f"at most {len(devices)}, the GPUs of this machine")
        most = len(devices) // share.gpus if share.gpus else None
        self.workers: int = workers or most or max(1, cores() // share.threads)
        check_number("--workers", self.workers, 1, most, integer=True)
        self._share = share
        # Places at GPUs, of which each worker takes one and gives it back.
        self._places = [devices[place * share.gpus :][: share.gpus] for place in range(self.workers)]

    def submit(self, folder: Path) -> Process:
        """Starts a worker."""
        place = self._places.pop()
        environment = {"CUDA_VISIBLE_DEVICES": ",".join(place)} if place else {}
        process = start(folder.resolve(), self._share, environment)
        return Process(process, folder, place, self._places)

    def close(self) -> None:
        """Nothing is held beyond the workers."""


@dataclass(frozen=True, eq=False)
class Process:
    """A worker on this machine.

    Attributes:
        process: The process.
        folder: The run folder.
        place: The GPUs that it has.
        places: Where it gives them back.
    """

    process: subprocess.Popen[bytes]
    folder: Path
    place: list[str]
    places: list[list[str]]

    def poll(self) -> str | None:
        """See `Job`."""
        status = self.process.poll()
        if status is None:
            return None
        self._leave()
        return reason(status, self.folder)

    def cancel(self) -> None:
        """Ends it, and waits until it has."""
        self.process.terminate()
        try:
            self.process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._leave()

    def _leave(self) -> None:
        self.places.append(self.place)
        if self.process.stdin is not None:
            self.process.stdin.close()


def _devices() -> list[str]:
    """Names the GPUs that this process may use, as CUDA does."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is not None:
        return [device for device in visible.split(",") if device.strip()]
    return [str(place) for place, _ in enumerate(Path("/dev").glob("nvidia[0-9]*"))]
