"""Evaluation of a cascade: how often it forms a valid pattern, in how many steps, against the kinematic bound."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from murmurate.analysis.optimum.best_known import BestKnown, best_known, is_record
from murmurate.analysis.optimum.formation import Target
from murmurate.discovery import Trajectories, Validity, bound_steps, check_validity
from murmurate.errors import check_function, check_type
from murmurate.runs import progress
from murmurate.runs.experiment import ExperimentConfig
from murmurate.runs.folder import RunFolder, describe_starts, is_fresh
from murmurate.runs.given_starts import given_starts
from murmurate.runs.presets import command
from murmurate.runs.run import Run, check_draw
from murmurate.world import Configuration, Objective, Start

__all__ = ["EPISODES", "SEED", "Evaluation", "evaluate", "evaluated", "is_below", "wilson"]

EPISODES = 200
"""Episodes of an evaluation, as in the paper."""

SEED = 0
"""Seed of an evaluation; its starts are never those of a training, whatever that one's seed (see `Run.starts`)."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Episodes of a cascade and what holds of each. Means are over all episodes, valid or not.

    Attributes:
        experiment: The run's experiment.
        seed: Seed of the starts, where they are fresh, of the robots' frames, of noise and of the scheduler.
        starts: Where the episodes began, as evaluation.json has it; see `folder.describe_starts`.
        trajectories: The episodes.
        validity: The conditions of a valid pattern, for each episode.
        bound: The kinematic bound of each episode, steps.
    """

    experiment: ExperimentConfig
    seed: int
    starts: dict[str, str]
    trajectories: Trajectories
    validity: Validity
    bound: Float[np.ndarray, " episodes"]

    def summary(self) -> dict[str, Any]:
        """Returns what evaluation.json holds."""
        measured, bound = _measured(self.trajectories, self.validity), float(self.bound.mean())
        signal = {name: float(values.mean()) for name, values in self.signals.items()}
        objective = float(self.objective(signal))
        known = None if self.target is None else best_known(self.target)
        return {
            "experiment": self.experiment.name,
            "robots": self.experiment.world.robots,
            "seed": self.seed,
            "starts": self.starts,
            **measured,
            "bound_steps": bound,
            "efficiency": bound / max(measured["total_steps"], 1.0),
            "signal": {**signal, "total": objective},
            "best_known": known,
            "gap": None if known is None else known - objective,
            "best_found": None if self.best is None else float(self.values[self.best]),
        }

    @property
    def objective(self) -> Objective:
        """The experiment's objective, with the signals' own weights."""
        return Objective(self.experiment.objective_signals)

    @property
    def target(self) -> Target | None:
        """What the patterns are compared by with the best known ones; None for an objective that is not the paper's."""
        experiment = self.experiment
        return Target(experiment.world, experiment.objective) if experiment.has_paper_objective else None

    @functools.cached_property
    def signals(self) -> dict[str, Float[np.ndarray, " episodes"]]:
        """The signals at the end of each episode by name, in float64."""
        final = Configuration(np.moveaxis(self.trajectories.final.astype(float), 0, -1), self.experiment.world)
        return {name: np.asarray(value, float) for name, value in self.objective.measure(final).items()}

    @functools.cached_property
    def values(self) -> Float[np.ndarray, " episodes"]:
        """The objective at the end of each episode, with the signals' own weights, in float64."""
        return np.asarray(self.objective(self.signals))

    @property
    def best(self) -> int | None:
        """The episode whose valid pattern has the greatest objective; None where none is valid."""
        return int(np.where(self.validity.valid, self.values, -np.inf).argmax()) if self.validity.valid.any() else None

    def record(self) -> BestKnown | None:
        """Returns the best pattern as an entry for the table of best-known patterns, if it beats the table."""
        target, best = self.target, self.best
        if target is None or best is None or not is_record(target, float(self.values[best])):
            return None
        return BestKnown.from_target(target, self.trajectories.final[best].astype(float), command(self.experiment))

    def arrays(self) -> dict[str, np.ndarray]:
        """Returns what trajectories.npz holds."""
        trajectories, names = self.trajectories, self.objective.names
        signals = np.stack([trajectories.signals[name] for name in names], axis=-1).astype(np.float32)
        weights = np.array([self.objective.weights[name] for name in names], np.float32)
        interventions, after_rest = trajectories.interventions, trajectories.after_rest
        return {
            "positions": trajectories.positions.astype(np.float32),
            "lengths": trajectories.lengths.astype(np.int32),
            "switch": trajectories.switch.astype(np.int32),
            "objective": (signals * weights).sum(axis=-1, dtype=np.float32),
            "signals": signals,
            "signal_names": np.array(names),
            "at_rest": trajectories.at_rest.astype(bool),
            "terminated": trajectories.terminated.astype(bool),
            "epochs": trajectories.epochs.astype(np.int32),
            **({} if interventions is None else {"interventions": interventions.astype(np.int32)}),
            **({} if after_rest is None else {"after_rest": after_rest.astype(np.float32)}),
        }

    def save(self, folder: str | Path | RunFolder) -> None:
        """Writes the evaluation to a run folder, in place of the one before.

        Raises:
            RunError: A file cannot be written.
        """
        target, record = RunFolder(folder), self.record()
        target.write_evaluation(self.summary(), self.arrays(), None if record is None else record.to_dict())

    def __repr__(self) -> str:
        valid, episodes = int(self.validity.valid.sum()), len(self.trajectories.lengths)
        steps = self.trajectories.lengths.mean()
        return f"Evaluation({self.experiment.name}: {valid} of {episodes} episodes valid, {steps:.1f} steps)"

    def _repr_png_(self) -> bytes:
        """Returns the formation of the typical pattern, which notebooks show."""
        from murmurate.plots import Recording  # figures are drawn from evaluations

        starts = "" if is_fresh({"starts": self.starts}) else describe_starts({"starts": self.starts})
        return Recording(self.experiment, self.trajectories, starts=starts)._repr_png_()


def evaluate(
    run: Run,
    episodes: int | None = None,
    seed: int = SEED,
    starts: str | Path | Start | Float[np.ndarray, "episodes robots 2"] | None = None,
    on_progress: Callable[..., None] | None = None,
) -> Evaluation:
    """Executes a run's cascade and checks every episode by its recorded positions.

    Args:
        run: The run.
        episodes: Number of starts; by default 200 that are drawn, and all that are given.
        seed: Seed of the starts, of the robots' frames, of noise and of the scheduler.
        starts: Where to begin instead of at fresh starts of the experiment: a named set ("cluster"; see
            `murmurate.start_set`), another registered start ("hard"), one's own as "module:Class", a CSV file of
            starts, a start, or configurations, world units.
        on_progress: Called as `on_progress(work, done, total, **values)` before and after each part of the work, and
            every few seconds while episodes are executed.

    Raises:
        InputError: There are no such starts, or one has another shape, is in contact or lies outside the world.
    """
    check_type("run", run, Run, "a run, such as murmurate.load(folder)")
    check_function("on_progress", on_progress, "on_progress(work, done, total, **values)")
    if starts is None:
        begin: Any = EPISODES if episodes is None else episodes
        source, count = {"kind": "fresh"}, begin
    else:
        check_draw(EPISODES if episodes is None else episodes, seed)
        given = given_starts(starts, run.experiment.world, seed, EPISODES, episodes)
        begin, source, count = given.points, given.source, len(given.points)
    report = on_progress or (lambda *_, **__: None)
    report("episodes executed", 0, count)
    usual_steps = run.experiment.usual_steps(len(run.cascade.policies), count)
    on_chunk = progress.on_chunk(report, "episodes executed", count, usual_steps)
    trajectories = run.rollout(begin, seed, on_chunk)
    report("episodes executed", count, count)
    evaluation = _judged(run.experiment, seed, source, trajectories)
    report("episodes checked", count, count, valid=float(evaluation.validity.valid.mean()))
    return evaluation


def evaluated(run: RunFolder, trust: bool = False) -> dict[str, Any]:
    """Computes the summary of a run's evaluation from its positions; only where they began is believed.

    Args:
        run: The folder of a finished run.
        trust: Whether modules that its configuration names may be imported.

    Returns:
        What `RunFolder.evaluation` returns.

    Raises:
        RunError: The evaluation is missing or damaged, contradicts itself, or its positions are not those of the run.
    """
    check_type("run", run, RunFolder, "the folder of a run, RunFolder(path)")
    run.verify()
    config, summary = run.experiment(trust), run.evaluation()
    # Nothing is claimed where no episode is valid: its positions may not even be finite, where a training diverged.
    trajectories = run.trajectories(config, finite=len(summary["failures"]) < summary["episodes"])
    return _judged(config, summary.get("seed", SEED), summary["starts"], trajectories).summary()


def _judged(experiment: ExperimentConfig, seed: int, starts: dict[str, str], trajectories: Trajectories) -> Evaluation:
    """Checks every episode by its positions, and computes its kinematic bound: NaN where they are not finite."""
    # In float64, in which squares of whatever a float32 holds are finite.
    pairs = zip(trajectories.positions[:, 0].astype(float), trajectories.final.astype(float), strict=True)
    bound = [
        bound_steps(first, final, experiment.world.max_speed) if np.isfinite([first, final]).all() else math.nan
        for first, final in pairs
    ]
    validity = check_validity(trajectories, experiment.world, experiment.thresholds)
    return Evaluation(experiment, seed, starts, trajectories, validity, np.array(bound))


def _measured(trajectories: Trajectories, validity: Validity) -> dict[str, Any]:
    """Returns how many episodes meet each condition, and in how many steps."""
    episodes, total = len(trajectories.lengths), float(trajectories.lengths.mean())
    # A list of one policy has no switch: all steps are the base policy's.
    base = float((trajectories.switch[:, 0] if trajectories.switch.shape[1] else trajectories.lengths).mean())
    interventions = trajectories.interventions
    conditions = ("contact_free", "inside", "mutually_visible", "gathered", "safe", "at_rest", "stationary", "valid")
    return {
        "episodes": episodes,
        **{name: float(getattr(validity, name).mean()) for name in conditions},
        "valid_interval": list(wilson(int(validity.valid.sum()), episodes)),
        "thresholds": {name: float(reached.mean()) for name, reached in validity.signals.items()},
        "failures": np.flatnonzero(~validity.valid).tolist(),
        "base_steps": base,
        "auxiliary_steps": total - base,
        "total_steps": total,
        "epochs": float(trajectories.epochs.mean()),
        **({} if interventions is None else {"interventions": float(interventions.mean())}),
    }


def is_below(summary: Mapping[str, Any], required_valid: float) -> bool:
    """Returns whether fewer valid patterns formed than are required, by more than chance (95% interval)."""
    return summary["valid_interval"][1] < required_valid


def wilson(successes: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Returns the Wilson score interval of a share; by default at 95%."""
    share, squared = successes / trials, z * z / trials
    center = (share + squared / 2) / (1 + squared)
    half = math.sqrt(share * (1 - share) * squared + squared * squared / 4) / (1 + squared)
    return max(0.0, center - half), min(1.0, center + half)
