"""Regenerates docs/results.md and its pictures: `make results`. Trains what is missing; finished runs are reused.

python -m benchmarks.results [--runs runs] [--out docs] [--seeds 0 1 2 3 4] [--only-finished]
                             [--learners formation central paper]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

import murmurate
from murmurate import plots, prng
from murmurate.discovery import bound_steps, check_validity
from murmurate.runs import comparison_page, table
from murmurate.runs.evaluate import EPISODES
from murmurate.runs.execute import InProcess, run_jobs
from murmurate.runs.grid import Grid
from murmurate.runs.jobs import training_jobs
from murmurate.runs.paper import EXPERIMENTS
from murmurate.runs.presets import DEFAULT_LEARNER, preset
from murmurate.runs.run import Run
from murmurate.world import DistributedStart, PackedStart, ScatteredStart, Start, UniformStart, WorldConfig, draw_starts

LEARNERS = {DEFAULT_LEARNER: 5, "central": 5, "paper": 1}
"""How many of the seeds each learner is trained with at most."""

SLOW = "paper"
"""The learner with the authors' own numbers: trained in experiment C alone."""

HARD_STARTS = ("cluster", "corner", "wall", "walls", "tight-grid", "surrounded", "symmetric")

# Every experiment's cascade is tried from every one of these; each experiment was trained on one of the layouts.
OTHER_STARTS: dict[str, Start] = {
    "random": UniformStart(),
    "scattered": ScatteredStart(),
    "two corners": DistributedStart(),
    "one line": PackedStart(),
    "two lines": PackedStart(lines=2),
    "one line, noise R": PackedStart(noise=1.0),
    **{name: Start.registered()[name]() for name in HARD_STARTS},
}
TITLES = {
    "formation": "The default learner, `formation`",
    "central": "The paper's own kind of policy, `central`",
    "paper": "The authors' own numbers, the learner `paper`",
}

NOISY = "its own, noise 4 R"
"""Column of an experiment's own start with twice the paper's noise."""

COLUMNS = ("experiment", "seed", "valid", "base steps", "auxiliary steps", "total steps", "paper's total", "bound")
COLUMNS += ("total / bound", "gap", "policies", "training")
"""What of `table.RESULTS` the page shows; what holds in all runs is a sentence."""


GROUPS = {
    "two groups": ((-1, -1), (1, -1)),
    "three groups": ((-1, -1), (1, -1), (0, 1)),
    "four groups": ((-1, -1), (1, -1), (1, 1), (-1, 1)),
}
"""Layouts that the package has no start for: near which corners, or sides, of the world the groups are."""

SPREAD = 6.0
"""Half-width of the square in which a group begins, in robot radii."""


def grouped(world: WorldConfig, places: Sequence[tuple[int, int]], seed: int) -> np.ndarray:
    """Draws starts in which the robots stand in groups as equal as can be, none in contact."""
    rng, bounds = np.random.default_rng(seed), np.asarray(world.bounds)
    centers = np.resize(np.asarray(places, float), (world.robots, 2)) * (bounds - SPREAD * world.radius)
    starts: list[np.ndarray] = []
    while len(starts) < EPISODES:
        points = centers + rng.uniform(-SPREAD, SPREAD, (world.robots, 2)) * world.radius
        if murmurate.geometry.clearances(points, world.radius).min() > 0:
            starts.append(points)
    return np.stack(starts).astype(np.float32)


@dataclass(frozen=True)
class Cell:
    """What one run does from one kind of start.

    Attributes:
        valid: Episodes that ended in a valid pattern.
        failed: Episodes with a contact or an exit.
        ratio: Mean steps over the mean bound.
    """

    valid: int
    failed: int
    ratio: float


def other_starts(run: Run) -> dict[str, Cell]:
    """Evaluates one run from every kind of start."""
    world = run.experiment.world
    own = cast(Start, replace(cast(Any, run.experiment.start), noise=4.0))
    layouts = {
        name: draw_starts(start.prepare(world), prng.key(10_000 + index), EPISODES, world)
        for index, (name, start) in enumerate({**OTHER_STARTS, NOISY: own}.items())
    }
    layouts |= {name: grouped(world, places, seed) for seed, (name, places) in enumerate(GROUPS.items())}
    cells = {}
    for name, points in layouts.items():
        trajectories = run.rollout(points)
        validity = check_validity(trajectories, world)
        bound = np.mean([bound_steps(a, b, world.max_speed) for a, b in zip(points, trajectories.final, strict=True)])
        failed = int((~(validity.contact_free & validity.inside)).sum())
        cells[name] = Cell(int(validity.valid.sum()), failed, float(trajectories.lengths.mean() / bound))
    return cells


def others(runs: Sequence[Path]) -> str:
    """Returns the table of other starts: a row for each kind, a column for each experiment."""
    cells: dict[str, list[dict[str, Cell]]] = {}
    for folder in runs:
        cells.setdefault(folder.name.partition("-")[0], []).append(other_starts(murmurate.load(folder)))
        print(folder.name, cells[folder.name.partition("-")[0]][-1], flush=True)
    rows = [
        (name, *(_ranges([seed[name] for seed in seeds]) for seeds in cells.values()))
        for name in (*OTHER_STARTS, NOISY, *GROUPS)
    ]
    return table.as_markdown(("", *cells), rows)


def _ranges(cells: Sequence[Cell]) -> str:
    """Spells one kind of start: valid, (contact or exit), steps over the bound, over all seeds."""
    valid = sorted({cell.valid for cell in cells})
    ratios = [f"{cell.ratio:.2f}" for cell in sorted(cells, key=lambda cell: cell.ratio)]
    few = f"{valid[0]}-{valid[-1]}" if len(valid) > 1 else str(valid[0])
    ratio = ratios[0] if ratios[0] == ratios[-1] else f"{ratios[0]}-{ratios[-1]}"
    return f"{few} ({sum(cell.failed for cell in cells)}) {ratio}"


def results(runs: Sequence[Path]) -> str:
    """Returns a table for each learner, and what holds in all runs of each."""
    records: dict[str, list[dict[str, str]]] = {}
    for folder, row in zip(runs, table.results(runs), strict=True):
        records.setdefault(_learner(folder), []).append(dict(zip(table.RESULTS, row, strict=True)))
    parts = []
    for learner, chosen in records.items():
        cells = [tuple(_short(record[name]) for name in COLUMNS) for record in chosen]
        parts.append(f"### {TITLES[learner]}\n\n{table.as_markdown(('', *COLUMNS[1:]), cells)}")
        parts.append(f"Episodes of `{learner}`: {_counts(chosen)}.\n")
        if learner == DEFAULT_LEARNER:
            parts.append(f"Steps before the rest over bound, mean of the seeds: {_moving(chosen)}.\n")
    return "\n".join(parts)


def _moving(records: Sequence[dict[str, str]]) -> str:
    """Says of each experiment in how many times the bound its robots arrive, without the steps of the rest."""
    ratios: dict[str, list[float]] = {}
    for record in records:
        window = preset(record["experiment"]).rest.window
        steps, bound = float(record["total steps"]), float(record["bound"])
        ratios.setdefault(record["experiment"], []).append((steps - window) / bound)
    return ", ".join(f"{name} {np.mean(values):.2f}" for name, values in ratios.items())


def _counts(records: Sequence[dict[str, str]]) -> str:
    """Sums over all runs of a learner how many episodes were what a valid pattern has to be."""
    counts = []
    for name in ("contact-free", "inside", "at rest", "stationary", "valid"):
        pairs = [[int(number) for number in record[name].split(" of ")] for record in records]
        good, total = map(sum, zip(*pairs, strict=True))
        counts.append(f"{name} {good:,} of {total:,}")
    return ", ".join(counts)


def _learner(folder: Path) -> str:
    return folder.name.split("-")[1]


def _short(text: str) -> str:
    """Shortens cells that would make the table wider than the page."""
    return text.partition(" printed")[0].removesuffix(f" of {EPISODES}")


def write(runs: list[Path], out: Path, commands: str) -> None:
    """Writes the page and its pictures from finished runs.

    Args:
        runs: The runs.
        out: Where results.md and figures/ are.
        commands: What makes the page, for its text.
    """
    figures = out / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    of_default = [folder for folder in runs if _learner(folder) == DEFAULT_LEARNER]
    firsts = [folder for folder in of_default if folder.name.endswith("-seed0")]
    recordings = [plots.Recording.open(folder) for folder in firsts]
    names = [recording.experiment.name for recording in recordings]
    plots.save(plots.patterns_figure(recordings, names), figures / "patterns.png", dpi=110)
    for recording in recordings:
        if recording.experiment.name == "C":
            plots.save(plots.discovery_figure(recording), figures / "discovery-C.png", dpi=110)
    seeds = sorted({int(folder.name.rpartition("seed")[2]) for folder in runs})
    page = PAGE.format(
        machine=machine(runs[0]),
        results=results(runs),
        others=others(of_default),
        commands=commands,
        seeds=", ".join(map(str, seeds)),
    )
    path = out / "results.md"
    # What `murmurate compare --into` put there stays.
    compared = comparison_page.kept(path.read_text("utf-8")) if path.exists() else ""
    path.write_text(f"{page}\n{compared}" if compared else page, encoding="utf-8")


def machine(run: Path) -> str:
    """Names what the runs were made with."""
    versions = murmurate.load(str(run)).manifest["versions"]
    return ", ".join(f"{name} {version}" for name, version in sorted(versions.items()))


PAGE = """# Results

What was measured, and the command that measures it again.

## The paper's experiments

Made by {commands}, which trains experiments A to F with seeds {seeds}
(finished runs are reused) and writes this page.
Versions: {machine}.

Every row is one training with the settings of `murmurate discover` for that experiment and policy, evaluated on 200
fresh starts with the paper's noise $U(-2R, 2R)$; none of them was seen in training. Each policy has one set of numbers
for all six experiments (`runs/presets.py`).

- `formation`, the default: it [searches formations](formations.md) by the gradient of what each is worth, and then
  learns the way into the best one. With a shield.
- `central`, the paper's own kind: one network over all positions, by PPO alone, with two to four policies
  ([what differs from the paper](paper.md#what-is-the-papers-and-what-is-not)). Without a shield.
- `paper`: the authors' own numbers, taken literally; experiment C, one seed.

`equivariant`, the default of all other problems, is measured on [these](problems.md).

The columns:

- *Valid*, of 200: no contact at any moment, nobody outside, at rest, all robots neighbours, all pairs mutually visible,
  no pair nearer than the safe distance, and all of that for 200 more steps with nothing frozen.
- Steps are means over all episodes, valid or not.
- The *bound* is the fewest steps in which any controller gets from that start to that pattern.
- The *gap* is how far the objective, mean of all episodes, is below that of the [best-known pattern](patterns.md), in
  percent of it.
- In row E of its table, the paper prints a total that is not the sum of its parts: 1168.83 printed, 745.27 summed.
- Training seconds are those of these runs: on two cores (`formation`), or on one that other work shared.

The five steps for which robots must be still count as steps. In D, where the bound is nine, not even a controller that
arrives at the bound comes within 1.25 of it.

**Your digits will differ.** Sums in floating point depend on the processor and on the number of threads, and training
amplifies that. Compare ranges over seeds, not single numbers.

The [report](reproduction/report.md) that `murmurate reproduce --out docs/reproduction` writes shows the rows of seed 0
beside the paper's tables and figures.

{results}
![The patterns that the default learner found in experiments A to F](figures/patterns.png)

## Other starts

All runs of the default learner, 200 starts for each cell and seed: valid of 200, (episodes with a contact or an exit),
steps over bound; ranges over the seeds. The row of an experiment's own start repeats the table above with other random
numbers. In training half of the episodes that are the experiment's own begin anywhere, and 30% of all begin at one of
random, cluster, corner, wall, walls, tight-grid and symmetric. The other layouts were never trained on. One row has the
experiment's own start with twice the paper's noise. For the last three the package has no start.

{others}
![Experiment C: start, final pattern, training, one episode](figures/discovery-C.png)

Below are the weights of the package beside hand-written rules, all of them with the shield: nobody touches anybody. The
weights are valid from every start (3 to 16 robots, 24 with visible sensing), but for noisy sensing: with it, eight
robots form the pattern and tremble in it for ever, and none of 4,000 swarms comes to rest. The rules that get that far
under SSYNC were measured with 4 and 8 robots. [The weights' card](models.md) and [hard starts](hard.md) have crowds,
corners and walls.
"""


def main() -> None:
    """Trains what is missing and writes the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=Path, default=Path("runs"))
    parser.add_argument("--out", type=Path, default=Path("docs"))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--only-finished", action="store_true", help="train nothing: write what the finished runs show")
    parser.add_argument("--learners", nargs="+", default=list(LEARNERS), choices=list(LEARNERS))
    options = parser.parse_args()
    if DEFAULT_LEARNER not in options.learners:
        parser.error(f"--learners needs {DEFAULT_LEARNER}, whose pictures and other starts the page shows")
    grids = [
        Grid.product(
            ["C"] if name == SLOW else list(EXPERIMENTS), learners=[name], seeds=options.seeds[: LEARNERS[name]]
        )
        for name in options.learners
    ]
    grid = sum(grids[1:], grids[0])
    if not options.only_finished:
        run_jobs(training_jobs(grid, options.runs), InProcess())
    finished = [options.runs / name for name, state in grid.check(options.runs).items() if state == "finished"]
    if not finished:
        raise SystemExit(f"no finished run in {options.runs}")
    seeds = " ".join(map(str, options.seeds))
    chosen = f"python -m benchmarks.results --learners {' '.join(options.learners)} --seeds {seeds}"
    is_default = (options.learners, options.seeds) == (list(LEARNERS), parser.get_default("seeds"))
    write(finished, options.out, f"`{'make results' if is_default else chosen}`")


if __name__ == "__main__":
    main()
