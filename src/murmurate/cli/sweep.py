"""`murmurate sweep`: many runs, on this machine's cores, on Ray or on Slurm, and one table of their results."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from murmurate.cli.arguments import Parser
from murmurate.cli.main import FAILED, NOTHING_VALID, TOO_FEW_VALID
from murmurate.errors import UsageError, check_choice
from murmurate.terminal import say, say_text

if TYPE_CHECKING:
    from murmurate.runs.execute import Executor

__all__ = ["run"]

BACKENDS = ("local", "ray", "slurm")
RETRIES = 2


def run(argv: Sequence[str]) -> int:
    """Runs the verb.

    Returns:
        0; 3 when no run discovered a valid pattern; 4 when a run failed as often as it may; 5 when no run discovered as
        many as its discovery.required_valid asks for.
    """
    options, _ = _parser().parse(argv)
    check_choice("--backend", options.backend, BACKENDS)
    for name, backend in (("address", "ray"), ("slurm", "slurm")):
        if getattr(options, name) and options.backend != backend:
            raise UsageError(f"--{name} is for --backend {backend}")
    import jax

    jax.config.update("jax_platforms", "cpu")  # the GPUs are for the workers
    from murmurate.runs.grid import Grid
    from murmurate.runs.sweep import check_parquet, sweep

    if options.parquet:
        check_parquet()
    grid, out = Grid.from_toml(options.sweep), Path(options.out or Path("runs") / Path(options.sweep).stem)
    grid.check(out, exclusive=True)
    try:
        with _executor(options, out) as executor:
            rows = sweep(grid, out, executor, parquet=options.parquet, quiet=options.quiet)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("interrupted; the same command goes on") from None
    return _report(rows, out)


def _parser() -> Parser:
    parser = Parser("sweep", "SWEEP.toml", "Trains many runs, and writes one table of their results.")
    text = "which runs: experiments, learners, seeds, a grid of fields"
    parser.add_argument("sweep", metavar="SWEEP.toml", help=text)
    parser.add_argument("--out", metavar="DIR", help="folder of all runs and the table (default: runs/SWEEP)")
    text = "where runs are trained: here, or on Ray or Slurm, each an extra (default: local)"
    parser.add_argument("--backend", metavar=f"{{{','.join(BACKENDS)}}}", default=BACKENDS[0], help=text)
    text = "runs at once, at most (default: one for each core or GPU; on a cluster, what its queue allows)"
    parser.add_argument("--workers", type=int, metavar="INT", help=text)
    text = f"how often a failed run is tried again, from its checkpoint (default: {RETRIES})"
    parser.add_argument("--retries", type=int, metavar="INT", default=RETRIES, help=text)
    parser.add_argument("--threads", type=int, metavar="INT", default=1, help="cores for each run (default: 1)")
    text = "GPUs for each run (default: 0, which trains on the CPU)"
    parser.add_argument("--gpus", type=int, metavar="INT", default=0, help=text)
    text = "address of a Ray cluster, or auto (default: a cluster on this machine only)"
    parser.add_argument("--address", metavar="HOST:PORT", help=text)
    text = "option of sbatch, such as partition=short; may be given several times"
    parser.add_argument("--slurm", action="append", default=[], metavar="KEY=VALUE", help=text)
    text = "write the table as results.parquet as well (needs the parquet extra)"
    parser.add_argument("--parquet", action="store_true", help=text)
    parser.add_argument("--quiet", action="store_true", help="do not show the progress")
    parser.epilog = "After an interruption, give the same command: finished runs stay, and unfinished ones go on."
    return parser


def _executor(options: Namespace, out: Path) -> Executor:
    from murmurate.runs.execute import LocalProcesses, Resources

    resources = Resources(options.threads, options.gpus)
    if options.backend == "local":
        return LocalProcesses(options.workers, resources, options.retries)
    from murmurate.runs.clusters import Ray, Slurm, read_options

    if options.backend == "ray":
        return Ray(options.address, options.workers, resources, options.retries)
    return Slurm(out, options.workers, resources, options.retries, read_options(options.slurm))


def _report(rows: list[dict[str, Any]], out: Path) -> int:
    """Prints the results of finished runs, and which failed; returns the exit status."""
    from murmurate.runs import table
    from murmurate.runs.evaluate import evaluated, is_below
    from murmurate.runs.folder import RunFolder
    from murmurate.runs.sweep import CSV
    from murmurate.runs.worker import LOG

    done = [row for row in rows if row["status"] == "done"]
    failed = [row for row in rows if row["status"] == "failed"]
    if done:
        names = [row["run"] for row in done]
        say_text(table.as_markdown(*table.side_by_side([out / name for name in names], True, names)))
    say(f"table: {out / CSV}")
    for row in failed:
        log = out / row["run"] / LOG
        say(f"failed: {row['run']}: {row['error']}{f' (see {log})' if log.exists() else ''}")
    if failed:
        say(f"{len(failed)} of {len(rows)} runs failed; the same command tries them again.")
        return FAILED
    if not any(row["valid_pattern"] for row in done):
        say(f"No valid pattern was discovered. The runs are kept in {out}.")
        return NOTHING_VALID
    runs = [RunFolder(out / row["run"]) for row in done]
    if all(is_below(evaluated(run, trust=True), run.experiment(trust=True).discovery.required_valid) for run in runs):
        say("No run formed valid patterns from the share of starts that discovery.required_valid asks for.")
        return TOO_FEW_VALID
    return 0
