"""`murmurate starts`: writes a named set of starts as a table, or lists the sets."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from murmurate.cli.arguments import Parser
from murmurate.errors import RunError
from murmurate.terminal import say

__all__ = ["run"]


def run(argv: Sequence[str]) -> int:
    """Runs the verb; returns 0."""
    text = "Writes a named set of starts, the same on every machine, as a table start,x,y; without a word, lists them."
    parser = Parser("starts", "[FAMILY]", text)
    families = "random, cluster, corner, wall, walls, tight-grid, polygon, line, grid or rings"
    parser.add_argument("family", metavar="FAMILY", nargs="?", help=families)
    parser.add_argument("--robots", type=int, metavar="INT", default=8, help="swarm size (default: 8)")
    text = "how many starts; the first are the same whatever the number (default: 1000)"
    parser.add_argument("--count", type=int, metavar="INT", default=1000, help=text)
    parser.add_argument("--out", metavar="FILE.csv", help="where to write them (default: FAMILY-N.csv)")
    parser.epilog = "murmurate evaluate RUN --starts FAMILY begins at the same starts."
    options, _ = parser.parse(argv)

    from murmurate.runs import files
    from murmurate.world import start_sets

    if options.family is None:
        known = start_sets.checksums()
        for family in start_sets.FAMILIES:
            sizes = [robots for robots in start_sets.SIZES if start_sets.set_name(family, robots) in known]
            say(f"{start_sets.VERSION}/{family}: N = {', '.join(map(str, sizes))}")
        return 0
    points = start_sets.start_set(options.family, options.robots, options.count)
    out = Path(options.out or f"{options.family}-{options.robots}.csv")
    if out.exists():
        raise RunError(f"{out} is there already: choose another --out")
    # The shortest decimals that single precision reads back as the same number.
    rows = [f"{number},{x},{y}" for number, start in enumerate(points.astype(str)) for x, y in start]
    files.write_text(out, "\n".join(["start,x,y", *rows, ""]))
    sizes, name = start_sets.set_world(options.robots), start_sets.set_name(options.family, options.robots)
    say(f"{name}: {options.count} starts in |x|, |y| <= {sizes.half_width:g}, robots of radius {sizes.radius:g}")
    say(f"starts: {out}")
    return 0
