"""Executes many jobs: in this process, in processes on this machine's cores, or on a cluster (see `clusters`).

Jobs that are finished are not done again, and unfinished ones continue. An executor says where jobs run; `run_jobs`
runs them and shows how far they are.
"""

from __future__ import annotations

import abc
import contextlib
import functools
import os
import subprocess
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from murmurate import untrusted
from murmurate.errors import InputError, RunError, check_number
from murmurate.interrupts import raise_if_interrupted, sigterm_as_interrupt
from murmurate.runs import files, worker
from murmurate.runs.grid import MAX_RUNS
from murmurate.runs.jobs import Job, JobStatus, initial_statuses
from murmurate.runs.live_table import LiveTable

__all__ = [
    "Batch",
    "Executor",
    "Handle",
    "InProcess",
    "LocalProcesses",
    "Resources",
    "WorkerExecutor",
    "count_cores",
    "locked",
    "run_jobs",
]

MAX_WORKERS = 1000
POLL_SECONDS = 0.2
TERMINATE_SECONDS = 5.0
"""Time that a worker has for ending before it is killed."""


def run_jobs(
    jobs: Sequence[Job],
    executor: Executor,
    *,
    statuses: dict[str, JobStatus] | None = None,
    on_end: Callable[[str], None] | None = None,
    quiet: bool = False,
) -> dict[str, JobStatus]:
    """Runs every job that is not finished, and shows how far they are.

    A terminal shows a live table; elsewhere lines are printed: for each chunk of work, and for every job that ends.

    Args:
        jobs: The jobs, each with a name of its own.
        executor: Where they run.
        statuses: See `initial_statuses`; kept up to date, so that they are known after an interruption too.
        on_end: Called with the name of a job when a worker at it has ended.
        quiet: Show nothing.

    Returns:
        The statuses.

    Raises:
        RunError: The executor refuses a job, or, in this process, a job failed.
        InputError: In this process, a job is impossible.
    """
    statuses = initial_statuses(jobs) if statuses is None else statuses
    with sigterm_as_interrupt(), LiveTable(jobs, statuses, quiet) as live_table:

        def end(name: str) -> None:
            live_table.report(name)
            if on_end is not None:
                on_end(name)

        executor.run(Batch(jobs, statuses, end, live_table.draw, live_table.progress))
    return statuses


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keeps a second driver out of a folder.

    Raises:
        RunError: Another one works there, or the folder cannot be written to.
    """
    with contextlib.ExitStack() as stack:
        with files.os_errors_as_run_errors(f"cannot write to {folder}"):
            folder.mkdir(parents=True, exist_ok=True)
            try:
                stack.enter_context(untrusted.locked(folder / ".lock"))
            except BlockingIOError:
                raise RunError(f"{folder}: another command is at work there") from None
        yield


# Executors


@dataclass(frozen=True)
class Batch:
    """Jobs that an executor runs.

    Attributes:
        jobs: The jobs.
        statuses: How far they are, by name; kept up to date.
        on_end: Called with the name of a job when a worker at it has ended.
        on_tick: Called several times a second, or, in this process, when a job begins.
        on_progress: Called as `on_progress(name, work, done, total, **values)` when a job in this process goes on.
    """

    jobs: Sequence[Job]
    statuses: dict[str, JobStatus]
    on_end: Callable[[str], None] = lambda name: None
    on_tick: Callable[[], None] = lambda: None
    on_progress: Callable[..., None] = lambda *_, **__: None


class Executor(abc.ABC):
    """Where jobs run. It is a context manager, which gives back what the executor holds."""

    @abc.abstractmethod
    def run(self, batch: Batch) -> None:
        """Runs the waiting jobs; however this ends, no worker is left.

        Raises:
            RunError: The executor refuses a job, or, in this process, a job failed.
        """

    def close(self) -> None:
        """Gives back what the executor holds; all jobs have ended or been cancelled."""
        return

    def __enter__(self) -> Executor:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class InProcess(Executor):
    """Runs jobs in this process. A job that fails ends all.

    Args:
        together: How many trainings run side by side in one compiled program; None for all on an accelerator, and 1 on
            a CPU, where it takes longer.

    Raises:
        InputError: `together` is out of bounds.
    """

    def __init__(self, together: int | None = 1) -> None:
        if together is not None:
            check_number("--together", together, 1, MAX_RUNS, integer=True)
        self._together = together

    def run(self, batch: Batch) -> None:
        """See `Executor`."""
        import jax

        statuses = batch.statuses
        waiting = [job for job in batch.jobs if statuses[job.name].state == "waiting"]
        size = self._together or (1 if jax.default_backend() == "cpu" else max(len(waiting), 1))
        for first in range(0, len(waiting), size):
            group = waiting[first : first + size]
            for job in group:
                statuses[job.name] = JobStatus("running", 1)
            batch.on_tick()
            try:
                names = group[0].name if len(group) == 1 else f"{len(group)} jobs"
                type(group[0]).run_together(group, functools.partial(batch.on_progress, names))
            except BaseException:
                for job in group:
                    statuses[job.name] = JobStatus("waiting", 1)
                raise
            for job in group:
                statuses[job.name] = JobStatus("done", 1)
                batch.on_end(job.name)


@dataclass(frozen=True)
class Resources:
    """What of a machine one job has for itself.

    Attributes:
        threads: Cores, and threads that compute on them. Their number changes the last bits of sums.
        gpus: GPUs; without any a job uses the CPU alone.
    """

    threads: int = 1
    gpus: int = 0

    def __post_init__(self) -> None:
        check_number("--threads", self.threads, 1, 1024, integer=True)
        check_number("--gpus", self.gpus, 0, 64, integer=True)


class Handle(abc.ABC):
    """A worker at a job."""

    @abc.abstractmethod
    def poll(self) -> str | None:
        """Returns None while the worker goes on, "" when it says that the job is finished, or else why it is not."""

    @abc.abstractmethod
    def cancel(self) -> None:
        """Ends the worker; its job can be continued."""


class WorkerExecutor(Executor):
    """Runs jobs in worker processes. A job that fails is tried again, and costs the others nothing.

    Args:
        workers: Workers at once; None for all, where there is a queue for them.
        resources: What each has for itself.
        retries: How often a job that failed is tried again.

    Raises:
        InputError: A number is out of bounds.
    """

    def __init__(self, workers: int | None, resources: Resources, retries: int) -> None:
        check_number("--retries", retries, 0, MAX_WORKERS, integer=True)
        if workers is not None:
            check_number("--workers", workers, 1, MAX_WORKERS, integer=True)
        self.workers, self.resources, self.retries = workers, resources, retries

    @abc.abstractmethod
    def submit(self, job: Job) -> Handle:
        """Starts a worker at a prepared job, or puts it in a queue.

        Raises:
            RunError: The executor refuses.
        """

    def run(self, batch: Batch) -> None:
        """See `Executor`."""
        statuses = batch.statuses
        waiting = deque(job for job in batch.jobs if statuses[job.name].state == "waiting")
        handles: dict[Job, Handle] = {}
        try:
            while waiting or handles:
                raise_if_interrupted()
                while waiting and (self.workers is None or len(handles) < self.workers):
                    job = waiting.popleft()
                    job.prepare()
                    handles[job] = self.submit(job)
                    status = statuses[job.name]
                    statuses[job.name] = replace(status, state="running", attempts=status.attempts + 1)
                for job, handle in list(handles.items()):
                    reason = handle.poll()
                    if reason is None:
                        continue
                    del handles[job]
                    statuses[job.name] = self._status_after(statuses[job.name], job, reason)
                    if statuses[job.name].state == "waiting":
                        waiting.append(job)
                    batch.on_end(job.name)
                batch.on_tick()
                if handles:
                    time.sleep(POLL_SECONDS)
        finally:
            for handle in handles.values():
                handle.cancel()

    def _status_after(self, status: JobStatus, job: Job, reason: str) -> JobStatus:
        """Returns the status after a worker has ended. The folder decides, whatever the worker said."""
        try:
            finished = job.is_finished()
        except RunError as error:
            finished, reason = False, str(error)
        if finished:
            return replace(status, state="done", error="")
        error = reason or "the worker ended, but the job is not finished"
        return replace(status, state="waiting" if status.attempts <= self.retries else "failed", error=error)


class LocalProcesses(WorkerExecutor):
    """Runs every job in a process of its own on this machine. The processes end with this one, however it ends.

    Args:
        workers: Processes at once; None for as many as there are cores, or GPUs, for what each has for itself.
        resources: What each has for itself.
        retries: How often a job that failed is tried again.

    Raises:
        InputError: There are not so many GPUs, or a number is out of bounds.
    """

    def __init__(self, workers: int | None = None, resources: Resources | None = None, retries: int = 2) -> None:
        resources = resources or Resources()
        devices = _gpu_names() if resources.gpus else []
        if resources.gpus > len(devices):
            raise InputError("--gpus", resources.gpus, f"at most {len(devices)}, the GPUs of this machine")
        limit = len(devices) // resources.gpus if resources.gpus else None
        if workers is None:
            workers = limit or max(1, count_cores() // resources.threads)
        check_number("--workers", workers, 1, limit, integer=True)
        super().__init__(workers, resources, retries)
        # Groups of GPUs, of which each worker takes one and gives it back.
        self._free = [devices[index * resources.gpus :][: resources.gpus] for index in range(workers)]

    def submit(self, job: Job) -> Handle:
        """See `WorkerExecutor`."""
        gpus = self._free.pop()
        environment = {"CUDA_VISIBLE_DEVICES": ",".join(gpus)} if gpus else {}
        process = worker.start_process(job.spec(), self.resources.threads, self.resources.gpus, environment)
        return _Process(process, job.folder, lambda: self._free.append(gpus))


@dataclass(frozen=True, eq=False)
class _Process(Handle):
    """A worker process.

    Attributes:
        process: The process.
        folder: The job's folder.
        give_back: Gives back its GPUs.
    """

    process: subprocess.Popen[bytes]
    folder: Path
    give_back: Callable[[], None]

    def poll(self) -> str | None:
        status = self.process.poll()
        if status is None:
            return None
        self._end()
        return worker.end_reason(status, self.folder)

    def cancel(self) -> None:
        self.process.terminate()
        try:
            self.process.wait(TERMINATE_SECONDS)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._end()

    def _end(self) -> None:
        self.give_back()
        if self.process.stdin is not None:
            self.process.stdin.close()


def count_cores() -> int:
    """Returns the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _gpu_names() -> list[str]:
    """Returns the GPUs that this process may use, as CUDA names them."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is not None:
        return [device for device in visible.split(",") if device.strip()]
    return [str(index) for index, _ in enumerate(Path("/dev").glob("nvidia[0-9]*"))]
