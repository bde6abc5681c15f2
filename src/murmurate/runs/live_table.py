"""The live table of many jobs, drawn on a terminal; elsewhere lines: for each chunk of work and each job that ends."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.live import Live
from rich.table import Table

from murmurate.errors import RunError, one_line
from murmurate.runs import escape, progress
from murmurate.runs.jobs import Job, JobStatus
from murmurate.terminal import say

__all__ = ["LiveTable"]

DRAW_SECONDS = 0.5
NONE = "-"
ORDER = ("running", "failed", "waiting", "done")


def print_progress(work: str, done: int, total: int, **values: float | str) -> None:
    """Prints a line of progress on stderr."""
    say(progress.line(work, done, total, **values), file=sys.stderr)


class LiveTable:
    """Shows how far jobs are: a table on stderr where that is a terminal, and lines elsewhere.

    The lines about jobs that ended are on stdout, those about their progress on stderr.

    Args:
        jobs: The jobs.
        statuses: How far they are, by name; kept up to date by others.
        quiet: Show nothing.
    """

    def __init__(self, jobs: Sequence[Job], statuses: Mapping[str, JobStatus], quiet: bool = False) -> None:
        self._jobs, self._statuses, self._quiet = {job.name: job for job in jobs}, statuses, quiet
        self._console = Console(stderr=True)
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._begun, self._drawn = time.monotonic(), 0.0
        self._results: dict[str, str] = {}
        self._printed: dict[str, tuple[str, int]] = {}

    @property
    def is_live(self) -> bool:
        """Whether the table is drawn."""
        return self._console.is_terminal and not self._quiet

    def __enter__(self) -> LiveTable:
        if self.is_live:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.is_live:
            self._live.stop()

    def draw(self) -> None:
        """Draws the table again, or prints which jobs have gone on; twice a second at most."""
        now = time.monotonic()
        if self._quiet or now - self._drawn < DRAW_SECONDS:
            return
        self._drawn = now
        if self.is_live:
            self._live.update(self.table(self._console.height - 6), refresh=True)
            return
        for name, status in self._statuses.items():
            known = self._jobs[name].progress() if status.state == "running" else None
            if known is not None and self._printed.get(name) != (known.stage, known.update):
                self._printed[name] = (known.stage, known.update)
                values = {name: getattr(known, name) for name in ("reward", "steps_per_second", "seconds_left")}
                values = {name: value for name, value in values.items() if value is not None}
                print_progress(f"{name}: {known.stage}", known.update, known.updates, **values)

    def progress(self, name: str, work: str, done: int, total: int, **values: float | str) -> None:
        """Takes what a job in this process reports: draws the table again, or prints a line."""
        if self.is_live:
            self.draw()
        elif not self._quiet:
            print_progress(f"{name}: {work}", done, total, **values)

    def report(self, name: str) -> None:
        """Prints that a worker at a job has ended; on a terminal, where the table shows it, only of one that failed."""
        status = self._statuses[name]
        if status.state == "done":
            text = self._result(name)
        elif status.state == "failed":
            text = f"failed, attempt {status.attempts}: {status.error}"
        else:
            text = f"to be tried again, attempt {status.attempts} failed: {status.error}"
        ended = sum(each.state in ("done", "failed") for each in self._statuses.values())
        line = f"{ended} of {len(self._statuses)}: {name}: {text}"
        if self.is_live and status.state != "done":
            self._console.print(escape.rich(line))
        elif not self.is_live and not self._quiet:
            say(one_line(line))

    def table(self, limit: int) -> Table:
        """Returns the table of at most so many jobs: those that run first, those that are done last."""
        states = [status.state for status in self._statuses.values()]
        minutes, seconds = divmod(int(time.monotonic() - self._begun), 60)
        title = ", ".join(f"{states.count(state)} {state}" for state in ORDER if state in states)
        table = Table(title=f"{title}; {minutes}:{seconds:02} so far", title_justify="left")
        for column in ("job", "state", "update", "reward", "result", "steps/s", "left"):
            table.add_column(column, justify="left" if column in ("job", "state") else "right", no_wrap=True)
        names = sorted(self._jobs, key=lambda name: ORDER.index(self._statuses[name].state))
        for name in names[: max(limit, 1)]:
            table.add_row(*map(escape.rich, (name, *self._cells(name))))
        if len(names) > limit:
            table.caption = f"and {len(names) - limit} more"
        return table

    def _cells(self, name: str) -> list[str]:
        status = self._statuses[name]
        state = status.state if status.attempts <= 1 else f"{status.state}, attempt {status.attempts}"
        progress = self._jobs[name].progress() if status.state in ("running", "failed") else None
        if progress is None:
            return [state, NONE, NONE, self._result(name) if status.state == "done" else NONE, NONE, NONE]
        speed, left = progress.steps_per_second, progress.seconds_left
        return [
            state.replace("running", progress.stage),
            f"{progress.update}/{progress.updates}",
            NONE if progress.reward is None else f"{progress.reward:+.4f}",
            NONE,
            NONE if speed is None else f"{speed:,.0f}",
            NONE if left is None else f"{left:.0f} s",
        ]

    def _result(self, name: str) -> str:
        """Returns what came of a finished job; read once."""
        if name not in self._results:
            try:
                self._results[name] = self._jobs[name].result()
            except RunError:
                self._results[name] = NONE
        return self._results[name]
