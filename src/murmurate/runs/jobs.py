"""Jobs: pieces of work with a folder, such as the training of a run, which any process can do and continue."""

from __future__ import annotations

import abc
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from murmurate.discovery import policy_name
from murmurate.representation import short_repr
from murmurate.runs import files
from murmurate.runs.experiment import ExperimentConfig
from murmurate.runs.folder import RunFolder
from murmurate.runs.grid import Grid
from murmurate.runs.run import Run

__all__ = ["Job", "JobStatus", "Progress", "TrainingJob", "initial_statuses", "training_jobs"]


@dataclass(frozen=True)
class Progress:
    """How far a training is.

    Attributes:
        stage: What is done, such as the policy in training.
        update: Updates of it that are done.
        updates: Updates of it in all.
        reward: Mean reward of a step in the last update; None where it was not finite.
        steps_per_second: Environment steps per second.
        seconds_left: Seconds until the last update; None where that is not known yet.
    """

    stage: str
    update: int
    updates: int
    reward: float | None
    steps_per_second: float | None
    seconds_left: float | None

    __repr__ = short_repr


class Job(abc.ABC):
    """A piece of work with a folder, which any process can do and, when interrupted, continue."""

    folder: Path

    @property
    def name(self) -> str:
        """What tables and messages call it."""
        return self.folder.name

    @abc.abstractmethod
    def is_finished(self) -> bool:
        """Returns whether the folder holds the finished work.

        Raises:
            RunError: The folder holds something else.
        """

    def prepare(self) -> None:
        """Creates the folder, with what a worker process needs to find there.

        Raises:
            RunError: It cannot be written to.
        """
        files.make_folder(self.folder)

    @abc.abstractmethod
    def run(self, on_progress: Callable[..., None] | None = None) -> None:
        """Does the work in this process.

        Args:
            on_progress: Called as `on_progress(work, done, total, **values)` from time to time.

        Raises:
            InputError: The work is impossible.
            RunError: The folder holds something else, is damaged, or cannot be written to.
        """

    @classmethod
    def run_together(cls, jobs: Sequence[Any], on_progress: Callable[..., None] | None = None) -> None:
        """Does several jobs of this class in this process; here, one after the other."""
        for job in jobs:
            job.run(on_progress)

    @abc.abstractmethod
    def fields(self) -> dict[str, Any]:
        """Returns what `from_spec` needs beside the folder, as JSON has it."""

    @classmethod
    @abc.abstractmethod
    def from_spec(cls, fields: Mapping[str, Any]) -> Job:
        """Returns the job of the `fields`, with its `folder`."""

    def spec(self) -> str:
        """Returns the job as JSON, for a worker."""
        name = f"{type(self).__module__}:{type(self).__qualname__}"
        return json.dumps({"class": name, "folder": str(self.folder.resolve()), **self.fields()})

    def progress(self) -> Progress | None:
        """Returns how far the work is, by its folder; None where that is not known."""
        return None

    def result(self) -> str:
        """Returns what came of the finished work, in a few words."""
        return "done"


@dataclass(frozen=True, eq=False)
class TrainingJob(Job):
    """The training of one run.

    Attributes:
        folder: The run folder.
        config: The experiment; None to read it from the folder.
        on_metrics: See `train.discover`; only in this process.
        initial: See `train.discover`.
    """

    folder: Path
    config: ExperimentConfig | None = None
    on_metrics: Callable[[Path], None] | None = None
    initial: Run | None = None

    __repr__ = short_repr

    def is_finished(self) -> bool:
        """See `Job`."""
        run = RunFolder(self.folder)
        return run.inspect(resume=True) == "finished" and run.is_whole()

    def prepare(self) -> None:
        """See `Job`."""
        from murmurate.runs.train import begin_with, check_initial

        run, config = RunFolder(self.folder), self.config
        if config is not None and self.initial is not None:
            check_initial({self.folder: config}, True, {self.folder: self.initial})
        is_damaged = run.inspect(resume=True) == "finished" and not run.is_whole()
        is_new = run.create(resume=True) == "new"
        if config is not None and self.initial is not None and (is_new or is_damaged):
            begin_with(run, config, self.initial)
        if is_damaged:
            run.unfinish()  # it is trained again
        if config is not None and is_new:
            run.write_experiment(config)

    def run(self, on_progress: Callable[..., None] | None = None) -> None:
        """See `Job`."""
        self.run_together([self], on_progress)

    @classmethod
    def run_together(cls, jobs: Sequence[TrainingJob], on_progress: Callable[..., None] | None = None) -> None:
        """Trains several runs, those of the same shapes side by side in one compiled program."""
        from murmurate.runs.train import discover_together

        # A worker may import the modules that its sweep names: the user who started the sweep named them.
        configs = {job.folder: job.config or RunFolder(job.folder).experiment(trust=True) for job in jobs}
        initial = {job.folder: job.initial for job in jobs if job.initial is not None}
        discover_together(configs, True, on_progress, jobs[0].on_metrics, initial)

    def fields(self) -> dict[str, Any]:
        """See `Job`."""
        return {}

    @classmethod
    def from_spec(cls, fields: Mapping[str, Any]) -> TrainingJob:
        """See `Job`."""
        return cls(Path(fields["folder"]))

    def progress(self) -> Progress | None:
        """See `Job`."""
        return _training_progress(self.folder, self.config) if self.config is not None else None

    def result(self) -> str:
        """See `Job`."""
        return f"{RunFolder(self.folder).evaluation()['valid']:.1%} valid"


def _training_progress(folder: Path, config: ExperimentConfig) -> Progress | None:
    """Reads from the metrics of a run how far it is; None while nothing is trained yet."""
    run = RunFolder(folder)
    rows = run.last_metrics()
    if not rows:
        return None
    last, speed = rows[-1], rows[-1]["steps_per_second"]
    policy, left = last["policy"], None
    stage_config = config.stage(policy)
    phase = stage_config.learners.index(last.get("learner", stage_config.learner))
    updates = stage_config.learning(phase).updates
    if len(rows) > 1 and speed:
        steps = last["environment_steps"] - rows[-2]["environment_steps"]
        left = (updates - last["update"]) * steps / speed
    stage = policy_name(policy) + (f" {policy}" if policy > 1 else "") + (", refined" if phase else "")
    if run.is_trained():
        stage = "evaluation"
    return Progress(stage, last["update"], updates, last["reward"], speed or None, left)


def training_jobs(
    grid: Grid,
    out: str | Path,
    on_metrics: Callable[[Path], None] | None = None,
    initial: Mapping[str, Run] | None = None,
) -> list[TrainingJob]:
    """Returns the trainings of a grid's runs in a folder.

    Args:
        grid: The runs.
        out: The folder of all runs.
        on_metrics: See `train.discover`; only in this process.
        initial: The runs that trainings begin with, by the names of the grid; the others begin with new policies.
    """
    initial = initial or {}
    return [TrainingJob(Path(out) / name, config, on_metrics, initial.get(name)) for name, config in grid.runs.items()]


@dataclass(frozen=True)
class JobStatus:
    """How far a job is.

    Attributes:
        state: Waiting for a worker, running, done, or failed as often as it may.
        attempts: How many workers have begun at it; 0 when it was finished before.
        error: Why the last of them that failed did.
    """

    state: Literal["waiting", "running", "done", "failed"] = "waiting"
    attempts: int = 0
    error: str = ""

    __repr__ = short_repr


def initial_statuses(jobs: Sequence[Job]) -> dict[str, JobStatus]:
    """Returns the status of every job by its name, before anything is done.

    Raises:
        RunError: A folder holds something else.
    """
    return {job.name: JobStatus("done" if job.is_finished() else "waiting") for job in jobs}
