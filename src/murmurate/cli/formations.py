"""The flags --pattern and --target: which formation a policy that remembers some forms."""

from __future__ import annotations

from argparse import Namespace
from typing import TYPE_CHECKING

from murmurate.cli.arguments import Parser

if TYPE_CHECKING:
    from murmurate.runs.run import Run
    from murmurate.types import Trajectories

__all__ = ["add_flags", "formed", "is_told", "told"]


def add_flags(parser: Parser, note: str = "") -> None:
    """Adds the two flags to a verb's parser, with a note on what they need."""
    pattern = f"form this one of the patterns that the policy remembers, or of a --target (1: the best){note}"
    parser.add_argument("--pattern", type=int, metavar="INT", help=pattern)
    target = f"form the formation in a table start,x,y of one start, or a pattern of a catalogue{note}"
    parser.add_argument("--target", metavar="FILE.csv|DIR", help=target)


def is_told(options: Namespace) -> bool:
    """Returns whether one of the flags is given."""
    return options.pattern is not None or options.target is not None


def told(run: Run, options: Namespace) -> Run:
    """Returns the run with the formation that the flags name.

    Raises:
        InputError: There is no such pattern, a table is not of one formation, or `Run.forming` refuses it.
        RunError: A catalogue is damaged.
    """
    from murmurate.runs import formations

    if options.target is None:
        return run.forming(options.pattern)
    return run.forming(formations.read_target(options.target, run.experiment.world, options.pattern))


def formed(run: Run, trajectories: Trajectories) -> str:
    """Says in how many episodes a swarm formed what it was told."""
    from murmurate.runs import formations

    near = formations.reached(run, trajectories)
    return f"formed within {formations.FORMED:g} R in {near.sum()} of {len(near)} episodes"
