"""Takes turns: every case is timed once a round, so that whatever slows the machine down slows them all."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax

__all__ = ["Case", "Timing", "measure"]


@dataclass(frozen=True)
class Case:
    """Something to time.

    Attributes:
        name: What it is.
        worlds: Worlds that run side by side.
        steps: World steps of one run, all worlds together.
        prepare: Sets up, untimed, and returns the run: a function that gives arrays to wait for.
    """

    name: str
    worlds: int
    steps: int
    prepare: Callable[[], Callable[[], Any]]


@dataclass(frozen=True)
class Timing:
    """How long a case took.

    Attributes:
        case: What was timed.
        first: Seconds of the first run, which compiles.
        runs: Seconds of every later run.
    """

    case: Case
    first: float
    runs: tuple[float, ...]

    @property
    def seconds(self) -> float:
        """Median seconds of a run."""
        return statistics.median(self.runs)

    @property
    def rate(self) -> float:
        """World steps a second."""
        return self.case.steps / self.seconds

    @property
    def spread(self) -> float:
        """Half the range of the middle half of the runs, as a share of the median."""
        low, _, high = statistics.quantiles(self.runs, n=4, method="inclusive")
        return (high - low) / 2 / self.seconds

    @property
    def compile(self) -> float:
        """Seconds that the first run took longer than the others."""
        return max(0.0, self.first - self.seconds)


def measure(cases: Sequence[Case], repeats: int, tell: Callable[[str], None]) -> list[Timing]:
    """Times every case.

    Args:
        cases: What to time.
        repeats: Timed runs of each; at least 2.
        tell: Is given a line of progress now and then.

    Returns:
        One timing for each case.
    """
    runs, firsts = [], []
    for case in cases:
        tell(f"compiling {case.name}, {case.worlds} worlds")
        run = case.prepare()
        firsts.append(_seconds(run))
        runs.append(run)
    seconds: list[list[float]] = [[] for _ in cases]
    for turn in range(repeats):
        tell(f"round {turn + 1} of {repeats}")
        for taken, run in zip(seconds, runs, strict=True):
            taken.append(_seconds(run))
    return [Timing(case, first, tuple(taken)) for case, first, taken in zip(cases, firsts, seconds, strict=True)]


def _seconds(run: Callable[[], Any]) -> float:
    begun = time.perf_counter()
    jax.block_until_ready(run())
    return time.perf_counter() - begun
