"""`murmurate discover --seeds`, `--vary`: many discoveries of one experiment, and one catalogue of their patterns."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from murmurate.analysis import Catalogue
from murmurate.cli.main import NOTHING_VALID, TOO_FEW_VALID
from murmurate.runs import catalogues, files, table
from murmurate.runs.evaluate import evaluated, is_below
from murmurate.runs.execute import InProcess, run_jobs
from murmurate.runs.folder import RunFolder
from murmurate.runs.grid import Grid
from murmurate.runs.jobs import training_jobs
from murmurate.runs.run import Run
from murmurate.runs.train import check_initial
from murmurate.terminal import say, say_text

__all__ = ["discover_many"]


def discover_many(
    grid: Grid,
    out: Path,
    name: str,
    resume: bool,
    together: int | None = None,
    on_metrics: Callable[[Path], None] | None = None,
    quiet: bool = False,
    initial: Run | None = None,
) -> int:
    """Trains the runs of a grid, each in a folder of its own, and catalogues the patterns that they found.

    Args:
        grid: The runs.
        out: The folder of all runs.
        name: The experiment and its learner, which the catalogue is named after.
        resume: Continue the runs that the folder holds.
        together: How many train side by side in one program; by default all on an accelerator, and one on a CPU.
        on_metrics: See `train.discover`.
        quiet: Do not show the progress.
        initial: A run whose policies those of every run begin with.

    Returns:
        0; 3 when no valid pattern was discovered; 5 when no run discovered as many as its discovery.required_valid asks
        for.

    Raises:
        InputError: `together` is out of bounds.
        RunError: A folder holds something else, is a link, or cannot be written to, or the policies of `initial` do
            not fit.
    """
    from murmurate.cli.catalogue import show

    catalogue, folders = files.inside(out, f"{name}-catalogue"), [out / run for run in grid.runs]
    catalogues.check_target(catalogue)
    for run, state in grid.check(out, resume=resume).items():
        if state == "finished" and on_metrics is not None:
            on_metrics(out / run)
    jobs = training_jobs(grid, out, on_metrics, {} if initial is None else dict.fromkeys(grid.runs, initial))
    if initial is not None:
        configs = {out / run: config for run, config in grid.runs.items()}
        check_initial(configs, resume, dict.fromkeys(configs, initial))
    try:
        run_jobs(jobs, InProcess(together), quiet=quiet)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("interrupted; add --resume to the same command to go on") from None
    say_text(table.as_markdown(*table.side_by_side(folders, trust=True)))
    findings = [finding for folder in folders for finding in catalogues.read_findings(folder, trust=True)]
    if not findings:
        say(f"No valid pattern was discovered. The runs are kept in {out}.")
        return NOTHING_VALID
    show(Catalogue.from_findings(findings), catalogue)
    required = {run: config.discovery.required_valid for run, config in grid.runs.items()}
    if all(is_below(evaluated(RunFolder(out / run), trust=True), least) for run, least in required.items()):
        say("No run formed valid patterns from the share of starts that discovery.required_valid asks for.")
        return TOO_FEW_VALID
    return 0
