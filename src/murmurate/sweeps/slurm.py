"""Workers as Slurm jobs, by submitit; the extra `slurm`."""

from __future__ import annotations

import shutil
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from murmurate.errors import InputError, RunError, UsageError, suggestion
from murmurate.sweeps import worker
from murmurate.sweeps.backend import Share, missing

__all__ = ["FOLDER", "Slurm", "read_options"]

FOLDER = ".slurm"
"""What submitit keeps of jobs, beside the run folders: scripts, logs and pickles, none of which a run needs."""

_MINUTES = 240
_ASK_EVERY = 30.0
"""Seconds between questions to Slurm whether jobs live; those that end well say so themselves."""


class Slurm:
    """Submits every run as a job of its own. The folder of the runs must be the same on all nodes.

    Args:
        out: The folder of all runs.
        workers: How many jobs to have at Slurm at once; by default all.
        share: What each job asks for.
        options: More of what sbatch is told, such as partition, time (minutes; 240 by default), account or mem.
        cluster: Which executor of submitit: slurm, or local for trying it out without one.

    Raises:
        UsageError: submitit is not installed, or this machine has no Slurm.
        InputError: An option is unknown or not allowed.
    """

    def __init__(
        self,
        out: Path,
        workers: int | None,
        share: Share,
        options: Mapping[str, str],
        cluster: str = "slurm",
    ) -> None:
        try:
            import submitit
        except ModuleNotFoundError:
            raise missing("slurm", "submitit") from None
        if cluster == "slurm" and not (shutil.which("sbatch") and shutil.which("srun")):
            raise UsageError("--backend slurm: this machine has no sbatch and srun; run it where jobs are submitted")
        self.workers, self._share, self._asked = workers, share, time.monotonic()
        self._executor: Any = submitit.AutoExecutor(folder=out / FOLDER, cluster=cluster)
        known = {name.removeprefix("slurm_"): name for name in _known(submitit)}
        for name, value in options.items():
            if name not in known:
                raise InputError("--slurm", f"{name}={value}", f"KEY=VALUE of sbatch{suggestion(name, known)}")
        self._executor.update_parameters(
            name="murmurate", cpus_per_task=share.threads, gpus_per_node=share.gpus or None, timeout_min=_MINUTES
        )
        more = {f"slurm_{name}": int(value) if value.isdigit() else value for name, value in options.items()}
        try:
            self._executor.update_parameters(**more)
        except Exception as error:
            raise InputError("--slurm", ",".join(options), f"options that submitit takes: {error}") from None

    def submit(self, folder: Path) -> Ticket:
        """Submits a job."""
        words = (str(folder.resolve()), self._share.threads, self._share.gpus)
        try:
            return Ticket(self, self._executor.submit(worker.train, *words))
        except (subprocess.CalledProcessError, RuntimeError) as error:  # submitit's own errors are RuntimeErrors
            said = (getattr(error, "stderr", None) or b"").decode(errors="replace").strip()
            raise RunError(f"Slurm refuses the job of {folder.name}: {said or error}") from None

    def is_time_to_ask(self) -> bool:
        """Says whether Slurm is to be asked about all jobs at once; not for every job each time."""
        now = time.monotonic()
        if now - self._asked < _ASK_EVERY:
            return False
        self._asked = now
        return True

    def close(self) -> None:
        """Nothing is held: jobs are Slurm's."""


@dataclass(frozen=True, eq=False)
class Ticket:
    """A job at Slurm.

    Attributes:
        backend: Where it was submitted.
        job: What submitit knows it by.
    """

    backend: Slurm
    job: Any

    def poll(self) -> str | None:
        """See `Job`."""
        if not self.job.done(force_check=self.backend.is_time_to_ask()):
            return None
        if self.job.exception() is None:
            return self.job.result()
        return f"the job ended as {self.job.state}: see {self.job.paths.stderr}"

    def cancel(self) -> None:
        """Has Slurm end it, or take it from the queue."""
        self.job.cancel(check=False)


def read_options(texts: Sequence[str]) -> dict[str, str]:
    """Reads options of the command line, each as `KEY=VALUE`.

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


def _known(submitit: Any) -> list[str]:
    """Lists what sbatch can be told by submitit, apart from what a share says."""
    taken = {"job_name", "cpus_per_task", "gpus_per_node", "array_parallelism", "map_count"}
    return sorted(submitit.SlurmExecutor._valid_parameters() - taken)
