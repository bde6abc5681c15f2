"""`murmurate sweep`: many runs, on this machine's cores, on Ray or on Slurm, and one table of what came of them."""

from __future__ import annotations

import contextlib
import fcntl
import signal
import threading
from argparse import Namespace
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from murmurate.cli.arguments import Parser
from murmurate.errors import RunError, UsageError, check_choice, check_number

if TYPE_CHECKING:
    from murmurate.sweeps.backend import Backend
    from murmurate.sweeps.conduct import Standing

__all__ = ["run"]

NOTHING_VALID = 3
FAILED = 4

LOCK = ".lock"
BACKENDS = ("local", "ray", "slurm")
RETRIES, MOST = 2, 1000


def run(argv: Sequence[str]) -> int:
    """Runs the verb.

    Returns:
        0; 3 when no run discovered a valid pattern; 4 when a run failed as often as it may.
    """
    options, _ = _parser().parse(argv)
    check_choice("--backend", options.backend, BACKENDS)
    check_number("--retries", options.retries, 0, MOST, integer=True)
    if options.workers is not None:
        check_number("--workers", options.workers, 1, MOST, integer=True)
    for name in ("address", "slurm"):
        if getattr(options, name) and options.backend != (of := "ray" if name == "address" else name):
            raise UsageError(f"--{name} is for --backend {of}")
    import jax

    jax.config.update("jax_platforms", "cpu")  # the GPUs are for the workers
    from murmurate.sweeps import plan, results

    if options.parquet:
        results.check_parquet()
    sweep = plan.read_sweep(options.sweep)
    out = Path(options.out or Path("runs") / Path(options.sweep).stem)
    plan.check(sweep, out)
    with _terminable(), contextlib.closing(_backend(options, out)) as backend, _alone(out):
        return _conduct(options, sweep, out, backend)


def _parser() -> Parser:
    parser = Parser("sweep", "SWEEP.toml", "Trains many runs, and writes one table of what came of them.")
    parser.add_argument(
        "sweep", metavar="SWEEP.toml", help="which runs: experiments, learners, seeds, a grid of fields"
    )
    parser.add_argument("--out", metavar="DIR", help="folder of all runs and the table (default: runs/SWEEP)")
    where = "where runs are trained: here, or on Ray or Slurm, each an extra (default: local)"
    parser.add_argument("--backend", metavar=f"{{{','.join(BACKENDS)}}}", default=BACKENDS[0], help=where)
    most = "most runs at once (default: one a core, or a GPU; on a cluster, what its queue allows)"
    parser.add_argument("--workers", type=int, metavar="INT", help=most)
    text = f"how often a failed run is tried again, from its checkpoint (default: {RETRIES})"
    parser.add_argument("--retries", type=int, metavar="INT", default=RETRIES, help=text)
    parser.add_argument("--threads", type=int, metavar="INT", default=1, help="cores for each run (default: 1)")
    text = "GPUs for each run (default: 0, which trains on the CPU)"
    parser.add_argument("--gpus", type=int, metavar="INT", default=0, help=text)
    text = "address of a Ray cluster, or auto (default: one of this machine's own)"
    parser.add_argument("--address", metavar="HOST:PORT", help=text)
    text = "what sbatch is told, such as partition=short; may be given several times"
    parser.add_argument("--slurm", action="append", default=[], metavar="KEY=VALUE", help=text)
    text = "write the table as results.parquet as well (needs the parquet extra)"
    parser.add_argument("--parquet", action="store_true", help=text)
    parser.epilog = "After an interruption, give the same command: finished runs stay, and unfinished ones go on."
    return parser


def _backend(options: Namespace, out: Path) -> Backend:
    """Makes the backend that was asked for; a module is imported when it is."""
    from murmurate.sweeps.backend import Share

    share = Share(options.threads, options.gpus)
    if options.backend == "local":
        from murmurate.sweeps.local import Local

        return Local(options.workers, share)
    if options.backend == "ray":
        from murmurate.sweeps.ray import Ray

        return Ray(options.address, options.workers, share)
    from murmurate.sweeps.slurm import Slurm, read_options

    return Slurm(out, options.workers, share, read_options(options.slurm))


def _conduct(options: Namespace, sweep: Any, out: Path, backend: Backend) -> int:
    from murmurate.sweeps import plan
    from murmurate.sweeps.board import Board
    from murmurate.sweeps.conduct import conduct, standing

    folders = plan.lay_out(sweep, out)
    standings = {name: standing(folder) for name, folder in folders.items()}
    done = sum(one.status == "done" for one in standings.values())
    print(f"{len(folders)} runs in {out}: {done} finished, {len(folders) - done} to train", flush=True)
    try:
        with Board(sweep.runs, out, standings) as board:
            conduct(folders, standings, backend, options.retries, _teller(board, out, standings), board.draw)
    except BaseException as error:
        with contextlib.suppress(RunError):  # what came first is what is told
            _write(options, sweep, out, standings)
        if isinstance(error, KeyboardInterrupt):
            raise KeyboardInterrupt("interrupted; the same command goes on") from None
        raise
    return _report(_write(options, sweep, out, standings), out)


def _teller(board: Any, out: Path, standings: dict[str, Standing]) -> Any:
    """Says what came of a worker: every run that ends, or on a terminal, whose table says so, those that fail."""
    from murmurate.runs import table

    def words(name: str, stands: Standing) -> str:
        if stands.status == "done":
            return f"{table.read_evaluation(out / name)['valid']:.1%} valid"
        if stands.status == "failed":
            return f"failed, attempt {stands.attempts}: {stands.error}"
        return f"to be tried again, attempt {stands.attempts} failed: {stands.error}"

    def tell(name: str) -> None:
        stands = standings[name]
        ended = sum(one.status in ("done", "failed") for one in standings.values())
        line = f"{ended} of {len(standings)}: {name}: {words(name, stands)}"
        if not board.shown:
            print(line, flush=True)
        elif stands.status != "done":
            board.say(line)

    return tell


def _write(options: Namespace, sweep: Any, out: Path, standings: dict[str, Standing]) -> list[dict[str, Any]]:
    from murmurate.sweeps import results

    table = results.rows(sweep, out, standings)
    results.write_csv(out / results.CSV, table)
    if options.parquet:
        results.write_parquet(out / results.PARQUET, table)
    return table


def _report(rows_of_all: list[dict[str, Any]], out: Path) -> int:
    """Prints the table of finished runs, and what failed."""
    from murmurate.runs import table, train
    from murmurate.sweeps import results
    from murmurate.sweeps.worker import LOG

    done = [row for row in rows_of_all if row["status"] == "done"]
    failed = [row for row in rows_of_all if row["status"] == "failed"]
    if done:
        found = table.results(out / row["run"] for row in done)
        rows = [(row["run"], *cells[3:]) for row, cells in zip(done, found, strict=True)]
        print(table.as_markdown(("run", *table.RESULTS[3:]), rows), end="")
    print(f"table: {out / results.CSV}")
    for row in failed:
        log = out / row["run"] / LOG
        print(f"failed: {row['run']}: {row['error']}{f' (see {log})' if log.exists() else ''}")
    if failed:
        print(f"{len(failed)} of {len(rows_of_all)} runs failed; the same command tries them again.")
        return FAILED
    if not any(row["outcome"] == train.VALID for row in done):
        print(f"No valid pattern was discovered. The runs are kept in {out}.")
        return NOTHING_VALID
    return 0


@contextlib.contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Keeps a second sweep out of the folder while this one is at work."""
    from murmurate.runs import storage

    with storage.os_errors_as_run_errors(f"cannot write to {out}"):
        out.mkdir(parents=True, exist_ok=True)
        lock = (out / LOCK).open("a")
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RunError(f"{out}: another sweep is at work there") from None
        yield


@contextlib.contextmanager
def _terminable() -> Iterator[None]:
    """Lets a request to end, such as a batch system sends, end workers as an interrupt does."""
    if threading.current_thread() is not threading.main_thread():  # signals are the main thread's
        yield
        return

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
