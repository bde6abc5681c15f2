"""What a report needs trained: the paper's six experiments with both policies, and swarms of other sizes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from murmurate.discovery import StageConfig
from murmurate.learning import GradientConfig, PPOConfig
from murmurate.representation import short_repr
from murmurate.runs.evaluate import EPISODES
from murmurate.runs.experiment import ExperimentConfig
from murmurate.runs.grid import Grid
from murmurate.runs.paper import EXPERIMENTS
from murmurate.runs.presets import DEFAULT_LEARNER, preset
from murmurate.world import Start

__all__ = ["STARTS", "TRAINING_PRESETS", "Plan", "PlannedRun", "half_side", "make_plan"]

TRAINING_PRESETS = ("central", DEFAULT_LEARNER)
"""The policies that every experiment is done with: the paper's own kind first."""

STARTS: tuple[Literal["distributed", "scattered"], ...] = ("distributed", "scattered")
"""The starts of the study of swarm sizes, as in the paper."""

_SIZES = tuple(range(4, 11))
_QUICK_SIZES = (6, 8, 10)
"""No size but the paper's experiments': compiling takes most of a quick report's time, and each size is compiled."""


@dataclass(frozen=True)
class _Budget:
    """How much a quick report trains.

    Attributes:
        policies: Policies in a list at most.
        ppo: Updates by PPO of each, where there are any.
        worlds: Parallel episodes of these.
        gradients: Updates by gradients, where there are any.
        gradient_worlds: Parallel episodes of these.
    """

    policies: int
    ppo: int = PPOConfig().updates
    worlds: int = PPOConfig().worlds
    gradients: int = GradientConfig().updates
    gradient_worlds: int = GradientConfig().worlds


_QUICK = {DEFAULT_LEARNER: _Budget(1, gradients=60, gradient_worlds=32), "central": _Budget(3, ppo=100, worlds=128)}


@dataclass(frozen=True)
class PlannedRun:
    """One run that a report needs.

    Attributes:
        name: The run's folder, in the folder of all runs.
        learner: Whose numbers it is trained with.
        config: What is to be discovered, and how.
    """

    name: str
    learner: str
    config: ExperimentConfig

    __repr__ = short_repr

    @property
    def title(self) -> str:
        """The run, as tables and progress call it."""
        return f"{self.config.name}, {self.learner}"


@dataclass(frozen=True)
class Plan:
    """All runs that a report needs.

    Attributes:
        seed: The seed of every one of them.
        quick: Whether their budgets are smaller than the presets'.
        experiments: Runs by the paper's experiment and the learner.
        sizes: Runs of the study of swarm sizes, by start and number of robots.
    """

    seed: int
    quick: bool
    experiments: Mapping[str, Mapping[str, PlannedRun]]
    sizes: Mapping[str, Mapping[int, PlannedRun]]

    __repr__ = short_repr

    @property
    def runs(self) -> tuple[PlannedRun, ...]:
        """Every run once, in the order of training."""
        groups = (*self.experiments.values(), *self.sizes.values())
        return tuple({run.name: run for group in groups for run in group.values()}.values())

    @property
    def grid(self) -> Grid:
        """The runs as a grid, by the names of their folders."""
        return Grid({run.name: run.config for run in self.runs})


def make_plan(seed: int = 0, quick: bool = False) -> Plan:
    """Plans a report.

    Args:
        seed: Seed of every run.
        quick: Smaller budgets and fewer swarm sizes, to see the whole report in minutes.

    Raises:
        InputError: The seed is out of bounds.
    """
    experiments = {
        name: {learner: _planned(_preset(name, learner, seed), name, learner, quick) for learner in TRAINING_PRESETS}
        for name in EXPERIMENTS
    }
    known = [runs[DEFAULT_LEARNER] for runs in experiments.values()]
    sizes = {
        start: {robots: _of_size(robots, start, seed, quick, known) for robots in (_QUICK_SIZES if quick else _SIZES)}
        for start in STARTS
    }
    return Plan(seed, quick, experiments, sizes)


def half_side(robots: int) -> float:
    """Returns X = Y of a swarm of any size, world units: the line on which the published 35, 40, 45 lie."""
    return 20.0 + 2.5 * robots


def _preset(name: str, learner: str, seed: int) -> ExperimentConfig:
    return replace(preset(name, learner), seed=seed)


def _of_size(
    robots: int, start: Literal["distributed", "scattered"], seed: int, quick: bool, known: list[PlannedRun]
) -> PlannedRun:
    """Plans one run of the study of swarm sizes; where it is one of the paper's experiments, that very run."""
    like = _preset("C", DEFAULT_LEARNER, seed)
    side = half_side(robots)
    world = replace(like.world, robots=robots, half_width=side, half_height=side)
    config = replace(like, name=f"size{robots}-{start}", world=world, start=Start.registered()[start]())
    planned = _planned(config, config.name, DEFAULT_LEARNER, quick)
    return next((run for run in known if replace(planned.config, name=run.config.name) == run.config), planned)


def _planned(config: ExperimentConfig, name: str, learner: str, quick: bool) -> PlannedRun:
    folder = f"{'quick-' if quick else ''}{name}-{learner}-seed{config.seed}"
    return PlannedRun(folder, learner, _quickened(config, learner) if quick else config)


def _quickened(config: ExperimentConfig, learner: str) -> ExperimentConfig:
    """Reduces the budgets of an experiment, and nothing else of it."""
    budget = _QUICK[learner]

    def stage(like: StageConfig) -> StageConfig:
        gradients = replace(like.gradients, updates=budget.gradients, worlds=budget.gradient_worlds)
        return replace(like, ppo=replace(like.ppo, updates=budget.ppo, worlds=budget.worlds), gradients=gradients)

    # As many episodes everywhere as the evaluation has: a cascade is then compiled once for each length of its list.
    discovery = replace(config.discovery, max_policies=budget.policies, sigma=EPISODES, episodes=EPISODES)
    return replace(config, base=stage(config.base), auxiliary=stage(config.auxiliary), discovery=discovery)
