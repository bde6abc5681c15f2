"""Weights that come with the package: each a run, without its evaluation, that a named command makes again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import murmurate
from murmurate.errors import InputError, check_choice
from murmurate.experiments.comparison import SCHEDULERS, SENSINGS
from murmurate.experiments.run import Run

__all__ = ["FOLDER", "available", "pretrained"]

FOLDER = Path(murmurate.__file__).parent / "pretrained"
"""One folder for each objective and sensing, such as C2-visible; they serve every scheduler."""


def available() -> list[tuple[str, str]]:
    """Returns the objectives and sensings that there are weights for."""
    names = (path.parent.name for path in FOLDER.glob("*/manifest.json"))
    return sorted((name.partition("-")[0], name.partition("-")[2]) for name in names)


def pretrained(objective: str = "C2", sensing: str = "visible", scheduler: str = "fsync") -> Run:
    """Opens weights; see `murmurate.pretrained`.

    Raises:
        InputError: There are no such weights.
        RunError: They are damaged.
    """
    there = available()
    check_choice("objective", objective, sorted({one for one, _ in there}))
    check_choice("sensing", sensing, tuple(SENSINGS))
    check_choice("scheduler", scheduler, tuple(SCHEDULERS))
    if (objective, sensing) not in there:
        known = ", ".join(f"{eyes} with {one}" for one, eyes in there)
        raise InputError("sensing", sensing, f"one that there are weights for: {known}")
    run = Run.open(FOLDER / f"{objective}-{sensing}")
    return run if scheduler == "fsync" else run.under(replace(run.experiment, scheduler=SCHEDULERS[scheduler]))
