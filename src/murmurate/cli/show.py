"""`murmurate show`: the figure and the animation of a run, or of the package's weights; or many runs' patterns."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from murmurate.cli.arguments import START_NAMES, Parser
from murmurate.errors import UsageError, escaped
from murmurate.terminal import say

if TYPE_CHECKING:
    from murmurate.plots import Recording

__all__ = ["run"]

PRETRAINED: dict[str, Any] = {
    "robots": 8,
    "start": "random",
    "objective": "C2",
    "sensing": "visible",
    "scheduler": "fsync",
    "seed": 0,
}
"""The options of the package's weights, with their defaults."""

EPISODES = 32
"""Starts from which the package's weights form patterns, to draw a typical one; fewer for large swarms."""

MAX_PAIRS = 2**18
"""Pairs of robots in all of these episodes together, at most."""


def run(argv: Sequence[str]) -> int:
    """Runs the verb; returns 0."""
    parser = Parser("show", "RUN...", "Draws the figure and the animation of a run; of several, their patterns.")
    parser.add_argument("runs", metavar="RUN", nargs="*", help="finished runs; none: the package's weights")
    parser.add_argument("--episode", type=int, metavar="INT", help="which episode (default: a typical one)")
    parser.add_argument("--animation", metavar="FILE", help="write this file only, a .webp, .gif or .mp4")
    parser.add_argument("--mp4", action="store_true", help="animate as mp4 (needs the video extra) instead of GIF")
    parser.add_argument("--out", metavar="DIR", help="where to write (default: RUN/figures, or a folder in runs)")
    parser.add_argument("--quiet", action="store_true", help="do not show the progress")
    text = "import the modules that the runs name, which executes them"
    parser.add_argument("--trust", action="store_true", help=text)
    parser.add_argument("--robots", type=int, metavar="INT", help="swarm size, without RUN (default: 8)")
    parser.add_argument("--start", metavar="NAME", help=f"{START_NAMES} (default: random)")
    parser.add_argument("--objective", metavar="C1|C2", help="where to gather: C2 anywhere (default), C1 at the origin")
    parser.add_argument("--sensing", metavar="NAME", help="visible (default), global, chiral or noisy")
    parser.add_argument("--scheduler", metavar="NAME", help="when they move (default: fsync)")
    parser.add_argument("--seed", type=int, metavar="INT", help="seed of the starts (default: 0)")
    options, _ = parser.parse(argv)
    folders = [Path(word) for word in options.runs]
    given = {name: value for name in PRETRAINED if (value := getattr(options, name)) is not None}
    if folders and given:
        raise UsageError(f"--{next(iter(given))} is for the package's weights: give it without RUN")
    if options.animation is not None and (options.mp4 or options.out is not None):
        raise UsageError("--animation names the only file to write: give it without --mp4 and --out")
    if len(folders) > 1:
        if options.out is None or options.episode is not None or options.mp4 or options.animation is not None:
            flags = "--episode, --animation nor --mp4"
            raise UsageError(f"of several runs, only the patterns are drawn: give --out, and neither {flags}")
        return _draw_patterns(folders, Path(options.out), options.trust)

    from murmurate import plots
    from murmurate.plots.animation import check_target
    from murmurate.runs.folder import RunFolder

    if options.animation is not None:
        check_target(options.animation, "--animation")  # before patterns are formed
    if folders:
        recording = plots.Recording.open(folders[0], options.trust)
        return _draw(recording, Path(options.out or RunFolder(folders[0]).figures), options)
    return _form_patterns(options, **PRETRAINED | given)


def _form_patterns(
    options: Namespace, robots: int, start: Any, objective: str, sensing: str, scheduler: str, seed: int
) -> int:
    """Lets the package's weights form patterns, keeps them as a run unless only an animation is wanted, and draws."""
    from murmurate import plots, pretrained
    from murmurate.cli.progress import Progress
    from murmurate.runs.evaluate import evaluate
    from murmurate.runs.folder import RunFolder
    from murmurate.runs.given_starts import find_start

    begin = find_start(start, "start")
    run = pretrained(objective, sensing, scheduler).of_size(robots)
    run = run.under(replace(run.experiment, sizes=(), start=begin))
    name = start.replace(":", "-")  # no system allows a colon everywhere in a path
    folder = Path(options.out or f"runs/{objective}-{sensing}-{scheduler}-{robots}-{name}-seed{seed}")
    if options.animation is None:
        RunFolder(folder).inspect()  # before patterns are formed
    episodes = max(1, min(EPISODES, MAX_PAIRS // robots**2))
    with Progress(quiet=options.quiet) as progress:
        evaluation = evaluate(run, episodes, seed, on_progress=progress.update)
    valid = int(evaluation.validity.valid.sum())
    starts = "1 start" if episodes == 1 else f"{episodes} starts"
    summary = f"{robots} robots, {starts}: {valid} ended in a valid pattern"
    if options.animation is not None:
        say(summary)
        return _draw(plots.Recording(run.experiment, evaluation.trajectories), Path(), options)
    run.save(folder)
    evaluation.save(folder)
    say(summary)
    return _draw(plots.Recording.open(folder), RunFolder(folder).figures, options)


def _draw(recording: Recording, out: Path, options: Namespace) -> int:
    """Draws the figure and the animation of one run, or the animation alone."""
    from murmurate import plots

    animation = Path(options.animation or out / f"discovery.{'mp4' if options.mp4 else 'gif'}")
    plots.animate(recording, animation, options.episode)
    if options.animation is None:
        plots.save(plots.discovery_figure(recording, options.episode), out / "discovery.png")
        say(f"picture: {out / 'discovery.png'}")
    say(f"animation: {animation}")
    return 0


def _draw_patterns(folders: list[Path], out: Path, trust: bool) -> int:
    """Draws the patterns of several runs, each named by its folder and the fields that tell it from the others."""
    from murmurate import plots
    from murmurate.runs import table

    recordings = [plots.Recording.open(folder, trust) for folder in folders]
    names = [folder.resolve().name for folder in folders]
    if len(set(names)) < len(names):
        names = [str(folder) for folder in folders]
    names = [escaped(name) for name in names]  # fonts have no control characters, nor bytes of other encodings
    notes = table.differences([recording.experiment for recording in recordings])
    for name, note in zip(names, notes, strict=True):
        say(f"{name}{': ' * bool(note)}{note}")
    plots.save(plots.patterns_figure(recordings, names, notes), out / "patterns.png")
    say(f"picture: {out / 'patterns.png'}")
    return 0
