"""Training among several swarm sizes: one problem for each size, and whose turn it is at each update."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from murmurate.discovery.problem import Problem, check_problem
from murmurate.learning import LEARNERS
from murmurate.representation import short_repr

__all__ = ["Curriculum"]

MAX_WORLDS_RATIO = 1.5
"""Small swarms train in at most this many times the worlds of the problem: their steps cost something too."""


class Curriculum:
    """The problems that training alternates among: one for each swarm size, or the problem alone.

    Args:
        problem: The problem.
    """

    __match_args__ = ("problem",)
    __repr__ = short_repr

    def __init__(self, problem: Problem) -> None:
        check_problem(problem)
        self.problem = problem

    @cached_property
    def parts(self) -> tuple[Problem, ...]:
        """The problem for each swarm size, with as many robots to learn from in an update."""
        problem = self.problem
        if not problem.sizes:
            return (problem,)
        config, parts = problem.discovery, []
        for robots in problem.sizes:
            ratio = min(problem.world.robots / robots, MAX_WORLDS_RATIO)
            part = problem.of_size(robots)
            base = part.base
            for phase, learner in enumerate(base.learners):
                numbers = base.learning(phase)
                if not numbers.worlds:  # no episode is taken
                    continue
                worlds = max(round(ratio * numbers.worlds / numbers.minibatches), 1) * numbers.minibatches
                base = replace(base, **{learner: replace(numbers, worlds=worlds)})
            episodes = math.ceil(config.episodes / len(problem.sizes))
            parts.append(replace(part, base=base, discovery=replace(config, episodes=episodes)))
        return tuple(parts)

    def turn(self, update: int) -> int:
        """Returns the place of the part that an update trains: in every round each once, in an order drawn anew."""
        number, offset = divmod(update, len(self.parts))
        return int(np.random.default_rng((self.problem.seed, number)).permutation(len(self.parts))[offset])

    def chunk(self, index: int, phase: int, update: int) -> int:
        """Returns how many updates of a policy run next without visiting the host: all of one part, or each of all."""
        learner = LEARNERS[self.problem.stage(index).learners[phase]]
        if self.problem.sizes and not learner.searches_goals:
            return 1
        return min(self.problem.discovery.chunk, self.problem.stage(index).learning(phase).updates - update)

    def policy_steps(self, index: int, phases: int | None = None) -> int:
        """Returns the environment's steps in all phases of the policy at a place in the list, or in the first ones."""
        stage = self.problem.stage(index)
        phases = len(stage.learners) if phases is None else phases
        return sum(self.steps(index, phase, stage.learning(phase).updates) for phase in range(phases))

    def steps(self, index: int, phase: int, updates: int) -> int:
        """Returns the environment's steps in the first updates of a phase of the policy at a place in the list."""
        per_update = [part.stage(index).steps_per_update(phase) for part in self.parts]
        rounds, rest = divmod(updates, len(per_update))
        first = rounds * len(per_update)
        return rounds * sum(per_update) + sum(per_update[self.turn(first + offset)] for offset in range(rest))
