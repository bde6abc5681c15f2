"""Takes turns: every case is timed once a round, so that whatever slows the machine down slows them all."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax

__all__ = ["Case", "Timing", "first_run", "measure"]


@dataclass(frozen=True)
class Case:
    """Something to time.

    Attributes:
        part: Which table it belongs to.
        name: What it is.
        work: What one run does, in `unit`; world steps are of all worlds together.
        prepare: Sets up, untimed, and returns the run: a function that gives arrays to wait for.
        robots: Swarm size.
        worlds: Worlds that run side by side; 0 where there are none.
        unit: Of the work.
    """

    part: str
    name: str
    work: float
    prepare: Callable[[], Callable[[], Any]]
    robots: int = 10
    worlds: int = 0
    unit: str = "steps"

    @property
    def key(self) -> str:
        """What tells it from every other case."""
        return f"{self.part} | {self.name} | {self.robots} | {self.worlds}"


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
        """Work a second."""
        return self.case.work / self.seconds

    @property
    def spread(self) -> float:
        """Half the range of the middle half of the runs, as a share of the median."""
        low, _, high = statistics.quantiles(self.runs, n=4, method="inclusive")
        return (high - low) / 2 / self.seconds

    @property
    def compile(self) -> float:
        """Seconds that the first run took longer than the others."""
        return max(0.0, self.first - self.seconds)


def measure(cases: Sequence[Case], repeats: int, tell: Callable[[str], None]) -> tuple[list[Timing], list[Case]]:
    """Times every case.

    Args:
        cases: What to time.
        repeats: Timed runs of each; at least 2.
        tell: Is given a line of progress now and then.

    Returns:
        One timing for each case, and the cases that did not fit in memory.
    """
    begun, left_out = [], []
    for case in cases:
        tell(f"compiling {case.key}")
        try:
            run, first = first_run(case)
        except MemoryError:
            tell(f"left out, as it does not fit in memory: {case.key}")
            left_out.append(case)
        else:
            begun.append((case, run, first, []))
    for turn in range(repeats):
        tell(f"round {turn + 1} of {repeats}")
        for _, run, _, taken in begun:
            taken.append(_seconds(run))
    return [Timing(case, first, tuple(taken)) for case, _, first, taken in begun], left_out


def first_run(case: Case) -> tuple[Callable[[], Any], float]:
    """Prepares a case and runs it once.

    Returns:
        The run, and the seconds that it took this time.

    Raises:
        MemoryError: It does not fit in memory.
    """
    try:
        run = case.prepare()
        return run, _seconds(run)
    except jax.errors.JaxRuntimeError as error:
        if "RESOURCE_EXHAUSTED" not in str(error):
            raise
        raise MemoryError(case.key) from error


def _seconds(run: Callable[[], Any]) -> float:
    begun = time.perf_counter()
    jax.block_until_ready(run())
    return time.perf_counter() - begun
