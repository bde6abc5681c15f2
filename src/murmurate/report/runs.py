"""The runs of a plan: checked together before anything is trained, trained one after the other, and read."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from murmurate import plots
from murmurate.discovery import Search
from murmurate.errors import RunError
from murmurate.report.plan import Plan, PlannedRun
from murmurate.runs import checkpoint, storage, table
from murmurate.runs import experiment as configuration
from murmurate.runs.evaluate import FRESH, TRAJECTORIES
from murmurate.runs.train import discover

__all__ = ["Result", "check", "read", "train"]

_NEEDED = frozenset({"platform", "device", "versions", "outcome", "policies", "environment_steps", "train_seconds"})


@dataclass(frozen=True, eq=False)
class Result:
    """A finished run of a plan.

    Attributes:
        planned: The run, as it was planned.
        folder: Its folder.
        manifest: The contents of manifest.json.
        summary: The contents of evaluation.json.
    """

    planned: PlannedRun
    folder: Path
    manifest: Mapping[str, Any]
    summary: Mapping[str, Any]

    @functools.cached_property
    def recording(self) -> plots.Recording:
        """The run as figures need it.

        Raises:
            RunError: Its episodes are damaged, or not finite because the training diverged.
        """
        return plots.Recording.open(self.folder)


def check(plan: Plan, runs: str | Path) -> dict[str, storage.Found]:
    """Makes sure that every run of a plan can be reused, continued or trained; writes nothing.

    Args:
        plan: The runs.
        runs: The folder of all runs.

    Returns:
        What the folder of each run holds, by its name.

    Raises:
        RunError: A folder holds another experiment, a damaged run, or something that would be overwritten.
    """
    return {planned.name: _look(planned, Path(runs) / planned.name) for planned in plan.runs}


def _look(planned: PlannedRun, folder: Path) -> storage.Found:
    found = storage.look(folder, resume=True)
    if found != "new":
        configuration.check_same(planned.config, folder)
    if found == "finished":
        read(planned, folder)
        storage.read_npz(folder / TRAJECTORIES)
    elif found == "unfinished":
        checkpoint.load(folder, Search(planned.config))
    return found


def train(planned: PlannedRun, runs: str | Path, on_progress: Callable[..., None] | None = None) -> Result:
    """Trains a run or goes on with it; where it is finished, reads it only.

    Args:
        planned: The run.
        runs: The folder of all runs.
        on_progress: See `training.discover`.

    Raises:
        RunError: The folder holds another run, is damaged, or cannot be written to.
    """
    folder = Path(runs) / planned.name
    if storage.look(folder, resume=True) != "finished":
        discover(planned.config, folder, resume=True, on_progress=on_progress)
    return read(planned, folder)


def read(planned: PlannedRun, folder: Path) -> Result:
    """Reads a finished run.

    Raises:
        RunError: It is damaged or unfinished, or was evaluated from other starts than its experiment's.
    """
    manifest = storage.read_manifest(folder)
    storage.verify(folder, manifest)
    summary = table.read_evaluation(folder)
    if summary["starts"] != FRESH:
        raise RunError(f"{folder} was evaluated from other starts: make it again with murmurate evaluate {folder}")
    missing = _NEEDED - manifest.keys()
    if missing:
        raise RunError(f"{folder / storage.MANIFEST} lacks {min(missing)}")
    return Result(planned, folder, manifest, summary)
