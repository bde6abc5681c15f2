"""What many seeds discover, beside what an annealer finds: `make seeds`; writes docs/discoveries.md and its plates.

python -m benchmarks.seeds [--runs runs] [--out docs] [--seeds 16] [--experiments A B C D E F] [--only-finished]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import murmurate
from murmurate import plots
from murmurate.analysis import Catalogue, Finding, PatternClass, unmatched, upright
from murmurate.analysis.optimum.polish import polish
from murmurate.analysis.optimum.search import Formation, OptimumConfig, annealed
from murmurate.runs import table
from murmurate.runs.execute import LocalProcesses, run_jobs
from murmurate.runs.formations import Formed, form_each
from murmurate.runs.grid import Grid
from murmurate.runs.jobs import training_jobs
from murmurate.runs.paper import EXPERIMENTS
from murmurate.runs.presets import DEFAULT_LEARNER, preset

SEEDS = 16

SEARCHED = "searches"
"""Folder of the searches, in that of the runs: they have the names of trainings."""

ANNEALINGS, POLISHED = 1, 256
"""Annealings of each problem, and how many of the 256 chains of each are polished: all, poor local optima too."""

BEST, STARTS, KEY = 100, 5, 7
"""How many patterns are formed, best first, from how many starts each, and their seed; training has other starts."""

CLOSE = 0.01
"""Greatest gap of a pattern to the local optimum that polishing leads it to, as a share of its objective."""

MAX_DRAWN = 14


@dataclass(frozen=True, eq=False)
class Study:
    """What was found of one experiment.

    Attributes:
        experiment: A to F.
        searched: How many formations the searches of all seeds began with.
        catalogue: The valid patterns among them, in classes.
        annealed: What annealing found: valid patterns, in classes too.
        never_annealed: Classes of the searches that annealing never found.
        never_found: Classes of the annealing that no search found.
        formed: How a swarm forms the best classes of the searches.
    """

    experiment: str
    searched: int
    catalogue: Catalogue
    annealed: Catalogue
    never_annealed: tuple[PatternClass, ...]
    never_found: tuple[PatternClass, ...]
    formed: tuple[Formed, ...]


def searches(experiment: str, seeds: int) -> Grid:
    """Returns the searches for formations of all seeds, without the way into any."""
    return Grid.product([experiment], learners=[DEFAULT_LEARNER], seeds=seeds, fields={"base.refine": False})


def trained(experiment: str) -> Grid:
    """Returns the training whose policy forms the patterns; `make results` has it too."""
    return Grid.product([experiment], learners=[DEFAULT_LEARNER], seeds=1)


def study(experiment: str, seeds: int, runs: Path) -> Study:
    """Sorts what the searches of one experiment found, compares it with annealing, and forms the best patterns."""
    found = [murmurate.load(runs / SEARCHED / name) for name in searches(experiment, seeds).runs]
    searched = sum(run.cascade.policies[-1].goals().shape[-1] for run in found)
    discovered = Catalogue.from_findings([finding for run in found for finding in run.remembered().findings])
    reference = Catalogue.from_findings(anneal(experiment))
    never_annealed = unmatched(discovered, [finding.positions for finding in reference.findings])
    never_found = unmatched(reference, [finding.positions for finding in discovered.findings])
    (name,) = trained(experiment).runs
    formed = form_each(murmurate.load(runs / name), discovered.classes[:BEST], STARTS, KEY)
    print(experiment, len(discovered.classes), len(reference.classes), len(never_found), flush=True)
    return Study(experiment, searched, discovered, reference, never_annealed, never_found, tuple(formed))


def anneal(experiment: str, first: int = 0) -> list[Finding]:
    """Returns the valid patterns that annealing ends in, with seeds from a first one."""
    config = preset(experiment)
    annealings = [
        OptimumConfig(config.world, config.objective, polished=POLISHED, seed=first + seed)
        for seed in range(ANNEALINGS)
    ]
    ends = [
        (search, index, formation)
        for search in annealings
        for index, formation in enumerate(annealed(search))
        if formation.valid
    ]
    return [_finding(experiment, search, index, formation) for search, index, formation in ends]


def optimum_gap(finding: Finding) -> float:
    """Returns by how much a pattern is below the local optimum that polishing leads it to, as a share of that."""
    config = preset(finding.experiment)
    target = OptimumConfig(config.world, config.objective).target
    best = target.value(polish(finding.positions, target))
    return (best - finding.value) / best


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
    *("", "robots", "objective", "searched", "valid", "best gap", "distinct", "in several searches"),
    *("annealed", "of these found", "never annealed", "formed", "contact or exit"),
)


def row(result: Study) -> tuple[str, ...]:
    """Returns one experiment's row of the table."""
    paper, classes, findings = EXPERIMENTS[result.experiment], result.catalogue.classes, result.catalogue.findings
    gaps = [finding.gap / (finding.gap + finding.value) for finding in findings if finding.gap is not None]
    several = [pattern for pattern in classes if len(pattern.seeds) > 1]
    annealed = len(result.annealed.classes)
    counts = (len(findings), f"{100 * min(gaps):.3f}%", len(classes), len(several))
    compared = (annealed, annealed - len(result.never_found), len(result.never_annealed))
    episodes = sum(each.episodes for each in result.formed)
    formed = f"{sum(each.formed for each in result.formed):,} of {episodes:,}"
    return (
        *(result.experiment, str(paper.world.robots), paper.objective, f"{result.searched:,}"),
        *map(str, (*counts, *compared, formed, sum(each.failed for each in result.formed))),
    )


def plate(robots: int, studies: Sequence[Study], path: Path) -> None:
    """Draws the commonest patterns of a swarm size, those of both objectives together, best first."""
    findings = [finding for result in studies for finding in result.catalogue.findings]
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

The patterns that {seeds} seeds of each experiment discover, beside those that simulated annealing finds. Made by
{command}, which trains what is missing and writes this page.

Each row is {seeds} [searches for formations](formations.md), the first part of a training of the default learner. The
valid patterns among all formations are sorted into classes as `murmurate catalogue` does: the same up to moving,
turning, relabelling, mirroring and scaling, within 0.125 root mean square radii.

- *Distinct* are the classes of the searches; *in several searches*, those that more than one seed found.
- *Annealed* are the distinct valid patterns among the {ends} ends of simulated annealing, good and bad ones, polished
  under the exact constraints (`murmurate optimum` without its rings; many chains end in no valid pattern). *Of these
  found* are the classes whose representative matches a formation of the searches.
- *Never annealed* are the classes of the searches whose representative matches none of these ends.
- *Formed*: one policy, that of the training with seed 0, is told the best {best} of the distinct patterns, one after
  the other, and forms each from {starts} fresh starts of the experiment: the episodes in which the swarm comes to rest
  within 0.1 R of it, as a root mean square.

{table}
{plates}"""


def main() -> None:
    """Trains what is missing and writes the page."""
    parser = argparse.ArgumentParser(description="Searches A-F with many seeds, and says what they discover.")
    parser.add_argument("--runs", type=Path, default=Path("runs"))
    parser.add_argument("--out", type=Path, default=Path("docs"))
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--experiments", nargs="+", choices=list(EXPERIMENTS), default=list(EXPERIMENTS))
    parser.add_argument("--only-train", action="store_true", help="write nothing yet")
    parser.add_argument("--only-finished", action="store_true", help="train nothing")
    options = parser.parse_args()
    if not options.only_finished:
        # One core each: the number of threads changes the last bits of a training.
        for experiment in options.experiments:
            run_jobs(training_jobs(searches(experiment, options.seeds), options.runs / SEARCHED), LocalProcesses())
            run_jobs(training_jobs(trained(experiment), options.runs), LocalProcesses())
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
        best=BEST,
        starts=STARTS,
        ends=ANNEALINGS * POLISHED,
        table=table.as_markdown(HEADER, [row(result) for result in studies]),
        plates="\n".join(plates),
    )
    (out / "discoveries.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
