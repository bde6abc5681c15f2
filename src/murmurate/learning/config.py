"""Numbers of proximal policy optimisation, and schedules of those that change while it runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from murmurate.errors import MOST, InputError, check_choice, check_number

__all__ = ["Exploration", "Hyperparameters", "PPOConfig", "Schedule", "Shape", "ValueTarget"]

ValueTarget = Literal["gae", "rewards-to-go"]
Exploration = Literal["learned", "scheduled"]
_FINITE = 1e30  # still a number in float32


@dataclass(frozen=True)
class PPOConfig:
    """Numbers of proximal policy optimisation (the paper's Table I and what it leaves unsaid).

    Attributes:
        updates: The paper's Z: learning epochs, each a fresh batch of trajectories.
        worlds: Parallel episodes.
        steps: Steps of each of them in one update.
        epochs: Passes over the batch of trajectories.
        minibatches: Parts of each pass.
        discount: The paper's gamma.
        gae_lambda: The paper's lambda.
        policy_rate: The paper's alpha at the first update.
        policy_rate_end: alpha at the last update.
        value_rate: The paper's beta at the first update.
        value_rate_end: beta at the last update.
        clip: The paper's epsilon_c at the first update.
        clip_end: epsilon_c at the last update; above `clip` it is the paper's gradual increase.
        value_target: gae (advantage plus value) or rewards-to-go (undiscounted, as the paper prints it).
        reward_scale: Factor on every reward while learning.
        max_gradient: Bound on the global norm of each network's gradient.
        exploration: Whether the spread of the actions is learned with the policy or scheduled. A learned one stays wide
            where noise itself pays, and what only noise reaches is lost when the most likely action is executed.
        log_std: Natural logarithm of the spread at the first update, in the policy's unit: the speed limit, for robots.
        log_std_end: The same at the last update, where it is scheduled.
    """

    updates: int = 100
    worlds: int = 256
    steps: int = 32
    epochs: int = 3
    minibatches: int = 8
    discount: float = 0.95
    gae_lambda: float = 0.95
    policy_rate: float = 1e-3
    policy_rate_end: float = 1e-4
    value_rate: float = 1e-3
    value_rate_end: float = 1e-4
    clip: float = 0.2
    clip_end: float = 0.2
    value_target: ValueTarget = "gae"
    reward_scale: float = 10.0
    max_gradient: float = 0.5
    exploration: Exploration = "learned"
    log_std: float = -1.0
    log_std_end: float = -2.5

    def __post_init__(self) -> None:
        for name in ("updates", "worlds", "steps", "epochs", "minibatches"):
            check_number(name, getattr(self, name), 1, MOST, integer=True)
        if (self.worlds * self.steps) % self.minibatches:
            raise InputError(
                "minibatches", self.minibatches, f"a divisor of worlds * steps = {self.worlds * self.steps}"
            )
        for name in ("discount", "gae_lambda"):
            check_number(name, getattr(self, name), 0, 1)
        for name in ("policy_rate", "policy_rate_end", "value_rate", "value_rate_end"):
            check_number(name, getattr(self, name), 0, _FINITE)
        for name in ("clip", "clip_end", "reward_scale", "max_gradient"):
            check_number(name, getattr(self, name), 0, _FINITE, exclusive_low=True)
        for name in ("log_std", "log_std_end"):
            check_number(name, getattr(self, name), -20, 20)
        check_choice("value_target", self.value_target, get_args(ValueTarget))
        check_choice("exploration", self.exploration, get_args(Exploration))


class Schedule(eqx.Module):
    """A number that goes linearly from `start` to `end` over the whole training."""

    start: Any
    end: Any

    def __call__(self, progress: Float[Array, ""]) -> Float[Array, ""]:
        """Returns the value at a progress from 0 (first update) to 1 (last)."""
        return self.start + (self.end - self.start) * progress


class Hyperparameters(eqx.Module):
    """The numbers of `PPOConfig` that can change without recompiling; `log_std` is None where it is learned."""

    updates: Any
    discount: Any
    gae_lambda: Any
    policy_rate: Schedule
    value_rate: Schedule
    clip: Schedule
    reward_scale: Any
    max_gradient: Any
    log_std: Schedule | None

    @classmethod
    def create(cls, config: PPOConfig) -> Hyperparameters:
        """Takes them from a configuration."""
        numbers = cls(
            updates=config.updates,
            discount=config.discount,
            gae_lambda=config.gae_lambda,
            policy_rate=Schedule(config.policy_rate, config.policy_rate_end),
            value_rate=Schedule(config.value_rate, config.value_rate_end),
            clip=Schedule(config.clip, config.clip_end),
            reward_scale=config.reward_scale,
            max_gradient=config.max_gradient,
            log_std=Schedule(config.log_std, config.log_std_end) if config.exploration == "scheduled" else None,
        )
        # Arrays, because equinox compiles plain numbers in.
        return jax.tree.map(jnp.asarray, numbers)


@dataclass(frozen=True)
class Shape:
    """The numbers of `PPOConfig` that change what is compiled."""

    worlds: int
    steps: int
    epochs: int
    minibatches: int
    value_target: ValueTarget

    @classmethod
    def create(cls, config: PPOConfig) -> Shape:
        """Takes them from a configuration."""
        return cls(config.worlds, config.steps, config.epochs, config.minibatches, config.value_target)
