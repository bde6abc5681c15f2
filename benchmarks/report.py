"""Writes the figures as Markdown, between the marks of a page."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import ceilings, peers, pieces
from benchmarks.cases import RESTARTS, SENSING, SIZED, STEP, TRAINING
from murmurate.runs.table import as_markdown

__all__ = ["machine_line", "markdown", "speed_table", "write"]

BEGIN, END = "<!-- begin: make benchmark -->", "<!-- end: make benchmark -->"
ALIKE = "(see above)"
Rows = Sequence[Mapping[str, Any]]


def markdown(data: Mapping[str, Any], picture: str | None = None) -> str:
    """Returns the whole section.

    Args:
        data: What was measured.
        picture: Path of the figure from the page, if it is to be shown.
    """
    cases = data["cases"]
    parts = [
        machine_line(data["machine"]),
        f"Medians of {data['repeats']} rounds in which the cases take turns, {data['seconds'] / 60:.0f} minutes in "
        "all; ± is half the range of the middle half.",
        *([f"![Cost of a step against the number of robots]({picture})"] if picture else []),
        "### Aims\n\n" + _aims(data["aims"]),
        "### Ten robots\n\n" + speed_table(cases),
        "### Swarms of other sizes\n\n" + _sizes(cases) + "\n" + _fits(data["fits"]),
        "### Where the time of an update goes\n\n" + _pieces(cases, data["updates"]),
        "### The machine's ceilings, and floors counted by hand\n\n"
        + _ceilings(cases)
        + "\n"
        + _floors(data["floors"]),
        "### Peak memory\n\n" + _memory(data["memory"]),
    ]
    if data["left_out"]:
        parts.append("Left out, as they do not fit in memory: " + "; ".join(data["left_out"]) + ".")
    return "\n".join(_wrapped(line) for line in "\n\n".join(part.strip("\n") for part in parts).splitlines()) + "\n"


def _wrapped(line: str) -> str:
    """Breaks a long line of text, as the rest of the page is broken; a table's stays."""
    return line if line.startswith("|") else textwrap.fill(line, 140, break_long_words=False, break_on_hyphens=False)


def machine_line(about: Mapping[str, Any]) -> str:
    """Names the machine on one line."""
    versions = ", ".join(f"{name} {version}" for name, version in about["versions"].items())
    device = f"{about['device']}, " if about["device"] else ""
    memory = f"{about['memory_bytes'] / 2**30:.0f} GiB, " if about["memory_bytes"] else ""
    return f"{device}{about['processor']}, {about['cores']} cores, {memory}{about['system']}; {versions}."


def _aims(rows: Rows) -> str:
    cells = []
    for row in rows:
        wanted = f"{'at least' if row['at_least'] else 'at most'} {_number(row['wanted'])}"
        if row["above_floor"] is not None:
            wanted += f", or within twice the floor (here {row['above_floor']:.1f} times)"
        cells.append((row["what"], wanted, _number(row["reached"]), "yes" if row["met"] else "no"))
    return as_markdown(("aim", "wanted", "reached", "met"), cells)


def speed_table(cases: Rows) -> str:
    """Returns the speeds of ten robots, beside other projects."""
    names = (STEP, RESTARTS)
    wanted = [row for row in cases if row["robots"] == 10 and row["name"] in names and row["worlds"] > 1]
    wanted += [row for row in cases if row["part"] in (peers.PART, TRAINING)]
    cells = []
    for row in sorted(wanted, key=lambda row: (row["part"] == TRAINING, row["part"] == peers.PART)):
        ratio = "" if row["ratio"] is None else f"{row['ratio']:.2f}"
        speed = (f"{row['per_second']:,.0f}", f"{row['spread']:.0%}", ratio, f"{row['compile_seconds']:.1f}")
        name = f"training, {row['name']}" if row["part"] == TRAINING else row["name"]
        cells.append((name, f"{row['worlds']:,}", *speed))
    text = as_markdown(("what", "worlds", "steps/s", "±", "ratio to JaxMARL", "compiling, s"), cells)
    missing = [name for name in (peers.JAXMARL, peers.VMAS, peers.SB3) if name not in {row["name"] for row in cases}]
    return text + (f"\nNot installed, so not compared with: {', '.join(missing)}.\n" if missing else "")


def _sizes(cases: Rows) -> str:
    """Steps a second by swarm size and batch; of the largest batch also the time of a step, and of sensing."""
    steps = {(row["robots"], row["worlds"]): row for row in cases if (row["part"], row["name"]) == (SIZED, STEP)}
    looks = {row["robots"]: row for row in cases if row["name"] == SENSING}
    counts = sorted({worlds for _, worlds in steps})
    header = ("N", *(f"{worlds:,}" for worlds in counts), "a step, µs", "sensing, µs", "compiling, s")
    cells = []
    for robots in sorted(looks):
        mine = {worlds: row for (size, worlds), row in steps.items() if size == robots}
        speeds = [f"{mine[worlds]['per_second']:,.0f}" if worlds in mine else "" for worlds in counts]
        last, look = mine[max(mine)], looks[robots]
        times = [f"{1e6 / row['per_second']:,.2f}" for row in (last, look)]
        cells.append((f"{robots:,}", *speeds, *times, f"{last['compile_seconds']:.1f}"))
    note = "World steps a second by the number of worlds side by side; times and compiling are of the most worlds.\n\n"
    return note + as_markdown(header, cells)


def _fits(rows: Rows) -> str:
    texts = [f"{row['name']}, N = {row['low']:,} to {row['high']:,}: {row['exponent']:.2f}" for row in rows]
    return "Exponents of the cost of a step in N: " + "; ".join(texts) + ".\n" if texts else ""


def _pieces(cases: Rows, updates: int) -> str:
    """Milliseconds of each part of an update and its share of the whole, policy by policy."""
    kinds = [row["name"].split()[0] for row in cases if row["part"] == TRAINING]
    wholes = {row["name"].split()[0]: row["seconds"] / updates for row in cases if row["part"] == TRAINING}
    times = {row["name"]: row["seconds"] for row in cases if row["part"] == pieces.PART}

    def cell(kind: str, seconds: float | None) -> str:
        return "" if seconds is None else f"{1e3 * seconds:,.1f} ({seconds / wholes[kind]:.0%})"

    cells = []
    for piece in pieces.PIECES:
        name = f"of which {piece.split(',')[0]}" if piece == pieces.SIGNALS else piece
        cells.append((name, *(cell(kind, times.get(f"{kind}: {piece}")) for kind in kinds)))
    explained = {kind: _explained(kind, times) for kind in kinds}
    cells.append(("everything else", *(cell(kind, wholes[kind] - explained[kind]) for kind in kinds)))
    cells.append(("the whole update", *(cell(kind, wholes[kind]) for kind in kinds)))
    note = (
        "Milliseconds; each part is a program of its own, on what it works on in training. Everything else "
        "(advantages, shuffling, Adam, metrics) is what the whole takes longer than its parts, negative where it "
        "shares their work.\n\n"
    )
    return note + as_markdown(("part", *kinds), cells)


def _explained(kind: str, times: Mapping[str, float]) -> float:
    parts = (times.get(f"{kind}: {piece}", 0.0) for piece in pieces.PIECES if piece != pieces.SIGNALS)
    return sum(parts)


def _ceilings(cases: Rows) -> str:
    found = [row for row in cases if row["part"] == ceilings.PART]
    units = {"operations": "G operations/s", "bytes": "GB/s"}
    cells = [(row["name"], f"{row['per_second'] / 1e9:,.1f} {units[row['unit']]}") for row in found]
    return as_markdown(("kind of work, alone", "at best"), cells)


def _floors(rows: Rows) -> str:
    header = ("what", "in products", "plain", "roots", "functions", "bytes", "floor", "measured", "measured / floor")
    cells = []
    for row in rows:
        amounts = [f"{row['counts'][name]:,.4g}" for name in ("products", "plain", "roots", "functions", "bytes")]
        times = [_duration(row[name]) for name in ("floor_seconds", "measured_seconds")]
        cells.append((row["name"], *amounts, f"{times[0]} ({row['bound']})", times[1], f"{row['ratio']:.1f}"))
    return as_markdown(header, cells)


def _memory(rows: Rows) -> str:
    def size(row: Mapping[str, Any]) -> str:
        return "does not fit" if row["peak_bytes"] is None else f"{row['peak_bytes'] / 2**20:,.0f} MiB"

    cells = [(row["name"], f"{row['robots']:,}", f"{row['worlds']:,}", size(row)) for row in rows]
    return as_markdown(("what", "N", "worlds", "peak"), cells)


def _duration(seconds: float) -> str:
    for factor, unit in ((1, "s"), (1e3, "ms"), (1e6, "µs")):
        if seconds * factor >= 1:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def _number(value: float) -> str:
    return f"{value:,.0f}" if value >= 1000 else f"{value:.3g}"


def write(path: Path, text: str) -> None:
    """Replaces the part of a page that stands between the two marks; a page without them gets them at its end."""
    page = path.read_text(encoding="utf-8") if path.exists() else "# Benchmarks\n"
    if BEGIN not in page or END not in page:
        page = f"{page.rstrip()}\n\n{BEGIN}\n{END}\n"
    before, after = page.split(BEGIN, 1)[0], page.split(END, 1)[1]
    path.write_text(f"{before}{BEGIN}\n{text}{END}{after}", encoding="utf-8")
