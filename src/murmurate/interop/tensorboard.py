"""Training curves for TensorBoard, from the metrics of runs; the extra `tensorboard`.

`murmurate discover EXPERIMENT --tensorboard` writes them while it trains; `tensorboard --logdir runs` shows them.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from murmurate.interop import missing_extra
from murmurate.runs import files
from murmurate.runs.folder import RunFolder

try:
    from tensorboardX import SummaryWriter
except ModuleNotFoundError as error:
    raise missing_extra("tensorboard") from error

__all__ = ["FOLDER", "Events"]

FOLDER = "tensorboard"
"""Folder of the events inside a run folder."""

_POSITION = ("environment_steps", "name", "seconds")
"""Columns of metrics that are coordinates of the curves, not curves."""


class Events:
    """Writes the new rows of runs' metrics as events, over the steps of the environment.

    At the first call for a run, all its events are written anew, without the rows that an interruption lost.

        with Events() as events:
            discover(config, folder, on_metrics=events)
    """

    def __init__(self) -> None:
        self._writers: dict[Path, SummaryWriter] = {}
        self._read: dict[Path, int] = {}

    def __call__(self, folder: Path) -> None:
        """Writes the rows of a run's metrics that are new since the last call.

        Raises:
            RunError: The metrics are damaged, or the events cannot be written, or their folder is a link.
        """
        events = files.inside(folder, FOLDER)
        with files.os_errors_as_run_errors(f"cannot write to {events}"):
            if folder not in self._writers:
                if events.exists():
                    shutil.rmtree(events)
                self._writers[folder], self._read[folder] = SummaryWriter(str(events)), 0
            rows, self._read[folder] = RunFolder(folder).new_metrics(self._read[folder])
            for row in rows:
                for name, value in scalars(row):
                    step, time = int(row["environment_steps"]), row.get("seconds")
                    self._writers[folder].add_scalar(name, value, step, walltime=time)
            self._writers[folder].flush()

    def __enter__(self) -> Events:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for writer in self._writers.values():
            writer.close()


def scalars(row: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """Yields the name and value of each curve at a row of metrics; values that are not finite are left out."""
    for name, value in row.items():
        if isinstance(value, Mapping):
            yield from ((f"{name}/{inner}", number) for inner, number in scalars(value))
        elif name not in _POSITION and files.is_number(value):
            yield name, float(value)
