"""Measures cases: seconds, peak memory, and the operations that the compiler counts.

Cases are timed in rounds, each case once a round, so that whatever slows the machine down slows all of them.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import equinox as eqx
import jax

try:
    import resource
except ImportError:  # Windows
    resource = None

__all__ = ["MEASURES_MEMORY", "Case", "Timing", "compiler_cost", "first_run", "measure", "peak_here", "peak_memory"]

MEASURES_MEMORY = resource is not None
"""Whether this system tells how large a process has been."""


@dataclass(frozen=True)
class Case:
    """A program to time.

    Attributes:
        part: The table that it belongs to.
        name: Its name in the table.
        work: Amount of work in one run, in `unit`; world steps are those of all worlds together.
        prepare: Sets up, untimed, and returns the run: a function that returns arrays to wait for.
        robots: Swarm size.
        worlds: Number of parallel worlds; 0 if the case has none.
        unit: Unit of the work.
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
        """Name that is unique among all cases."""
        return f"{self.part} | {self.name} | {self.robots} | {self.worlds}"


@dataclass(frozen=True)
class Timing:
    """The seconds that a case took.

    Attributes:
        case: The case.
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
        """Work per second."""
        return self.case.work / self.seconds

    @property
    def spread(self) -> float:
        """Half the interquartile range of the runs, relative to the median."""
        low, _, high = statistics.quantiles(self.runs, n=4, method="inclusive")
        return (high - low) / 2 / self.seconds

    @property
    def compile(self) -> float:
        """Seconds by which the first run exceeds the median of the others."""
        return max(0.0, self.first - self.seconds)


def measure(cases: Sequence[Case], repeats: int, tell: Callable[[str], None]) -> tuple[list[Timing], list[Case]]:
    """Times every case.

    Args:
        cases: The cases.
        repeats: Timed runs of each; at least 2.
        tell: Called with lines that tell the progress.

    Returns:
        One timing for each case, and the cases that did not fit in memory.
    """
    ready, left_out = [], []
    for case in cases:
        tell(f"compiling {case.key}")
        try:
            run, first = first_run(case)
        except MemoryError:
            tell(f"left out, because it does not fit in memory: {case.key}")
            left_out.append(case)
        else:
            ready.append((case, run, first, []))
    for turn in range(repeats):
        tell(f"round {turn + 1} of {repeats}")
        for _, run, _, seconds in ready:
            seconds.append(_seconds(run))
    return [Timing(case, first, tuple(seconds)) for case, _, first, seconds in ready], left_out


def first_run(case: Case) -> tuple[Callable[[], Any], float]:
    """Prepares a case and runs it once.

    Returns:
        The run, and the seconds that it took.

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
    start = time.perf_counter()
    jax.block_until_ready(run())
    return time.perf_counter() - start


def compiler_cost(program: Callable[..., Any], *arguments: Any) -> dict[str, float]:
    """Returns what the compiler counts in a program; the turns of a loop count once.

    Args:
        program: The program, to be compiled.
        *arguments: Its arguments.

    Returns:
        `operations` (additions, multiplications, comparisons and the like), `functions` (exponentials, tangents and the
        like) and `bytes` (read and written by all fused parts of the program).
    """
    analysis = eqx.filter_jit(program).lower(*arguments).compile().compiled.cost_analysis()
    names = {"operations": "flops", "functions": "transcendentals", "bytes": "bytes accessed"}
    return {name: float(analysis.get(key, 0.0)) for name, key in names.items()}


def peak_memory(case: Case, arguments: Sequence[str]) -> int | None:
    """Measures the peak memory of a case in a new process.

    Args:
        case: The case.
        arguments: Arguments of `python -m benchmarks` with which that process makes the same cases.

    Returns:
        Peak bytes beyond those of an idle process, or None if the case does not fit.
    """
    command = [sys.executable, "-m", "benchmarks", *arguments, "--peak", case.key]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return json.loads(done.stdout.splitlines()[-1])["peak_bytes"] if done.returncode == 0 else None


def peak_here(case: Case) -> int:
    """Runs a case twice in this process, which has computed nothing yet, and returns its peak bytes.

    On an accelerator these are the bytes on it; on a CPU the growth of the process, including the compiler.
    """
    jax.block_until_ready(jax.jit(lambda x: x + 1)(jax.numpy.ones(8)))
    device, before = jax.devices()[0], _resident()
    run, _ = first_run(case)
    jax.block_until_ready(run())
    stats = device.memory_stats() or {}
    return stats.get("peak_bytes_in_use", _resident() - before)


def _resident() -> int:
    """Returns the largest size that this process has had in memory."""
    status = Path("/proc/self/status")
    if status.exists():  # ru_maxrss also counts the process that this one was forked from
        line = next(line for line in status.read_text(encoding="ascii").splitlines() if line.startswith("VmHWM"))
        return 1024 * int(line.split()[1])
    assert resource is not None, "peak memory is not measured on this system"
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
