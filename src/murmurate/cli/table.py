"""`murmurate table`: many runs as one Markdown table."""

from __future__ import annotations

from collections.abc import Sequence

from murmurate.cli.arguments import Parser

__all__ = ["run"]


def run(argv: Sequence[str]) -> int:
    """Runs the verb; returns 0."""
    parser = Parser("table", "RUN...", "Prints the results of finished runs as a Markdown table.")
    parser.add_argument("runs", metavar="RUN", nargs="+", help="folder of a finished run")
    text = "import the modules that the runs name, which executes them"
    parser.add_argument("--trust", action="store_true", help=text)
    options, _ = parser.parse(argv)
    from murmurate.runs import table

    print(table.as_markdown(table.RESULTS, table.results(options.runs, options.trust)), end="")
    return 0
