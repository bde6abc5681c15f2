"""Trains the problems that come with the package and measures them in swarms of all their sizes: `make problems`.

python -m benchmarks.problems [--runs runs] [--docs docs] [--seeds 0 1] [--problems circle] [--only-finished]

Writes the tables of docs/problems.md and docs/figures/problems.png. Finished runs are reused.
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np

import murmurate
from murmurate import plots
from murmurate.discovery import bound_steps, build_cascade
from murmurate.policies import LocalPolicy
from murmurate.policies.baselines import CentralCircle
from murmurate.runs import files, table
from murmurate.runs.evaluate import EPISODES
from murmurate.runs.problems import PROBLEMS
from murmurate.world import Configuration

BEGIN, END = "<!-- measured problems -->", "<!-- end of measured problems -->"
SIZES = range(4, 11)
SETS, SET_SIZES, SET_STARTS = ("cluster", "corner", "wall", "walls", "tight-grid"), (5, 8), 60
"""Sets of hard starts, of which swarms, and how many of each."""
KEY = 7
"""Seed of starts; training has other starts."""
RINGS = ("circle", "convex", "visibility")
"""Problems that a ring solves, which the baseline `circle-central` forms, and the package's weights with own eyes."""


def of_rule(run: murmurate.Run) -> murmurate.Run:
    """Returns a run in which a hand-written rule, in place of the policy, sends robots to places on a ring."""
    rest = replace(run.experiment.rest, dead_zone=CentralCircle.dead_zone, damping=CentralCircle.damping)
    base = replace(run.experiment.base, learner="ppo", refine=False)
    experiment = replace(run.experiment, policy=LocalPolicy(), sizes=(), rest=rest, base=base)
    rule = CentralCircle(experiment.world, experiment.landmark)
    return replace(run, experiment=experiment, cascade=build_cascade(experiment, [rule]))


def of_own_eyes(run: murmurate.Run) -> murmurate.Run:
    """Returns a run in which the package's weights act on what each robot sees, in place of the policy."""
    weights = murmurate.pretrained("C2", "visible")
    seeing = weights.experiment
    parts = {name: getattr(seeing, name) for name in ("policy", "sensing", "rest", "shield")}
    base = replace(run.experiment.base, learner="ppo", refine=False)
    experiment = replace(run.experiment, sizes=(), base=base, **parts)
    return replace(run, experiment=experiment, cascade=build_cascade(experiment, weights.cascade.policies))


def sizes_of(run: murmurate.Run) -> tuple[int, ...]:
    """Returns the sizes of swarms that a run was trained with."""
    return run.experiment.sizes or (run.experiment.world.robots,)


def measure(run: murmurate.Run) -> tuple[str, dict[str, str]]:
    """Executes a run from 200 random starts.

    Returns:
        The cell of the table, and the means of the signals that have a threshold, over all episodes.
    """
    experiment = run.experiment
    trajectories = run.rollout(EPISODES, key=KEY)
    validity = murmurate.check_validity(trajectories, experiment.world, experiment.thresholds)
    pairs = zip(trajectories.positions[:, 0], trajectories.final, strict=True)
    bound = np.mean([bound_steps(start, final, experiment.world.max_speed) for start, final in pairs])
    failed = int((~(validity.contact_free & validity.inside)).sum())
    final = Configuration(np.moveaxis(trajectories.final.astype(float), 0, -1), experiment.world)
    thresholds = {name: signal for name, (signal, least) in experiment.thresholds.items() if least}
    signals = {name: f"{float(np.mean(signal.value(final))):.3f}" for name, signal in thresholds.items()}
    return f"{int(validity.valid.sum())} ({failed}) {trajectories.lengths.mean():.0f} / {bound:.0f}", signals


def measure_set(run: murmurate.Run, name: str) -> str:
    """Executes a run from the first starts of a named set; returns the cell of the table."""
    starts = murmurate.start_set(name, robots=run.experiment.world.robots, count=SET_STARTS)
    trajectories = run.rollout(starts, key=KEY)
    validity = murmurate.check_validity(trajectories, run.experiment.world, run.experiment.thresholds)
    failed = int((~(validity.contact_free & validity.inside)).sum())
    return f"{int(validity.valid.sum())} ({failed})"


def page(runs: dict[tuple[str, int], murmurate.Run]) -> str:
    """Returns the tables of finished runs, by problem and seed."""
    rows, exact, hard = [], [], []
    for (name, number), run in runs.items():
        seed, measured = str(number), {robots: measure(run.of_size(robots)) for robots in sizes_of(run)}
        cells = [measured[robots][0] if robots in measured else "" for robots in SIZES]
        rows.append((name, seed, *cells, f"{run.manifest['train_seconds']:.0f} s"))
        print(*rows[-1], flush=True)
        for signal, least in run.experiment.valid.items():
            if least:
                values = [measured[robots][1][signal] if robots in measured else "" for robots in SIZES]
                exact.append((name, seed, signal, f"{least:g}", *values))
        for robots in SET_SIZES:
            if robots in measured:
                of_size = run.of_size(robots)
                hard.append((name, seed, str(robots), *(measure_set(of_size, starts) for starts in SETS)))
        if name in RINGS and (name, number + 1) not in runs:
            for other, change in (("rule", of_rule), ("own eyes", of_own_eyes)):
                changed = {robots: change(run.of_size(robots)) for robots in SIZES}
                rows.append((name, other, *(measure(each)[0] for each in changed.values()), "none"))
                print(*rows[-1], flush=True)
                hard += [
                    (name, other, str(robots), *(measure_set(changed[robots], starts) for starts in SETS))
                    for robots in SET_SIZES
                ]
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
        folder = options.runs / f"{name}-formation-seed{seed}"
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
