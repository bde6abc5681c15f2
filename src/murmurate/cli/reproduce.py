"""`murmurate reproduce`: trains what the paper's tables and figures need, and writes them beside ours as a report."""

from __future__ import annotations

import shlex
import time
from argparse import Namespace
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from murmurate.cli.arguments import Parser
from murmurate.errors import UsageError
from murmurate.terminal import say

if TYPE_CHECKING:
    from murmurate.report.plan import Plan
    from murmurate.runs.execute import Executor

__all__ = ["run"]

RUNS = "runs"
SEED = 0


def run(argv: Sequence[str]) -> int:
    """Runs the verb.

    Returns:
        0, whether patterns are valid or not: the report says so.
    """
    begun = time.perf_counter()
    parser = Parser("reproduce", "", "Trains what is missing, and writes the paper's tables and figures beside ours.")
    parser.add_argument("--quick", action="store_true", help="smaller budgets: in minutes, but with other numbers")
    parser.add_argument("--out", metavar="DIR", help="report folder (default: reproduction, or reproduction-quick)")
    parser.add_argument("--runs", metavar="DIR", default=RUNS, help=f"folder of all run folders (default: {RUNS})")
    parser.add_argument("--seed", type=int, metavar="INT", default=SEED, help=f"seed of every run (default: {SEED})")
    text = "train in so many processes of one core each (default: all cores; on an accelerator, in this process)"
    parser.add_argument("--workers", type=int, metavar="INT", help=text)
    parser.add_argument("--quiet", action="store_true", help="do not show the progress")
    parser.epilog = "Finished runs are reused, and unfinished ones go on: after an interruption, give the same command."
    options, _ = parser.parse(argv)
    runs, out = Path(options.runs), Path(options.out or f"reproduction{'-quick' if options.quick else ''}")
    if out.resolve() == runs.resolve():
        raise UsageError("--out and --runs are the same folder: the report needs one of its own")
    from murmurate.report.plan import make_plan

    try:
        reproduce(make_plan(options.seed, options.quick), runs, out, options, begun)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted; the same command goes on: {_command(options)}") from None
    return 0


def reproduce(plan: Plan, runs: Path, out: Path, options: Namespace, begun: float) -> None:
    """Trains what is missing of a plan and writes its report.

    Args:
        plan: The runs.
        runs: The folder of all run folders.
        out: The report folder.
        options: The options of the command line.
        begun: When the command began, by `time.perf_counter`.

    Raises:
        RunError: A folder holds something else, is damaged, or cannot be written to.
    """
    from murmurate.report import report
    from murmurate.report import runs as planned
    from murmurate.report.data import Command, ReportData

    executor = _executor(options.workers)
    states = Counter(planned.check(plan, runs).values())
    report.check(out)
    parts = f"{states['finished']} finished, {states['unfinished']} to go on with, {states['new']} to train"
    say(f"{len(plan.runs)} runs in {runs}: {parts}")
    results = planned.train(plan, runs, executor, options.quiet)
    say("drawing the report")
    full = _command(options, full=True)
    command = Command(_command(options), full, time.perf_counter() - begun, states["finished"])
    report.write(report.make(ReportData(plan, results, command)), out)
    say(f"report: {out / report.HTML}, {out / report.MARKDOWN}")
    say(f"numbers: {out / report.NUMBERS}")


def _executor(workers: int | None) -> Executor:
    """Returns where runs are trained. On a CPU, runs take less time side by side than one after another."""
    import jax

    from murmurate.runs.execute import InProcess, LocalProcesses

    on_accelerator = workers is None and jax.default_backend() != "cpu"
    return InProcess() if on_accelerator else LocalProcesses(workers)


def _command(options: Namespace, full: bool = False) -> str:
    """Returns the command line; with `full`, that of the full report, in a folder of its own."""
    arguments = ["murmurate", "reproduce"]
    if not full:
        arguments += ["--quick"] * options.quick + (["--out", options.out] if options.out else [])
    arguments += ["--runs", options.runs] if options.runs != RUNS else []
    arguments += ["--seed", str(options.seed)] if options.seed != SEED else []
    return shlex.join(arguments)
