"""Algorithm 2: grows the list of policies until patterns are valid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from murmurate.discovery.build import build_cascade, build_world
from murmurate.discovery.curriculum import Curriculum
from murmurate.discovery.limits import check_training, rollout
from murmurate.discovery.problem import Problem
from murmurate.discovery.programs import forget_programs
from murmurate.discovery.stage import Stage, draw_key, policy_name, repeat_to, training_world
from murmurate.discovery.validity import check_validity
from murmurate.learning import TrainState, check_divides, sharding, train_together
from murmurate.representation import short_repr
from murmurate.world import (
    HardStart,
    JitteredStart,
    SurroundedStart,
    SymmetricStart,
    UniformStart,
    World,
    check_start,
    draw_starts,
)

__all__ = ["Search", "Snapshot", "advance_together"]


@dataclass(frozen=True)
class Snapshot:
    """How far a search has come: all that resuming needs.

    Attributes:
        policies: The list Pi of finished policies.
        sigma: The set of configurations that the policy in training starts from, repeated up to a fixed number; empty
            when every episode of the policy before ended in contact or outside the world.
        valid: Share of valid patterns after the last finished policy.
        train: Training of the current policy; None before its first update in a phase.
        unrefined: What the first learner has trained and gradients are to refine; None in the first phase of a policy.
        finished: Whether the search is over.
    """

    policies: tuple[Any, ...]
    sigma: Float[Array, "sigma robots 2"]
    valid: float
    train: TrainState | None
    finished: bool = False
    unrefined: Any | None = None

    __repr__ = short_repr

    @property
    def phase(self) -> int:
        """Which learner of its stage trains the current policy."""
        return 0 if self.unrefined is None else 1


class Search:
    """Algorithm 2, one chunk of updates at a time.

    Everything random derives from the seed and the place in the list, never from what ran before, so a search that is
    resumed from any snapshot ends in the same weights as an unbroken one.

    Args:
        problem: What to discover, and how.
        initial: Policy networks whose weights the policies of the list begin with, as far as there are any; those
            without begin as their stage has it.

    Raises:
        InputError: The problem is impossible, as with too many robots for the start.
    """

    __match_args__ = ("problem",)
    __repr__ = short_repr

    def __init__(self, problem: Problem, initial: Sequence[Any] = ()) -> None:
        self.problem, self.initial = problem, tuple(initial)
        self.curriculum = Curriculum(problem)
        self.world = build_world(problem)
        for part in self.curriculum.parts:
            check_training(part)
            if problem.base.random_share:
                check_start(UniformStart(), part.world)
            if problem.base.symmetric_share:
                check_start(SymmetricStart(), part.world)
            if problem.base.hard_share:
                check_start(HardStart(), part.world)
            if problem.base.surrounded_share:
                check_start(SurroundedStart(), part.world)

    @cached_property
    def part_worlds(self) -> tuple[World, ...]:
        """The evaluation world of each swarm size."""
        if not self.problem.sizes:
            return (self.world,)
        return tuple(build_world(part) for part in self.curriculum.parts)

    def check_devices(self) -> None:
        """Checks that the available devices divide every batch that is trained on.

        Raises:
            InputError: They do not.
        """
        for index in range(min(2, self.problem.discovery.max_policies)):
            for part in self.curriculum.parts:
                stage = part.stage(index)
                robots = f" (swarms of {part.world.robots})" if self.problem.sizes else ""
                for phase, learner in enumerate(stage.learners):
                    numbers, name = stage.learning(phase), f"{policy_name(index)}.{learner}"
                    check_divides(f"{name}.worlds{robots}", numbers.worlds)
                    part_of_pass = numbers.worlds * numbers.steps // numbers.minibatches
                    check_divides(f"{name}.worlds * steps / minibatches{robots}", part_of_pass)

    def begin(self) -> Snapshot:
        """Returns the snapshot before the first policy: sigma is the problem's start."""
        return Snapshot(policies=(), sigma=_initial_sigma(self.problem, self.world), valid=0.0, train=None)

    def stage(self, snapshot: Snapshot) -> Stage:
        """Returns the training of the next policy of the list."""
        sigmas = self._first_sigmas if self.problem.sizes else (snapshot.sigma,)
        starts = [world.start for world in self.part_worlds]
        return Stage(self.curriculum, len(snapshot.policies), snapshot.phase, starts, sigmas)

    def training(self, snapshot: Snapshot) -> TrainState:
        """Returns the state of the next policy's training, which may be before its first update."""
        if snapshot.train is not None:
            return snapshot.train
        index, warm_start = len(snapshot.policies), snapshot.unrefined
        if warm_start is None and index < len(self.initial):
            warm_start = self.initial[index]
        elif warm_start is None and index and self.problem.stage(index).warm_start:
            warm_start = snapshot.policies[-1]
        return self.stage(snapshot).begin(warm_start)

    def advance(self, snapshot: Snapshot) -> tuple[Snapshot, list[dict[str, Any]]]:
        """Runs one chunk of updates; after a policy's last one, also evaluates the list.

        Returns:
            The new snapshot, and the metrics of every update of the chunk.
        """
        return advance_together([self], [snapshot])[0]

    def validity(self, policies: tuple[Any, ...], index: int) -> float:
        """Returns the share of fresh episodes from (S_0, epsilon) in which the list forms a valid pattern."""
        key, valid = draw_key(self.problem, index, "evaluation"), []
        for part, world in zip(self.curriculum.parts, self.part_worlds, strict=True):
            forget_programs()
            starts = draw_starts(world.start, key, part.discovery.episodes, world.config)
            trajectories = rollout(build_cascade(part, policies, world), starts)
            valid.append(check_validity(trajectories, part.world, part.thresholds).valid)
        return float(sharding.broadcast(np.concatenate(valid)).mean())

    def conclude(self, snapshot: Snapshot, policy: Any) -> Snapshot:
        """Appends a trained policy, evaluates from sigma, and decides whether the list is complete.

        The last policy of a list that stays incomplete is left out again where fewer patterns are valid with it.
        """
        config, index = self.problem.discovery, len(snapshot.policies)
        policies = (*snapshot.policies, policy)
        # Every policy's sigma* comes from running the whole list so far from where the base policy was trained.
        world = training_world(self.problem, 0, self.world.start, self.begin().sigma)
        starts = draw_starts(world.start, draw_key(self.problem, index, "sigma"), config.sigma, world.config)
        trajectories = rollout(build_cascade(self.problem, policies, self.world), starts)
        final, terminated = sharding.broadcast((trajectories.final, trajectories.terminated))
        alive = final[~terminated]
        valid = self.validity(policies, index)
        complete = len(policies) >= config.min_policies and valid >= config.required_valid
        finished = complete or len(policies) == config.max_policies or len(alive) == 0
        if finished and not complete and index >= config.min_policies and valid < snapshot.valid:
            return replace(snapshot, train=None, unrefined=None, finished=True)
        sigma = repeat_to(alive, config.sigma) if len(alive) else jnp.asarray(alive)
        return Snapshot(policies=policies, sigma=sigma, valid=valid, train=None, finished=finished)

    @cached_property
    def _first_sigmas(self) -> tuple[Float[Array, "_ _ 2"], ...]:
        # Drawn only when it is trained from; with its numbers even where only shapes are asked for, as they are kept.
        with jax.ensure_compile_time_eval():
            return tuple(map(_initial_sigma, self.curriculum.parts, self.part_worlds))


def advance_together(
    searches: Sequence[Search], snapshots: Sequence[Snapshot]
) -> list[tuple[Snapshot, list[dict[str, Any]]]]:
    """Runs one chunk of updates of each of many searches, in one program where their shapes agree.

    Args:
        searches: Of any experiments; what differs in numbers only, such as seeds, weights or discounts, agrees.
        snapshots: How far each has come; none of them is finished.

    Returns:
        What `Search.advance` returns, for each. It is the same as alone, but for the order of floating-point sums.
    """
    forget_programs()
    stages = [search.stage(snapshot) for search, snapshot in zip(searches, snapshots, strict=True)]
    before = [search.training(snapshot) for search, snapshot in zip(searches, snapshots, strict=True)]
    results = train_together([stage.next_chunk(train) for stage, train in zip(stages, before, strict=True)])
    advanced = []
    for search, snapshot, stage, train, result in zip(searches, snapshots, stages, before, results, strict=True):
        train, rows = stage.after_chunk(train, *result)
        if stage.is_done(train) and stage.is_last_phase:
            advanced.append((search.conclude(snapshot, stage.result(train)), rows))
        elif stage.is_done(train):
            advanced.append((replace(snapshot, train=None, unrefined=stage.result(train)), rows))
        else:
            advanced.append((replace(snapshot, train=train), rows))
    return advanced


def _initial_sigma(problem: Problem, world: World) -> Float[Array, "sigma robots 2"]:
    start, size = world.start, problem.discovery.sigma
    if isinstance(start, JitteredStart):
        # Each configuration of a file as often as every other, and none left out.
        return repeat_to(np.asarray(start.points), -(-size // len(start.points)) * len(start.points))
    return jnp.asarray(draw_starts(start, draw_key(problem, 0, "initial"), size, world.config))
