"""`murmurate show`: the figure and the animation of a run, or of the package's weights; or many runs' patterns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from murmurate.cli.arguments import Parser
from murmurate.errors import UsageError

if TYPE_CHECKING:
    from murmurate.plots import Record

__all__ = ["run"]

WEIGHTS = ("robots", "start", "objective", "sensing", "scheduler", "seed")
STARTS = ("random", "scattered", "distributed", "packed")

EPISODES = 32
"""Starts from which the package's weights form patterns, to draw a typical one."""


def run(argv: Sequence[str]) -> int:
    """Runs the verb; returns 0."""
    parser = Parser("show", "RUN...", "Draws the figure and the animation of a run; of several, their patterns.")
    parser.add_argument("runs", metavar="RUN", nargs="*", help="finished runs; none: the package's weights")
    parser.add_argument("--episode", type=int, metavar="INT", help="which episode (default: a typical one)")
    parser.add_argument("--mp4", action="store_true", help="animate as mp4 (needs the video extra) instead of GIF")
    parser.add_argument("--out", metavar="DIR", help="where to write (default: RUN/figures, or a folder in runs)")
    parser.add_argument("--robots", type=int, metavar="INT", help="swarm size, without RUN (default: 8)")
    parser.add_argument("--start", metavar="KIND", help="random, scattered, distributed or packed (default: random)")
    parser.add_argument("--objective", metavar="C1|C2", help="where to gather: C2 anywhere (default), C1 at the origin")
    parser.add_argument("--sensing", metavar="NAME", help="visible (default), global, chiral or noisy")
    parser.add_argument("--scheduler", metavar="NAME", help="when they move (default: fsync)")
    parser.add_argument("--seed", type=int, metavar="INT", help="seed of the starts (default: 0)")
    options, _ = parser.parse(argv)
    folders = [Path(word) for word in options.runs]
    chosen = {name: value for name in WEIGHTS if (value := getattr(options, name)) is not None}
    if folders and chosen:
        raise UsageError(f"--{next(iter(chosen))} is for the package's weights: give it without RUN")
    if not folders:
        return _show(_formed(options.out, **chosen), None, options.episode, options.mp4)
    if len(folders) == 1:
        return _show(folders[0], options.out, options.episode, options.mp4)
    if options.out is None or options.episode is not None or options.mp4:
        raise UsageError("of several runs, only the patterns are drawn: give --out, and neither --episode nor --mp4")
    return _show_patterns(folders, Path(options.out))


def _formed(
    out: str | None,
    robots: int = 8,
    start: Any = "random",
    objective: str = "C2",
    sensing: str = "visible",
    scheduler: str = "fsync",
    seed: int = 0,
) -> Path:
    """Lets the package's weights form patterns, and returns the folder of that run."""
    from murmurate import pretrained
    from murmurate.errors import check_choice
    from murmurate.runs.evaluate import evaluate
    from murmurate.world import Start

    check_choice("start", start, STARTS)
    run = pretrained(objective, sensing, scheduler).of_size(robots)
    run = run.under(replace(run.experiment, sizes=(), start=Start.registered()[start]()))
    folder = Path(out or f"runs/{objective}-{sensing}-{scheduler}-{robots}-{start}-seed{seed}")
    evaluation = evaluate(run, EPISODES, seed)
    run.save(folder)
    evaluation.save(folder)
    print(f"{robots} robots, {EPISODES} starts: {int(evaluation.validity.valid.sum())} ended in a valid pattern")
    return folder


def _show(folder: Path, to: str | None, episode: int | None, mp4: bool) -> int:
    from murmurate import plots

    record, out = _record(folder), Path(to or folder / "figures")
    animation = out / f"discovery.{'mp4' if mp4 else 'gif'}"
    figure = plots.discovery_figure(record, episode)
    plots.animate(record, animation, episode)
    plots.save(figure, out / "discovery.png")
    print(f"picture: {out / 'discovery.png'}")
    print(f"animation: {animation}")
    return 0


def _show_patterns(folders: list[Path], out: Path) -> int:
    from murmurate import plots

    records = [_record(folder) for folder in folders]
    plots.save(plots.patterns_figure(records, [record.name for record in records]), out / "patterns.png")
    print(f"picture: {out / 'patterns.png'}")
    return 0


def _record(folder: Path) -> Record:
    """Opens the record of a run whose files are as its manifest says."""
    from murmurate import plots
    from murmurate.runs import storage

    storage.verify(folder, storage.read_manifest(folder))
    return plots.Record.open(folder)
