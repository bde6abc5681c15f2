"""A finished run as its figures need it: the experiment, the episodes of its evaluation, the curves of its training."""

from __future__ import annotations

import functools
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from murmurate.discovery import check_validity, policy_name
from murmurate.errors import RunError, check_number, check_type
from murmurate.representation import short_repr
from murmurate.runs.experiment import ExperimentConfig
from murmurate.runs.folder import RunFolder, describe_starts, is_fresh
from murmurate.types import Trajectories

__all__ = ["Episode", "Recording", "TrainingCurve"]


@dataclass(frozen=True)
class TrainingCurve:
    """The training of one policy, a value for each recorded update.

    Attributes:
        name: The policy's name.
        environment_steps: Steps of the environment so far, over the whole run.
        signals: Mean of each signal over the states of the update's rollout, by name.
    """

    name: str
    environment_steps: Float[np.ndarray, " updates"]
    signals: Mapping[str, Float[np.ndarray, " updates"]]

    __repr__ = short_repr


@dataclass(frozen=True)
class Episode:
    """One execution of the cascade, from its start to its end.

    Attributes:
        positions: Centres before the first step and after each step, world units.
        switches: Steps at which the auxiliary policies took over, ascending.
        signals: Every signal by name, for each configuration.
        at_rest: Whether it came to rest; it ended in a contact, outside the world or at a time limit otherwise.
    """

    positions: Float[np.ndarray, "configurations robots 2"]
    switches: tuple[int, ...]
    signals: Mapping[str, Float[np.ndarray, " configurations"]]
    at_rest: bool

    __repr__ = short_repr

    @property
    def outcome(self) -> str:
        """How it ended, in words."""
        return "at rest" if self.at_rest else "not at rest"

    @property
    def steps(self) -> int:
        """Formation steps, all policies together."""
        return len(self.positions) - 1

    @property
    def policies(self) -> Int[np.ndarray, " steps"]:
        """Index of the policy that made each step."""
        return np.searchsorted(self.switches, np.arange(self.steps), side="right")


@dataclass(frozen=True, eq=False)
class Recording:
    """What the figures of a run are drawn from.

    Example:
        >>> from murmurate import plots  # doctest: +SKIP
        >>> run = murmurate.pretrained()  # doctest: +SKIP
        >>> plots.formation_figure(plots.Recording(run.experiment, run.rollout(20)))  # doctest: +SKIP

    Attributes:
        experiment: The experiment.
        trajectories: The episodes of an evaluation.
        training: A curve for each policy; none where its training is not known.
        starts: Where the episodes began, in words, where not at fresh starts of the experiment.
        search: The search for goals that came before any robot moved, whose updates take the place of steps; None
            where there was none.
    """

    experiment: ExperimentConfig
    trajectories: Trajectories
    training: Sequence[TrainingCurve] = ()
    starts: str = ""
    search: TrainingCurve | None = None

    @classmethod
    def open(cls, run: str | os.PathLike[str], trust: bool = False) -> Recording:
        """Reads the folder of a finished run.

        Args:
            run: The folder that `murmurate discover` wrote.
            trust: Whether modules that the experiment names may be imported, which executes them.

        Raises:
            RunError: The folder or one of its files is missing or damaged, or names modules and is not trusted.
        """
        folder = RunFolder(run)
        kept = len(folder.verify()["policies"])
        config, summary, rows = folder.experiment(trust), folder.evaluation(), folder.metrics()
        if rows and rows[0]["signals"].keys() != {*config.signal_names}:
            names = ", ".join(rows[0]["signals"])
            raise RunError(f"{folder.path} has metrics that are not of its experiment: of the signals {names}")
        starts = "" if is_fresh(summary) else describe_starts(summary)
        searched = [row for row in rows if row.get("learner") == "goals"]
        moved = [row for row in rows if row.get("learner") != "goals" and row["policy"] < kept]
        search = _curve("search", searched, steps=range(1, len(searched) + 1)) if searched else None
        return cls(config, folder.trajectories(config), _curves(moved), starts, search)

    def __post_init__(self) -> None:
        check_type("experiment", self.experiment, ExperimentConfig, "an experiment, such as run.experiment")
        check_type("trajectories", self.trajectories, Trajectories, "trajectories, such as run.rollout(20)")

    def __repr__(self) -> str:
        return f"Recording({self.experiment.name}: {self.trajectories!r})"

    def _repr_png_(self) -> bytes:
        """Returns the formation of the typical pattern, which notebooks show."""
        from murmurate.plots import formation_figure, png  # imported late: the figures are drawn from recordings

        return png(formation_figure(self), dpi=110)

    @property
    def policies(self) -> list[str]:
        """The names of the policies, in the order of the list."""
        count = max(len(self.training), self.trajectories.switch.shape[1] + 1)
        return [curve.name for curve in self.training] + [policy_name(i) for i in range(len(self.training), count)]

    @property
    def weights(self) -> dict[str, float]:
        """The weight of each signal in the objective."""
        return {name: float(signal.weight) for name, signal in self.experiment.objective_signals.items()}

    @property
    def gathering_point(self) -> bool:
        """Whether the objective names a point at which to gather."""
        return self.experiment.landmark

    def objective(self, signals: Mapping[str, Float[np.ndarray, "*shape"]]) -> Float[np.ndarray, "*shape"]:
        """Returns the objective of signals, whatever weights a policy was trained with, so that policies compare."""
        return np.sum([weight * np.asarray(signals[name], float) for name, weight in self.weights.items()], axis=0)

    @functools.cached_property
    def valid(self) -> Bool[np.ndarray, " episodes"]:
        """Which episodes ended in a valid pattern."""
        return check_validity(self.trajectories, self.experiment.world, self.experiment.thresholds).valid

    def typical(self) -> int:
        """Returns the episode of median formation steps among the valid ones, or among all where none is valid."""
        candidates = np.flatnonzero(self.valid if self.valid.any() else np.ones_like(self.valid))
        order = candidates[np.argsort(self.trajectories.lengths[candidates], kind="stable")]
        return int(order[(len(order) - 1) // 2])

    def episode(self, index: int | None = None) -> Episode:
        """Returns one episode, cut where it ended.

        Args:
            index: Its index in the evaluation; the typical one where None.

        Raises:
            InputError: There is no such episode.
        """
        lengths = self.trajectories.lengths
        index = self.typical() if index is None else index
        check_number("episode", index, 0, len(lengths) - 1, integer=True)
        length = int(lengths[index])
        # A policy that never took over has no step: its switch falls on the end.
        switches = np.maximum.accumulate(np.clip(self.trajectories.switch[index], 0, length))
        return Episode(
            positions=self.trajectories.positions[index, : length + 1],
            switches=tuple(switches.tolist()),
            signals={name: values[index, : length + 1] for name, values in self.trajectories.signals.items()},
            at_rest=bool(self.trajectories.at_rest[index]),
        )


def check_recording(recording: object) -> None:
    """Checks what a figure is drawn from.

    Raises:
        InputError: It is no recording.
    """
    check_type("recording", recording, Recording, "a recording, such as plots.Recording.open(folder)")


def _curves(rows: Iterable[Mapping[str, Any]]) -> list[TrainingCurve]:
    """Returns the training curves of rows of metrics.jsonl, one for each policy."""
    by_policy: dict[int, list[Mapping[str, Any]]] = {}
    for row in rows:
        by_policy.setdefault(row["policy"], []).append(row)
    return [_curve(policy_name(index), updates) for index, (_, updates) in enumerate(sorted(by_policy.items()))]


def _curve(name: str, updates: Sequence[Mapping[str, Any]], steps: Iterable[int] | None = None) -> TrainingCurve:
    return TrainingCurve(
        name=name,
        environment_steps=np.array(steps or [row["environment_steps"] for row in updates], float),
        signals={name: np.array([row["signals"][name] for row in updates], float) for name in updates[0]["signals"]},
    )
