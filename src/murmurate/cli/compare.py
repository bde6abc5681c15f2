"""`murmurate compare`: learned policies and baselines from the same starts, in a table and two figures."""

from __future__ import annotations

import os
import shlex
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from murmurate.cli.arguments import Parser
from murmurate.errors import InputError, RunError

if TYPE_CHECKING:
    from murmurate.runs.run import Run

__all__ = ["run"]

LEARNED = "learned"


def run(argv: Sequence[str]) -> int:
    """Runs the verb; returns 0."""
    text = (
        "Runs methods from the same random starts, with the same eyes and schedulers; writes a table and two figures."
    )
    parser = Parser("compare", "[RUN...]", text)
    what = "finished runs of the policy local (default: the package's weights, called learned)"
    parser.add_argument("runs", metavar="RUN", nargs="*", help=what)
    parser.add_argument("--methods", metavar="A,B", help="which of the runs, by name, and baselines (default: all)")
    parser.add_argument("--robots", metavar="N,N", default="4,8,12,16", help="swarm sizes (default: 4,8,12,16)")
    parser.add_argument("--sensing", metavar="A,B", default="visible", help="what robots perceive (default: visible)")
    parser.add_argument("--schedulers", metavar="A,B", default="fsync", help="when they move (default: fsync)")
    parser.add_argument("--starts", metavar="A,B", default="random", help="random, polygon, line, grid, rings")
    parser.add_argument("--objective", metavar="C1|C2", default="C2", help="of the package's weights (default: C2)")
    parser.add_argument(
        "--episodes", type=int, metavar="INT", default=1000, help="starts for each cell (default: 1000)"
    )
    parser.add_argument("--seed", type=int, metavar="INT", default=0, help="their seed (default: 0)")
    parser.add_argument("--out", metavar="DIR", default="runs/comparison", help="where to write, or to go on")
    parser.add_argument(
        "--into", metavar="FILE.md", help="put the table into this page as well, in place of the one there"
    )
    options, _ = parser.parse(argv)
    if options.into is not None and not Path(options.into).is_file():
        raise RunError(f"--into {options.into}: there is no such file")
    return _compare(options, shlex.join(["murmurate", "compare", *argv]))


def _compare(options: Namespace, command: str) -> int:
    from murmurate.cli.progress import Progress
    from murmurate.policies.baselines import BASELINES
    from murmurate.runs import comparison

    sizes = [_whole(word) for word in _words(options.robots, "--robots")]
    sensings, schedulers = _words(options.sensing, "--sensing"), _words(options.schedulers, "--schedulers")
    starts = _words(options.starts, "--starts")
    comparison.cells([], sensings, schedulers, sizes, starts)
    runs = _runs(options, sensings)
    names = [*runs, *BASELINES]
    methods = names if options.methods is None else _words(options.methods, "--methods")
    wanted = comparison.cells(methods, sensings, schedulers, sizes, starts, names)
    base = next(iter(next(iter(runs.values())).values())).experiment
    setting = comparison.Comparison(base, options.episodes, options.seed)
    with Progress() as progress:
        found = comparison.compare(setting, wanted, runs, options.out, progress.update, command)
    _tell(found)
    _write(options, setting)
    return 0


def _runs(options: Namespace, sensings: Sequence[str]) -> dict[str, dict[str, Run]]:
    """Returns the learned methods by name, and by what robots perceive."""
    from murmurate.runs.pretrained import pretrained
    from murmurate.runs.run import Run

    if not options.runs:
        return {LEARNED: {eyes: pretrained(options.objective, eyes) for eyes in sensings}}
    given: dict[str, dict[str, Run]] = {}
    for word in options.runs:
        opened = Run.open(word)
        policy = opened.experiment.policy
        if not policy.perceives:
            raise InputError(
                "policy.use", policy.name, f"local, to be compared by what its robots perceive: {word} is not"
            )
        name = Path(word).name
        if name in given:
            raise InputError("RUN", word, f"of another name than the others: {name} is there already")
        given[name] = dict.fromkeys(sensings, opened)
    return given


def _write(options: Namespace, setting: Any) -> None:
    """Writes the table and the figures of all that the folder holds."""
    from murmurate import plots
    from murmurate.policies.baselines import BASELINES
    from murmurate.runs import comparison, comparison_page, storage
    from murmurate.world import scaled_to

    out = Path(options.out)
    found, commands = comparison.sorted_rows(out), comparison.load(out).get("commands", [])
    plots.save(plots.comparison_figure(found), out / "comparison.png")
    pictures = [out / "comparison.png"]
    # Baselines fail in known ways: of interest is where what was learned does.
    learned = [row for row in found if row["method"] not in BASELINES] or found
    if any(row["worst"] for row in learned):
        world = setting.base.world
        worlds = {row["robots"]: scaled_to(world, row["robots"]) for row in found}
        plots.save(plots.failures_figure(learned, worlds), out / "failures.png")
        pictures.append(out / "failures.png")
    shown = {row["method"] for row in found}
    deviations = {name: one.deviations for name, one in BASELINES.items() if name in shown and one.deviations}
    notes = [f"`{name}`: {text}" for name, text in deviations.items()]
    storage.write_text(out / "comparison.md", comparison_page.page(found, commands, notes))
    if options.into is not None:
        page = Path(options.into)
        part = comparison_page.page(found, commands, notes, f"{os.path.relpath(out, page.parent)}/")
        storage.write_text(page, comparison_page.put_into(page.read_text("utf-8"), part))
    print(f"table: {out / 'comparison.md'}")
    print("pictures: " + ", ".join(map(str, pictures)))


def _tell(found: list[dict[str, Any]]) -> None:
    for row in found:
        low, high = (100 * share for share in row["interval"])
        cell = f"{row['method']}, {row['sensing']}, {row['scheduler']}, {row['start']}, N = {row['robots']}"
        valid = f"{row['valid']} of {row['episodes']} valid ({low:.1f}-{high:.1f}%)"
        print(f"{cell}: {valid}, {row['collisions']} collided, {row['left']} left the world")


def _words(text: str, flag: str) -> list[str]:
    words = [word.strip() for word in text.split(",")]
    if not all(words):
        raise InputError(flag, text, "names or numbers, separated by commas")
    return list(dict.fromkeys(words))


def _whole(word: str) -> int:
    if not word.isdecimal():
        raise InputError("--robots", word, "whole numbers, separated by commas")
    return int(word)
