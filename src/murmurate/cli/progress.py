"""The progress of long work on stderr: a live line on a terminal, plain lines in a pipe or a log, or nothing."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bars
from rich.table import Column

from murmurate.runs import progress
from murmurate.terminal import say

__all__ = ["Progress"]


class Progress:
    """Shows the progress of one piece of work after another.

    On a terminal, each piece of work is a line that is redrawn at every update. Elsewhere every update is a plain line,
    as logs need it.

        with Progress() as progress:
            for update in range(updates):
                progress.update("base policy", update + 1, updates, reward=0.12, visible=0.87)

    Args:
        stream: Where to write; stderr by default.
        quiet: Whether to write nothing.
    """

    def __init__(self, stream: TextIO | None = None, quiet: bool = False) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._quiet = quiet
        self._is_live = not quiet and self._stream.isatty()
        self._tasks: dict[str, TaskID] = {}
        # On a narrow terminal the values are cut, not the counts; drawn at updates only, because a thread that redraws
        # would take time from the training.
        self._bars = Bars(
            TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True)),
            BarColumn(bar_width=12, table_column=Column(no_wrap=True)),
            MofNCompleteColumn(table_column=Column(no_wrap=True)),
            TimeRemainingColumn(table_column=Column(no_wrap=True)),
            TextColumn(
                "{task.fields[text]}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)
            ),
            console=Console(file=stream, stderr=True),
            expand=True,
            auto_refresh=False,
            disable=not self._is_live,
        )

    def __enter__(self) -> Progress:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()

    def update(self, work: str, done: int, total: int, **values: float | str) -> None:
        """Redraws the line of a piece of work, or writes a line.

        Args:
            work: What is being done, such as the policy in training; new work starts a new line below.
            done: How many updates (or other units) are done.
            total: How many there are.
            **values: What else to show, by name; see `murmurate.runs.progress.line`.
        """
        if self._is_live:
            if work not in self._tasks:
                self._tasks[work] = self._bars.add_task(work, total=total, completed=done, text="")
            text = progress.values_text(**values)
            self._bars.update(self._tasks[work], completed=done, total=total, text=text, refresh=True)
        elif not self._quiet:
            say(progress.line(work, done, total, **values), file=self._stream)
