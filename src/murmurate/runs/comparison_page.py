"""A comparison as a page in Markdown, or as a part of another page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from murmurate.errors import printable
from murmurate.runs import escape
from murmurate.runs.table import NONE, Row, as_markdown, gap

__all__ = ["HEADER", "kept", "page", "put_into", "table_rows", "tables"]

CONDITION = ("start", "sensing", "scheduler", "N", "method")
"""The columns that say what was evaluated."""

FAILURES = ("collided", "left", "hidden", "not at rest", "not stationary")
"""The columns that count what was wrong."""

HEADER = (*CONDITION, "valid", "95% interval", *FAILURES, "steps", "epochs", "efficiency", "shortened", "gap")

LATER = {"not stationary": "unsteady", "shortened": "interventions"}
"""Columns of fields that rows of older comparisons do not have."""

RANDOM = "random"

BEGIN, END = "<!-- comparison -->", "<!-- end of comparison -->"


def table_rows(rows: Iterable[Mapping[str, Any]]) -> list[Row]:
    """Returns a row of the table for each row of comparison.json, under `HEADER`."""
    return [
        (
            row["start"],
            row["sensing"],
            row["scheduler"],
            str(row["robots"]),
            row["method"],
            f"{row['valid']} of {row['episodes']}",
            f"{100 * row['interval'][0]:.1f}-{100 * row['interval'][1]:.1f}%",
            str(row["collisions"]),
            str(row["left"]),
            str(row["hidden"]),
            str(row["restless"]),
            str(row.get("unsteady", NONE)),
            _number(row["steps"], "{:.1f}"),
            _number(row["epochs"], "{:.1f}"),
            _number(row["efficiency"], "{:.2f}"),
            _number(row.get("interventions"), "{:.1f}"),
            gap(row),
        )
        for row in rows
    ]


def tables(rows: Sequence[Mapping[str, Any]]) -> str:
    """Returns the rows as tables that fit a page, each under a heading.

    There is a table for each start and, for random starts, for each sensing and scheduler. What all rows of a table
    share is its heading instead of a column.
    """
    groups: dict[tuple[str, ...], list[Row]] = {}
    unknown = [HEADER.index(column) for column, field in LATER.items() if not any(field in row for row in rows)]
    for row in table_rows(rows):
        groups.setdefault(tuple(row[:3] if row[0] == RANDOM else row[:1]), []).append(row)
    parts = []
    for group in groups.values():
        shared = [len({row[column] for row in group}) == 1 for column in range(len(CONDITION))]
        # A table needs a column of names.
        shared[CONDITION.index("method")] &= not all(shared)
        columns = [column for column in range(len(HEADER)) if column >= len(CONDITION) or not shared[column]]
        columns = [column for column in columns if column not in unknown]
        named = zip(CONDITION, group[0], shared, strict=False)
        titles = (_TITLES.get(name, "{}").format(escape.markdown(value)) for name, value, shares in named if shares)
        title = ", ".join(titles)
        cells = [tuple(row[column] for column in columns) for row in group]
        parts.append(f"### {title[0].upper()}{title[1:]}\n\n{as_markdown([HEADER[c] for c in columns], cells)}")
    return "\n".join(parts)


_TITLES = {"start": "{} starts", "sensing": "`{}` sensing", "scheduler": "scheduler `{}`", "N": "{} robots"}


def page(
    rows: Sequence[Mapping[str, Any]], commands: Sequence[str], notes: Sequence[str] = (), pictures: str = ""
) -> str:
    """Returns the page: what was compared, the table, and the figures.

    Args:
        rows: Rows of comparison.json.
        commands: The commands that evaluated them.
        notes: Remarks on methods, one line each.
        pictures: Folder of comparison.png and failures.png, as a prefix of their links.
    """
    failures = any(row["worst"] for row in rows)
    lines = [
        "## Any swarm, under any scheduler",
        "",
        "Made by",
        "",
        "```sh",
        *(printable(command).replace("```", "'''") for command in commands),
        "```",
        "",
        "Under each condition all methods have the same starts, none of them seen in training, the same speed limit,",
        "and the same step budget. Robots have directions and handedness of their own; only",
        "`circle-central` has a common frame and all positions. Episodes that failed *collided*, *left* the world, had",
        "robots *hidden* from each other at the end, or were *not at rest*; an episode may count in several columns.",
        *(text for field, text in _NOTES.items() if any(field in row for row in rows)),
        "Steps, epochs and efficiency (kinematic bound over steps) are means over the valid episodes, and so is the",
        "gap: how far the objective is below that of the best-known pattern, where there is one, in percent of it.",
        "",
        tables(rows),
        *(f"- {note}" for note in notes),
        *([""] if notes else []),
        f"![Valid patterns by method]({escape.link(pictures)}comparison.png)",
    ]
    if failures:
        lines += ["", f"![The worst failures]({escape.link(pictures)}failures.png)"]
    return "\n".join(lines) + "\n"


_NOTES = {
    "unsteady": "*Not stationary* are patterns that formed and did not stay: in the 200 steps after rest, with nothing "
    "frozen.",
    "interventions": "*Shortened* are the moves that the shield made shorter, a mean over all episodes.",
}


def kept(text: str) -> str:
    """Returns the comparison that a page holds, marks included; empty where there is none."""
    _, mark, rest = text.partition(BEGIN)
    inside, end, _ = rest.partition(END)
    return f"{mark}{inside}{end}\n" if mark and end else ""


def put_into(text: str, part: str) -> str:
    """Returns a page with the comparison in the place of the one it holds, or at its end."""
    old, new = kept(text), f"{BEGIN}\n{part}\n{END}\n"
    return text.replace(old, new) if old else f"{text.rstrip()}\n\n{new}"


def _number(value: float | None, form: str) -> str:
    return NONE if value is None else form.format(value)
