"""Weights that come with the package: each a run, without its evaluation, that a named command makes again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import murmurate
from murmurate.errors import check_choice
from murmurate.runs.comparison import SCHEDULERS, SENSINGS
from murmurate.runs.folder import RunFolder
from murmurate.runs.run import Run

__all__ = ["CARD", "FOLDER", "SHARED", "available", "pretrained", "run_folder"]

FOLDER = Path(murmurate.__file__).parent / "pretrained"
"""One folder for each objective, in it one for each kind of sensing: weights serve every scheduler."""

SHARED = "shared"
"""Stands in place of a kind of sensing for the weights of robots that know all positions in one frame."""

CARD = "README.md"
"""The card beside each set of weights: what it is, how it was trained, and where it was measured."""


def available() -> dict[str, tuple[str, ...]]:
    """Returns the objectives that there are weights for, and for which kinds of sensing."""
    available = sorted((path.parent.name, path.name) for path in FOLDER.glob("*/*") if RunFolder(path).is_finished())
    return {objective: tuple(sensing for name, sensing in available if name == objective) for objective, _ in available}


def run_folder(word: str) -> Path:
    """Returns the folder of a run: that of the package's weights for a name such as C2-visible, unless there is one."""
    objective, _, sensing = word.partition("-")
    is_weights = sensing in available().get(objective, ()) and not Path(word).exists()
    return FOLDER / objective / sensing if is_weights else Path(word)


def pretrained(objective: str = "C2", sensing: str = "visible", scheduler: str = "fsync") -> Run:
    """Opens weights; see `murmurate.pretrained`.

    Raises:
        InputError: There are no such weights, or no such sensing or scheduler.
        RunError: They are damaged.
    """
    known = available()
    check_choice("objective", objective, tuple(known))
    folders = {name: kind.name for name, kind in SENSINGS.items()} | {SHARED: SHARED}
    check_choice("sensing", sensing, tuple(name for name, folder in folders.items() if folder in known[objective]))
    check_choice("scheduler", scheduler, tuple(SCHEDULERS))
    run = Run.open(FOLDER / objective / folders[sensing])
    perceived = run.experiment.sensing if sensing == SHARED else SENSINGS[sensing]
    return run.under(replace(run.experiment, sensing=perceived, scheduler=SCHEDULERS[scheduler]))
