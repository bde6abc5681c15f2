"""Sweeps: a grid trained in one folder, and the table of all its runs, results.csv."""

from __future__ import annotations

import contextlib
import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from murmurate.errors import RunError, UsageError, check_path, check_type
from murmurate.runs import config_io, escape, files
from murmurate.runs.evaluate import evaluated
from murmurate.runs.execute import Executor, LocalProcesses, locked, run_jobs
from murmurate.runs.experiment import ExperimentConfig
from murmurate.runs.folder import RunFolder
from murmurate.runs.grid import Grid
from murmurate.runs.jobs import JobStatus, initial_statuses, training_jobs
from murmurate.terminal import say

__all__ = ["CSV", "MEASURED", "PARQUET", "check_parquet", "rows", "sweep", "write_csv", "write_parquet"]

CSV = "results.csv"
PARQUET = "results.parquet"

Row = dict[str, Any]

FRACTIONS = ("valid", "contact_free", "inside", "mutually_visible", "gathered", "safe", "at_rest", "stationary")
MEANS = ("base_steps", "auxiliary_steps", "total_steps", "bound_steps", "efficiency", "best_known", "gap")

MEASURED = (
    *("valid_pattern", "episodes", *FRACTIONS, *MEANS, "signal_total"),
    *("policies", "environment_steps", "train_seconds", "device", "version"),
)
"""Columns of what was measured: empty where a run is not finished."""


def sweep(
    grid: Grid, out: str | Path, executor: Executor | None = None, *, parquet: bool = False, quiet: bool = True
) -> list[Row]:
    """Trains all runs of a grid in one folder, or continues them, and writes the table of their results.

    The table is also written when the sweep is interrupted; the same call continues it.

    Args:
        grid: The runs.
        out: The folder of all runs and the table.
        executor: Where runs are trained; by default in processes on this machine's cores.
        parquet: Write the table as Parquet too.
        quiet: Show nothing.

    Returns:
        The table, a row for every run.

    Raises:
        RunError: The folder holds other runs, cannot be written to, or another sweep is at work there.
        UsageError: Parquet needs pyarrow.
    """
    check_type("grid", grid, Grid, "a grid, such as Grid.from_toml(path)")
    check_path("out", out)
    out = Path(out)
    if parquet:
        check_parquet()
    grid.check(out, exclusive=True)
    with locked(out):
        grid.check(out, exclusive=True)
        jobs = training_jobs(grid, out)
        statuses = initial_statuses(jobs)

        def write() -> list[Row]:
            table = rows(grid, out, statuses)
            write_csv(out / CSV, table)
            if parquet:
                write_parquet(out / PARQUET, table)
            return table

        if not quiet:
            done = sum(status.state == "done" for status in statuses.values())
            say(f"{len(grid)} runs in {out}: {done} finished, {len(grid) - done} to train")
        try:
            run_jobs(jobs, executor or LocalProcesses(), statuses=statuses, quiet=quiet)
        except BaseException:
            with contextlib.suppress(RunError):  # the first error is the one to report
                write()
            raise
        return write()


def rows(grid: Grid, out: Path, statuses: Mapping[str, JobStatus]) -> list[Row]:
    """Returns the table of a grid's runs.

    The status of a run is done, failed or unfinished; a run folder that is damaged counts as failed.

    Args:
        grid: The runs.
        out: The folder of all runs.
        statuses: How far they are, by name.
    """
    return [_row(name, config, grid.varied, out / name, statuses[name]) for name, config in grid.runs.items()]


def _row(name: str, config: ExperimentConfig, varied: Sequence[str], folder: Path, status: JobStatus) -> Row:
    values = {leaf.path: leaf.value for leaf in config_io.leaves(config)}
    state = status.state if status.state in ("done", "failed") else "unfinished"
    error, measured = status.error, {}
    if state == "done":
        try:
            measured = _measured(folder)
        except RunError as damage:
            state, error = "failed", str(damage)
    return {
        "run": name,
        "status": state,
        "attempts": status.attempts,
        "error": error,
        "experiment": config.name,
        "objective": config.objective,
        "policy": config.policy.name,
        "robots": config.world.robots,
        "seed": config.seed,
        **{path: values.get(path) for path in varied},
        **{column: _finite(measured.get(column)) for column in MEASURED},
    }


def _measured(folder: Path) -> Row:
    """Reads what a finished run measured.

    Raises:
        RunError: The folder is damaged.
    """
    run = RunFolder(folder)
    manifest, summary = run.verify(), evaluated(run, trust=True)
    policies, total = len(manifest["policies"]), summary["signal"].get("total")
    version = manifest.get("murmurate")
    return {**summary, **manifest, "policies": policies, "signal_total": total, "version": version}


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_csv(path: Path, table: Sequence[Row]) -> None:
    """Writes the table as CSV, whole or not at all; a missing value is empty.

    Raises:
        RunError: It cannot be written.
    """
    check_path("path", path)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(map(escape.cell, table[0])), lineterminator="\n")
    writer.writeheader()
    for row in table:
        writer.writerow({escape.cell(name): _cell(value) for name, value in row.items()})
    files.write_text(path, text.getvalue())


def _cell(value: Any) -> str:
    return "" if value is None else config_io.spelled(escape.cell(value))


def check_parquet() -> None:
    """Checks that Parquet can be written.

    Raises:
        UsageError: pyarrow is not installed.
    """
    try:
        import pyarrow.parquet  # noqa: F401
    except ModuleNotFoundError:
        raise UsageError('--parquet needs pyarrow: pip install "murmurate[parquet]"') from None


def write_parquet(path: Path, table: Sequence[Row]) -> None:
    """Writes the table as Parquet, whole or not at all; a column of values of several kinds, or of lists, is text.

    Raises:
        RunError: It cannot be written.
    """
    check_path("path", path)
    import pyarrow
    from pyarrow import parquet

    columns = {name: _column([row[name] for row in table]) for name in table[0]}
    buffer = io.BytesIO()
    parquet.write_table(pyarrow.table(columns), buffer)
    files.write_bytes(path, buffer.getvalue())


def _column(values: Sequence[Any]) -> list[Any]:
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {int, float}:
        return [value if value is None or float not in kinds else float(value) for value in values]
    if len(kinds) == 1 and kinds <= {bool, str}:
        return list(values)
    return [None if value is None else config_io.spelled(value) for value in values]
