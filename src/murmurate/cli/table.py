"""`murmurate table`: many runs as one Markdown table."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from murmurate.cli.arguments import Parser
from murmurate.errors import RunError
from murmurate.terminal import say, say_text

__all__ = ["run"]

DAMAGED = 2


def run(argv: Sequence[str]) -> int:
    """Runs the verb.

    Returns:
        0, also where some of the folders hold no finished run; 2 where one is damaged.
    """
    parser = Parser("table", "RUN...", "Prints the results of finished runs as a Markdown table.")
    parser.add_argument("runs", metavar="RUN", nargs="+", help="finished runs; other folders are left out and named")
    text = "import the modules that the runs name, which executes them"
    parser.add_argument("--trust", action="store_true", help=text)
    options, _ = parser.parse(argv)
    from murmurate.runs import table
    from murmurate.runs.folder import RunFolder

    finished, errors = [], {}
    for folder in options.runs:
        try:
            table.results([folder], options.trust)
            finished.append(folder)
        except RunError as error:
            errors[folder] = error
    if not finished:
        raise next(iter(errors.values()))
    say_text(table.as_markdown(*table.side_by_side(finished, options.trust)))
    for error in errors.values():
        say(f"murmurate: left out: {error}", file=sys.stderr)
    return DAMAGED if any(RunFolder(folder).is_finished() for folder in errors) else 0
