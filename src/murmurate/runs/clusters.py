"""Executors of clusters: Ray (the extra `ray`) and Slurm, by submitit (the extra `slurm`).

The jobs' folders must be the same on all nodes of a cluster, and murmurate must be installed there.
"""

from __future__ import annotations

import json
import logging
import os
import shutil
import subprocess
import sys
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from murmurate.errors import InputError, RunError, UsageError, one_line, suggestion
from murmurate.runs import worker
from murmurate.runs.execute import Handle, Resources, WorkerExecutor, count_cores
from murmurate.runs.jobs import Job

__all__ = ["Ray", "Slurm", "read_options"]

ANSWER_SECONDS = 20.0
"""Time that a Ray cluster has to answer. Ray itself waits for minutes, and then ends the process."""

CONNECT = """
import sys, ray
try:
    ray.init(address=sys.argv[1], log_to_driver=False, logging_level="ERROR")
except BaseException as error:
    sys.exit(str(error) or type(error).__name__)
"""

OBJECT_STORE_BYTES = 80 << 20
"""About the least that Ray takes: jobs pass no objects."""

SLURM_FOLDER = ".slurm"
"""What submitit keeps of its jobs: scripts, logs and pickles, none of which a run needs."""

SLURM_MINUTES = 240
SLURM_POLL_SECONDS = 30.0
"""Seconds between queries of Slurm whether its jobs are alive; jobs that end well say so themselves."""


class Ray(WorkerExecutor):
    """Lets Ray distribute jobs over its nodes, each in a process of its own.

    Args:
        address: Address of a cluster, such as `10.0.0.1:6379` or `auto`; None for a cluster on this machine only, which
            ends with this process.
        workers: Jobs at once; None for all that a cluster has room for, or for as many as this machine has cores.
        resources: What each job has for itself.
        retries: How often a job that failed is tried again.

    Raises:
        UsageError: Ray is not installed.
        InputError: No cluster answers at that address, or a number is out of bounds.
        RunError: Ray does not start.
    """

    def __init__(
        self,
        address: str | None = None,
        workers: int | None = None,
        resources: Resources | None = None,
        retries: int = 2,
    ) -> None:
        resources = resources or Resources()
        if address is None and workers is None:
            workers = max(1, count_cores() // resources.threads)
        super().__init__(workers, resources, retries)
        # Before Ray is loaded: it sends no usage statistics, and a cluster of one machine listens on its loopback only.
        os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
        if address is None:
            os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"
        try:
            import ray
        except ModuleNotFoundError:
            raise _missing("ray", "Ray") from None
        local: dict[str, Any] = {}
        if address is None:
            local = {"include_dashboard": False, "object_store_memory": OBJECT_STORE_BYTES}
            local |= {"num_cpus": resources.threads * (workers or 1)}
        else:
            _check_address(address)
        try:
            with warnings.catch_warnings():
                # JAX warns of every fork; Ray's children at once become other programs.
                warnings.simplefilter("ignore", RuntimeWarning)
                ray.init(address or "local", log_to_driver=False, logging_level=logging.ERROR, **local)
        except Exception as error:
            raise RunError(f"Ray does not start: {error}") from None
        self._ray = ray
        # Failed jobs are tried again by `WorkerExecutor`, which counts; and memory is given back after every job.
        task: Any = ray.remote(max_calls=1, max_retries=0, num_cpus=resources.threads, num_gpus=resources.gpus)
        self._task = task(_work_in_process)

    def submit(self, job: Job) -> Handle:
        """See `WorkerExecutor`."""
        reference = self._task.remote(job.spec(), self.resources.threads, self.resources.gpus)
        return _RayTask(self._ray, reference)

    def close(self) -> None:
        """Leaves the cluster, or ends this machine's own."""
        self._ray.shutdown()


@dataclass(frozen=True, eq=False)
class _RayTask(Handle):
    """A job at Ray.

    Attributes:
        ray: The module.
        reference: Ray's reference of the task.
    """

    ray: Any
    reference: Any

    def poll(self) -> str | None:
        try:
            if not self.ray.wait([self.reference], timeout=0)[0]:
                return None
            return self.ray.get(self.reference)
        except self.ray.exceptions.WorkerCrashedError:
            return "the worker died"
        except Exception as error:
            return one_line(f"Ray: {error}")

    def cancel(self) -> None:
        self.ray.cancel(self.reference, force=True)


def _work_in_process(spec: str, threads: int, gpus: int) -> str:
    """Does a job in a process of its own, on a node of Ray; returns why it is not finished.

    In Ray's worker itself a compilation by JAX never returns (Ray 2.60, JAX on CPU).
    """
    with worker.start_process(spec, threads, gpus) as process:
        return worker.end_reason(process.wait(), Path(json.loads(spec)["folder"]))


def _check_address(address: str) -> None:
    """Checks that a cluster answers, in a process that can be ended when none does."""
    try:
        command = [sys.executable, "-c", CONNECT, address]
        answer = subprocess.run(command, timeout=ANSWER_SECONDS, capture_output=True, check=False)
        output = answer.stderr
        lines = output.decode(errors="replace").strip().splitlines() or ["no answer"]
        trouble = lines[-1] if answer.returncode else ""
    except subprocess.TimeoutExpired as error:
        output, trouble = error.stderr or b"", f"none answered within {ANSWER_SECONDS:g} seconds"
    if trouble:
        if b"InvalidAuthToken" in output:
            trouble = "it refuses us without its token (RAY_AUTH_MODE=token, RAY_AUTH_TOKEN)"
        raise InputError("--address", address, f"the address of a Ray cluster: {trouble}")


class Slurm(WorkerExecutor):
    """Submits every job to Slurm.

    Args:
        folder: The folder of the jobs' folders, where submitit keeps its files too.
        workers: Jobs at Slurm at once; None for all.
        resources: What each job asks for.
        retries: How often a job that failed is tried again.
        options: More options of sbatch, such as partition, time (minutes; 240 by default), account or mem.
        cluster: The executor of submitit: slurm, or local to try it without Slurm.

    Raises:
        UsageError: submitit is not installed, or this machine has no Slurm.
        InputError: An option is unknown or not allowed, or a number is out of bounds.
    """

    def __init__(
        self,
        folder: Path,
        workers: int | None = None,
        resources: Resources | None = None,
        retries: int = 2,
        options: Mapping[str, str] | None = None,
        cluster: str = "slurm",
    ) -> None:
        super().__init__(workers, resources or Resources(), retries)
        try:
            import submitit
        except ModuleNotFoundError:
            raise _missing("slurm", "submitit") from None
        if cluster == "slurm" and not (shutil.which("sbatch") and shutil.which("srun")):
            raise UsageError("--backend slurm: this machine has no sbatch and srun; run it where jobs are submitted")
        self._polled = time.monotonic()
        self._executor: Any = submitit.AutoExecutor(folder=folder / SLURM_FOLDER, cluster=cluster)
        # What `resources` says is no option.
        taken = {"job_name", "cpus_per_task", "gpus_per_node", "array_parallelism", "map_count"}
        known = [name.removeprefix("slurm_") for name in sorted(submitit.SlurmExecutor._valid_parameters() - taken)]
        for name, value in (options or {}).items():
            if name not in known:
                raise InputError("--slurm", f"{name}={value}", f"KEY=VALUE of sbatch{suggestion(name, known)}")
        self._executor.update_parameters(
            name="murmurate",
            cpus_per_task=self.resources.threads,
            gpus_per_node=self.resources.gpus or None,
            timeout_min=SLURM_MINUTES,
        )
        more = {f"slurm_{name}": int(value) if value.isdigit() else value for name, value in (options or {}).items()}
        try:
            self._executor.update_parameters(**more)
        except Exception as error:
            allowed = f"options that submitit takes: {error}"
            raise InputError("--slurm", ",".join(options or ()), allowed) from None

    def submit(self, job: Job) -> Handle:
        """See `WorkerExecutor`."""
        try:
            submitted = self._executor.submit(worker.work, job.spec(), self.resources.threads, self.resources.gpus)
            return _SlurmJob(self, submitted)
        except (subprocess.CalledProcessError, RuntimeError) as error:  # submitit's own errors are RuntimeErrors
            output = (getattr(error, "stderr", None) or b"").decode(errors="replace").strip()
            raise RunError(f"Slurm refuses the job of {job.name}: {output or error}") from None

    def should_query(self) -> bool:
        """Returns whether Slurm is to be asked now: about all jobs at once, not for every job each time."""
        now = time.monotonic()
        if now - self._polled < SLURM_POLL_SECONDS:
            return False
        self._polled = now
        return True


@dataclass(frozen=True, eq=False)
class _SlurmJob(Handle):
    """A job at Slurm.

    Attributes:
        executor: Where it was submitted.
        job: The job, as submitit has it.
    """

    executor: Slurm
    job: Any

    def poll(self) -> str | None:
        if not self.job.done(force_check=self.executor.should_query()):
            return None
        if self.job.exception() is None:
            return self.job.result()
        return f"the job ended as {self.job.state}: see {self.job.paths.stderr}"

    def cancel(self) -> None:
        self.job.cancel(check=False)


def read_options(texts: Sequence[str]) -> dict[str, str]:
    """Reads options of sbatch from the command line, each as `KEY=VALUE`.

    Raises:
        InputError: One is not of that form, or comes twice.
    """
    options: dict[str, str] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if not name or not value or name in options:
            raise InputError("--slurm", text, "KEY=VALUE, each key once")
        options[name] = value
    return options


def _missing(backend: str, package: str) -> UsageError:
    return UsageError(f'--backend {backend} needs {package}: pip install "murmurate[{backend}]"')
