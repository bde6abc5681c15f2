"""Compares the package's weights with the baselines, 1,000 starts for each condition: `make compare` (hours).

python -m benchmarks.compare [--out docs]

Writes the folder comparison and into results.md (C2), the folder comparison/C1 and into point.md (C1), and the folder
comparison/hard and into hard.md (starts that are hard for a controller; alone with --hard, in twenty minutes).
Conditions that the folders hold are not evaluated again: delete comparison.json after new weights.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from murmurate.cli.main import main as murmurate

ALL, SMALL = ",".join(map(str, range(3, 17))), ",".join(map(str, range(3, 13)))
FAMILIES = "polygon,line,grid,rings"
BASELINES = ("--methods", "circle,two-color,centroid,gradient")
PARTS = (
    ("--methods", "learned", "--robots", ALL, "--sensing", "visible,global"),
    ("--methods", "learned", "--robots", SMALL, "--schedulers", "ssync,adversarial,async-nonrigid"),
    ("--methods", "learned", "--robots", "4,8,16", "--starts", FAMILIES),
    # What breaks symmetry: handedness, noise, or the scheduler.
    ("--methods", "learned", "--robots", "8", "--starts", FAMILIES, "--sensing", "chiral,noisy"),
    ("--methods", "learned", "--robots", "8", "--starts", FAMILIES, "--sensing", "chiral", "--schedulers", "ssync"),
    # Baselines are slow where they fail: every episode takes all its steps.
    (*BASELINES, "--robots", "4,8,12,16", "--sensing", "visible,global", "--episodes", "200"),
    (*BASELINES, "--robots", "4,8,12,16", "--schedulers", "ssync", "--episodes", "200"),
    ("--methods", "random,circle-central", "--robots", "4,8,12,16", "--episodes", "200"),
    ("--methods", "circle", "--robots", "4,8,12", "--schedulers", "async-nonrigid", "--episodes", "200"),
    # One swarm that does not come to rest takes all its steps, 70,000 with 32 robots.
    ("--methods", "learned,circle,two-color", "--robots", "24", "--episodes", "200"),
    ("--methods", "learned", "--robots", "24", "--sensing", "global", "--episodes", "200"),
    ("--methods", "learned", "--robots", "32", "--sensing", "global,visible", "--episodes", "100"),
)
C1 = ("--objective", "C1")
POINT = (
    (*C1, "--methods", "learned", "--robots", ALL, "--sensing", "global,visible"),
    (*C1, "--methods", "learned", "--robots", "24", "--sensing", "global,visible"),
    (*C1, "--methods", "learned", "--robots", "4,8,12", "--schedulers", "ssync,async-nonrigid"),
    (*C1, "--methods", "learned", "--robots", "8", "--starts", FAMILIES),
    (*C1, "--methods", "circle,two-color", "--robots", "4,8,12,16", "--sensing", "global,visible"),
)
HARD_STARTS = ("--starts", "random,cluster,corner,wall,walls,tight-grid", "--episodes", "200")
SAME_EYES = ("--methods", "learned,circle", "--sensing", "visible,global")
HARD = (
    (*SAME_EYES, "--robots", "4,8,12,16", *HARD_STARTS),
    (*SAME_EYES, "--robots", "4,8", "--schedulers", "ssync", *HARD_STARTS),
)


def compare(parts: Sequence[tuple[str, ...]], folder: Path, page: Path) -> None:
    """Runs every part into one folder, and puts the table into a page."""
    for index, part in enumerate(parts):
        last = index == len(parts) - 1
        status = murmurate(["compare", *part, "--out", str(folder), *(["--into", str(page)] if last else [])])
        if status:
            raise SystemExit(status)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs"), help="where the pages and the comparisons are kept")
    parser.add_argument("--hard", action="store_true", help="the starts that are hard for a controller alone")
    options = parser.parse_args()
    docs = options.out
    if not options.hard:
        compare(PARTS, docs / "comparison", docs / "results.md")
        compare(POINT, docs / "comparison" / "C1", docs / "point.md")
    compare(HARD, docs / "comparison" / "hard", docs / "hard.md")


if __name__ == "__main__":
    main()
