"""What is to be discovered, and how; the same for swarms of other sizes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Self

from murmurate.discovery.cascade import RestRule
from murmurate.discovery.config import DiscoveryConfig, StageConfig
from murmurate.policies import PolicyConfig
from murmurate.world import SchedulerConfig, SensingConfig, StartConfig, World, WorldConfig, make_start, scaled_to

__all__ = ["Problem"]


@dataclass(frozen=True)
class Problem:
    """What is to be discovered, and how; an experiment without its bookkeeping.

    Attributes:
        world: Sizes.
        objective: C1 or C2.
        start: Where episodes begin: the paper's (S_0, epsilon).
        policy: Which networks.
        base: How the first policy is trained.
        auxiliary: How each later one is.
        discovery: How the list grows.
        rest: When a policy has come to rest.
        seed: Seed of everything random.
        sensing: What robots perceive, where each acts on that alone (the policy local).
        scheduler: When robots look and move.
        sizes: Swarm sizes among which training goes about, each in a world grown to it; none: the world's own alone.
    """

    world: WorldConfig
    objective: str
    start: StartConfig
    policy: PolicyConfig
    base: StageConfig
    auxiliary: StageConfig
    discovery: DiscoveryConfig
    rest: RestRule
    seed: int
    sensing: SensingConfig = field(default_factory=SensingConfig, kw_only=True)
    scheduler: SchedulerConfig = field(default_factory=SchedulerConfig, kw_only=True)
    sizes: tuple[int, ...] = field(default=(), kw_only=True)

    def stage(self, index: int) -> StageConfig:
        """Returns how the policy of that place in the list is trained."""
        return self.base if index == 0 else self.auxiliary

    def of_size(self, robots: int) -> Self:
        """Returns the same problem for a swarm of another size, in a world grown to it.

        In a larger world the objective changes by less where robots move as far: what counts as rest is as much less,
        must last as much longer, and there is as much more time to come to it.

        Raises:
            InputError: There are too few or too many robots.
        """
        world, rest = scaled_to(self.world, robots), self.rest
        factor = max(world.half_width / self.world.half_width, 1.0)
        rest = replace(
            rest,
            window=math.ceil(rest.window * factor),
            tolerance=rest.tolerance / factor,
            switch_tolerance=rest.switch_tolerance / factor,
            max_steps=math.ceil(rest.max_steps * factor),
        )
        return replace(self, world=world, rest=rest, sizes=())

    @property
    def rest_in_steps(self) -> RestRule:
        """When a policy has come to rest under the scheduler.

        Rest is rest of every robot: where not all move at every step, the rule counts their cycles.
        """
        period = self.scheduler.period
        return replace(self.rest, window=self.rest.window * period, max_steps=self.rest.max_steps * period)

    def parts(self) -> list[Self]:
        """Returns the problem for each swarm size that training goes about, with as much to learn from in an update."""
        ppo, config = self.base.ppo, self.discovery
        found = []
        for robots in self.sizes:
            # As many robots in all, but no more worlds than half as many again: their steps cost something too.
            share = min(self.world.robots / robots, 1.5)
            worlds = max(round(share * ppo.worlds / ppo.minibatches), 1) * ppo.minibatches
            part = self.of_size(robots)
            base = replace(part.base, ppo=replace(ppo, worlds=worlds))
            episodes = math.ceil(config.episodes / len(self.sizes))
            found.append(replace(part, base=base, discovery=replace(config, episodes=episodes)))
        return found

    def evaluation_world(self) -> World:
        """Builds the world with the experiment's start and all weights 1, as evaluation measures it."""
        return World.create(self.world, make_start(self.start, self.world), self.objective)
