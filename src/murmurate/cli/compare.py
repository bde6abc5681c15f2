"""`murmurate compare`: learned policies and baselines from the same starts, in a table and two figures."""

from __future__ import annotations

import os
import shlex
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from murmurate.cli.arguments import START_NAMES, Parser
from murmurate.errors import InputError, RunError, printable
from murmurate.terminal import say, say_text

if TYPE_CHECKING:
    from murmurate.runs.comparison import Comparison
    from murmurate.runs.run import Run

__all__ = ["run"]

LEARNED = "learned"


def run(argv: Sequence[str]) -> int:
    """Runs the verb; returns 0."""
    text = "Runs methods from the same starts, with the same sensing and schedulers; writes a table and two figures."
    parser = Parser("compare", "[RUN...]", text)
    text = "finished runs of a policy that acts on what robots perceive, such as local, with the same world, "
    text += "objective, rest rule and shield (default: the package's weights, called learned)"
    parser.add_argument("runs", metavar="RUN", nargs="*", help=text)
    text = "which of the runs, by name, and baselines, of one's own as module:Class (default: all)"
    parser.add_argument("--methods", metavar="A,B", help=text)
    parser.add_argument("--robots", metavar="N,N", default="4,8,12,16", help="swarm sizes (default: 4,8,12,16)")
    text = "what robots perceive: global, visible, chiral, noisy, or module:Class (default: visible)"
    parser.add_argument("--sensing", metavar="A,B", default="visible", help=text)
    text = "when they move: fsync, ssync, adversarial, async, async-nonrigid, or module:Class (default: fsync)"
    parser.add_argument("--schedulers", metavar="A,B", default="fsync", help=text)
    text = f"{START_NAMES} (default: random, which is where the first run's experiment begins)"
    parser.add_argument("--starts", metavar="A,B", default="random", help=text)
    parser.add_argument("--objective", metavar="C1|C2", default="C2", help="of the package's weights (default: C2)")
    text = "starts for each condition (default: 1000)"
    parser.add_argument("--episodes", type=int, metavar="INT", default=1000, help=text)
    text = "seed of starts but those of sets, of frames, noise and schedulers (default: 0)"
    parser.add_argument("--seed", type=int, metavar="INT", default=0, help=text)
    parser.add_argument("--out", metavar="DIR", default="runs/comparison", help="where to write, or to go on")
    text = "put the table into this page as well, in place of the one there"
    parser.add_argument("--into", metavar="FILE.md", help=text)
    text = "evaluate in so many processes of one core each (default: one condition after the other, on all cores)"
    parser.add_argument("--workers", type=int, metavar="INT", help=text)
    text = "import the modules that the runs name, which executes them"
    parser.add_argument("--trust", action="store_true", help=text)
    parser.add_argument("--quiet", action="store_true", help="do not show the progress")
    parser.epilog = "Conditions that are done are not evaluated again: after an interruption, give the same command."
    options, _ = parser.parse(argv)
    if options.into is not None and not Path(options.into).is_file():
        raise RunError(f"--into {options.into}: there is no such file")
    try:
        _compare(options, shlex.join(["murmurate", "compare", *argv]))
    except KeyboardInterrupt:
        raise KeyboardInterrupt("interrupted; the same command goes on") from None
    return 0


def _compare(options: Namespace, command: str) -> None:
    from murmurate.policies.baselines import Baseline
    from murmurate.runs.comparison import Comparison, compare, conditions, shared_experiment
    from murmurate.runs.execute import InProcess, LocalProcesses

    executor = InProcess() if options.workers is None else LocalProcesses(options.workers)
    sizes = [_whole(word) for word in _words(options.robots, "--robots")]
    sensings, schedulers = _words(options.sensing, "--sensing"), _words(options.schedulers, "--schedulers")
    starts = _words(options.starts, "--starts")
    opened = _opened(options.runs, options.trust)
    conditions([], sensings, schedulers, sizes, starts)
    runs = {name: dict.fromkeys(sensings, run) for name, run in opened.items()} or _weights(options, sensings)
    names = [*runs, *Baseline.registered()]
    methods = names if options.methods is None else _words(options.methods, "--methods")
    wanted = conditions(methods, sensings, schedulers, sizes, starts, names)
    learned = [name for name in runs if name in methods] or list(runs)[:1]
    base = shared_experiment({name: next(iter(runs[name].values())).experiment for name in learned})
    comparison = Comparison(base, options.episodes, options.seed)
    rows = compare(comparison, wanted, runs, options.out, executor, command=command, quiet=options.quiet)
    say_text("\n".join(map(_line, rows)))
    _write(options, comparison)


def _weights(options: Namespace, sensings: Sequence[str]) -> dict[str, dict[str, Run]]:
    """Returns the package's weights by what robots perceive: for a user's own sensing, those for visible robots."""
    from murmurate.runs.comparison import SENSINGS
    from murmurate.runs.pretrained import pretrained

    return {
        LEARNED: {
            sensing: pretrained(options.objective, sensing if sensing in SENSINGS else "visible")
            for sensing in sensings
        }
    }


def _opened(folders: Sequence[str], trust: bool) -> dict[str, Run]:
    """Returns the runs by the names of their folders."""
    from murmurate.runs.run import Run

    runs: dict[str, Run] = {}
    for word in folders:
        opened = Run.open(word, trust)
        policy = opened.experiment.policy
        if not policy.perceives:
            raise InputError(
                "policy.use", policy.name, f"local, to be compared by what its robots perceive: {word} is not"
            )
        name = Path(word).name
        if name in runs:
            raise InputError("RUN", word, f"of another name than the others: {name} is there already")
        runs[name] = opened
    return runs


def _write(options: Namespace, comparison: Comparison) -> None:
    """Writes the table and the figures of all rows that the folder holds."""
    from murmurate import plots
    from murmurate.runs import comparison_page, escape, files
    from murmurate.runs.comparison import deviations, is_baseline, load, sorted_rows
    from murmurate.world import scaled_to

    out = Path(options.out)
    rows, commands = sorted_rows(out), load(out)["commands"]
    pictures = [out / "comparison.png", out / "failures.png"]
    plots.save(plots.comparison_figure(rows), pictures[0])
    # Baselines fail in known ways: of interest is where learned methods do.
    learned = [row for row in rows if not is_baseline(row["method"])] or rows
    worlds = {row["robots"]: scaled_to(comparison.base.world, row["robots"]) for row in rows}
    plots.save(plots.failures_figure(learned, worlds), pictures[1])
    notes = [f"{escape.code(method)}: {text}" for method, text in deviations(rows).items()]
    files.write_text(out / "comparison.md", comparison_page.page(rows, commands, notes))
    if options.into is not None:
        page = Path(options.into)
        part = comparison_page.page(rows, commands, notes, f"{os.path.relpath(out, page.parent)}/")
        files.write_text(page, comparison_page.put_into(page.read_text("utf-8"), part))
    say(f"table: {out / 'comparison.md'}")
    say("pictures: " + ", ".join(map(str, pictures)))


def _line(row: dict[str, Any]) -> str:
    low, high = (100 * share for share in row["interval"])
    condition = f"{printable(row['method'])}, {row['sensing']}, {row['scheduler']}, {row['start']}, N = {row['robots']}"
    valid = f"{row['valid']} of {row['episodes']} valid ({low:.1f}-{high:.1f}%)"
    return f"{condition}: {valid}, {row['collisions']} collided, {row['left']} left the world"


def _words(text: str, flag: str) -> list[str]:
    names = [word.strip() for word in text.split(",")]
    if not all(names):
        raise InputError(flag, text, "names or numbers, separated by commas")
    return list(dict.fromkeys(names))


def _whole(word: str) -> int:
    if not word.isdecimal():
        raise InputError("--robots", word, "whole numbers, separated by commas")
    return int(word)
