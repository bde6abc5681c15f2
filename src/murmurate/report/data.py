"""What a report is made of: finished runs, and what they measured as numbers, for its tables and report.json."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from murmurate.analysis.measures import Line, fit_line
from murmurate.errors import RunError
from murmurate.plots import Recording
from murmurate.report.plan import Plan
from murmurate.report.runs import Result
from murmurate.representation import short_repr
from murmurate.world import WorldConfig

__all__ = ["REASONS", "Command", "Machine", "Measures", "Pattern", "ReportData", "measure"]

REASONS = {
    "contact_free": "contact",
    "inside": "outside",
    "mutually_visible": "not visible",
    "safe": "not safe",
    "gathered": "not gathered",
    "at_rest": "not at rest",
    "stationary": "not stationary",
}
"""The conditions of a valid pattern, as evaluation.json names them, and what an episode is that misses one."""


@dataclass(frozen=True)
class Pattern:
    """Means over all episodes of the configurations at one moment.

    Attributes:
        objective: The objective.
        visible: The signal `visible`.
    """

    objective: float
    visible: float

    __repr__ = short_repr


@dataclass(frozen=True)
class Measures:
    """One run in numbers; None stands for what could not be computed or is not known.

    Attributes:
        run: Name of the run folder.
        experiment: The experiment's name.
        policy: central or formation.
        seed: The training's seed.
        world: Sizes of the world, which is a square, and its robots.
        start: Kind of start.
        valid_pattern: Whether the training discovered a valid pattern.
        policies: Length of the list of policies.
        episodes: Episodes of the evaluation.
        valid: Of these, those that ended in a valid pattern.
        valid_interval: Their share, at 95%.
        lacking: Episodes that miss each of `REASONS`.
        failures: Indices of the episodes that are not valid.
        base_steps: Mean.
        auxiliary_steps: Mean.
        total_steps: Mean.
        bound_steps: Mean kinematic bound.
        efficiency: bound_steps over total_steps.
        gap: Objective of the best-known pattern minus the mean of those reached.
        best_known: Objective of the best-known pattern.
        base_pattern: Where the base policy came to rest.
        final_pattern: Where the cascade came to rest.
        environment_steps: Steps of the training.
        train_seconds: Seconds that the training took.
    """

    run: str
    experiment: str
    policy: str
    seed: int
    world: WorldConfig
    start: str
    valid_pattern: bool
    policies: int
    episodes: int
    valid: int | None
    valid_interval: tuple[float, float]
    lacking: dict[str, int | None]
    failures: tuple[int, ...]
    base_steps: float
    auxiliary_steps: float
    total_steps: float
    bound_steps: float
    efficiency: float
    gap: float | None
    best_known: float | None
    base_pattern: Pattern | None
    final_pattern: Pattern | None
    environment_steps: int
    train_seconds: float

    __repr__ = short_repr

    def to_dict(self) -> dict[str, Any]:
        """Returns the numbers as a dictionary for JSON."""
        numbers = asdict(self)
        del numbers["world"]
        first = {
            "run": self.run,
            "experiment": self.experiment,
            "policy": self.policy,
            "seed": self.seed,
            "robots": self.world.robots,
            "start": self.start,
            "half_side": self.world.half_width,
        }
        return first | numbers


def measure(result: Result) -> Measures:
    """Returns the numbers of a finished run."""
    config, summary, manifest = result.planned.config, result.summary, result.manifest
    episodes = summary["episodes"]
    steps = {name: summary[name] for name in ("base_steps", "auxiliary_steps", "total_steps", "bound_steps")}
    base, final = _patterns(result)
    return Measures(
        run=result.planned.name,
        experiment=config.name,
        policy=result.planned.learner,
        seed=config.seed,
        world=config.world,
        start=config.start.name,
        valid_pattern=bool(manifest["valid_pattern"]),
        policies=len(manifest["policies"]),
        episodes=episodes,
        valid=_count(summary["valid"], episodes),
        valid_interval=tuple(summary["valid_interval"]),
        lacking={name: _count(1 - summary[name], episodes) for name in REASONS},
        failures=tuple(summary.get("failures", ())),
        **steps,
        efficiency=steps["bound_steps"] / max(steps["total_steps"], 1.0),
        gap=_known(summary, "gap"),
        best_known=_known(summary, "best_known"),
        base_pattern=base,
        final_pattern=final,
        environment_steps=manifest["environment_steps"],
        train_seconds=manifest["train_seconds"],
    )


def _known(summary: Mapping[str, Any], name: str) -> float | None:
    value = summary.get(name)
    return value if isinstance(value, float) and math.isfinite(value) else None


def _count(share: float, episodes: int) -> int | None:
    return None if math.isnan(share) else round(share * episodes)


def _patterns(result: Result) -> tuple[Pattern, Pattern] | tuple[None, None]:
    """Returns the means where the base policy came to rest, and at the end; nothing where the run cannot be read."""
    try:
        recording = result.recording
    except RunError:
        return None, None
    lengths, switch = recording.trajectories.lengths, recording.trajectories.switch
    first = np.minimum(switch[:, 0], lengths) if switch.shape[1] else lengths
    return _pattern(recording, first), _pattern(recording, lengths)


def _pattern(recording: Recording, steps: np.ndarray) -> Pattern:
    episodes = np.arange(len(steps))
    signals = {name: values[episodes, steps] for name, values in recording.trajectories.signals.items()}
    return Pattern(float(recording.objective(signals).mean()), float(np.mean(signals["visible"])))


@dataclass(frozen=True)
class Command:
    """The command that makes a report.

    Attributes:
        words: The command line.
        full: The command line of the full report.
        seconds: How long it ran.
        reused: How many runs were finished before it.
    """

    words: str
    full: str
    seconds: float
    reused: int

    __repr__ = short_repr


@dataclass(frozen=True)
class Machine:
    """What runs were made with; runs of two machines, or of two versions, are not quite alike.

    Attributes:
        platform: Operating system and processor.
        device: What JAX computed on.
        murmurate: Version.
        versions: Versions of the packages that the numbers depend on.
    """

    platform: str
    device: str
    murmurate: str
    versions: tuple[tuple[str, str], ...]

    __repr__ = short_repr

    @classmethod
    def from_manifest(cls, manifest: Mapping[str, object]) -> Machine:
        """Returns the machine that a run's manifest names."""
        versions = manifest["versions"]
        pairs = sorted(versions.items()) if isinstance(versions, Mapping) else []
        names = [str(manifest.get(name, "unknown")) for name in ("platform", "device", "murmurate")]
        return cls(*names, versions=tuple((str(package), str(version)) for package, version in pairs))


@dataclass(frozen=True)
class ReportData:
    """Everything that a report is made of.

    Attributes:
        plan: The plan.
        results: The finished runs, in the order of the plan.
        command: The command that makes the report.
    """

    plan: Plan
    results: Sequence[Result]
    command: Command

    __repr__ = short_repr

    @functools.cached_property
    def measures(self) -> dict[str, Measures]:
        """The numbers of every run, by its name."""
        return {result.planned.name: measure(result) for result in self.results}

    @functools.cached_property
    def experiments(self) -> dict[str, dict[str, Measures]]:
        """The numbers of the paper's experiments, by experiment and training preset."""
        return {
            name: {preset: self.measures[run.name] for preset, run in runs.items()}
            for name, runs in self.plan.experiments.items()
        }

    @functools.cached_property
    def sizes(self) -> dict[str, dict[int, Measures]]:
        """The numbers of the study of swarm sizes, by start and number of robots."""
        return {
            start: {robots: self.measures[run.name] for robots, run in runs.items()}
            for start, runs in self.plan.sizes.items()
        }

    @functools.cached_property
    def lines(self) -> dict[str, tuple[Line | None, Line | None]]:
        """Straight lines through formation steps and through kinematic bounds, by start."""
        return {
            start: (
                fit_line(list(runs), [run.total_steps for run in runs.values()]),
                fit_line(list(runs), [run.bound_steps for run in runs.values()]),
            )
            for start, runs in self.sizes.items()
        }

    @functools.cached_property
    def machines(self) -> dict[str, Machine]:
        """What each run was made with, by its name."""
        return {result.planned.name: Machine.from_manifest(result.manifest) for result in self.results}

    def recording(self, experiment: str, preset: str) -> Recording:
        """Returns the run of one of the paper's experiments.

        Raises:
            RunError: It cannot be read.
        """
        name = self.plan.experiments[experiment][preset].name
        return next(result for result in self.results if result.planned.name == name).recording
