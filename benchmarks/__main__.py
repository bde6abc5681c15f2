"""Times the world and the training, the machine's ceilings and other projects; writes tables, JSON and a figure.

python -m benchmarks --out docs/benchmarks.md --json docs/benchmarks.json --figure docs/figures/cost.png (`make
benchmark`: eight minutes on two quiet cores). With --redraw, page and figure are made from the JSON instead.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import figure, report
from benchmarks.cases import SIZED, STEP, TRAINING, Size, all_cases, batches, costs
from benchmarks.machine import Extent, machine, memory_bytes
from benchmarks.measure import MEASURES_MEMORY, Case, measure, peak_here, peak_memory
from murmurate import plots

QUICK = Size(
    robots=(4, 10),
    worlds=(1, 8),
    run=1 << 12,
    steps=(2, 4),
    side_by_side=(8,),
    training={"worlds": 8, "steps": 4, "minibatches": 2, "epochs": 1},
    updates=1,
    extent=Extent(side=64, copied=1 << 12, chained=1 << 10, links=128),
)
WIDE = Size(
    worlds=(1, 16, 256, 4096, 65536),
    pairs=1 << 24,
    run=1 << 27,
    side_by_side=(256, 1024, 16384),
    extent=Extent(side=8192, copied=1 << 27, chained=1 << 22, links=1 << 11),
)
"""Enough worlds side by side to keep an accelerator busy."""

PAIR_BYTES = 200
"""Bytes that a world step takes at its peak for each pair of robots: about so many arrays of numbers at a time."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command line."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.repeats < 2:
        parser.error("--repeats must be at least 2")
    size = _size(parser, options)
    if options.peak:
        chosen = [case for case in all_cases(size) if case.key == options.peak]
        print(json.dumps({"peak_bytes": peak_here(chosen[0])}))
        return
    if options.redraw:
        if options.json is None or not options.json.is_file():
            parser.error("--redraw needs --json FILE, a file that was written before")
        data = json.loads(options.json.read_text(encoding="utf-8"))
    else:
        data = run(size, options.repeats, _remade(options))
        if options.json:
            options.json.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    _write(data, options)


def run(size: Size, repeats: int, remade: Sequence[str]) -> dict[str, Any]:
    """Measures everything.

    Args:
        size: The amount of work.
        repeats: Timed runs of each case.
        remade: Arguments with which another process makes the same cases.
    """
    start = time.perf_counter()
    cases = all_cases(size)
    timings, left_out = measure(cases, repeats, _tell)
    rows = report.records(timings)
    _tell("counting operations")
    results = {
        "cases": rows,
        "costs": costs(size),
        "fits": report.fits(rows),
        "left_out": [case.key for case in left_out],
        "memory": [{**_named(case), "peak_bytes": _peak(case, remade)} for case in _weighed(cases, size)],
    }
    head = {"machine": machine(), "repeats": repeats, "updates": size.updates}
    return {**head, "seconds": round(time.perf_counter() - start), **results}


def _tell(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _weighed(cases: Sequence[Case], size: Size) -> list[Case]:
    """Picks the cases whose memory is measured: each swarm in its most worlds, and every training."""
    if not MEASURES_MEMORY:
        _tell("peak memory is not measured on this system")
        return []
    most = {robots: batches(robots, size)[-1] for robots in size.robots}
    steps = [case for case in cases if (case.part, case.name) == (SIZED, STEP) and case.worlds == most[case.robots]]
    return steps + [case for case in cases if case.part == TRAINING]


def _peak(case: Case, remade: Sequence[str]) -> int | None:
    _tell(f"peak memory of {case.key}")
    return peak_memory(case, remade)


def _named(case: Case) -> dict[str, Any]:
    return {"part": case.part, "name": case.name, "robots": case.robots, "worlds": case.worlds}


def _size(parser: argparse.ArgumentParser, options: argparse.Namespace) -> Size:
    size = QUICK if options.quick else WIDE if options.wide else Size()
    if options.robots is None:
        return size
    robots = tuple(sorted(set(options.robots)))
    if robots[0] < 2:
        parser.error(f"--robots: {robots[0]}: a swarm has at least 2")
    room = memory_bytes()
    if room and PAIR_BYTES * robots[-1] ** 2 > room:
        most = int((room / PAIR_BYTES) ** 0.5)
        parser.error(f"--robots: {robots[-1]}: at most {most} fit into the {room / 2**30:.0f} GiB of memory here")
    return Size(**{**vars(size), "robots": robots})


def _remade(options: argparse.Namespace) -> list[str]:
    robots = ["--robots", *map(str, options.robots)] if options.robots else []
    return robots + [f"--{name}" for name in ("quick", "wide") if getattr(options, name)]


def _write(data: dict[str, Any], options: argparse.Namespace) -> None:
    picture = None
    if options.figure:
        plots.save(figure.figure(data), options.figure, dpi=150)
        picture = os.path.relpath(options.figure, options.out.parent) if options.out else None
    text = report.markdown(data, picture)
    print(text, end="")
    if options.out:
        report.write(options.out, text)


def _parser() -> argparse.ArgumentParser:
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__, formatter_class=form)
    parser.add_argument("--out", type=Path, help="Markdown page to put the tables into (default: print them only)")
    parser.add_argument("--json", type=Path, help="file for the same figures as JSON")
    parser.add_argument("--figure", type=Path, help="PNG to draw cost and speed into")
    parser.add_argument("--repeats", type=int, default=9, help="timed runs of each case, at least 2 (default: 9)")
    parser.add_argument("--robots", type=int, nargs="+", metavar="N", help="swarm sizes instead of the usual ones")
    parser.add_argument("--quick", action="store_true", help="tiny sizes: says that it works, not how fast it is")
    parser.add_argument("--wide", action="store_true", help="as many worlds side by side as suit an accelerator")
    parser.add_argument("--redraw", action="store_true", help="measure nothing: page and figure from the JSON")
    parser.add_argument("--peak", metavar="KEY", help=argparse.SUPPRESS)
    return parser


if __name__ == "__main__":
    main()
