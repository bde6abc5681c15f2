"""`murmurate evaluate`: executes the cascade of a run from other starts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from murmurate.cli.arguments import Parser
from murmurate.errors import UsageError

__all__ = ["run"]


def run(argv: Sequence[str]) -> int:
    """Runs the verb; returns 0."""
    parser = Parser("evaluate", "RUN", "Executes the cascade of a run from fresh starts, or from a file of starts.")
    parser.add_argument("run", metavar="RUN", help="folder of a finished run")
    parser.add_argument("--episodes", type=int, metavar="INT", help="fresh starts to draw (default: 200)")
    parser.add_argument("--seed", type=int, metavar="INT", help="their seed (default: 0)")
    parser.add_argument("--starts", metavar="FILE.csv", help="start,x,y: one row a robot, every start in file order")
    parser.add_argument("--out", metavar="DIR", help="leave RUN as it is, and write a copy with the new evaluation")
    options, _ = parser.parse(argv)
    if options.starts is not None and (options.episodes is not None or options.seed is not None):
        raise UsageError("--starts takes every start of its file: leave out --episodes and --seed")
    return _evaluate(Path(options.run), options.episodes, options.seed, options.starts, options.out)


def _evaluate(folder: Path, episodes: int | None, seed: int | None, starts: str | None, out: str | None) -> int:
    from murmurate.cli import outcome
    from murmurate.experiments import evaluation, presets, tables
    from murmurate.experiments.run import Run, check_draw
    from murmurate.world import check_configurations, read_starts

    episodes = evaluation.EPISODES if episodes is None else episodes
    seed = evaluation.SEED if seed is None else seed
    check_draw(episodes, seed)
    opened = Run.open(folder)
    world, points = opened.experiment.world, None
    if starts is not None:
        points = read_starts(starts, world.robots)
        check_configurations(points, world, starts)
    result = evaluation.evaluate(opened, episodes, seed, points, Path(starts or "").name)
    folder = folder if out is None else opened.copy(out)
    result.save(folder)
    summary = tables.read_evaluation(folder)
    row = presets.paper_row(opened.experiment) if points is None else None
    outcome.print_comparison(summary, row)
    print(f"picture: {outcome.draw(folder)}")
    print(f"record: {folder / evaluation.EVALUATION}, {folder / evaluation.TRAJECTORIES}")
    return 0
