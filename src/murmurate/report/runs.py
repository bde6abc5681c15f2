"""The runs of a plan: checked together before anything is trained, trained as a grid, and read."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from murmurate import plots
from murmurate.discovery import Search
from murmurate.errors import RunError
from murmurate.report.plan import Plan, PlannedRun
from murmurate.representation import short_repr
from murmurate.runs.evaluate import evaluated
from murmurate.runs.execute import Executor, InProcess, run_jobs
from murmurate.runs.folder import FolderState, RunFolder, is_fresh
from murmurate.runs.jobs import training_jobs

__all__ = ["Result", "check", "read", "train"]

NEEDED = frozenset({"platform", "device", "versions", "policies", "environment_steps", "train_seconds"})


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

    __repr__ = short_repr

    @functools.cached_property
    def recording(self) -> plots.Recording:
        """The run as figures need it.

        Raises:
            RunError: Its episodes are damaged, or not finite because the training diverged.
        """
        return plots.Recording.open(self.folder)


def check(plan: Plan, runs: str | Path) -> dict[str, FolderState]:
    """Checks that every run of a plan can be reused, continued or trained; writes nothing.

    Args:
        plan: The runs.
        runs: The folder of all runs.

    Returns:
        What the folder of each run holds, by its name.

    Raises:
        RunError: A folder holds another experiment, a damaged run, or something that would be overwritten.
    """
    states = plan.grid.check(runs)
    for planned in plan.runs:
        folder = RunFolder(Path(runs) / planned.name)
        if states[planned.name] == "finished":
            read(planned, folder.path)
            folder.trajectories(planned.config)
        elif states[planned.name] == "unfinished":
            folder.checkpoint(Search(planned.config))
    return states


def train(plan: Plan, runs: str | Path, executor: Executor | None = None, quiet: bool = True) -> list[Result]:
    """Trains the runs of a plan that are not finished, or continues them, and reads all.

    Args:
        plan: The runs.
        runs: The folder of all runs.
        executor: Where runs are trained; by default in this process, one after the other.
        quiet: Show nothing.

    Raises:
        RunError: A folder holds another run, is damaged, or cannot be written to; or a training failed.
    """
    statuses = run_jobs(training_jobs(plan.grid, runs), executor or InProcess(), quiet=quiet)
    for name, status in statuses.items():
        if status.state == "failed":
            raise RunError(f"{Path(runs) / name}: {status.error}")
    return [read(planned, Path(runs) / planned.name) for planned in plan.runs]


def read(planned: PlannedRun, folder: Path) -> Result:
    """Reads a finished run.

    Raises:
        RunError: It is damaged or unfinished, or was evaluated from other starts than its experiment's.
    """
    run = RunFolder(folder)
    manifest, summary = run.verify(NEEDED), evaluated(run)
    if not is_fresh(summary):
        raise RunError(f"{folder} was evaluated from other starts: make it again with murmurate evaluate {folder}")
    return Result(planned, folder, manifest, summary)
