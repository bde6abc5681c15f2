"""Compares the package's weights with the baselines, 1,000 starts a cell: `make compare` (an hour or two on two cores).

python -m benchmarks.compare [--out docs/comparison] [--into docs/results.md]

Cells that the folder holds are not run again: delete comparison.json after new weights.
"""

from __future__ import annotations

import argparse

from murmurate.cli.main import main as murmurate

ALL, SMALL = ",".join(map(str, range(3, 17))), ",".join(map(str, range(3, 13)))
FAMILIES = "polygon,line,grid,rings"
PARTS = (
    ("--methods", "learned", "--robots", ALL),
    ("--methods", "learned", "--robots", ALL, "--sensing", "global"),
    ("--methods", "learned", "--robots", SMALL, "--schedulers", "ssync,async-nonrigid"),
    # Larger than any that the weights were trained in.
    ("--methods", "learned", "--robots", "24,32", "--sensing", "global,visible"),
    ("--methods", "learned", "--robots", "64", "--sensing", "global,visible", "--episodes", "100"),
    ("--methods", "learned", "--robots", "4,8,16", "--starts", FAMILIES),
    # What breaks symmetry: handedness, noise, or the scheduler.
    ("--methods", "learned", "--robots", "8", "--starts", FAMILIES, "--sensing", "chiral,noisy"),
    ("--methods", "learned", "--robots", "8", "--starts", FAMILIES, "--sensing", "chiral", "--schedulers", "ssync"),
    ("--robots", "4,8,12,16"),
    ("--methods", "circle,two-color,centroid", "--robots", "4,8,12,16", "--sensing", "global"),
    ("--methods", "gradient", "--robots", "4,8,12", "--sensing", "global"),
    ("--methods", "circle,two-color", "--robots", "24", "--episodes", "200"),
    # The best of the baselines under the other schedulers.
    ("--methods", "circle,two-color", "--robots", "4,8", "--schedulers", "ssync,async-nonrigid"),
    ("--methods", "circle", "--robots", "12", "--schedulers", "ssync,async-nonrigid"),
    ("--methods", "centroid,gradient", "--robots", "4", "--schedulers", "ssync"),
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
