"""`murmurate evaluate`: executes the cascade of a run from other starts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from murmurate.cli.arguments import Parser
from murmurate.errors import InputError, UsageError

__all__ = ["run"]


def run(argv: Sequence[str]) -> int:
    """Runs the verb; returns 0."""
    parser = Parser("evaluate", "RUN", "Executes the cascade of a run from fresh starts, or from a file of starts.")
    parser.add_argument("run", metavar="RUN", help="folder of a finished run")
    many = "fresh starts to draw (default: 200), or how many to take of --starts (default: all)"
    parser.add_argument("--episodes", type=int, metavar="INT", help=many)
    parser.add_argument("--seed", type=int, metavar="INT", help="their seed (default: 0)")
    parser.add_argument("--starts", metavar="FILE.csv", help="start,x,y: one row a robot, every start in file order")
    parser.add_argument("--out", metavar="DIR", help="leave RUN as it is, and write a copy with the new evaluation")
    options, _ = parser.parse(argv)
    return _evaluate(Path(options.run), options.episodes, options.seed, options.starts, options.out)


def _evaluate(folder: Path, episodes: int | None, seed: int | None, starts: str | None, out: str | None) -> int:
    from murmurate.cli import outcome
    from murmurate.runs import evaluate, presets, storage, table
    from murmurate.runs.run import Run, check_draw
    from murmurate.world import check_configurations, read_starts

    if starts is not None and seed is not None:
        raise UsageError("--seed draws fresh starts: leave it out with --starts")
    if out is not None and Path(out).resolve() != folder.resolve():
        storage.look(out)
    count = evaluate.EPISODES if episodes is None else episodes
    seed = evaluate.SEED if seed is None else seed
    check_draw(count, seed)
    opened = Run.open(folder)
    world, points = opened.experiment.world, None
    if starts is not None:
        points = read_starts(starts, world.robots)
        check_configurations(points, world, starts)
        if (episodes or 0) > len(points):
            raise InputError("--episodes", episodes, f"at most the {len(points)} starts of {starts}")
        points = points[:episodes]
    result = evaluate.evaluate(opened, count, seed, points, Path(starts or "").name)
    folder = folder if out is None else opened.copy(out)
    result.save(folder)
    summary = table.read_evaluation(folder)
    outcome.print_comparison(summary, presets.paper_row(opened.experiment))
    outcome.print_record(folder)
    print(f"picture: {outcome.draw(folder)}")
    print(f"record: {folder / evaluate.EVALUATION}, {folder / evaluate.TRAJECTORIES}")
    return 0
