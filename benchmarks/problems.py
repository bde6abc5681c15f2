"""Trains the problems that come with the package and measures them in swarms of 4 to 10: `make problems`.

python -m benchmarks.problems [--runs runs] [--docs docs] [--seeds 0 1] [--problems circle] [--only-finished]

Writes the table of docs/problems.md and docs/figures/problems.png. Finished runs are reused.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import numpy as np

import murmurate
from murmurate import plots
from murmurate.discovery import bound_steps
from murmurate.runs import files, table
from murmurate.runs.evaluate import EPISODES
from murmurate.runs.problems import PROBLEMS
from murmurate.world import Configuration

BEGIN, END = "<!-- measured problems -->", "<!-- end of measured problems -->"
SIZES = range(4, 11)
SETS, SET_SIZES, SET_STARTS = ("cluster", "corner", "wall", "walls", "tight-grid"), (5, 8), 60
"""Sets of hard starts, of which swarms, and how many of each."""
KEY = 7
"""Seed of starts and frames; training has other starts."""


def measure(run: murmurate.Run, robots: int) -> tuple[str, dict[str, float]]:
    """Executes a policy from 200 random starts in a swarm of another size.

    Returns:
        The cell of the table, and the means of the signals that have a threshold, over all episodes.
    """
    run = run.of_size(robots)
    experiment = run.experiment
    trajectories = run.rollout(EPISODES, key=KEY)
    validity = murmurate.check_validity(trajectories, experiment.world, experiment.thresholds)
    pairs = zip(trajectories.positions[:, 0], trajectories.final, strict=True)
    bound = np.mean([bound_steps(start, final, experiment.world.max_speed) for start, final in pairs])
    failed = int((~(validity.contact_free & validity.inside)).sum())
    final = Configuration(np.moveaxis(trajectories.final.astype(float), 0, -1), experiment.world)
    signals = {
        name: float(np.mean(signal.value(final))) for name, (signal, least) in experiment.thresholds.items() if least
    }
    cell = f"{int(validity.valid.sum())} ({failed}) {trajectories.lengths.mean():.0f} / {bound:.0f}"
    return cell, signals


def measure_set(run: murmurate.Run, name: str, robots: int) -> str:
    """Executes a policy from the first starts of a named set; returns the cell of the table."""
    run = run.of_size(robots)
    trajectories = run.rollout(murmurate.start_set(name, robots=robots, count=SET_STARTS), key=KEY)
    validity = murmurate.check_validity(trajectories, run.experiment.world, run.experiment.thresholds)
    failed = int((~(validity.contact_free & validity.inside)).sum())
    return f"{int(validity.valid.sum())} ({failed})"


def page(runs: dict[tuple[str, int], murmurate.Run]) -> str:
    """Returns the tables of finished runs, by problem and seed."""
    rows, exact, hard = [], [], []
    for (name, number), run in runs.items():
        seed = str(number)
        cells, signals = zip(*(measure(run, robots) for robots in SIZES), strict=True)
        rows.append((name, seed, *cells, f"{run.manifest['train_seconds']:.0f} s"))
        for signal, least in run.experiment.valid.items():
            if least:
                exact.append((name, seed, signal, f"{least:g}", *(f"{values[signal]:.3f}" for values in signals)))
        hard += [
            (name, seed, str(robots), *(measure_set(run, starts, robots) for starts in SETS)) for robots in SET_SIZES
        ]
        print(*rows[-1], flush=True)
    tables = [
        table.as_markdown(("", "seed", *map(str, SIZES), "training"), rows),
        table.as_markdown(("", "seed", "signal", "at least", *map(str, SIZES)), exact),
        f"From {SET_STARTS} of each set of [hard starts](world.md#sets-of-starts), valid and (contact or exit):\n",
        table.as_markdown(("", "seed", "robots", *SETS), hard),
    ]
    return "\n".join(tables)


def main() -> None:
    """Trains what is missing and writes the table and the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, default=Path("runs"))
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--problems", nargs="+", default=list(PROBLEMS), choices=list(PROBLEMS))
    parser.add_argument("--only-finished", action="store_true", help="train nothing: write what the finished runs show")
    options = parser.parse_args()
    runs = {}
    for name, seed in itertools.product(options.problems, options.seeds):
        folder = options.runs / f"{name}-equivariant-seed{seed}"
        if options.only_finished:
            if (folder / "manifest.json").exists():
                runs[name, seed] = murmurate.load(folder)
        else:
            runs[name, seed] = murmurate.discover(name, out=folder, resume=folder.exists(), seed=seed)
    first = {name: run for (name, seed), run in runs.items() if seed == options.seeds[0]}
    recordings = [plots.Recording.open(run.folder) for run in first.values()]
    figure = plots.patterns_figure(recordings, list(first))
    plots.save(figure, options.docs / "figures" / "problems.png", dpi=110)
    document = options.docs / "problems.md"
    tables = page(runs)
    before, _, rest = document.read_text(encoding="utf-8").partition(BEGIN)
    files.write_text(document, f"{before}{BEGIN}\n{tables}{END}{rest.partition(END)[2]}")


if __name__ == "__main__":
    main()
