"""Names the machine and writes the table."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.cases import JAXMARL
from benchmarks.timing import Timing

__all__ = ["machine", "records", "table", "write"]

BEGIN, END = "<!-- begin: make benchmark -->", "<!-- end: make benchmark -->"
PACKAGES = ("murmurate", "jax", "jaxlib", "numpy", "equinox", "jaxmarl")


def machine() -> dict[str, Any]:
    """Returns processor, usable cores, system and versions."""
    return {
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "system": platform.system(),
        "versions": {"Python": platform.python_version(), **{name: _version(name) for name in PACKAGES}},
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def records(timings: Sequence[Timing]) -> list[dict[str, Any]]:
    """Returns the figures of every case; `ratio` is to JaxMARL with as many worlds, None without it."""
    base = {timing.case.worlds: timing.rate for timing in timings if timing.case.name == JAXMARL}
    return [
        {
            "name": timing.case.name,
            "worlds": timing.case.worlds,
            "steps_per_second": round(timing.rate),
            "spread": round(timing.spread, 3),
            "ratio": round(timing.rate / base[timing.case.worlds], 2) if timing.case.worlds in base else None,
            "compile_seconds": round(timing.compile, 1),
        }
        for timing in timings
    ]


def table(rows: Sequence[dict[str, Any]], about: dict[str, Any], repeats: int) -> str:
    """Returns machine and figures in Markdown."""
    versions = ", ".join(f"{name} {version}" for name, version in about["versions"].items())
    lines = [
        f"{about['processor']}, {about['cores']} cores, {about['system']}; {versions}.",
        f"Medians of {repeats} runs, the cases taking turns; ± is half the range of the middle half of the runs.",
        "",
        "| what (N = 10) | worlds | steps/s | ± | ratio to JaxMARL | compiling, s |",
        "| --- | ---: | ---: | ---: | ---: | ---: |",
    ]
    for row in rows:
        ratio = "" if row["ratio"] is None else f"{row['ratio']:.2f}"
        lines.append(
            f"| {row['name']} | {row['worlds']} | {row['steps_per_second']:,} | {row['spread']:.0%} | {ratio} "
            f"| {row['compile_seconds']:.1f} |"
        )
    if all(row["ratio"] is None for row in rows):
        lines += ["", "JaxMARL is not installed (it is the extra `benchmark`), so there is nothing to compare with."]
    return "\n".join(lines) + "\n"


def write(path: Path, text: str) -> None:
    """Replaces the part of a page that stands between the two marks; a page without them gets them at its end."""
    page = path.read_text(encoding="utf-8") if path.exists() else "# Benchmarks\n"
    if BEGIN not in page or END not in page:
        page = f"{page.rstrip()}\n\n{BEGIN}\n{END}\n"
    before, after = page.split(BEGIN, 1)[0], page.split(END, 1)[1]
    path.write_text(f"{before}{BEGIN}\n{text}{END}{after}", encoding="utf-8")
