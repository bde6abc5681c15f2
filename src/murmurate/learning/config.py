"""Configuration of proximal policy optimisation, and schedules of the numbers that change during training."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from murmurate.errors import MAX_INTEGER, InputError, check_choice, check_number
from murmurate.representation import short_repr

__all__ = ["Exploration", "Hyperparameters", "PPOConfig", "Schedule", "Shape", "ValueTarget"]

ValueTarget = Literal["gae", "rewards-to-go"]
Exploration = Literal["learned", "scheduled"]
MAX_RATE = 1e30
"""Learning rates and factors, at most: finite in float32."""


@dataclass(frozen=True)
class PPOConfig:
    """Configuration of proximal policy optimisation (the paper's Table I, and what the paper leaves open).

    Attributes:
        updates: Number of updates, each from a new batch of trajectories (the paper's Z).
        worlds: Number of parallel episodes.
        steps: Steps of each episode in one update.
        epochs: Passes over each batch of trajectories.
        minibatches: Minibatches in each pass.
        discount: The paper's gamma.
        gae_lambda: The paper's lambda.
        policy_rate: The paper's alpha at the first update.
        policy_rate_end: alpha at the last update.
        value_rate: The paper's beta at the first update.
        value_rate_end: beta at the last update.
        clip: The paper's epsilon_c at the first update.
        clip_end: epsilon_c at the last update (the paper increases it gradually).
        value_target: gae (advantage plus value) or rewards-to-go (undiscounted, as the paper prints it).
        reward_scale: Factor on every reward in training.
        max_gradient: Bound on the global norm of each network's gradient.
        exploration: learned (the policy holds the standard deviation of the actions as a parameter) or scheduled. A
            learned one stays wide where the noise itself earns reward, which the most likely action does not get.
        log_std: Natural logarithm of the standard deviation at the first update, relative to the speed limit.
        log_std_end: The same at the last update, if it is scheduled.
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

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for name in ("updates", "worlds", "steps", "epochs", "minibatches"):
            check_number(name, getattr(self, name), 1, MAX_INTEGER, integer=True)
        if (self.worlds * self.steps) % self.minibatches:
            raise InputError(
                "minibatches", self.minibatches, f"a divisor of worlds * steps = {self.worlds * self.steps}"
            )
        for name in ("discount", "gae_lambda"):
            check_number(name, getattr(self, name), 0, 1)
        for name in ("policy_rate", "policy_rate_end", "value_rate", "value_rate_end"):
            check_number(name, getattr(self, name), 0, MAX_RATE)
        for name in ("clip", "clip_end", "reward_scale", "max_gradient"):
            check_number(name, getattr(self, name), 0, MAX_RATE, exclusive_low=True)
        for name in ("log_std", "log_std_end"):
            check_number(name, getattr(self, name), -20, 20)
        check_choice("value_target", self.value_target, get_args(ValueTarget))
        check_choice("exploration", self.exploration, get_args(Exploration))


class Schedule(eqx.Module):
    """A number that changes linearly from `start` to `end` over the whole training."""

    start: Any
    end: Any

    __repr__ = short_repr

    def __call__(self, progress: Float[Array, ""]) -> Float[Array, ""]:
        """Returns the value at a progress from 0 (first update) to 1 (last)."""
        return self.start + (self.end - self.start) * progress


class Hyperparameters(eqx.Module):
    """The numbers of `PPOConfig` that can change without recompiling; `log_std` is None if it is learned."""

    updates: Any
    discount: Any
    gae_lambda: Any
    policy_rate: Schedule
    value_rate: Schedule
    clip: Schedule
    reward_scale: Any
    max_gradient: Any
    log_std: Schedule | None

    __repr__ = short_repr

    @classmethod
    def from_config(cls, config: PPOConfig) -> Hyperparameters:
        """Returns the numbers of a configuration."""
        numbers = cls(
            updates=jnp.asarray(config.updates, jnp.int32),
            discount=config.discount,
            gae_lambda=config.gae_lambda,
            policy_rate=Schedule(config.policy_rate, config.policy_rate_end),
            value_rate=Schedule(config.value_rate, config.value_rate_end),
            clip=Schedule(config.clip, config.clip_end),
            reward_scale=config.reward_scale,
            max_gradient=config.max_gradient,
            log_std=Schedule(config.log_std, config.log_std_end) if config.exploration == "scheduled" else None,
        )
        # Equinox compiles plain numbers into the program, so they become arrays; their type is not left to JAX's flags.
        return jax.tree.map(lambda x: x if isinstance(x, jax.Array) else jnp.asarray(x, jnp.float32), numbers)


@dataclass(frozen=True)
class Shape:
    """The numbers of `PPOConfig` that change what is compiled."""

    worlds: int
    steps: int
    epochs: int
    minibatches: int
    value_target: ValueTarget

    __repr__ = short_repr

    @classmethod
    def from_config(cls, config: PPOConfig) -> Shape:
        """Returns the numbers of a configuration."""
        return cls(config.worlds, config.steps, config.epochs, config.minibatches, config.value_target)
