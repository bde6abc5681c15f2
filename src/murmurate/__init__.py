"""Discovers collisionless patterns in swarms of fat, opaque robots by deep reinforcement learning."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from murmurate.experiments.run import Run

__all__ = ["__version__", "load"]

__version__ = "0.1.0"


def load(run: str | Path) -> Run:
    """Opens the folder of a finished run.

    Args:
        run: The folder that `murmurate discover` wrote.

    Returns:
        The run: its experiment, world and cascade, and `rollout(starts, key)`.

    Raises:
        RunError: The folder is missing, unfinished, damaged or of an unknown version.
    """
    from murmurate.experiments.run import Run  # only now, because it loads JAX

    return Run.open(run)
