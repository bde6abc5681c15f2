"""Training curves for TensorBoard, told from metrics.jsonl; the extra `tensorboard`.

`murmurate discover EXPERIMENT --tensorboard` writes them while it trains; `tensorboard --logdir runs` shows them.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from murmurate.errors import RunError
from murmurate.interop.extras import missing
from murmurate.runs import storage
from murmurate.runs.run import METRICS

try:
    from tensorboardX import SummaryWriter
except ModuleNotFoundError as error:
    raise missing("tensorboard") from error

__all__ = ["FOLDER", "Events"]

FOLDER = "tensorboard"
"""Where a run's events are, inside of its folder."""

_PLACE = ("environment_steps", "name", "seconds")
"""Columns of metrics.jsonl that say where on the curves a row belongs."""


class Events:
    """Writes what is new in runs' metrics.jsonl as events, over the steps of the environment.

    A run's events are made anew when it is first told of: what was trained before an interruption is there once, and
    what was lost by it is not.

        with Events() as events:
            discover(config, folder, on_metrics=events)
    """

    def __init__(self) -> None:
        self._writers: dict[Path, SummaryWriter] = {}
        self._read: dict[Path, int] = {}

    def __call__(self, folder: Path) -> None:
        """Takes over what a run's metrics.jsonl has gained.

        Raises:
            RunError: The events cannot be written.
        """
        with storage.os_errors_as_run_errors(f"cannot write to {folder / FOLDER}"):
            if folder not in self._writers:
                if (folder / FOLDER).exists():
                    shutil.rmtree(folder / FOLDER)
                self._writers[folder], self._read[folder] = SummaryWriter(str(folder / FOLDER)), 0
            for row in self._new_rows(folder):
                for name, value in scalars(row):
                    step, time = row["environment_steps"], row["seconds"]
                    self._writers[folder].add_scalar(name, value, step, walltime=time)
            self._writers[folder].flush()

    def _new_rows(self, folder: Path) -> Iterator[Mapping[str, Any]]:
        path = folder / METRICS
        if not path.is_file():  # nothing is trained yet
            return
        with path.open("rb") as file:
            file.seek(self._read[folder])
            lines = file.readlines()
        self._read[folder] += sum(map(len, lines))
        try:
            yield from map(json.loads, lines)
        except ValueError:
            raise RunError(f"{path} is damaged") from None

    def __enter__(self) -> Events:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for writer in self._writers.values():
            writer.close()


def scalars(row: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """Names the curves that a row of metrics.jsonl holds a point of; what was not finite has none."""
    for name, value in row.items():
        if isinstance(value, Mapping):
            yield from ((f"{name}/{inner}", one) for inner, one in scalars(value))
        elif name not in _PLACE and isinstance(value, int | float):
            yield name, float(value)
