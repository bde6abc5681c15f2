"""`murmurate optimum`: searches for the best formation there is, or lists the best known."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from murmurate.cli.arguments import Parser
from murmurate.errors import InputError, RunError
from murmurate.runs.paper import ALLOWED, check_experiment
from murmurate.terminal import say, say_text

if TYPE_CHECKING:
    from murmurate.analysis.optimum.search import Formation, OptimumConfig

__all__ = ["run"]

MAX_LISTED = 8

EVERYDAY = ("--out", "--quiet", "--objective", "--world.robots", "--annealing.chains", "--polished", "--hops", "--seed")
"""The flags that --help shows; --help-all shows the rest, one for every field of the search."""


def run(argv: Sequence[str]) -> int:
    """Runs the verb; returns 0, or 3 when a valid pattern was sought and none found."""
    word = argv[0] if argv and not argv[0].startswith("-") else None
    if not argv:
        return _list()
    if word is not None:
        check_experiment(word)
    from murmurate.analysis.optimum.search import OptimumConfig
    from murmurate.runs import config_io, presets

    formations = presets.resolve(word or "C")
    if formations.objective == "custom":
        raise InputError("objective", formations.objective, "C1 or C2")
    # Formations are polished by formulas of the paper's signals.
    for name, signal in formations.signals.items():
        raise InputError(f"signals.{name}", signal.name, "left out: the search knows the signals of C1 and C2 alone")
    for name, least in formations.valid.items():
        raise InputError(f"valid.{name}", least, "left out: the search knows the paper's valid patterns alone")
    config = OptimumConfig(formations.world, formations.objective)
    text = "Searches for the best formation in the world of an experiment; without any word, lists the best known."
    parser = Parser("optimum", "[EXPERIMENT]", text, EVERYDAY)
    names = f"whose sizes to begin with: {ALLOWED} (default: C)"
    parser.add_argument("experiment", metavar="EXPERIMENT", nargs="?", help=names)
    parser.add_argument("--out", metavar="FILE.json", help="write the best one, for the table of best-known patterns")
    parser.add_argument("--quiet", action="store_true", help="do not show the progress")
    parser.add_fields(config)
    options, flags = parser.parse(argv)
    config = config_io.replaced(config, flags)
    out = None if options.out is None else Path(options.out)
    if out is not None and out.exists():
        raise RunError(f"{out} is there already: choose another --out")
    if out is not None and not out.parent.is_dir():
        raise RunError(f"{out.parent} is no folder: choose another --out")
    return _search(config, out, " ".join(["murmurate optimum", *argv]), options.quiet)


def _list() -> int:
    from murmurate.analysis.optimum import best_known
    from murmurate.runs import optima, table

    say_text(table.as_markdown(optima.OPTIMA, optima.rows(best_known.load())))
    return 0


def _search(config: OptimumConfig, out: Path | None, command: str, quiet: bool) -> int:
    from murmurate.analysis.optimum.best_known import BestKnown
    from murmurate.analysis.optimum.search import hop, search
    from murmurate.cli.progress import Progress
    from murmurate.runs import files

    with Progress(quiet=quiet) as progress:
        formations = search(config, progress.update)
        checked = hop(config, progress.update) if config.hops else None
    _print_found(config, formations)
    best = formations[0]
    if checked is not None:
        say(f"basin hopping, {config.hops} rounds: {checked.value:.7f}{_flaw(checked)}")
        best = min(best, checked, key=lambda formation: (config.only_valid and not formation.valid, -formation.value))
    if config.only_valid and not best.valid:
        say("No valid pattern was found; the best of what was found is not one.")
        return 3
    _print_comparison(config, best)
    if out is not None:
        files.write_json(out, BestKnown.from_target(config.target, best.positions, command).to_dict())
        say(f"pattern: {out}")
    return 0


def _print_found(config: OptimumConfig, formations: list[Formation]) -> None:
    sizes = config.world
    what = f"{sizes.robots} robots, {config.objective}, R = {sizes.radius:g}, safe distance {sizes.safe_distance:g}"
    say(f"{what}: {len(formations)} distinct local optima, best first")
    for formation in formations[:MAX_LISTED]:
        signals = config.target.signals(formation.positions)
        parts = ", ".join(f"{name} {float(value):.6f}" for name, value in signals.items())
        say(f"  {formation.value:.7f}{_flaw(formation)}  ({parts})")


def _flaw(formation: Formation) -> str:
    return "" if formation.valid else " not a valid pattern"


def _print_comparison(config: OptimumConfig, best: Formation) -> None:
    """Prints the best formation beside the bounds and the best known one."""
    from murmurate.analysis.optimum import bounds
    from murmurate.analysis.optimum.best_known import RECORD_MARGIN, best_known
    from murmurate.geometry import smallest_ring

    target, sizes = config.target, config.world
    if best.valid:
        say(f"packing bound on valid patterns: {bounds.upper_bound(target):.7f}")
        ring = smallest_ring(sizes.robots, sizes.radius, sizes.safe_distance)
        say(f"smallest regular ring, radius {ring.radius:.6f}: {target.value(ring.positions):.7f}")
    known = best_known(target)
    if known is None:
        say("best known: none for these sizes")
    elif best.value > known + RECORD_MARGIN:
        say(f"best known: {known:.7f}; this one is better")
    elif best.value < known - RECORD_MARGIN:
        say(f"best known: {known:.7f}; this one is {100 * (known - best.value) / known:.2g}% short of it")
    else:
        say(f"best known: {known:.7f}; this one equals it")
