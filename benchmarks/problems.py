"""Trains the problems that come with the package and measures them in swarms of 4 to 10: `make problems`.

python -m benchmarks.problems [--runs runs] [--docs docs] [--seed 0] [--problems circle line] [--only-finished]

Writes the table of docs/problems.md and docs/figures/problems.png. Finished runs are reused.
"""

from __future__ import annotations

import argparse
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


def page(runs: dict[str, murmurate.Run]) -> str:
    """Returns the tables of finished runs."""
    rows, exact = [], []
    for name, run in runs.items():
        cells, signals = zip(*(measure(run, robots) for robots in SIZES), strict=True)
        rows.append((name, *cells, f"{run.manifest['train_seconds']:.0f} s"))
        for signal, least in run.experiment.valid.items():
            if least:
                exact.append((name, signal, f"{least:g}", *(f"{values[signal]:.3f}" for values in signals)))
        print(*rows[-1], flush=True)
    first = table.as_markdown(("", *map(str, SIZES), "training"), rows)
    return f"{first}\n{table.as_markdown(('', 'signal', 'at least', *map(str, SIZES)), exact)}"


def main() -> None:
    """Trains what is missing and writes the table and the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, default=Path("runs"))
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--problems", nargs="+", default=list(PROBLEMS), choices=list(PROBLEMS))
    parser.add_argument("--only-finished", action="store_true", help="train nothing: write what the finished runs show")
    options = parser.parse_args()
    runs = {}
    for name in options.problems:
        folder = options.runs / f"{name}-equivariant-seed{options.seed}"
        if options.only_finished:
            if (folder / "manifest.json").exists():
                runs[name] = murmurate.load(folder)
        else:
            runs[name] = murmurate.discover(name, out=folder, resume=folder.exists(), seed=options.seed)
    recordings = [plots.Recording.open(run.folder) for run in runs.values()]
    figure = plots.patterns_figure(recordings, list(runs))
    plots.save(figure, options.docs / "figures" / "problems.png", dpi=110)
    document = options.docs / "problems.md"
    before, _, rest = document.read_text(encoding="utf-8").partition(BEGIN)
    files.write_text(document, f"{before}{BEGIN}\n{page(runs)}{END}{rest.partition(END)[2]}")


if __name__ == "__main__":
    main()
