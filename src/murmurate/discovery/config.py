"""Numbers of the two algorithms."""

from __future__ import annotations

from dataclasses import dataclass, field

from murmurate.errors import GREATEST, MOST, InputError, check_number
from murmurate.learning import PPOConfig
from murmurate.world import WeightsConfig

__all__ = ["DiscoveryConfig", "StageConfig"]


@dataclass(frozen=True)
class StageConfig:
    """How one policy of the list is trained (the paper's Algorithm 1).

    Attributes:
        weights: Weights of the signals in this policy's reward.
        ppo: Numbers of the learner; its discount is the paper's F_gamma at this policy.
        horizon: Steps after which a training episode is truncated.
        repeat: Steps for which each action is kept up while training; what is learned is executed step by step.
        noise: Half-width of the uniform noise on each restart configuration, in robot radii (auxiliary only).
        random_share: Share of training episodes that begin anywhere, in two windows, instead of at the start (base
            only).
        random_spread: Each of the windows takes at least this share of the world's sides.
        symmetric_share: Share of all training episodes that begin exactly symmetric: as a polygon, line, grid or rings
            of random width and direction (base only).
        margin: Robots are trained as if their radius and safe distance were larger by this share, so that patterns hold
            with room to spare.
        warm_start: Whether the policy begins with the weights of the one before, all but the spread of its actions
            (auxiliary only); its value is new.
    """

    weights: WeightsConfig = field(default_factory=WeightsConfig)
    ppo: PPOConfig = field(default_factory=PPOConfig)
    horizon: int = 120
    repeat: int = 1
    noise: float = 0.25
    random_share: float = 0.5
    random_spread: float = 0.05
    symmetric_share: float = 0.0
    margin: float = 0.0
    warm_start: bool = False

    def __post_init__(self) -> None:
        for name in ("horizon", "repeat"):
            check_number(name, getattr(self, name), 1, MOST, integer=True)
        check_number("noise", self.noise, 0, GREATEST)
        check_number("margin", self.margin, 0, 10)
        check_number("random_share", self.random_share, 0, 1)
        check_number("symmetric_share", self.symmetric_share, 0, 1)
        check_number("random_spread", self.random_spread, 0, 1, exclusive_low=True)

    @property
    def steps_per_update(self) -> int:
        """Steps of the environment in one update."""
        return self.ppo.worlds * self.ppo.steps * self.repeat


@dataclass(frozen=True)
class DiscoveryConfig:
    """How the list of policies grows (the paper's Algorithm 2).

    Attributes:
        min_policies: Policies trained in any case: the base policy and, by the paper, one auxiliary.
        max_policies: Policies after which the search ends, valid or not.
        required_valid: The list is complete when at least this share of fresh episodes forms a valid pattern.
        sigma: Size of the set of initial configurations sigma.
        episodes: Fresh episodes by which the list is judged after each policy.
        chunk: Updates between two visits to the host: progress, metrics, checkpoint.
    """

    min_policies: int = 2
    max_policies: int = 3
    required_valid: float = 0.995
    sigma: int = 512
    episodes: int = 256
    chunk: int = 5

    def __post_init__(self) -> None:
        for name in ("min_policies", "max_policies", "sigma", "episodes", "chunk"):
            check_number(name, getattr(self, name), 1, MOST, integer=True)
        if self.max_policies < self.min_policies:
            raise InputError("max_policies", self.max_policies, f"at least min_policies = {self.min_policies}")
        check_number("required_valid", self.required_valid, 0, 1)
