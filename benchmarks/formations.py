"""Measures how policies that remember formations form other patterns than the best one: `make formations`.

python -m benchmarks.formations [--runs runs] [--docs docs] [--experiments A C] [--only-finished]

Writes the tables and the figure of docs/formations.md. Trains what is missing; finished runs are reused.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import murmurate
from benchmarks.seeds import CLOSE, anneal, optimum_gap
from murmurate.analysis import Catalogue, unmatched
from murmurate.analysis.measures import nearest_distances
from murmurate.cli.catalogue import MAP_PLATE, PLATE, show
from murmurate.discovery import bound_steps
from murmurate.runs import files, formations, table
from murmurate.runs.paper import EXPERIMENTS
from murmurate.runs.pretrained import SHARED
from murmurate.world import Start

BEGIN, END = "<!-- measured formations -->", "<!-- end of measured formations -->"
KEY = 7
"""Seed of starts; training has other starts."""
PATTERNS, PATTERN_STARTS = 20, 200
"""How many of the remembered patterns are formed, from how many starts each."""
MORE, MORE_OF = 1024, ("E", "F")
"""How many formations are searched in further runs, and of which experiments."""
TARGET_COLUMNS = ("formed", "contact or exit", "steps / bound")
TARGETS, TARGET_STARTS, TARGET_SIZES = 100, 5, (4, 8, 12, 16)
"""How many random formations the package's weights form, from how many starts each, in swarms of which sizes."""


def pattern_row(name: str, run: murmurate.Run) -> tuple[str, ...]:
    """Counts the patterns that a run remembers beside those that annealing finds; swarms form the best ones."""
    found, annealed = run.remembered(), Catalogue.from_findings(anneal(name))
    missed = unmatched(annealed, [finding.positions for finding in found.findings])
    new = unmatched(found, [finding.positions for finding in annealed.findings])
    formed = formations.form_each(run, found.classes[:PATTERNS], PATTERN_STARTS, KEY)
    episodes = sum(each.episodes for each in formed)
    gaps = np.array([optimum_gap(pattern.representative) for pattern in found.classes])
    return (
        *(name, str(run.experiment.world.robots), str(run.cascade.policies[-1].goals().shape[-1])),
        *(str(len(found.findings)), str(len(found.classes))),
        f"{(gaps <= CLOSE).sum()}, {100 * max(gaps.max(), 0):.2f}%",
        *(str(len(annealed.classes)), str(len(annealed.classes) - len(missed)), str(len(new))),
        *(str(len(formed)), f"{sum(each.formed for each in formed)} of {episodes}"),
        *(f"{sum(each.valid for each in formed)} of {episodes}", str(sum(each.failed for each in formed))),
    )


def random_targets(run: murmurate.Run) -> list[np.ndarray]:
    """Draws random formations that fit the world, however turned: the nearest two points are a safe distance apart."""
    world, random, targets = run.experiment.world, np.random.default_rng(KEY), []
    while len(targets) < TARGETS:
        points = random.uniform(-1, 1, (world.robots, 2))
        points -= points.mean(axis=0)
        points *= 1.001 * world.safe_distance / nearest_distances(points).min()
        if np.linalg.norm(points, axis=1).max() + world.radius <= world.limits.min():
            targets.append(points)
    return targets


def target_row(run: murmurate.Run) -> tuple[str, ...]:
    """Lets swarms form random formations that training has not seen, from fresh starts and from crowds in a corner."""
    cells = []
    for start in (run.experiment.start, Start.registered()["corner"]()):
        other = run.under(replace(run.experiment, start=start))
        formed = failed = 0
        ratios = []
        for number, target in enumerate(random_targets(run)):
            told = other.forming(target)
            trajectories, world = told.rollout(TARGET_STARTS, key=number), run.experiment.world
            validity = murmurate.check_validity(trajectories, world)
            formed += int(formations.reached(told, trajectories).sum())
            failed += int((~(validity.contact_free & validity.inside)).sum())
            pairs = zip(trajectories.positions[:, 0], trajectories.final, strict=True)
            bound = np.mean([bound_steps(begin, final, world.max_speed) for begin, final in pairs])
            ratios.append(trajectories.lengths.mean() / bound)
        cells += [f"{formed} of {TARGETS * TARGET_STARTS}", str(failed), f"{np.mean(ratios):.2f}"]
    return (str(run.experiment.world.robots), *cells)


def page(runs: dict[str, murmurate.Run], more: dict[str, murmurate.Run], sizes: list[murmurate.Run]) -> str:
    """Returns the tables: of finished runs, by experiment and with more formations, and of weights in several sizes."""
    patterns = []
    for name, run in (*runs.items(), *more.items()):
        patterns.append(pattern_row(name, run))
        print(*patterns[-1], flush=True)
    targets = [target_row(run) for run in sizes]
    print(targets, flush=True)
    pattern_header = (
        *(
            "",
            "robots",
            "searched",
            "valid",
            "distinct",
            "within 1%, greatest gap",
            "annealed",
            "of these found",
            "never annealed",
        ),
        *("told", "formed", "valid", "contact or exit"),
    )
    target_header = ("robots", *(f"{word}{start}" for start in ("", ", corner") for word in TARGET_COLUMNS))
    return "\n".join(
        (
            "Patterns that the runs of seed 0 remember, beside those that annealing finds, and\n"
            f"the best of them formed from {PATTERN_STARTS} starts each:\n",
            table.as_markdown(pattern_header, patterns),
            f'{TARGETS} random formations of each size, told to one policy, `murmurate.pretrained("C2", "shared")`,\n'
            f"from {TARGET_STARTS} random starts each, and from as many crowds in a corner:\n",
            table.as_markdown(target_header, targets),
        )
    )


def main() -> None:
    """Trains what is missing and writes the tables and the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, default=Path("runs"))
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    parser.add_argument("--experiments", nargs="+", default=list(EXPERIMENTS), choices=list(EXPERIMENTS))
    parser.add_argument("--only-finished", action="store_true", help="train nothing: write what the finished runs show")
    options = parser.parse_args()

    def run(name: str, experiment: str, **fields: object) -> murmurate.Run | None:
        folder = options.runs / name
        if options.only_finished:
            return murmurate.load(folder) if (folder / "manifest.json").exists() else None
        return murmurate.discover(experiment, out=folder, resume=folder.exists(), **fields)

    policy = {"use": "formation", "formations": MORE}
    runs = {name: run(f"{name}-formation-seed0", name) for name in options.experiments}
    more = {name: run(f"{name}-formation-{MORE}-seed0", name, policy=policy) for name in MORE_OF if name in runs}
    weights = murmurate.pretrained("C2", SHARED)
    runs, more = ({name: run for name, run in some.items() if run is not None} for some in (runs, more))
    if not runs:
        raise SystemExit(f"no finished run in {options.runs}")
    if "E" in runs:
        with tempfile.TemporaryDirectory() as folder:
            show(runs["E"].remembered(), Path(folder))
            for plate, name in ((PLATE, "remembered.png"), (MAP_PLATE, "remembered-map.png")):
                shutil.copy(Path(folder) / plate, options.docs / "figures" / name)
    document = options.docs / "formations.md"
    tables = page(runs, more, [weights.of_size(robots) for robots in TARGET_SIZES])
    before, _, rest = document.read_text(encoding="utf-8").partition(BEGIN)
    files.write_text(document, f"{before}{BEGIN}\n{tables}{END}{rest.partition(END)[2]}")


if __name__ == "__main__":
    main()
