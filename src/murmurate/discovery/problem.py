"""What is to be discovered, and how: the problem, its stages, and the same problem for swarms of other sizes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from murmurate.discovery.rest import RestRule
from murmurate.discovery.validity import REPLACED
from murmurate.errors import MAX_INTEGER, MAX_MAGNITUDE, InputError, check_choice, check_number, check_type
from murmurate.learning import LEARNERS, GoalConfig, GradientConfig, LearnerConfig, PPOConfig
from murmurate.policies import NoShield, Policy, Shield
from murmurate.representation import short_repr
from murmurate.world import (
    SMOOTH_SIGNALS,
    FsyncScheduler,
    GlobalSensing,
    Objective,
    Scheduler,
    Sensing,
    Signal,
    SlowMoves,
    Start,
    WorldConfig,
    episodes_at_once,
    objective_signals,
    scaled_to,
)

__all__ = ["GATHERING", "GATHERING_SIGNALS", "DiscoveryConfig", "Problem", "StageConfig"]

ProblemT = TypeVar("ProblemT", bound="Problem")

GATHERING = "gathering"
GATHERING_SIGNALS = ("close", "nclose")
"""In weights, `gathering` stands for the gathering signal of either objective: close (C1) or nclose (C2)."""

DAMPED = 0.5
"""Share of the speed limit from which on no move is damped."""


_READ = {
    "ppo": ("ppo", "weights", "repeat", "motion_cost", "margin"),
    "gradients": ("gradients",),
    "goals": ("goals",),
}
"""Which numbers of a stage each learner reads; what is named by none of them is where episodes begin, and how long."""


@dataclass(frozen=True)
class StageConfig:
    """How one policy of the list is trained (the paper's Algorithm 1).

    Attributes:
        weights: Weights of the signals in this policy's reward, by name: of those of the objective, where gathering
            stands for close (C1) or nclose (C2), and of the package's smooth signals beside them.
        learner: ppo, which discovers; gradients, which refines what `--from` or `warm_start` begins with; or goals,
            which searches the formations of a policy that remembers some.
        refine: Whether gradients refine the policy that ppo or goals has discovered, from the same starts; with the
            learner gradients it changes nothing.
        ppo: Numbers of the learner ppo; its discount is the paper's F_gamma at this policy.
        gradients: Numbers of the learner gradients; it has weights, margins and a cost of motion of its own.
        goals: Numbers of the learner goals; it has weights and margins of its own.
        horizon: Steps after which a training episode is truncated.
        repeat: Steps for which each action is kept up in training; the trained policy acts at every step.
        noise: Half-width of the uniform noise on each restart configuration, in robot radii (auxiliary only).
        random_share: Share of training episodes that begin anywhere, in two windows, instead of at the start (base
            only).
        random_spread: Each of the windows takes at least this share of the world's sides.
        symmetric_share: Share of all training episodes that begin exactly symmetric: as a polygon, line, grid or rings
            of random width and direction (base only).
        hard_share: Share of all training episodes that begin at the start `hard`: crowded, at the walls, in a corner,
            in a tight grid, exactly symmetric or anywhere (base only).
        surrounded_share: Share of all training episodes that begin at the start `surrounded`: a ring of robots around
            one robot or a few (base only).
        motion_cost: What each robot's credit loses in training by ppo for a step at the speed limit along an axis, and
            for a shorter one in proportion; where the swarm learns from one credit, that loses the mean.
        margin: ppo trains robots as if their radius and safe distance were larger by this share, so that patterns hold
            with room to spare.
        warm_start: Whether the policy begins with the weights of the one before, all but the spread of its actions
            (auxiliary only); its value network is new.
    """

    weights: Mapping[str, float] = field(default_factory=dict)
    learner: str = "ppo"
    refine: bool = False
    ppo: PPOConfig = field(default_factory=PPOConfig)
    gradients: GradientConfig = field(default_factory=GradientConfig)
    goals: GoalConfig = field(default_factory=GoalConfig)
    horizon: int = 120
    repeat: int = 1
    noise: float = 0.25
    random_share: float = 0.5
    random_spread: float = 0.05
    symmetric_share: float = 0.0
    hard_share: float = 0.0
    surrounded_share: float = 0.0
    motion_cost: float = 0.0
    margin: float = 0.0
    warm_start: bool = False

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for name, weight in self.weights.items():
            check_number(f"weights.{name}", weight, 0, MAX_MAGNITUDE)
        check_choice("learner", self.learner, tuple(LEARNERS))
        for name in ("horizon", "repeat"):
            check_number(name, getattr(self, name), 1, MAX_INTEGER, integer=True)
        check_number("noise", self.noise, 0, MAX_MAGNITUDE)
        check_number("motion_cost", self.motion_cost, 0, MAX_MAGNITUDE)
        check_number("margin", self.margin, 0, 10)
        check_number("random_share", self.random_share, 0, 1)
        check_number("symmetric_share", self.symmetric_share, 0, 1)
        check_number("hard_share", self.hard_share, 0, 1)
        check_number("surrounded_share", self.surrounded_share, 0, 1)
        check_number("random_spread", self.random_spread, 0, 1, exclusive_low=True)

    @property
    def learners(self) -> tuple[str, ...]:
        """The learners that train the policy, one after the other: its phases."""
        return (self.learner, "gradients") if self.refine and self.learner != "gradients" else (self.learner,)

    @property
    def unread(self) -> set[str]:
        """Fields that none of the learners reads."""
        read = {name for learner in self.learners for name in _READ[learner]}
        return {name for names in _READ.values() for name in names} - read

    def learning(self, phase: int) -> LearnerConfig:
        """Returns the numbers of the learner of a phase."""
        return getattr(self, self.learners[phase])

    def steps_per_update(self, phase: int) -> int:
        """Returns the steps of the environment in one update of a phase."""
        numbers = self.learning(phase)
        return numbers.worlds * numbers.steps * (self.repeat if LEARNERS[self.learners[phase]].repeats_actions else 1)


@dataclass(frozen=True)
class DiscoveryConfig:
    """How the list of policies grows (the paper's Algorithm 2).

    Attributes:
        min_policies: Policies trained in any case: the base policy and, by the paper, one auxiliary.
        max_policies: Policies after which the search ends, valid or not.
        required_valid: The list is complete when at least this share of fresh episodes forms a valid pattern.
        sigma: Size of the set of initial configurations sigma.
        episodes: Fresh episodes by which the list is evaluated after each policy.
        chunk: Updates between two visits to the host: progress, metrics, checkpoint.
    """

    min_policies: int = 2
    max_policies: int = 3
    required_valid: float = 0.995
    sigma: int = 512
    episodes: int = 256
    chunk: int = 5

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for name in ("min_policies", "max_policies", "sigma", "episodes", "chunk"):
            check_number(name, getattr(self, name), 1, MAX_INTEGER, integer=True)
        if self.max_policies < self.min_policies:
            raise InputError("max_policies", self.max_policies, f"at least min_policies = {self.min_policies}")
        check_number("required_valid", self.required_valid, 0, 1)


def check_problem(problem: object) -> None:
    """Checks an argument that says what is to be discovered.

    Raises:
        InputError: It is something else.
    """
    check_type("problem", problem, Problem, "an experiment, such as run.experiment")


@dataclass(frozen=True)
class Problem:
    """What is to be discovered, and how: an experiment without its name.

    Attributes:
        world: Sizes of the world and its robots.
        objective: C1 (gathering at the origin), C2 (at no predefined point) or custom (the signals below alone).
        start: Where episodes begin: the paper's (S_0, epsilon).
        policy: Which networks are trained.
        base: How the first policy is trained.
        auxiliary: How each later policy is trained.
        discovery: How the list grows.
        rest: When a policy has come to rest.
        seed: Seed of everything random.
        signals: Signals of the objective besides those that it is named after, or in their place, by name.
        valid: Least values of signals that a valid pattern must reach, by name. A value of visible, neighbors or safety
            replaces the condition that all pairs see each other, are neighbours, or keep the safe distance.
        sensing: What robots perceive, where each acts on that alone (policies such as local).
        scheduler: When robots look and move.
        shield: What shortens the robots' moves.
        sizes: Swarm sizes among which training alternates, each in a world scaled to it; none: the world's own alone.
    """

    world: WorldConfig
    objective: str
    start: Start
    policy: Policy
    base: StageConfig
    auxiliary: StageConfig
    discovery: DiscoveryConfig
    rest: RestRule
    seed: int
    signals: Mapping[str, Signal] = field(default_factory=dict, kw_only=True)
    valid: Mapping[str, float] = field(default_factory=dict, kw_only=True)
    sensing: Sensing = field(default_factory=GlobalSensing, kw_only=True)
    scheduler: Scheduler = field(default_factory=FsyncScheduler, kw_only=True)
    shield: Shield = field(default_factory=NoShield, kw_only=True)
    sizes: tuple[int, ...] = field(default=(), kw_only=True)

    __repr__ = short_repr

    @property
    def objective_signals(self) -> dict[str, Signal]:
        """The signals of the objective by name, in the order in which they are recorded.

        Raises:
            InputError: The objective has no signal.
        """
        return objective_signals(self.objective, self.signals)

    @property
    def signal_names(self) -> tuple[str, ...]:
        """The names of the objective's signals, in the order in which they are recorded."""
        return tuple(self.objective_signals)

    @property
    def thresholds(self) -> dict[str, tuple[Signal, float]]:
        """The signals that a valid pattern must reach, with their least values, by name."""
        known: Mapping[str, Any] = Signal.registered()
        signals: dict[str, Any] = {**{name: known[name]() for name in REPLACED}, **self.objective_signals}
        return {name: (signals[name], least) for name, least in self.valid.items()}

    @property
    def prepared_shield(self) -> Shield:
        """The shield as it acts under the scheduler.

        Raises:
            InputError: It cannot serve the scheduler.
        """
        return self.shield.prepare(self.scheduler)

    @property
    def landmark(self) -> bool:
        """Whether the gathering point is known: whether a signal of the objective is measured from it."""
        return Objective(self.objective_signals).needs_landmark

    def stage(self, index: int) -> StageConfig:
        """Returns how the policy at a place in the list is trained."""
        return self.base if index == 0 else self.auxiliary

    def reward(self, index: int) -> tuple[dict[str, Signal], dict[str, float]]:
        """Returns the signals, with their weights, that reward the policy at a place in the list while ppo trains it.

        They are those of the objective, and the smooth signals that the policy has weights for.
        """
        given, weights, signals = self.stage(index).weights, {}, self.objective_signals
        for name, signal in signals.items():
            gathering = given.get(GATHERING) if name in GATHERING_SIGNALS else None
            weights[name] = given.get(name, signal.weight if gathering is None else gathering)
        known: Mapping[str, Any] = Signal.registered()
        beside: dict[str, Any] = {
            name: known[name]() for name in SMOOTH_SIGNALS if name in given and name not in signals
        }
        weights.update((name, given[name]) for name in beside)
        return {**signals, **beside}, weights

    def refinement(self, index: int, learner: str = "gradients") -> tuple[dict[str, Signal], dict[str, float]]:
        """Returns the signals, with their weights, that a learner with weights of its own improves a policy by.

        Args:
            index: Place of the policy in the list.
            learner: gradients or goals.

        Raises:
            InputError: There is no signal of a name, or it has no margin.
        """
        numbers, section = getattr(self.stage(index), learner), f"{'base' if index == 0 else 'auxiliary'}.{learner}"
        given, margins = dict(numbers.weights), numbers.margins
        gathering = given.pop(GATHERING, None)
        if gathering is not None:
            given["centered" if self.landmark else "compact"] = gathering
        configured, known = self.objective_signals, Signal.registered()
        for name in given:
            if name not in configured and name not in known:
                allowed = f"for a signal ({', '.join(sorted({*configured, *known}))})"
                raise InputError(f"{section}.weights.{name}", given[name], allowed)
        signals: dict[str, Any] = {name: configured[name] if name in configured else known[name]() for name in given}
        with_margin = sorted(name for name in given if name not in configured and hasattr(signals[name], "margin"))
        for name, margin in margins.items():
            if name not in with_margin:
                allowed = f"for a signal of {section}.weights that has one ({', '.join(with_margin) or 'none has'})"
                raise InputError(f"{section}.margins.{name}", margin, allowed)
            signals[name] = replace(signals[name], margin=margin)
        return signals, given

    def of_size(self: ProblemT, robots: int) -> ProblemT:
        """Returns the same problem for a swarm of another size, in a world scaled to it.

        In a larger world the objective changes by less where robots move as far: what ends a policy that another one
        follows is as much less. Rest must last as much longer, and there is as much more time to come to it.

        Raises:
            InputError: There are too few or too many robots.
        """
        world, rest = scaled_to(self.world, robots), self.rest
        factor = max(world.half_width / self.world.half_width, 1.0)
        rest = replace(
            rest,
            window=math.ceil(rest.window * factor),
            switch_tolerance=rest.switch_tolerance / factor,
            max_steps=math.ceil(rest.max_steps * factor),
        )
        return replace(self, world=world, rest=rest, sizes=())

    def usual_steps(self, policies: int, episodes: int) -> float:
        """Returns about how many steps a list of policies takes: from half of the world's side away, and until rest.

        Args:
            policies: Length of the list.
            episodes: How many episodes, in batches that are executed one after another.
        """
        batches = -(-episodes // episodes_at_once(self.world.robots))
        steps = self.world.half_width / self.world.max_speed
        return batches * self.scheduler.period * (steps + policies * self.rest.window)

    @property
    def slow_moves(self) -> SlowMoves:
        """What becomes of slow moves, in world units."""
        rest, speed = self.rest, self.world.max_speed
        return SlowMoves(rest.dead_zone * speed, DAMPED * speed, rest.damping, rest.sidestep * speed)

    @property
    def rest_in_steps(self) -> RestRule:
        """When a policy has come to rest under the scheduler.

        Rest is rest of every robot: where not all move at every step, the rule counts their cycles.
        """
        period = self.scheduler.period
        return replace(self.rest, window=self.rest.window * period, max_steps=self.rest.max_steps * period)
