"""Turns timings into numbers, and the numbers into Markdown, between the marks of a page."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import peers, pieces
from benchmarks.cases import RESTARTS, SENSING, SIZED, STEP, TRAINING
from benchmarks.machine import CEILING
from benchmarks.measure import Timing
from murmurate.analysis.measures import fit_line
from murmurate.runs.table import as_markdown

__all__ = ["RANGES", "fits", "markdown", "records", "step_seconds", "write"]

RANGES = ((4, 32), (128, 1024))
"""Ranges of swarm sizes over which exponents are fitted."""

BEGIN, END = "<!-- begin: make benchmark -->", "<!-- end: make benchmark -->"
Rows = Sequence[Mapping[str, Any]]


def records(timings: Sequence[Timing]) -> list[dict[str, Any]]:
    """Returns the numbers of every case; `ratio` is to JaxMARL in as many worlds, None without it.

    A ceiling is the best of its runs; all other numbers are medians.
    """
    base = {timing.case.worlds: timing.rate for timing in timings if timing.case.name == peers.JAXMARL}
    rows = []
    for timing in timings:
        case = timing.case
        seconds = min(timing.runs) if case.part == CEILING else timing.seconds
        comparable = case.unit == "steps" and case.robots == peers.AGENTS and case.worlds in base
        rows.append(
            {
                "part": case.part,
                "name": case.name,
                "robots": case.robots,
                "worlds": case.worlds,
                "unit": case.unit,
                "work": case.work,
                "seconds": seconds,
                "per_second": case.work / seconds,
                "spread": round(timing.spread, 3),
                "ratio": round(timing.rate / base[case.worlds], 3) if comparable else None,
                "compile_seconds": round(timing.compile, 2),
            }
        )
    return rows


def step_seconds(cases: Rows, name: str) -> tuple[list[int], list[float]]:
    """Returns swarm sizes, and the seconds of one step of one world in the largest batch timed."""
    largest: dict[int, Mapping[str, Any]] = {}
    for row in _of(cases, SIZED, name):
        if row["worlds"] >= largest.get(row["robots"], row)["worlds"]:
            largest[row["robots"]] = row
    sizes = sorted(largest)
    return sizes, [1 / largest[robots]["per_second"] for robots in sizes]


def fits(cases: Rows) -> list[dict[str, Any]]:
    """Returns the exponent of N in the cost over each range in which at least three sizes were timed.

    It is the slope of the line through the logarithms.
    """
    rows = []
    for name in (STEP, SENSING):
        sizes, seconds = step_seconds(cases, name)
        for low, high in RANGES:
            inside = [index for index, robots in enumerate(sizes) if low <= robots <= high]
            line = fit_line(*([math.log(values[index]) for index in inside] for values in (sizes, seconds)))
            if line is not None:
                ends = {"low": sizes[inside[0]], "high": sizes[inside[-1]]}
                rows.append({"name": name, **ends, "exponent": round(line.slope, 3)})
    return rows


def markdown(data: Mapping[str, Any], picture: str | None = None) -> str:
    """Returns the whole section.

    Args:
        data: The content of the JSON file.
        picture: Path of the figure relative to the page; None to leave it out.
    """
    cases = data["cases"]
    parts = [
        machine_line(data["machine"]),
        f"Medians of {data['repeats']} rounds in which the cases take turns, {data['seconds'] / 60:.0f} minutes in "
        "all; ± is half the interquartile range.",
        *([f"![Cost of a step against the number of robots]({picture})"] if picture else []),
        "### Ten robots\n\n" + speed_table(cases),
        "### Swarms of other sizes\n\n" + _sizes(cases) + "\n" + _fits(data["fits"]),
        "### Where the time of an update goes\n\n" + _pieces(cases, data["updates"]),
        "### Operations, as the compiler counts them\n\n" + _costs(data["costs"], cases, data["updates"]),
        "### The machine's ceilings\n\n" + _ceilings(cases),
        "### Peak memory\n\n" + _memory(data["memory"]),
    ]
    if data["left_out"]:
        parts.append("Left out, because they do not fit in memory: " + "; ".join(data["left_out"]) + ".")
    return "\n".join(_wrapped(line) for line in "\n\n".join(part.strip("\n") for part in parts).splitlines()) + "\n"


def _wrapped(line: str) -> str:
    """Breaks a long line of text as in the rest of the page, but not the row of a table."""
    return line if line.startswith("|") else textwrap.fill(line, 140, break_long_words=False, break_on_hyphens=False)


def machine_line(about: Mapping[str, Any]) -> str:
    """Returns the machine and the versions on one line."""
    versions = ", ".join(f"{name} {version}" for name, version in about["versions"].items())
    device = f"{about['device']}, " if about["device"] else ""
    memory = f"{about['memory_bytes'] / 2**30:.0f} GiB, " if about["memory_bytes"] else ""
    return f"{device}{about['processor']}, {about['cores']} cores, {memory}{about['system']}; {versions}."


def speed_table(cases: Rows) -> str:
    """Returns the speeds of ten robots and of other projects."""
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
    """Returns steps per second by swarm size and batch; and times of a step and of sensing in the largest batch."""
    steps = {(row["robots"], row["worlds"]): row for row in cases if (row["part"], row["name"]) == (SIZED, STEP)}
    sensing = {row["robots"]: row for row in cases if row["name"] == SENSING}
    counts = sorted({worlds for _, worlds in steps})
    header = ("N", *(f"{worlds:,}" for worlds in counts), "a step, µs", "sensing, µs", "compiling, s")
    cells = []
    for robots in sorted(sensing):
        by_worlds = {worlds: row for (size, worlds), row in steps.items() if size == robots}
        speeds = [f"{by_worlds[worlds]['per_second']:,.0f}" if worlds in by_worlds else "" for worlds in counts]
        last = by_worlds[max(by_worlds)]
        times = [f"{1e6 / row['per_second']:,.2f}" for row in (last, sensing[robots])]
        cells.append((f"{robots:,}", *speeds, *times, f"{last['compile_seconds']:.1f}"))
    note = (
        "World steps per second, by the number of parallel worlds; the times and compiling are those of the largest "
        "number.\n\n"
    )
    return note + as_markdown(header, cells)


def _fits(rows: Rows) -> str:
    texts = [f"{row['name']}, N = {row['low']:,} to {row['high']:,}: {row['exponent']:.2f}" for row in rows]
    return "Exponents of the cost of a step in N: " + "; ".join(texts) + ".\n" if texts else ""


def _pieces(cases: Rows, updates: int) -> str:
    """Returns the milliseconds of each part of an update and its fraction of the whole, for every policy."""
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
        "Milliseconds; each part is timed as its own program, on the data of a training. Everything else (advantages, "
        "shuffling, Adam, metrics) is the difference between the whole and its parts; it is negative if the whole "
        "shares work between parts.\n\n"
    )
    return note + as_markdown(("part", *kinds), cells)


def _explained(kind: str, times: Mapping[str, float]) -> float:
    parts = (times.get(f"{kind}: {piece}", 0.0) for piece in pieces.PIECES if piece != pieces.SIGNALS)
    return sum(parts)


def _ceilings(cases: Rows) -> str:
    units = {"operations": "G operations/s", "bytes": "GB/s"}
    cells = [(row["name"], f"{row['per_second'] / 1e9:,.1f} {units[row['unit']]}") for row in _of(cases, CEILING)]
    return as_markdown(("kind of work", "at best"), cells)


def _costs(costs: Rows, cases: Rows, updates: int) -> str:
    header = ("what", "operations", "functions", "bytes", "measured", "G operations/s")
    cells = []
    for row in costs:
        seconds = _measured(row, cases, updates)
        if seconds is None:
            continue
        amounts = [f"{row[name]:,.3g}" for name in ("operations", "functions", "bytes")]
        cells.append((row["name"], *amounts, _duration(seconds), f"{row['operations'] / seconds / 1e9:.1f}"))
    note = (
        "One step of one world, and one update: sensing, world steps, both networks forward and both gradients. "
        "Functions are exponentials, tangents and the like. Bytes are those that the fused parts of the program read "
        "and write, mostly in caches.\n\n"
    )
    return note + as_markdown(header, cells)


def _measured(cost: Mapping[str, Any], cases: Rows, updates: int) -> float | None:
    """Returns the measured seconds of one step of one world, or of one update; None if it was not timed."""
    if cost["part"] == TRAINING:
        rows = [row for row in _of(cases, TRAINING) if row["name"].startswith(cost["kind"])]
        return rows[0]["seconds"] / updates if rows else None
    rows = [row for row in _of(cases, SIZED, STEP, cost["robots"]) if row["worlds"] == cost["worlds"]]
    return 1 / rows[0]["per_second"] if rows else None


def _memory(rows: Rows) -> str:
    def size(row: Mapping[str, Any]) -> str:
        return "does not fit" if row["peak_bytes"] is None else f"{row['peak_bytes'] / 2**20:,.0f} MiB"

    if not rows:
        return "Not measured: this system does not tell how large a process has been."
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
    """Replaces the part of a page between the two marks; a page without them gets them at its end."""
    page = path.read_text(encoding="utf-8") if path.exists() else "# Benchmarks\n"
    if BEGIN not in page or END not in page:
        page = f"{page.rstrip()}\n\n{BEGIN}\n{END}\n"
    before, after = page.split(BEGIN, 1)[0], page.split(END, 1)[1]
    path.write_text(f"{before}{BEGIN}\n{text}{END}{after}", encoding="utf-8")


def _of(cases: Rows, part: str, name: str | None = None, robots: int | None = None) -> list[Mapping[str, Any]]:
    return [
        row for row in cases if row["part"] == part and name in (None, row["name"]) and robots in (None, row["robots"])
    ]
