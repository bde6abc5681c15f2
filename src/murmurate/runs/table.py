"""Tables of results: one run beside the paper, and many runs together; on the terminal and as Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from murmurate.runs import config_io, escape
from murmurate.runs.evaluate import evaluated
from murmurate.runs.experiment import ExperimentConfig
from murmurate.runs.folder import RunFolder, describe_starts, is_fresh
from murmurate.runs.paper import PaperExperiment
from murmurate.runs.presets import paper_row

__all__ = [
    "RESULTS",
    "Row",
    "as_markdown",
    "as_rich",
    "comparison",
    "differences",
    "gap",
    "paper_total",
    "results",
    "side_by_side",
]

NONE = "-"
Row = Sequence[str]

RESULTS = (
    "experiment",
    "policy",
    "seed",
    "valid",
    "contact-free",
    "inside",
    "at rest",
    "stationary",
    "base steps",
    "auxiliary steps",
    "total steps",
    "paper's total",
    "bound",
    "total / bound",
    "gap",
    "policies",
    "environment steps",
    "training",
)


def comparison(summary: Mapping[str, Any], row: PaperExperiment | None) -> tuple[Row, list[Row]]:
    """Returns one evaluation beside the paper's Table IV.

    Args:
        summary: What `RunFolder.evaluation` returns.
        row: The paper's experiment; None when it has none like this. It is left out where the starts are not fresh.

    Returns:
        The header and the rows; without a column of the paper where it has nothing to say.
    """
    row = row if is_fresh(summary) else None
    paper: dict[str, str] = {}
    if row is not None:
        parts = f"{row.base_steps:.2f}", f"{row.auxiliary_steps:.2f}", paper_total(row)
        paper = dict(zip(("base steps", "auxiliary steps", "total steps"), parts, strict=True))
    steps = [f"{summary[name]:.2f}" for name in ("base_steps", "auxiliary_steps", "total_steps")]
    low, high = (math.nan if end is None else end for end in summary["valid_interval"])
    valid = f"{_count(summary, 'valid')} (95%: {100 * low:.1f}-{100 * high:.1f}%)"
    episodes = summary["episodes"]
    thresholds = [
        (f"{name} reached", f"{round(fraction * episodes)} of {episodes}")
        for name, fraction in summary.get("thresholds", {}).items()
    ]
    shortened = summary.get("interventions")
    shield = [("moves shortened by the shield, an episode", f"{shortened:.1f}")] if shortened else []
    rows: list[Row] = [
        ("base steps", steps[0]),
        ("auxiliary steps", steps[1]),
        ("total steps", steps[2]),
        ("kinematic bound, steps", f"{summary['bound_steps']:.2f}"),
        ("total / bound", _times(summary)),
        ("contact-free", _count(summary, "contact_free")),
        ("inside", _count(summary, "inside")),
        ("at rest", _count(summary, "at_rest")),
        ("stationary", _count(summary, "stationary")),
        ("gathered", _count(summary, "gathered")),
        ("mutually visible", _count(summary, "mutually_visible")),
        ("safe", _count(summary, "safe")),
        *thresholds,
        *shield,
        ("valid pattern", valid),
        ("gap to the best-known pattern", gap(summary)),
    ]
    header = f"{episodes} {describe_starts(summary)}"
    if not paper:
        return (header, "this run"), rows
    return (header, "paper", "this run"), [(name, paper.get(name, NONE), value) for name, value in rows]


def side_by_side(
    folders: Iterable[str | Path], trust: bool = False, names: Sequence[str] | None = None
) -> tuple[Row, list[Row]]:
    """Returns finished runs as a table that tells them apart: by the folder, and by the fields in which they differ.

    Args:
        folders: The run folders.
        trust: Whether modules that the runs' configurations name may be imported.
        names: What to call the runs instead of by their folders.

    Returns:
        The header and the rows; the paper's column is left out where it is empty.

    Raises:
        RunError: A folder is missing, unfinished, damaged or of an unknown version.
    """
    folders = list(folders)
    fields = differences([RunFolder(folder).experiment(trust) for folder in folders])
    header = ["run", *RESULTS[:3], "fields", *RESULTS[3:]]
    rows = [
        [name, *row[:3], text or NONE, *row[3:]]
        for name, text, row in zip(names or map(str, folders), fields, results(folders, trust), strict=True)
    ]
    for name in ("fields", "paper's total"):
        column = header.index(name)
        if all(row[column] == NONE for row in rows):
            for row in (header, *rows):
                del row[column]
    return header, [*rows]


def differences(experiments: Sequence[ExperimentConfig]) -> list[str]:
    """Returns for each experiment the fields that tell it from the others of its name and policy, as `field=value`.

    Seeds are not among them.
    """
    leaves = [
        {leaf.path: config_io.spelled(leaf.value) for leaf in config_io.leaves(experiment)}
        for experiment in experiments
    ]
    groups: dict[tuple[str, str], list[int]] = {}
    for index, experiment in enumerate(experiments):
        groups.setdefault((experiment.name, experiment.policy.name), []).append(index)
    texts = [""] * len(experiments)
    for group in groups.values():
        paths = dict.fromkeys(path for index in group for path in leaves[index])
        varied = [
            path
            for path in paths
            if path != "seed"
            and not path.startswith("modules.")
            and len({leaves[index].get(path) for index in group}) > 1
        ]
        for index in group:
            parts = (f"{path}={leaves[index].get(path, NONE)}" for path in varied)
            texts[index] = ", ".join(parts)
    return texts


def results(folders: Iterable[str | Path], trust: bool = False) -> list[Row]:
    """Returns a row for every finished run, under the header `RESULTS`.

    Args:
        folders: The run folders.
        trust: Whether modules that the runs' configurations name may be imported.

    Raises:
        RunError: A folder is missing, unfinished, damaged or of an unknown version.
    """
    return [_result(RunFolder(folder), trust) for folder in folders]


def _result(folder: RunFolder, trust: bool) -> Row:
    manifest = folder.verify(needed=("environment_steps", "train_seconds"))
    config, summary = folder.experiment(trust), evaluated(folder, trust)
    row = paper_row(config) if is_fresh(summary) else None
    return (
        config.name,
        config.policy.name,
        str(config.seed),
        _count(summary, "valid"),
        _count(summary, "contact_free"),
        _count(summary, "inside"),
        _count(summary, "at_rest"),
        _count(summary, "stationary"),
        f"{summary['base_steps']:.1f}",
        f"{summary['auxiliary_steps']:.1f}",
        f"{summary['total_steps']:.1f}",
        NONE if row is None else paper_total(row),
        f"{summary['bound_steps']:.1f}",
        _times(summary),
        gap(summary),
        str(len(manifest["policies"])),
        f"{manifest['environment_steps'] / 1e6:.2f} M",
        f"{manifest['train_seconds']:.0f} s",
    )


def paper_total(row: PaperExperiment) -> str:
    """Writes the paper's total steps; where the printed total is not the sum of its parts, both."""
    if row.total_steps == row.summed_steps:
        return f"{row.total_steps:.2f}"
    return f"{row.total_steps:.2f} printed, {row.summed_steps:.2f} summed"


def gap(summary: Mapping[str, Any]) -> str:
    """Writes by how much the mean objective is below that of the best-known pattern, in percent of it."""
    below, known = summary.get("gap"), summary.get("best_known")
    if not isinstance(below, float) or not isinstance(known, float) or math.isnan(below) or not known:
        return NONE
    return f"{100 * below / known:.3f}%"


def _count(summary: Mapping[str, Any], name: str) -> str:
    count = summary[name] * summary["episodes"]
    return NONE if math.isnan(count) else f"{round(count)} of {summary['episodes']}"


def _times(summary: Mapping[str, Any]) -> str:
    return f"{summary['total_steps'] / summary['bound_steps']:.2f}" if summary["bound_steps"] else NONE


def as_rich(header: Row, rows: Iterable[Row]) -> Table:
    """Returns a table for the terminal; the first column is text, the others numbers."""
    table = Table()
    for index, name in enumerate(header):
        table.add_column(escape.rich(name), justify="right" if index else "left")
    for row in rows:
        table.add_row(*map(escape.rich, row))
    return table


def as_markdown(header: Row, rows: Iterable[Row]) -> str:
    """Returns a table as Markdown."""
    rule = ["---", *["---:"] * (len(header) - 1)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (_escaped(header), rule, *map(_escaped, rows))) + "\n"


def _escaped(cells: Row) -> Row:
    return [escape.markdown(cell) for cell in cells]
