"""`murmurate show`: the figure and the animation of a run, or of the package's weights; or many runs' patterns."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from murmurate.cli import formations as formation_flags
from murmurate.cli.arguments import START_NAMES, Parser
from murmurate.errors import UsageError, escaped
from murmurate.terminal import say, say_text

if TYPE_CHECKING:
    from murmurate.plots import Recording
    from murmurate.runs.run import Run

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
    formation_flags.add_flags(parser, "; without RUN, by the package's weights for one shared frame")
    parser.add_argument("--robots", type=int, metavar="INT", help="swarm size, without RUN (default: 8)")
    parser.add_argument("--start", metavar="NAME", help=f"{START_NAMES} (default: random)")
    parser.add_argument("--objective", metavar="C1|C2", help="where to gather: C2 anywhere (default), C1 at the origin")
    parser.add_argument("--sensing", metavar="NAME", help="visible (default), global, chiral, noisy or shared")
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
        single = (options.episode, options.mp4 or None, options.animation, options.pattern, options.target)
        if options.out is None or any(option is not None for option in single):
            flags = "--episode, --animation, --mp4, --pattern nor --target"
            raise UsageError(f"of several runs, only the patterns are drawn: give --out, and neither {flags}")
        return _draw_patterns(folders, Path(options.out), options.trust)

    from murmurate import plots
    from murmurate.plots.animation import check_target
    from murmurate.runs.folder import RunFolder
    from murmurate.runs.pretrained import SHARED
    from murmurate.runs.run import Run

    if options.animation is not None:
        check_target(options.animation, "--animation")  # before patterns are formed
    if folders and not formation_flags.is_told(options):
        recording = plots.Recording.open(folders[0], options.trust)
        return _draw(recording, Path(options.out or RunFolder(folders[0]).figures), options)
    if folders:
        return _form_patterns(options, Run.open(folders[0], options.trust), str(folders[0]), PRETRAINED["seed"])
    if formation_flags.is_told(options):
        given.setdefault("sensing", SHARED)
    run, name = _package_weights(**PRETRAINED | given)
    return _form_patterns(options, run, name, (PRETRAINED | given)["seed"])


def _package_weights(
    robots: int, start: Any, objective: str, sensing: str, scheduler: str, seed: int
) -> tuple[Run, str]:
    """Returns the package's weights in a swarm, and the folder of the run that they make."""
    from murmurate import pretrained
    from murmurate.runs.given_starts import find_start
    from murmurate.runs.pretrained import SHARED

    begin = find_start(start, "start")
    run = pretrained(objective, sensing, scheduler).of_size(robots)
    name = start.replace(":", "-")  # no system allows a colon everywhere in a path
    # What is formed by robots that know all positions has the sizes that it remembers.
    sizes = run.experiment.sizes if sensing == SHARED else ()
    run = run.under(replace(run.experiment, sizes=sizes, start=begin))
    return run, f"runs/{objective}-{sensing}-{scheduler}-{robots}-{name}-seed{seed}"


def _form_patterns(options: Namespace, run: Run, name: str, seed: int) -> int:
    """Lets a swarm form patterns, keeps them as a run unless only an animation is wanted, and draws."""
    from murmurate import plots
    from murmurate.cli.progress import Progress
    from murmurate.runs.evaluate import evaluate
    from murmurate.runs.folder import RunFolder

    if formation_flags.is_told(options):
        run = formation_flags.told(run, options)
        name += "-target" if options.pattern is None else f"-pattern{options.pattern}"
    folder, robots = Path(options.out or name), run.experiment.world.robots
    if options.animation is None:
        RunFolder(folder).inspect()  # before patterns are formed
    episodes = max(1, min(EPISODES, MAX_PAIRS // robots**2))
    with Progress(quiet=options.quiet) as progress:
        evaluation = evaluate(run, episodes, seed, on_progress=progress.update)
    valid = int(evaluation.validity.valid.sum())
    starts = "1 start" if episodes == 1 else f"{episodes} starts"
    summary = f"{robots} robots, {starts}: {valid} ended in a valid pattern"
    if formation_flags.is_told(options):
        summary += f"\n{formation_flags.formed(run, evaluation.trajectories)}"
    if options.animation is not None:
        say_text(summary)
        return _draw(plots.Recording(run.experiment, evaluation.trajectories), Path(), options)
    run.save(folder)
    evaluation.save(folder)
    say_text(summary)
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
