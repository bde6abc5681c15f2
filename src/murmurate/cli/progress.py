"""A live line on stderr for long work: what is being done, how far it is, what matters, and the time left."""

from __future__ import annotations

from types import TracebackType
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bars
from rich.table import Column

__all__ = ["Progress"]

_FORMATS = {
    "reward": "reward {:+.4f}",
    "objective": "objective {:.3f}",
    "visible": "{:.0%} visible",
    "valid": "{:.0%} valid",
    "steps_per_second": "{:,.0f} steps/s",
}


class Progress:
    """A live progress line, one for each piece of work; silent when the stream is not a terminal.

        with Progress() as progress:
            for update in range(updates):
                progress.update("base policy", update + 1, updates, reward=0.12, visible=0.87)

    Args:
        stream: Where to draw; stderr by default.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        console = Console(file=stream, stderr=True)
        self._tasks: dict[str, TaskID] = {}
        # On a narrow terminal the values are cut, not the counts; drawn at updates only, because a thread that redraws
        # would take time from the training.
        self._bars = Bars(
            TextColumn("{task.description}", table_column=Column(no_wrap=True)),
            BarColumn(bar_width=12, table_column=Column(no_wrap=True)),
            MofNCompleteColumn(table_column=Column(no_wrap=True)),
            TimeRemainingColumn(table_column=Column(no_wrap=True)),
            TextColumn("{task.fields[text]}", table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)),
            console=console,
            expand=True,
            auto_refresh=False,
            disable=not console.file.isatty(),
        )

    def __enter__(self) -> Progress:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()

    def update(self, work: str, done: int, total: int, **values: float | str) -> None:
        """Redraws the line.

        Args:
            work: What is being done, such as the policy in training; new work starts a new line below.
            done: How many updates (or other units) are done.
            total: How many there are.
            **values: What else to show, by name: reward, visible, valid, steps_per_second, or anything else; text is
                shown as it is.
        """
        if work not in self._tasks:
            self._tasks[work] = self._bars.add_task(work, total=total, completed=done, text="")
        text = "  ".join(_formatted(name, value) for name, value in values.items())
        self._bars.update(self._tasks[work], completed=done, total=total, text=text, refresh=True)


def _formatted(name: str, value: float | str) -> str:
    return value if isinstance(value, str) else _FORMATS.get(name, name + " {:.3g}").format(value)
