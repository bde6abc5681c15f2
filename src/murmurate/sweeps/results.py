"""The table of a sweep: one row a run, with what it was told, what came of it, and why not."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from murmurate.errors import RunError, UsageError
from murmurate.runs import config_io, storage, table
from murmurate.runs.experiment import ExperimentConfig
from murmurate.sweeps.conduct import Standing
from murmurate.sweeps.plan import Sweep

__all__ = ["CSV", "MEASURED", "PARQUET", "check_parquet", "rows", "write_csv", "write_parquet"]

CSV = "results.csv"
PARQUET = "results.parquet"

Row = dict[str, Any]

_SHARES = ("valid", "contact_free", "inside", "mutually_visible", "gathered", "safe", "at_rest")
_MEANS = ("base_steps", "auxiliary_steps", "total_steps", "bound_steps", "efficiency", "best_known", "gap")

MEASURED = (
    *("outcome", "episodes", *_SHARES, *_MEANS, "signal_total"),
    *("policies", "environment_steps", "train_seconds", "device", "version"),
)
"""Columns of what was measured: empty where a run is not finished."""


def rows(sweep: Sweep, out: Path, standings: Mapping[str, Standing]) -> list[Row]:
    """Returns the table, a row for every run of a sweep.

    The status of a run is done, failed or unfinished; a run folder that is damaged counts as failed.

    Args:
        sweep: The runs.
        out: The folder of all runs.
        standings: How they stand.
    """
    return [_row(name, config, sweep.swept, out / name, standings[name]) for name, config in sweep.runs.items()]


def _row(name: str, config: ExperimentConfig, swept: Sequence[str], folder: Path, stands: Standing) -> Row:
    values = {leaf.path: leaf.value for leaf in config_io.leaves(config)}
    status = stands.status if stands.status in ("done", "failed") else "unfinished"
    error, measured = stands.error, {}
    if status == "done":
        try:
            measured = _measured(folder)
        except RunError as damage:
            status, error = "failed", str(damage)
    return {
        "run": name,
        "status": status,
        "attempts": stands.attempts,
        "error": error,
        "experiment": config.name,
        "objective": config.objective,
        "policy": config.policy.name,
        "robots": config.world.robots,
        "seed": config.seed,
        **{path: values[path] for path in swept},
        **{column: _finite(measured.get(column)) for column in MEASURED},
    }


def _measured(folder: Path) -> Row:
    """Reads what a finished run measured.

    Raises:
        RunError: The folder is damaged.
    """
    manifest = storage.read_manifest(folder)
    storage.verify(folder, manifest)
    summary = table.read_evaluation(folder)
    signal, policies = summary.get("signal"), manifest.get("policies")
    return {
        **summary,
        **manifest,
        "policies": len(policies) if isinstance(policies, list) else None,
        "signal_total": signal.get("total") if isinstance(signal, Mapping) else None,
        "version": manifest.get("murmurate"),
    }


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_csv(path: Path, table: Sequence[Row]) -> None:
    """Writes the table as CSV, whole or not at all; what there is not is empty.

    Raises:
        RunError: It cannot be written.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, list(table[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {name: "" if value is None else config_io.spelled(value) for name, value in row.items()} for row in table
    )
    storage.write_text(path, text.getvalue())


def check_parquet() -> None:
    """Makes sure that Parquet can be written.

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
    import pyarrow
    from pyarrow import parquet

    columns = {name: _column([row[name] for row in table]) for name in table[0]}
    buffer = io.BytesIO()
    parquet.write_table(pyarrow.table(columns), buffer)
    storage.write_bytes(path, buffer.getvalue())


def _column(values: Sequence[Any]) -> list[Any]:
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {int, float}:
        return [value if value is None or float not in kinds else float(value) for value in values]
    if len(kinds) == 1 and kinds <= {bool, str}:
        return list(values)
    return [None if value is None else config_io.spelled(value) for value in values]
