"""Archives of patterns at equal cost: searches for formations, annealing, and MAP-Elites by pyribs: `make archives`.

python -m benchmarks.archives [--docs docs] [--experiments E F] [--seeds 0 1]

Each method has one core for as long as the annealing of an experiment takes, compilation left out. Writes the table of
docs/formations.md. Needs pyribs (the benchmark extra).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from ribs.archives import GridArchive
from ribs.emitters import EvolutionStrategyEmitter, IsoLineEmitter
from ribs.schedulers import Scheduler

from benchmarks.seeds import CLOSE, POLISHED, anneal, optimum_gap
from murmurate.analysis import Catalogue, Finding, unmatched
from murmurate.analysis.optimum.polish import polish
from murmurate.analysis.optimum.search import VALIDITY_WEIGHT, OptimumConfig
from murmurate.discovery import Search
from murmurate.discovery.validity import is_valid_pattern
from murmurate.learning.together import train_together
from murmurate.runs import files, table
from murmurate.runs.experiment import ExperimentConfig
from murmurate.runs.paper import EXPERIMENTS
from murmurate.runs.presets import preset
from murmurate.world import Configuration, Objective, WorldConfig

BEGIN, END = "<!-- measured archives -->", "<!-- end of measured archives -->"

CELLS = {"elongation": 20, "variation of the distances from the centroid": 20}
"""Cells of the grid of MAP-Elites in two directions; the third is the number of robots on the hull."""

EMITTERS, BATCH = 8, 64
"""Emitters of MAP-Elites, and configurations that each tries at once."""

POLISHING = 0.5
"""Share of the time that is left to polish elites, where MAP-Elites does as annealing does with its ends."""


def findings(
    config: ExperimentConfig, positions: Float[np.ndarray, "patterns robots 2"], name: str, seed: int
) -> list[Finding]:
    """Returns the valid ones among configurations."""
    world, objective = config.world, Objective(config.objective_signals)
    valid = np.flatnonzero(is_valid_pattern(positions, world, config.thresholds))
    values = objective(objective.measure(Configuration(np.moveaxis(positions, 0, -1), world)))
    return [
        Finding(
            positions=positions[index],
            radius=world.radius,
            safe_distance=world.safe_distance,
            scan_radius=world.scan_radius,
            objective=config.objective,
            value=float(values[index]),
            gap=None,
            experiment=config.name,
            policy=name,
            start="none",
            seed=seed,
            run=f"{name} {seed}",
            episode=int(index),
        )
        for index in valid
    ]


def annealing(experiment: str, seed: int, seconds: float) -> tuple[list[Finding], int]:
    """Returns the valid ends of annealings that begin within a time, and how many ends there are."""
    found, ends, begun = [], 0, time.perf_counter()
    while not ends or time.perf_counter() - begun < seconds:
        number = 1000 * seed + ends // POLISHED
        found += anneal(experiment, number)
        ends += POLISHED
    return found, ends


def searching(experiment: str, seed: int, seconds: float) -> tuple[list[Finding], int]:
    """Returns the valid formations of searches that begin within a time, and how many are searched."""
    found, formations, begun = [], 0, time.perf_counter()
    while not formations or time.perf_counter() - begun < seconds:
        config = replace(preset(experiment), seed=1000 * seed + formations)
        config = replace(config, base=replace(config.base, refine=False))
        search = Search(config)
        stage = search.stage(search.begin())
        state = stage.begin()
        while not stage.is_done(state):
            state, _ = stage.after_chunk(state, *train_together([stage.next_chunk(state)])[0])
        places = np.moveaxis(np.asarray(stage.result(state).goals(), float), -1, 0)
        found += findings(config, places, f"formations {formations}", seed)
        formations += len(places)
    return found, formations


def map_elites(
    emitters: Callable[..., Sequence[object]], polishing: float = 0.0
) -> Callable[[str, int, float], tuple[list[Finding], int]]:
    """Returns a search by MAP-Elites.

    Args:
        emitters: Makes them of an archive, a first configuration and a seed.
        polishing: Share of the time that is left to polish elites.
    """

    def search(experiment: str, seed: int, seconds: float) -> tuple[list[Finding], int]:
        config = preset(experiment)
        world, target, robots = config.world, OptimumConfig(config.world, config.objective).target, config.world.robots
        archive = GridArchive(
            solution_dim=2 * robots,
            dims=(robots - 2, *CELLS.values()),
            ranges=((2.5, robots + 0.5), (0.0, 1.0), (0.0, 1.0)),
            seed=seed,
        )
        # In safe distances; robots begin spread over about the area of a pattern.
        first = np.random.default_rng(seed).normal(size=2 * robots)
        scheduler = Scheduler(archive, emitters(archive, first, seed))
        evaluate = jax.jit(lambda points: _evaluated(config, points))
        _evaluate(evaluate, scheduler.ask(), world)  # compiled
        scheduler.tell(*_evaluate(evaluate, scheduler._cur_solutions, world))
        tried, begun = EMITTERS * BATCH, time.perf_counter()
        while time.perf_counter() - begun < (1 - polishing) * seconds:
            solutions = scheduler.ask()
            scheduler.tell(*_evaluate(evaluate, solutions, world))
            tried += len(solutions)
        elites = archive.data("solution").reshape(-1, robots, 2) * world.safe_distance
        ends = list(elites)
        # All over the map: the best elites are much the same.
        for index in np.random.default_rng(seed).permutation(len(elites)):
            if time.perf_counter() - begun > seconds:
                break
            ends[index] = polish(ends[index], target)
        return findings(config, np.array(ends), "MAP-Elites", seed), tried

    return search


def _evaluate(evaluate: Callable, solutions: np.ndarray, world: WorldConfig) -> tuple[np.ndarray, np.ndarray]:
    points = jnp.asarray(solutions.reshape(len(solutions), -1, 2) * world.safe_distance, jnp.float32)
    value, measures = evaluate(points)
    return np.asarray(value, float), np.asarray(measures, float)


def _evaluated(config: ExperimentConfig, points: Float[Array, "batch robots 2"]) -> tuple[Array, Array]:
    """Returns the objective, in which nothing is worth losing validity, and the three measures of the grid."""
    objective = Objective(config.objective_signals)
    signals = objective.measure(Configuration(jnp.moveaxis(points, 0, -1), config.world))
    required = ("safety", "neighbors", "visible")
    value = sum(signals[name] for name in signals if name not in required)
    value += VALIDITY_WEIGHT * sum(signals[name] - 1 for name in required)
    offsets = points[:, None] - points[:, :, None]
    angles = jnp.arctan2(offsets[..., 1], offsets[..., 0]) + 4 * jnp.pi * jnp.eye(points.shape[1])
    ordered = jnp.sort(angles, axis=-1)[..., :-1]
    gaps = jnp.concatenate([jnp.diff(ordered), ordered[..., :1] + 2 * jnp.pi - ordered[..., -1:]], axis=-1)
    hull = jnp.sum(gaps.max(axis=-1) >= jnp.pi, axis=1)
    centred = points - points.mean(axis=1, keepdims=True)
    length, width = jnp.moveaxis(jnp.linalg.svd(centred, compute_uv=False), -1, 0)
    radii = jnp.linalg.norm(centred, axis=-1)
    variation = radii.std(axis=1) / radii.mean(axis=1)
    return value, jnp.stack([hull, 1 - width / length, variation], axis=1)


def _with_lines(archive: GridArchive, first: np.ndarray, seed: int) -> list[object]:
    return [
        IsoLineEmitter(archive, x0=first, iso_sigma=0.05, line_sigma=0.2, batch_size=BATCH, seed=seed * EMITTERS + i)
        for i in range(EMITTERS)
    ]


def _with_cma(archive: GridArchive, first: np.ndarray, seed: int) -> list[object]:
    return [
        EvolutionStrategyEmitter(archive, x0=first, sigma0=0.5, batch_size=BATCH, seed=seed * EMITTERS + i)
        for i in range(EMITTERS)
    ]


METHODS = {
    "formations": searching,
    "annealing": annealing,
    "MAP-Elites": map_elites(_with_lines),
    "MAP-Elites, polished": map_elites(_with_lines, POLISHING),
    "CMA-ME": map_elites(_with_cma),
}


def rows(experiment: str, seeds: Sequence[int]) -> Iterator[tuple[str, ...]]:
    """Yields the rows of one experiment: one for each method, over all seeds."""
    config = preset(experiment)
    for method in ("formations", "annealing"):
        METHODS[method](experiment, 99, 0.0)  # compiled
    begun = time.perf_counter()
    anneal(experiment, 98)
    seconds = time.perf_counter() - begun
    found = {method: [search(experiment, seed, seconds) for seed in seeds] for method, search in METHODS.items()}
    everything = [Catalogue.from_findings(each) for results in found.values() for each, _ in results if each]
    for method, results in found.items():
        others = [c for name, each in found.items() if name != method for c, _ in each]
        catalogues = [Catalogue.from_findings(each) for each, _ in results if each]
        cells = [len(catalogue.cells()) for catalogue in catalogues]
        gaps = [optimum_gap(pattern.representative) for catalogue in catalogues for pattern in catalogue.classes]
        alone = [
            len(unmatched(catalogue, [finding.positions for each in others for finding in each]))
            for catalogue in catalogues
        ]
        best = max(catalogue.classes[0].value for catalogue in everything)
        yield (
            *(experiment, str(config.world.robots), method, f"{seconds:.0f} s"),
            _range([tried for _, tried in results]),
            _range([len(each) for each, _ in results]),
            _range([len(catalogue.classes) for catalogue in catalogues]),
            _range(alone),
            _range(cells),
            f"{100 * np.mean(np.array(gaps) <= CLOSE):.0f}%" if gaps else "",
            f"{100 * (1 - max((c.classes[0].value for c in catalogues), default=0) / best):.3f}%",
        )


def _range(numbers: Sequence[int]) -> str:
    low, high = min(numbers, default=0), max(numbers, default=0)
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"


HEADER = (
    *("", "robots", "method", "time", "tried", "valid", "distinct", "in no other archive", "cells"),
    *("within 1% of their optimum", "best gap"),
)


def main() -> None:
    """Measures and writes the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    parser.add_argument("--experiments", nargs="+", default=["E", "F"], choices=list(EXPERIMENTS))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    options = parser.parse_args()
    lines = []
    for experiment in options.experiments:
        for row in rows(experiment, options.seeds):
            print(*row, sep="  ", flush=True)
            lines.append(row)
    document = options.docs / "formations.md"
    before, _, rest = document.read_text(encoding="utf-8").partition(BEGIN)
    text = table.as_markdown(HEADER, lines)
    files.write_text(document, f"{before}{BEGIN}\n{text}{END}{rest.partition(END)[2]}")


if __name__ == "__main__":
    main()
