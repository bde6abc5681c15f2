"""`murmurate evaluate`: executes the cascade of a run from other starts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from murmurate.cli.arguments import Parser
from murmurate.errors import InputError

__all__ = ["run"]


def run(argv: Sequence[str]) -> int:
    """Runs the verb; returns 0."""
    parser = Parser("evaluate", "RUN", "Executes the cascade of a run from fresh starts, or from a file of starts.")
    parser.add_argument("run", metavar="RUN", help="folder of a finished run")
    episodes = "number of fresh starts (default: 200), or how many to take of --starts (default: all)"
    parser.add_argument("--episodes", type=int, metavar="INT", help=episodes)
    seed = "seed of the fresh starts, of frames, noise and scheduler (default: 0)"
    parser.add_argument("--seed", type=int, metavar="INT", help=seed)
    parser.add_argument("--starts", metavar="FILE.csv", help="start,x,y: one row a robot, every start in file order")
    parser.add_argument("--out", metavar="DIR", help="leave RUN as it is, and write a copy with the new evaluation")
    parser.add_argument("--trust", action="store_true", help="import the modules that RUN names, which executes them")
    parser.add_argument("--quiet", action="store_true", help="do not show the progress")
    options, _ = parser.parse(argv)

    import numpy as np

    from murmurate.cli import summary
    from murmurate.cli.progress import Progress
    from murmurate.runs import evaluate
    from murmurate.runs.folder import RunFolder
    from murmurate.runs.run import Run, check_draw
    from murmurate.world import check_configurations, read_named_starts

    folder, target = RunFolder(options.run), RunFolder(options.out or options.run)
    is_copy = target.path.resolve() != folder.path.resolve()
    if is_copy:
        target.inspect()
    episodes = evaluate.EPISODES if options.episodes is None else options.episodes
    seed = evaluate.SEED if options.seed is None else options.seed
    check_draw(episodes, seed)
    opened = Run.open(folder.path, options.trust)
    world, starts, file = opened.experiment.world, None, None
    if options.starts is not None:
        named, file = read_named_starts(options.starts, world.robots), Path(options.starts).name
        starts = np.array(list(named.values()))
        check_configurations(starts, world, options.starts, list(named))
        if (options.episodes or 0) > len(starts):
            raise InputError("--episodes", options.episodes, f"at most the {len(starts)} starts of {options.starts}")
        starts = starts[: options.episodes]
    with Progress(quiet=options.quiet) as progress:
        result = evaluate.evaluate(opened, episodes, seed, starts, file, on_progress=progress.update)
    if is_copy:
        folder.copy_to(target)
    result.save(target)
    summary.print_results(opened, target)
    print(f"picture: {summary.draw(target)}")
    print("record: " + ", ".join(map(str, target.evaluation_files)))
    return 0
