"""Compares the package's weights with the baselines, 1,000 starts a cell: `make compare` (an hour or two on two cores).

python -m benchmarks.compare [--out docs/comparison] [--into docs/results.md]

Cells that the folder holds are not run again: delete comparison.json after new weights.
"""

from __future__ import annotations

import argparse

from murmurate.cli.main import main as murmurate

ALL = ",".join(map(str, range(3, 17)))
PARTS = (
    ("--methods", "learned", "--robots", ALL),
    ("--methods", "learned", "--robots", "4,8,12", "--schedulers", "ssync,async-nonrigid"),
    ("--methods", "learned", "--robots", "4,8,12,16", "--sensing", "global"),
    ("--methods", "learned", "--robots", "4,8,16", "--starts", "polygon,line,grid,rings"),
    ("--robots", "4,8,12,16"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="docs/comparison", help="where the cells are kept")
    parser.add_argument("--into", default="docs/results.md", help="the page that shows the table")
    options = parser.parse_args()
    for place, part in enumerate(PARTS):
        last = place == len(PARTS) - 1
        status = murmurate(["compare", *part, "--out", options.out, *(["--into", options.into] if last else [])])
        if status:
            raise SystemExit(status)


if __name__ == "__main__":
    main()
