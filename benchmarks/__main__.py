"""Times the world and both policies' training beside JaxMARL, and writes the table."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from benchmarks import report
from benchmarks.cases import Size, all_cases
from benchmarks.timing import measure

QUICK = Size(worlds=(8,), steps=4, training={"worlds": 8, "steps": 4, "minibatches": 2, "epochs": 1})


def main(arguments: list[str] | None = None) -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--out", type=Path, help="Markdown page to put the table into (default: print it only)")
    parser.add_argument("--json", type=Path, help="file for the same figures as JSON")
    parser.add_argument("--repeats", type=int, default=9, help="timed runs of each case, at least 2 (default: 9)")
    parser.add_argument("--quick", action="store_true", help="tiny sizes: says that it works, not how fast it is")
    options = parser.parse_args(arguments)
    if options.repeats < 2:
        parser.error("--repeats must be at least 2")

    size = QUICK if options.quick else Size()
    timings = measure(all_cases(size), options.repeats, tell=lambda line: print(line, file=sys.stderr, flush=True))
    rows, about = report.records(timings), report.machine()
    text = report.table(rows, about, options.repeats)
    print(text, end="")
    if options.out:
        report.write(options.out, text)
    if options.json:
        options.json.write_text(json.dumps({"machine": about, "cases": rows}, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
