"""The live table of a sweep: how far each run is, read from its folder."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.table import Table

from murmurate.discovery import policy_name
from murmurate.errors import RunError
from murmurate.runs import table
from murmurate.runs.experiment import ExperimentConfig
from murmurate.runs.run import METRICS
from murmurate.sweeps.conduct import Standing

__all__ = ["Board", "Place", "place"]

_TAIL = 1 << 14
"""Bytes at the end of metrics.jsonl that are read: some tens of rows."""

_EVERY = 0.5
"""Seconds between looks into the folders."""

_NONE = "-"
_ORDER = {"running": 0, "failed": 1, "waiting": 2, "done": 3}


@dataclass(frozen=True)
class Place:
    """How far a training is.

    Attributes:
        policy: The policy in training, by its place in the list.
        update: How many of its updates are done.
        updates: How many there are.
        reward: Mean reward of a step in the last of them; None where it was not finite.
        speed: Environment steps a second.
        left: Seconds until its last update; None where that cannot be told yet.
    """

    policy: int
    update: int
    updates: int
    reward: float | None
    speed: float | None
    left: float | None


def place(folder: Path, config: ExperimentConfig) -> Place | None:
    """Reads from the metrics of a run how far it is; None while nothing is trained yet."""
    found = [row for row in map(_parsed, _last_lines(folder / METRICS)) if row is not None]
    if not found:
        return None
    last, speed = found[-1], found[-1]["steps_per_second"]
    updates, left = config.stage(last["policy"]).ppo.updates, None
    if len(found) > 1 and speed:
        steps = last["environment_steps"] - found[-2]["environment_steps"]
        left = (updates - last["update"]) * steps / speed
    return Place(last["policy"], last["update"], updates, last["reward"], speed, left)


def _last_lines(path: Path) -> list[bytes]:
    try:
        with path.open("rb") as file:
            start = max(0, file.seek(0, 2) - _TAIL)
            file.seek(start)
            return file.read().split(b"\n")[1 if start else 0 :]
    except OSError:
        return []


def _parsed(line: bytes) -> dict[str, Any] | None:
    """Reads one row; None for what is being written at this moment."""
    try:
        row = json.loads(line)
        return row if row.keys() >= {"policy", "update", "environment_steps", "reward", "steps_per_second"} else None
    except (ValueError, AttributeError):
        return None


class Board:
    """Draws the table on stderr while a sweep goes on; nothing where that is no terminal.

        with Board(runs, out, standings) as board:
            board.draw()

    Args:
        runs: The runs.
        out: The folder of all of them.
        standings: How they stand, kept up to date by others.
    """

    def __init__(self, runs: Mapping[str, ExperimentConfig], out: Path, standings: Mapping[str, Standing]) -> None:
        self._runs, self._out, self._standings = runs, out, standings
        self._console = Console(stderr=True)
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._begun, self._drawn = time.monotonic(), 0.0
        self._valid: dict[str, str] = {}

    @property
    def shown(self) -> bool:
        """Whether anybody sees it."""
        return self._console.is_terminal

    def __enter__(self) -> Board:
        if self.shown:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.shown:
            self._live.stop()

    def draw(self) -> None:
        """Draws the table anew, twice a second at most."""
        now = time.monotonic()
        if self.shown and now - self._drawn >= _EVERY:
            self._drawn = now
            self._live.update(self.table(self._console.height - 6), refresh=True)

    def say(self, line: str) -> None:
        """Prints a line above the table."""
        self._console.print(line, markup=False, highlight=False)

    def table(self, most: int) -> Table:
        """Returns the table, of so many runs at most: those that run first, those that are done last."""
        counts = dict.fromkeys(_ORDER, 0)
        for stands in self._standings.values():
            counts[stands.status] += 1
        minutes, seconds = divmod(int(time.monotonic() - self._begun), 60)
        title = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
        table = Table(title=f"{title}; {minutes}:{seconds:02} so far", title_justify="left")
        for column in ("run", "state", "update", "reward", "valid", "steps/s", "left"):
            table.add_column(column, justify="left" if column in ("run", "state") else "right", no_wrap=True)
        names = sorted(self._runs, key=lambda name: _ORDER[self._standings[name].status])
        for name in names[: max(most, 1)]:
            table.add_row(name, *self._cells(name))
        if len(names) > most:
            table.caption = f"and {len(names) - most} more"
        return table

    def _cells(self, name: str) -> list[str]:
        """Writes how one run stands."""
        stands, folder = self._standings[name], self._out / name
        state = stands.status if stands.attempts <= 1 else f"{stands.status}, attempt {stands.attempts}"
        where = place(folder, self._runs[name]) if stands.status in ("running", "failed") else None
        if where is None:
            # Nothing is trained yet: it compiles, or stands in the queue of a cluster.
            state = state.replace("running", "submitted")
            return [state, _NONE, _NONE, self._found(name) if stands.status == "done" else _NONE, _NONE, _NONE]
        if stands.status == "running":
            phase = policy_name(where.policy) + (f" {where.policy}" if where.policy > 1 else "")
            state = state.replace("running", "evaluation" if (folder / "policies").exists() else phase)
        return [
            state,
            f"{where.update}/{where.updates}",
            _NONE if where.reward is None else f"{where.reward:+.4f}",
            _NONE,
            _NONE if where.speed is None else f"{where.speed:,.0f}",
            _NONE if where.left is None else f"{where.left:.0f} s",
        ]

    def _found(self, name: str) -> str:
        """Writes how many patterns of a finished run are valid; read once."""
        if name not in self._valid:
            try:
                self._valid[name] = f"{table.read_evaluation(self._out / name)['valid']:.1%}"
            except RunError:
                self._valid[name] = _NONE
        return self._valid[name]
