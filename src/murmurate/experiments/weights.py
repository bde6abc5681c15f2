"""Weights that come with the package: each a run, without its evaluation, that a named command makes again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import murmurate
from murmurate.errors import check_choice
from murmurate.experiments.comparison import SCHEDULERS, SENSINGS
from murmurate.experiments.run import Run
from murmurate.experiments.storage import MANIFEST

__all__ = ["FOLDER", "available", "pretrained"]

FOLDER = Path(murmurate.__file__).parent / "pretrained"
"""One folder for each objective: its weights serve every sensing and every scheduler."""


def available() -> tuple[str, ...]:
    """Returns the objectives that there are weights for."""
    return tuple(sorted(path.parent.name for path in FOLDER.glob(f"*/{MANIFEST}")))


def pretrained(objective: str = "C2", sensing: str = "visible", scheduler: str = "fsync") -> Run:
    """Opens weights; see `murmurate.pretrained`.

    Raises:
        InputError: There are no such weights, or no such sensing or scheduler.
        RunError: They are damaged.
    """
    check_choice("objective", objective, available())
    check_choice("sensing", sensing, tuple(SENSINGS))
    check_choice("scheduler", scheduler, tuple(SCHEDULERS))
    run = Run.open(FOLDER / objective)
    return run.under(replace(run.experiment, sensing=SENSINGS[sensing], scheduler=SCHEDULERS[scheduler]))
