"""What a cascade does from given starts: how often a valid pattern, in how many steps, against the kinematic bound."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from murmurate.discovery import Trajectories, Validity, bound_steps, check_validity
from murmurate.runs import storage
from murmurate.runs.experiment import ExperimentConfig
from murmurate.runs.presets import command
from murmurate.runs.run import Run
from murmurate.analysis.optimum.best_known import BestKnown, best_known, is_record
from murmurate.analysis.optimum.formation import Target

__all__ = ["EPISODES", "EVALUATION", "FRESH", "RECORD", "SEED", "TRAJECTORIES", "Evaluation", "evaluate", "wilson"]

EPISODES = 200
"""Episodes of an evaluation, as in the paper."""

SEED = 0
"""Seed of an evaluation's starts; they are never those of a training, whatever its seed (see `Run.starts`)."""

FRESH = "fresh"
EVALUATION = "evaluation.json"
TRAJECTORIES = "trajectories.npz"
RECORD = "record.json"


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Episodes of a cascade, judged. Means are over all episodes, whether they ended in a valid pattern or not.

    Attributes:
        experiment: The run's experiment.
        seed: Seed of the starts, when they are fresh.
        starts: Where the starts are from: `fresh`, or the name of what held them.
        trajectories: What happened.
        validity: What holds of each episode.
        bound: The kinematic bound of each episode, steps.
    """

    experiment: ExperimentConfig
    seed: int
    starts: str
    trajectories: Trajectories
    validity: Validity
    bound: Float[np.ndarray, " episodes"]

    def summary(self) -> dict[str, Any]:
        """Returns what evaluation.json holds."""
        ran, validity = self.trajectories, self.validity
        episodes, total, bound = len(ran.lengths), float(ran.lengths.mean()), float(self.bound.mean())
        base = float((ran.switch[:, 0] if ran.switch.shape[1] else ran.lengths).mean())
        names = ("contact_free", "inside", "mutually_visible", "gathered", "safe", "at_rest", "valid")
        signal = {name: float(ran.signals[name][:, -1].mean()) for name in self.experiment.signal_names}
        reached, known, best = sum(signal.values()), best_known(self.target), self.best
        return {
            "experiment": self.experiment.name,
            "robots": self.experiment.world.robots,
            "episodes": episodes,
            "seed": self.seed,
            "starts": self.starts,
            **{name: float(getattr(validity, name).mean()) for name in names},
            "valid_interval": list(wilson(int(validity.valid.sum()), episodes)),
            "base_steps": base,
            "auxiliary_steps": total - base,
            "total_steps": total,
            "epochs": float(ran.epochs.mean()),
            "bound_steps": bound,
            "efficiency": bound / max(total, 1.0),
            "signal": {**signal, "total": reached},
            "best_known": known,
            "gap": None if known is None else known - reached,
            "best_found": None if best is None else float(self.values[best]),
            "failures": np.flatnonzero(~validity.valid).tolist(),
        }

    @property
    def target(self) -> Target:
        """By what the patterns are compared."""
        return Target(self.experiment.world, self.experiment.objective)

    @functools.cached_property
    def values(self) -> Float[np.ndarray, " episodes"]:
        """The objective at the end of each episode, all weights 1, in float64."""
        return np.sum(list(self.target.signals(self.trajectories.final).values()), axis=0)

    @property
    def best(self) -> int | None:
        """The episode whose valid pattern has the greatest objective; None where none is valid."""
        return int(np.where(self.validity.valid, self.values, -np.inf).argmax()) if self.validity.valid.any() else None

    def record(self) -> BestKnown | None:
        """Returns the best pattern as an entry for the table of best-known patterns, if it beats the table."""
        if self.best is None or not is_record(self.target, float(self.values[self.best])):
            return None
        final = self.trajectories.final[self.best].astype(float)
        return BestKnown.from_target(self.target, final, command(self.experiment))

    def arrays(self) -> dict[str, np.ndarray]:
        """Returns what trajectories.npz holds."""
        ran, names = self.trajectories, self.experiment.signal_names
        signals = np.stack([ran.signals[name] for name in names], axis=-1).astype(np.float32)
        return {
            "positions": ran.positions.astype(np.float32),
            "lengths": ran.lengths.astype(np.int32),
            "switch": ran.switch.astype(np.int32),
            "objective": signals.sum(axis=-1, dtype=np.float32),
            "signals": signals,
            "signal_names": np.array(names),
            "at_rest": ran.at_rest.astype(bool),
        }

    def save(self, folder: str | Path) -> None:
        """Writes trajectories.npz and evaluation.json, each in the place of the one before, and a record, if it is one.

        Raises:
            RunError: A file cannot be written.
        """
        record = self.record()
        if record is None:
            with storage.os_errors_as_run_errors(f"cannot write to {folder}"):
                (Path(folder) / RECORD).unlink(missing_ok=True)
        else:
            storage.write_json(Path(folder) / RECORD, record.to_dict())
        storage.write_npz(Path(folder) / TRAJECTORIES, self.arrays())
        storage.write_json(Path(folder) / EVALUATION, self.summary())


def evaluate(
    run: Run,
    episodes: int = EPISODES,
    seed: int = SEED,
    starts: Float[np.ndarray, "episodes robots 2"] | None = None,
    source: str = "given",
) -> Evaluation:
    """Executes a run's cascade and judges every episode by its recorded positions.

    Args:
        run: The run.
        episodes: How many fresh starts to draw.
        seed: Their seed.
        starts: Configurations to begin at instead, world units.
        source: What to call those in the record, such as their file's name.

    Raises:
        InputError: A start has another shape, is in collision or lies outside the world.
    """
    ran = run.rollout(episodes, seed) if starts is None else run.rollout(starts)
    speed = run.experiment.world.max_speed
    bound = [bound_steps(first, last, speed) for first, last in zip(ran.positions[:, 0], ran.final, strict=True)]
    return Evaluation(
        experiment=run.experiment,
        seed=seed,
        starts=FRESH if starts is None else source,
        trajectories=ran,
        validity=check_validity(ran, run.experiment.world),
        bound=np.array(bound),
    )


def wilson(successes: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Returns the Wilson score interval of a share; by default at 95%."""
    share, squared = successes / trials, z * z / trials
    center = (share + squared / 2) / (1 + squared)
    half = math.sqrt(share * (1 - share) * squared + squared * squared / 4) / (1 + squared)
    return max(0.0, center - half), min(1.0, center + half)
