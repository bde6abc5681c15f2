"""`murmurate catalogue`: sorts what runs found into classes of the same pattern, and draws them on a plate."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from murmurate.cli.arguments import Parser
from murmurate.errors import MAX_MAGNITUDE, RunError, check_number
from murmurate.terminal import say

if TYPE_CHECKING:
    from murmurate.analysis import Catalogue, PatternClass
    from murmurate.plots import PlatePattern

__all__ = ["run", "show"]

PLATE, MAP_PLATE = "plate.png", "map.png"
MAX_DRAWN, MAX_LISTED = 48, 20


def run(argv: Sequence[str]) -> int:
    """Runs the verb; returns 0."""
    text = "Sorts the valid patterns of runs, and of other catalogues, into classes, and draws a plate of them."
    parser = Parser("catalogue", "RUN...", text)
    parser.add_argument("runs", metavar="RUN", nargs="+", help="folder of a finished run, or of a catalogue")
    parser.add_argument("--out", metavar="DIR", default="catalogue", help="where to write (default: catalogue)")
    tolerance = "greatest distance within a class: root mean square radii (default: 0.125), or units if not scaled"
    parser.add_argument("--tolerance", type=float, metavar="NUMBER", help=tolerance)
    parser.add_argument("--no-scaling", action="store_true", help="patterns of different size are different")
    parser.add_argument("--no-reflection", action="store_true", help="mirror images are different patterns")
    text = "the patterns that their policies remember, instead of those that their evaluations ended in"
    parser.add_argument("--remembered", action="store_true", help=text)
    text = "import the modules that the runs name, which executes them"
    parser.add_argument("--trust", action="store_true", help=text)
    parser.add_argument("--quiet", action="store_true", help="do not show the progress")
    options, _ = parser.parse(argv)
    if options.tolerance is not None:
        check_number("--tolerance", options.tolerance, 0, MAX_MAGNITUDE, exclusive_low=True)
    from murmurate.analysis import Catalogue
    from murmurate.cli.progress import Progress
    from murmurate.runs import catalogues
    from murmurate.runs.run import Run

    out = Path(options.out)
    catalogues.check_target(out)
    findings = []
    with Progress(quiet=options.quiet) as progress:
        for index, word in enumerate(options.runs, 1):
            if options.remembered:
                findings += Run.open(word, options.trust).remembered().findings
            else:
                findings += catalogues.read_findings(word, options.trust)
            patterns = "valid pattern" if len(findings) == 1 else "valid patterns"
            progress.update("runs read", index, len(options.runs), found=f"{len(findings)} {patterns}")
    if not findings:
        raise RunError(f"no valid pattern was found in {', '.join(options.runs)}")
    scaling, reflection = not options.no_scaling, not options.no_reflection
    show(Catalogue.from_findings(findings, tolerance=options.tolerance, scaling=scaling, reflection=reflection), out)
    return 0


def show(catalogue: Catalogue, out: Path) -> None:
    """Writes a catalogue to a folder, with its plate, and prints its best classes."""
    from murmurate.runs import catalogues

    catalogues.write(catalogue, out)
    _draw(catalogue, out / PLATE)
    _draw_map(catalogue, out / MAP_PLATE)
    _print(catalogue, out)


def _draw_map(catalogue: Catalogue, path: Path) -> None:
    """Draws the best pattern of each cell of a catalogue's map."""
    from murmurate import plots
    from murmurate.analysis import upright

    cells, shown = catalogue.cells(), []
    for cell, patterns in cells.items():
        best = patterns[0].representative
        symbol = patterns[0].symmetry.symbol
        caption = f"{cell.hull} on hull{' · ' * bool(symbol)}{symbol} · best of {len(patterns)}"
        note = f"elongation {cell.elongation:g}+ · margin {cell.margin:g}+ R"
        shown.append(plots.PlatePattern(upright(best.positions), best.radius, best.scan_radius, caption, note))
    title = f"Map of the patterns of {len(catalogue.findings[0].positions)} robots"
    subtitle = f"the best pattern of each of {len(cells)} {'cell' if len(cells) == 1 else 'cells'}"
    if len(cells) > MAX_DRAWN:
        subtitle += f"; the first {MAX_DRAWN}"
    plots.save(plots.plate_figure(shown[:MAX_DRAWN], title, subtitle), path)


def _draw(catalogue: Catalogue, path: Path) -> None:
    """Draws the plate of a catalogue's best classes."""
    from murmurate import plots

    classes, total = catalogue.classes, len(catalogue.findings)
    shown = classes[:MAX_DRAWN]
    subtitle = f"{len(classes)} {'class' if len(classes) == 1 else 'classes'} of {total} valid patterns, best first"
    if len(shown) < len(classes):
        subtitle += f"; the first {len(shown)}"
    title = f"Patterns of {len(catalogue.findings[0].positions)} robots"
    plots.save(plots.plate_figure([_plate_pattern(cls, total) for cls in shown], title, subtitle), path)


def _plate_pattern(pattern: PatternClass, total: int) -> PlatePattern:
    """Returns a class's representative with its mirror axis upright, if it has one, and its caption."""
    from murmurate import plots
    from murmurate.analysis import upright

    best, symbol = pattern.representative, pattern.symmetry.symbol
    caption = f"{symbol}{' · ' * bool(symbol)}{_layers(pattern)} · {pattern.count} of {total}"
    note = f"{best.objective} {pattern.value:.4f}"
    if pattern.gap is not None:
        note += f", {_gap(pattern)} short"
    return plots.PlatePattern(upright(best.positions), best.radius, best.scan_radius, caption, note)


def _gap(pattern: PatternClass) -> str:
    """Writes by how much a class is below the best-known pattern, as `table.gap` does: in percent of that one."""
    from murmurate.runs import table

    return table.gap({"gap": pattern.gap, "best_known": None if pattern.gap is None else pattern.gap + pattern.value})


def _layers(pattern_class: PatternClass) -> str:
    return "+".join(map(str, pattern_class.layers))


def _print(catalogue: Catalogue, out: Path) -> None:
    from rich.console import Console

    from murmurate.runs import catalogues, table

    header = ("class", "found", "symmetry", "layers", "objective", "gap", "margin", "starts")
    rows = [
        (
            pattern_class.name,
            str(pattern_class.count),
            pattern_class.symmetry.name,
            _layers(pattern_class),
            f"{pattern_class.representative.objective} {pattern_class.value:.4f}",
            _gap(pattern_class),
            f"{pattern_class.margin:.2f} R",
            ", ".join(f"{start} {count}" for start, count in pattern_class.starts.items()),
        )
        for pattern_class in catalogue.classes[:MAX_LISTED]
    ]
    console = Console()
    console.print(table.as_rich(header, rows))
    if len(catalogue.classes) > MAX_LISTED:
        say(f"and {len(catalogue.classes) - MAX_LISTED} more")
    say(f"classes: {out / catalogues.CLASSES}, all findings: {out / catalogues.CATALOGUE}")
    say(f"map: {out / catalogues.MAP}, {len(catalogue.cells())} cells")
    say(f"plates: {out / PLATE}, {out / MAP_PLATE}")
