"""`murmurate experiments`: lists the experiments, or writes one out as TOML."""

from __future__ import annotations

from collections.abc import Sequence

from murmurate.cli.arguments import Parser
from murmurate.errors import UsageError, check_choice
from murmurate.runs.paper import ALLOWED, EXPERIMENTS, check_experiment
from murmurate.runs.problems import PROBLEMS
from murmurate.terminal import say, say_text

__all__ = ["run"]

LEARNERS = ("formation", "equivariant", "central", "local", "paper")
"""The training presets, spelled out because they are known only once JAX is loaded."""

HEADER = ("", "robots", "gathers", "start", "X = Y", "R", "scan", "safe", "speed", "steps")


def run(argv: Sequence[str]) -> int:
    """Runs the verb; returns 0."""
    parser = Parser("experiments", "[EXPERIMENT]", "Lists the experiments; with a name, writes that one out as TOML.")
    parser.add_argument("experiment", metavar="EXPERIMENT", nargs="?", help=ALLOWED)
    usual = f"that of the policy, or else {LEARNERS[0]} for A to F and {LEARNERS[1]} for others"
    text = f"whose numbers: {', '.join(LEARNERS)} (default: {usual})"
    parser.add_argument("--learner", metavar="NAME", help=text)
    options, _ = parser.parse(argv)
    if options.learner is not None:
        if options.experiment is None:
            raise UsageError("--learner is for one experiment: give its name")
        check_choice("learner", options.learner, LEARNERS)
    if options.experiment is not None:
        check_experiment(options.experiment)
        from murmurate.runs import config_io, presets

        say_text(config_io.dump_toml(presets.resolve(options.experiment, learner=options.learner)))
        return 0
    _print_all()
    say()
    say("steps: the paper's. murmurate experiments C writes C out with all its fields; murmurate discover C runs it.")
    say()
    width = max(map(len, PROBLEMS))
    for name, formed in PROBLEMS.items():
        say(f"{name:{width}}  {formed}")
    say()
    say("Problems for 4 to 10 robots: murmurate discover circle")
    return 0


def _print_all() -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(*HEADER, box=None, padding=(0, 2, 0, 0))
    for row in EXPERIMENTS.values():
        world = row.world
        sizes = (world.half_width, world.radius, world.scan_radius, world.safe_distance, world.max_speed)
        table.add_row(
            row.name,
            str(world.robots),
            "at the origin" if row.objective == "C1" else "anywhere",
            row.start,
            *(f"{value:g}" for value in sizes),
            f"{row.total_steps:.2f}",
        )
    Console().print(table)
