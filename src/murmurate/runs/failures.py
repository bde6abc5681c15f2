"""What was wrong with the episodes that did not end in a valid pattern, in words."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from murmurate.analysis import symmetry
from murmurate.discovery import Trajectories, Validity, check_validity
from murmurate.runs.experiment import ExperimentConfig

__all__ = ["describe_failures"]

CONDITIONS = {
    "contact_free": "in contact",
    "inside": "outside the world",
    "gathered": "not gathered",
    "mutually_visible": "not mutually visible",
    "safe": "nearer than the safe distance",
    "at_rest": "not at rest",
    "stationary": "not stationary",
}

EXACT = 1e-3
"""A start is symmetric up to this residual: numbers of a file that were written with a few digits."""

MAX_ROBOTS, MAX_EPISODES = 64, 200
"""Symmetries are looked for in swarms of at most so many robots, and in at most so many episodes."""


def describe_failures(experiment: ExperimentConfig, trajectories: Trajectories) -> list[str]:
    """Returns how many episodes failed by each condition and, where that is known, why: a line each; none if none did.

    Args:
        experiment: The experiment.
        trajectories: The episodes of its evaluation.
    """
    validity = check_validity(trajectories, experiment.world, experiment.thresholds)
    failed = np.flatnonzero(~validity.valid)
    if not len(failed):
        return []
    if trajectories.after_rest is None:
        count = f"{len(failed)} of {len(validity.valid)} starts failed"
        return [f"{count}: what follows after rest was not recorded by an older version; evaluate the run again"]
    counts = [f"{count} {text}" for text, count in _counts(validity).items() if count]
    several = " (some in several ways)" if sum(_counts(validity).values()) > len(failed) else ""
    lines = [f"{len(failed)} of {len(validity.valid)} starts failed: {', '.join(counts)}{several}"]
    # A centralised policy tells its robots apart by their numbers, and may break any symmetry.
    if experiment.policy.any_size and experiment.world.robots <= MAX_ROBOTS:
        examined = failed[:MAX_EPISODES]
        symmetric = sum(_keeps_symmetry(trajectories.positions[i, 0], trajectories.final[i]) for i in examined)
        if symmetric:
            subject = f"{symmetric} of them" if len(examined) > 1 else "it"
            lines.append(
                f"why: {subject} began symmetric and stayed so: robots that are all alike, in step and without noise "
                "keep a symmetry for ever; move a robot a little, or take noise or another scheduler"
            )
    return lines


def _counts(validity: Validity) -> dict[str, int]:
    failed = {name: ~getattr(validity, name) for name in CONDITIONS if name not in validity.replaced}
    # Where no pattern formed, none could stay.
    failed["stationary"] = validity.formed & ~validity.stationary
    counts = {CONDITIONS[name]: int(flags.sum()) for name, flags in failed.items()}
    return counts | {f"{name} not reached": int((~reached).sum()) for name, reached in validity.signals.items()}


def _keeps_symmetry(start: Float[np.ndarray, "robots 2"], final: Float[np.ndarray, "robots 2"]) -> bool:
    """Returns whether a start has a symmetry that the robots still have at the end."""
    if not (np.isfinite(start).all() and np.isfinite(final).all()):
        return False
    before = symmetry(start.astype(float), EXACT)
    if before.rotations == 1 and not before.mirrored:
        return False
    after = symmetry(final.astype(float))
    return after.rotations % before.rotations == 0 and (after.mirrored or not before.mirrored)
