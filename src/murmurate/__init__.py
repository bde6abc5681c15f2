"""Discovers collisionless patterns in swarms of fat, opaque robots by deep reinforcement learning."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from murmurate.runs.run import Run

__all__ = ["__version__", "load", "pretrained"]

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
    from murmurate import compilation_cache

    compilation_cache.configure()
    from murmurate.runs.run import Run  # only now, because it loads JAX

    return Run.open(run)


def pretrained(objective: str = "C2", sensing: str = "visible", scheduler: str = "fsync") -> Run:
    """Opens weights that come with the package: one policy for swarms of any size, trained without further ado.

    Args:
        objective: C2 (gathering anywhere) or C1 (gathering at the origin, which a landmark marks for all).
        sensing: What robots perceive, in frames of their own: visible (whom nobody hides), global (everybody), chiral
            (whom nobody hides, with a common handedness) or noisy (whom nobody hides, not quite where they are).
        scheduler: When they move: fsync, ssync, adversarial, async or async-nonrigid.

    Returns:
        The run; `of_size(robots)` puts it into a swarm of another size.

    Raises:
        InputError: There are no such weights; the message lists those that there are.
    """
    from murmurate import compilation_cache

    compilation_cache.configure()
    from murmurate.runs import pretrained  # only now, because it loads JAX

    return pretrained.pretrained(objective, sensing, scheduler)
