"""`murmurate evaluate`: executes the cascade of a run from other starts."""

from __future__ import annotations

from collections.abc import Sequence

from murmurate.cli import formations as formation_flags
from murmurate.cli.arguments import START_NAMES, Parser
from murmurate.errors import UsageError
from murmurate.terminal import say

__all__ = ["run"]


def run(argv: Sequence[str]) -> int:
    """Runs the verb; returns 0."""
    parser = Parser("evaluate", "RUN", "Executes the cascade of a run from fresh starts, a set or a file.")
    parser.add_argument("run", metavar="RUN", help="folder of a finished run")
    episodes = "number of starts (default: 200, or all of a file)"
    parser.add_argument("--episodes", type=int, metavar="INT", help=episodes)
    seed = "seed of the fresh starts, of frames, noise and scheduler (default: 0)"
    parser.add_argument("--seed", type=int, metavar="INT", help=seed)
    starts = f"{START_NAMES}; or a file start,x,y: one row a robot, every start in file order. The first ten are sets"
    parser.add_argument("--starts", metavar="NAME|FILE.csv", help=starts)
    formation_flags.add_flags(parser, ", with --out")
    parser.add_argument("--out", metavar="DIR", help="leave RUN as it is, and write a copy with the new evaluation")
    parser.add_argument("--trust", action="store_true", help="import the modules that RUN names, which executes them")
    parser.add_argument("--quiet", action="store_true", help="do not show the progress")
    options, _ = parser.parse(argv)

    is_other = formation_flags.is_told(options)
    if is_other and options.out is None:
        raise UsageError("--pattern and --target make a run that forms something else: give --out too")
    from murmurate.cli import summary
    from murmurate.cli.progress import Progress
    from murmurate.runs import evaluate
    from murmurate.runs.folder import RunFolder
    from murmurate.runs.run import Run, check_draw

    folder, target = RunFolder(options.run), RunFolder(options.out or options.run)
    is_copy = target.path.resolve() != folder.path.resolve()
    if is_copy:
        target.inspect()
    seed = evaluate.SEED if options.seed is None else options.seed
    check_draw(evaluate.EPISODES if options.episodes is None else options.episodes, seed)
    opened = Run.open(folder.path, options.trust)
    if is_other:
        opened = formation_flags.told(opened, options)
    with Progress(quiet=options.quiet) as progress:
        result = evaluate.evaluate(opened, options.episodes, seed, options.starts, on_progress=progress.update)
    if is_other:
        opened.save(target.path)
    elif is_copy:
        folder.copy_to(target)
    result.save(target)
    summary.print_results(opened, target)
    if is_other:
        say(formation_flags.formed(opened, result.trajectories))
    say(f"picture: {summary.draw(target)}")
    say("record: " + ", ".join(map(str, target.evaluation_files)))
    return 0
