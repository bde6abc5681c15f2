"""What a report is made of: finished runs and their numbers, as the plan arranges them."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from murmurate.report.measures import Line, Measures, fit_line, measure
from murmurate.report.plan import Plan
from murmurate.report.runs import Result

__all__ = ["Command", "Machine", "Material"]


@dataclass(frozen=True)
class Command:
    """How a report came to be.

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


@dataclass(frozen=True)
class Machine:
    """What runs were made with; runs of two machines, or of two versions, are not quite alike.

    Attributes:
        platform: Operating system and processor.
        device: What JAX computed on.
        murmurate: Version.
        versions: Versions of what the numbers depend on, by package.
    """

    platform: str
    device: str
    murmurate: str
    versions: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Material:
    """All that the sections of a report are made of.

    Attributes:
        plan: The plan.
        results: The finished runs, in the order of the plan.
        command: How the report came to be.
    """

    plan: Plan
    results: Sequence[Result]
    command: Command

    @functools.cached_property
    def measures(self) -> dict[str, Measures]:
        """The numbers of every run, by its name."""
        return {result.planned.name: measure(result) for result in self.results}

    @property
    def experiments(self) -> dict[str, dict[str, Measures]]:
        """The numbers of the paper's experiments, by experiment and learner."""
        return {
            name: {learner: self.measures[run.name] for learner, run in runs.items()}
            for name, runs in self.plan.experiments.items()
        }

    @property
    def sizes(self) -> dict[str, dict[int, Measures]]:
        """The numbers of the study of swarm sizes, by start and number of robots."""
        return {
            start: {robots: self.measures[run.name] for robots, run in runs.items()}
            for start, runs in self.plan.sizes.items()
        }

    @property
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
        return {result.planned.name: _machine(result.manifest) for result in self.results}

    def result(self, experiment: str, learner: str) -> Result:
        """Returns the run of one of the paper's experiments."""
        name = self.plan.experiments[experiment][learner].name
        return next(result for result in self.results if result.planned.name == name)


def _machine(manifest: Mapping[str, object]) -> Machine:
    versions = manifest["versions"]
    pairs = sorted(versions.items()) if isinstance(versions, Mapping) else []
    names = [str(manifest.get(name, "unknown")) for name in ("platform", "device", "murmurate")]
    return Machine(*names, versions=tuple((str(package), str(version)) for package, version in pairs))
