"""What the runs of a report measured, as numbers: for its tables and for report.json alike."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from murmurate.errors import RunError
from murmurate.plots import Record
from murmurate.report.runs import Result

__all__ = ["REASONS", "Line", "Measures", "Pattern", "fit_line", "measure"]

REASONS = ("contact_free", "inside", "mutually_visible", "safe", "gathered", "at_rest")
"""What a valid pattern needs, as evaluation.json names it."""


@dataclass(frozen=True)
class Pattern:
    """Means over all episodes of the configurations at one moment.

    Attributes:
        objective: The paper's C1 or C2, signals of equal weight.
        visible: The signal `visible`.
    """

    objective: float
    visible: float


@dataclass(frozen=True)
class Measures:
    """One run in numbers; None is what could not be computed or is not known.

    Attributes:
        run: Name of the run folder.
        experiment: The experiment's name.
        policy: central or equivariant.
        seed: The training's seed.
        robots: Swarm size.
        start: Kind of start.
        half_side: X = Y, world units.
        outcome: What the manifest says.
        policies: Length of the list of policies.
        episodes: Episodes of the evaluation.
        valid: Of these, those that ended in a valid pattern.
        valid_interval: Their share, at 95%.
        lacking: Episodes that lack each of `REASONS`.
        failures: Places of the episodes that are not valid.
        base_steps: Mean.
        auxiliary_steps: Mean.
        total_steps: Mean.
        bound_steps: Mean kinematic bound.
        efficiency: bound_steps over total_steps.
        gap: Objective of the best-known pattern less the one reached, a mean.
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
    robots: int
    start: str
    half_side: float
    outcome: str
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
        robots=config.world.robots,
        start=config.start.name,
        half_side=config.world.half_width,
        outcome=manifest["outcome"],
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
    try:
        record = result.record
    except RunError:
        return None, None
    switches = record.switch[:, 0] if record.switch.shape[1] else record.lengths
    return _pattern(record, np.minimum(switches, record.lengths)), _pattern(record, record.lengths)


def _pattern(record: Record, steps: np.ndarray) -> Pattern:
    signals = record.signals[np.arange(len(steps)), steps]
    visible = signals[:, record.signal_names.index("visible")]
    return Pattern(objective=float(signals.sum(axis=1).mean()), visible=float(visible.mean()))


@dataclass(frozen=True)
class Line:
    """A straight line through points by least squares.

    Attributes:
        slope: Steps a robot.
        intercept: Steps.
        r_squared: Share of the variance that the line explains.
    """

    slope: float
    intercept: float
    r_squared: float


def fit_line(robots: Sequence[int], steps: Sequence[float]) -> Line | None:
    """Fits steps to swarm sizes; None where the points are fewer than three, not finite, or all of one size."""
    x, y = np.asarray(robots, float), np.asarray(steps, float)
    if len(x) < 3 or not np.isfinite(y).all() or np.ptp(x) == 0:
        return None
    slope, intercept = np.polyfit(x, y, 1)
    whole = float(((y - y.mean()) ** 2).sum())
    rest = float(((y - intercept - slope * x) ** 2).sum())
    return Line(float(slope), float(intercept), 1 - rest / whole if whole else 1.0)
