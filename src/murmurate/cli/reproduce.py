"""`murmurate reproduce`: trains what the paper's tables and figures need, and writes them beside ours as a report."""

from __future__ import annotations

import functools
import shlex
import time
from argparse import Namespace
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from murmurate.cli.arguments import Parser
from murmurate.errors import UsageError

if TYPE_CHECKING:
    from murmurate.cli.progress import Progress
    from murmurate.report.plan import Plan
    from murmurate.report.runs import Result

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
    parser.epilog = "Finished runs are reused, and unfinished ones go on: after an interruption, give the same command."
    options, _ = parser.parse(argv)
    runs, out = Path(options.runs), Path(options.out or f"reproduction{'-quick' if options.quick else ''}")
    if out.resolve() == runs.resolve():
        raise UsageError("--out and --runs are the same folder: the report needs one of its own")
    from murmurate.report.plan import make_plan

    words, full = _words(options), _words(options, full=True)
    try:
        reproduce(make_plan(options.seed, options.quick), runs, out, words, full, begun)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted; the same command goes on: {words}") from None
    return 0


def _words(options: Namespace, full: bool = False) -> str:
    """Writes the command line; with `full`, that of the full report, in a folder of its own."""
    words = ["murmurate", "reproduce"]
    if not full:
        words += ["--quick"] * options.quick + (["--out", options.out] if options.out else [])
    words += ["--runs", options.runs] if options.runs != RUNS else []
    words += ["--seed", str(options.seed)] if options.seed != SEED else []
    return shlex.join(words)


def reproduce(plan: Plan, runs: Path, out: Path, words: str, full: str, begun: float) -> None:
    """Trains what is missing of a plan and writes its report.

    Args:
        plan: The runs.
        runs: The folder of all run folders.
        out: The report folder.
        words: The command line.
        full: The command line of the full report.
        begun: When the command began, by `time.perf_counter`.

    Raises:
        RunError: A folder holds something else, is damaged, or cannot be written to.
    """
    from murmurate.report import report
    from murmurate.report import runs as work
    from murmurate.report.data import Command, ReportData

    found = Counter(work.check(plan, runs).values())
    report.check(out)
    parts = f"{found['finished']} finished, {found['unfinished']} to go on with, {found['new']} to train"
    print(f"{len(plan.runs)} runs in {runs}: {parts}", flush=True)
    results = _train(plan, runs)
    print("drawing the report", flush=True)
    command = Command(words, full, time.perf_counter() - begun, found["finished"])
    report.write(report.make(ReportData(plan, results, command)), out)
    print(f"report: {out / report.HTML}, {out / report.MARKDOWN}")
    print(f"numbers: {out / report.NUMBERS}")


def _train(plan: Plan, runs: Path) -> list[Result]:
    """Trains one run after the other, and says what came of each."""
    from murmurate.cli.progress import Progress
    from murmurate.report import runs as work

    results = []
    for place, planned in enumerate(plan.runs, 1):
        head = f"run {place} of {len(plan.runs)}"
        # Live lines of its own for each run: those of all would not fit on a screen.
        with Progress() as progress:
            result = work.train(planned, runs, functools.partial(_show, progress, f"{head} ({planned.title})"))
        print(f"{head}: {planned.title}: {result.summary['valid']:.1%} valid", flush=True)
        results.append(result)
    return results


def _show(progress: Progress, head: str, work: str, done: int, total: int, **values: float | str) -> None:
    progress.update(f"{head}: {work}", done, total, **values)
