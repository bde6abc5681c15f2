"""Searches for the best-known patterns again and keeps the better ones: `make optima`.

python -m benchmarks.optima [--robots 2 16] [--seeds 0 1] [--hops 60] [--add FILE.json]

Two families of sizes, as in experiments A-F: R = 1, delta_s = 5 (B, C, E, F) and R = 0.4, delta_s = 2.8 (A, D). The
published worlds X = Y = 35, 40, 45 for N = 6, 8, 10 are on the line 20 + 2.5 N, which is continued.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from murmurate import plots
from murmurate.analysis import symmetry, upright
from murmurate.analysis.optimum import best_known
from murmurate.analysis.optimum.annealing import AnnealingConfig
from murmurate.analysis.optimum.best_known import BestKnown
from murmurate.analysis.optimum.formation import Target
from murmurate.analysis.optimum.polish import polish
from murmurate.analysis.optimum.search import OptimumConfig, hop, search
from murmurate.geometry import convex_layers
from murmurate.runs.optima import EXACT
from murmurate.runs.presets import preset

PICTURE = Path("docs/figures/best-known.png")
TABLE = Path(best_known.__file__).with_name(best_known.TABLE)
FAMILIES = ("C", "F", "A", "D")


def target(experiment: str, robots: int) -> tuple[Target, str]:
    """Returns an experiment's problem for another swarm size, and the command that searches it."""
    config = preset(experiment)
    half = 20 + 2.5 * robots
    changed = {"robots": robots, "half_width": half, "half_height": half}
    if config.world.scan_radius > config.world.half_width:
        # "Very large": everyone neighbours everyone, wherever they are in the world.
        changed["scan_radius"] = max(config.world.scan_radius, 3 * half)
    world = replace(config.world, **changed)
    flags = [f"--world.{name} {value:g}" for name, value in changed.items() if value != getattr(config.world, name)]
    return Target(world, config.objective), " ".join(["murmurate optimum", experiment, *flags])


def improve(table: dict[str, BestKnown], key: str, entry: BestKnown) -> bool:
    """Puts an entry in the place of a worse one."""
    if not entry.target.is_valid(entry.positions) or (key in table and entry.value <= table[key].value + 1e-12):
        return False
    table[key] = entry
    return True


def key_of(entry: BestKnown) -> str:
    """Names the place in the table."""
    return f"{entry.radius:g} {entry.safe_distance:g} {entry.objective} {entry.robots:02}"


def main() -> None:
    """Searches and writes the table after each search, so that nothing is lost."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, nargs=2, default=(2, 16), metavar=("FROM", "TO"))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--moves_per_robot", type=int, default=AnnealingConfig.moves_per_robot)
    parser.add_argument("--polished", type=int, default=OptimumConfig.polished)
    parser.add_argument("--hops", type=int, default=60, help="rounds of basin hopping that check each entry")
    parser.add_argument("--families", nargs="+", default=FAMILIES)
    parser.add_argument("--add", type=Path, help="a record that `murmurate optimum` or `evaluate` wrote")
    options = parser.parse_args()
    entries = json.loads(TABLE.read_text("utf-8")) if TABLE.exists() else []
    table = {key_of(entry): entry for entry in map(BestKnown.from_dict, entries)}
    if options.add:
        entry = BestKnown.from_dict(json.loads(options.add.read_text("utf-8")))
        print("added" if improve(table, key_of(entry), entry) else "the table has one as good")
        write(table)
        draw(table)
        return
    # From large to small: without one of its robots, a good pattern is a good start for one robot less.
    for robots in reversed(range(options.robots[0], options.robots[1] + 1)):
        for experiment in options.families:
            for seed in options.seeds:
                work(table, experiment, robots, seed, options)
                write(table)
    draw(table)


def work(table: dict[str, BestKnown], experiment: str, robots: int, seed: int, options: argparse.Namespace) -> None:
    """Searches one place of the table, and checks what the table then has by basin hopping."""
    begun = time.perf_counter()
    sought, command = target(experiment, robots)
    annealing = AnnealingConfig(moves_per_robot=options.moves_per_robot)
    config = OptimumConfig(sought.world, sought.objective, annealing=annealing, hops=options.hops, seed=seed)
    config = replace(config, polished=options.polished)
    command += f" --seed {seed}" if options.polished else " --polished 0"
    if options.polished and annealing != AnnealingConfig():
        command += f" --annealing.moves_per_robot {options.moves_per_robot}"
    optima = search(config)
    best = BestKnown.from_target(sought, optima[0].positions, command)
    key = key_of(best)
    better = improve(table, key, best)
    parent = table.get(f"{key[:-2]}{robots + 1:02}")
    for entry in () if parent is None else heirs(parent, sought):
        better |= improve(table, key, entry)
    checked = hop(config) if options.hops else None
    if checked and checked.valid:
        entry = BestKnown.from_target(sought, checked.positions, f"{command} --hops {options.hops}")
        better |= improve(table, key, entry)
        reached = max(checked.value, table[key].hop or checked.value)
        table[key] = replace(table[key], hop=reached)
    values = " ".join(f"{optimum.value:.7f}{'' if optimum.valid else '!'}" for optimum in optima[:4])
    hopped = f"hop {checked.value:.7f}{'' if checked.valid else '!'}" if checked else ""
    seconds = time.perf_counter() - begun
    print(f"{experiment} {robots:2} {values} {hopped} {'BETTER' if better else ''} {seconds:.0f} s", flush=True)


def heirs(parent: BestKnown, sought: Target) -> Iterator[BestKnown]:
    """Yields entries made of a pattern of one robot more, by leaving one of its robots out and polishing."""
    for robot in range(parent.robots):
        positions = polish(np.delete(parent.positions, robot, axis=0), sought)
        yield BestKnown.from_target(sought, positions, "python -m benchmarks.optima")


def write(table: dict[str, BestKnown]) -> None:
    """Writes the table."""
    TABLE.write_text(best_known.to_json(table[key] for key in sorted(table)), encoding="utf-8")


def draw(table: dict[str, BestKnown]) -> None:
    """Draws the best-known patterns of one family: robots of radius 1 that gather anywhere."""
    entries = [table[key] for key in sorted(table) if key.startswith("1 5 C2 ") and table[key].robots > 2]
    patterns = [
        plots.PlatePattern(
            upright(entry.positions),
            entry.radius,
            entry.scan_radius,
            f"{entry.robots} robots · {'+'.join(map(str, convex_layers(entry.positions)))}",
            f"{symmetry(entry.positions, EXACT).symbol or 'no symmetry'} · {entry.value:.4f}",
        )
        for entry in entries
    ]
    title = f"Best-known patterns of {entries[0].robots} to {entries[-1].robots} robots"
    figure = plots.plate_figure(patterns, title, "no predefined point; all at one scale", columns=7)
    plots.save(figure, PICTURE, dpi=110)


if __name__ == "__main__":
    main()
