"""What many seeds discover, beside what an annealer finds: `make seeds`; writes docs/discoveries.md and its plates.

python -m benchmarks.seeds [--runs runs] [--out docs] [--seeds 16] [--experiments A B C D E F] [--only-finished]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from murmurate import plots
from murmurate.analysis import Catalogue, Finding, PatternClass, unmatched, upright
from murmurate.analysis.optimum.formation import Target
from murmurate.analysis.optimum.polish import polish
from murmurate.analysis.optimum.search import Formation, OptimumConfig, annealed
from murmurate.runs import catalogues, table
from murmurate.runs.evaluate import EPISODES
from murmurate.runs.execute import LocalProcesses, run_jobs
from murmurate.runs.grid import Grid
from murmurate.runs.jobs import training_jobs
from murmurate.runs.paper import EXPERIMENTS
from murmurate.runs.presets import preset

SEEDS = 16

SEARCHES, POLISHED = 1, 256
"""Annealings of each problem, and how many of the 256 chains of each are polished: all, poor local optima too."""

MAX_DRAWN = 14


@dataclass(frozen=True, eq=False)
class Study:
    """What was found of one experiment.

    Attributes:
        experiment: A to F.
        catalogue: What its runs discovered; None where no pattern was valid.
        annealed: What annealing found: valid patterns, in classes too.
        unseen: Classes of the runs that annealing never found.
        tightened: Those of them, polished, that annealing did not find either.
        missed: Classes of the annealing that no run discovered.
    """

    experiment: str
    catalogue: Catalogue | None
    annealed: Catalogue
    unseen: tuple[PatternClass, ...]
    tightened: tuple[PatternClass, ...]
    missed: tuple[PatternClass, ...]


def study(experiment: str, seeds: int, runs: Path) -> Study:
    """Sorts what the runs of one experiment discovered, anneals the same problem, and compares."""
    folders = [runs / f"{experiment}-equivariant-seed{seed}" for seed in range(seeds)]
    findings = [finding for folder in folders for finding in catalogues.read_findings(folder)]
    discovered = Catalogue.from_findings(findings) if findings else None
    reference = Catalogue.from_findings(anneal(experiment))
    if discovered is None:
        return Study(experiment, None, reference, (), (), reference.classes)
    ends = [finding.positions for finding in reference.findings]
    unseen = unmatched(discovered, ends)
    tight = [finding for pattern in unseen if (finding := _polished(experiment, pattern)) is not None]
    tightened = unmatched(Catalogue.from_findings(tight), ends) if tight else ()
    # By the same measure: the annealed classes of which no member is one of the runs' representatives.
    missed = tuple(
        pattern
        for pattern in reference.classes
        if len(unmatched(discovered, [member.positions for member in pattern.members])) == len(discovered.classes)
    )
    return Study(experiment, discovered, reference, unseen, tightened, missed)


def _polished(experiment: str, pattern: PatternClass) -> Finding | None:
    """Returns the local optimum next to a class's representative; None where that is no valid pattern."""
    config, best = preset(experiment), pattern.representative
    target = Target(config.world, config.objective)
    positions = polish(best.positions, target)
    return replace(best, positions=positions, value=target.value(positions)) if target.is_valid(positions) else None


def anneal(experiment: str) -> list[Finding]:
    """Returns the valid patterns that annealing ends in."""
    config = preset(experiment)
    searches = [OptimumConfig(config.world, config.objective, polished=POLISHED, seed=seed) for seed in range(SEARCHES)]
    ends = [
        (search, index, formation)
        for search in searches
        for index, formation in enumerate(annealed(search))
        if formation.valid
    ]
    return [_finding(experiment, search, index, formation) for search, index, formation in ends]


def _finding(experiment: str, search: OptimumConfig, index: int, formation: Formation) -> Finding:
    world = search.world
    return Finding(
        positions=formation.positions,
        radius=world.radius,
        safe_distance=world.safe_distance,
        scan_radius=world.scan_radius,
        objective=search.objective,
        value=formation.value,
        gap=None,
        experiment=experiment,
        policy="annealing",
        start="none",
        seed=search.seed,
        run=f"annealing {search.seed}",
        episode=index,
    )


HEADER = (
    *("", "robots", "objective", "valid runs", "valid patterns", "best gap"),
    *("distinct", "in several runs", "never annealed", "polished too", "annealed", "never discovered"),
)


def row(result: Study, seeds: int) -> tuple[str, ...]:
    """Returns one experiment's row of the table."""
    paper, episodes = EXPERIMENTS[result.experiment], seeds * EPISODES
    classes = result.catalogue.classes if result.catalogue else ()
    findings = result.catalogue.findings if result.catalogue else ()
    gaps = [finding.gap / (finding.gap + finding.value) for finding in findings if finding.gap is not None]
    several = [pattern for pattern in classes if len(pattern.seeds) > 1]
    counts = (classes, several, result.unseen, result.tightened, result.annealed.classes, result.missed)
    return (
        *(result.experiment, str(paper.world.robots), paper.objective),
        f"{len({finding.run for finding in findings})} of {seeds}",
        f"{len(findings)} of {episodes}",
        f"{100 * min(gaps):.2f}%" if gaps else table.NONE,
        *(str(len(group)) for group in counts),
    )


def plate(robots: int, studies: Sequence[Study], path: Path) -> None:
    """Draws the commonest patterns of a swarm size, those of both objectives together, best first."""
    findings = [finding for result in studies if result.catalogue for finding in result.catalogue.findings]
    if not findings:
        return
    everything = Catalogue.from_findings(findings)
    commonest = sorted(everything.classes, key=lambda pattern: -pattern.count)[:MAX_DRAWN]
    shown = sorted(commonest, key=lambda pattern: everything.classes.index(pattern))
    subtitle = f"{len(everything.classes)} distinct among {len(findings)} valid patterns; "
    subtitle += "all" if len(shown) == len(everything.classes) else f"the {len(shown)} that were found most often"
    pictures = [picture(pattern, len(findings)) for pattern in shown]
    plots.save(plots.plate_figure(pictures, f"Patterns of {robots} robots", subtitle, columns=7), path, dpi=110)


def picture(pattern: PatternClass, total: int) -> plots.PlatePattern:
    """Captions one pattern of a plate."""
    best, symbol = pattern.representative, pattern.symmetry.symbol
    caption = "+".join(map(str, pattern.layers)) + ("" if not symbol else f" · {symbol}")
    note = f"{best.objective} {best.value:.4f} · {100 * pattern.count / total:.1f}%"
    return plots.PlatePattern(upright(best.positions), best.radius, best.scan_radius, caption, note)


PAGE = """# Discoveries

The patterns that {seeds} seeds of each experiment discover, beside those that simulated annealing finds among
configurations alone. Made by {command}, which trains what is missing and writes this page.

Each row is {seeds} trainings of the default learner, each evaluated on {episodes} fresh starts. Their valid final
patterns are sorted into classes as `murmurate catalogue` does: the same up to moving, turning, relabelling, mirroring
and scaling, within 0.125 root mean square radii. Each training was pinned to one core, because the number of threads
changes a policy a little.

- *Distinct* are the classes of the runs; *in several runs*, those that more than one run found.
- *Annealed* are the distinct valid patterns among the {ends} ends of simulated annealing, good and bad ones, polished
  under the exact constraints (`murmurate optimum` without its rings; many chains end in no valid pattern).
- *Never annealed* are the classes of the runs whose representative matches none of these ends.
- *Polished too*: a pattern of a run is where a policy comes to rest, and need not be a local optimum. So the
  representatives that annealing never found are polished as well; this counts those that still match nothing annealed.
- *Never discovered* are the annealed classes of which no member matches a representative of the runs.

{table}
{plates}"""


def main() -> None:
    """Trains what is missing and writes the page."""
    parser = argparse.ArgumentParser(description="Trains many seeds of A-F, and says what they discover.")
    parser.add_argument("--runs", type=Path, default=Path("runs"))
    parser.add_argument("--out", type=Path, default=Path("docs"))
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--experiments", nargs="+", choices=list(EXPERIMENTS), default=list(EXPERIMENTS))
    parser.add_argument("--only-train", action="store_true", help="write nothing yet")
    parser.add_argument("--only-finished", action="store_true", help="train nothing")
    options = parser.parse_args()
    if not options.only_finished:
        # The runs of `make results` are among these.
        grid = Grid.product(options.experiments, learners=["equivariant"], seeds=options.seeds)
        # One core each: the number of threads changes the last bits of a training.
        run_jobs(training_jobs(grid, options.runs), LocalProcesses())
    if options.only_train:
        return
    studies = [study(experiment, options.seeds, options.runs) for experiment in options.experiments]
    write(studies, options.seeds, options.out)


def write(studies: Sequence[Study], seeds: int, out: Path) -> None:
    """Writes the page and its plates."""
    figures = out / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    plates = []
    for robots in sorted({EXPERIMENTS[result.experiment].world.robots for result in studies}):
        name = f"discovered-{robots}.png"
        same_size = [result for result in studies if EXPERIMENTS[result.experiment].world.robots == robots]
        plate(robots, same_size, figures / name)
        plates.append(f"![Patterns of {robots} robots that the runs discovered](figures/{name})\n")
    text = PAGE.format(
        seeds=seeds,
        command="`make seeds`" if seeds == SEEDS else f"`python -m benchmarks.seeds --seeds {seeds}`",
        episodes=EPISODES,
        ends=SEARCHES * POLISHED,
        table=table.as_markdown(HEADER, [row(result, seeds) for result in studies]),
        plates="\n".join(plates),
    )
    (out / "discoveries.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
