"""The learners by name: each trains a policy and a value network in an environment, one chunk of updates at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from murmurate.learning import gradients, ppo
from murmurate.learning.config import Hyperparameters, PPOConfig, Shape
from murmurate.learning.gradients import GradientConfig, GradientHyperparameters, Segment

__all__ = ["LEARNERS", "Learner", "LearnerConfig"]


def _as_it_is(policy: Any, config: Any) -> Any:
    del config
    return policy


def _with_spread(policy: Any, config: PPOConfig) -> Any:
    return ppo.set_log_std(policy, config.log_std)


@dataclass(frozen=True)
class Learner:
    """One way to train a policy.

    Attributes:
        hyperparameters: Returns the numbers of its configuration that can change without recompiling.
        shape: Returns those that cannot.
        train_chunk: Runs some updates: see `ppo.train_chunk`.
        prepare: Returns a policy network as it is before the first update, by the configuration.
        repeats_actions: Whether each action is kept up for the steps that a stage's `repeat` says.
        needs_gradients: Whether it improves signals by their gradients.
    """

    hyperparameters: Callable[[Any], Any]
    shape: Callable[[Any], Any]
    train_chunk: Callable[..., tuple[Any, dict[str, Any]]]
    prepare: Callable[[Any, Any], Any] = _as_it_is
    repeats_actions: bool = True
    needs_gradients: bool = False


LEARNERS: dict[str, Learner] = {
    "ppo": Learner(Hyperparameters.from_config, Shape.from_config, ppo.train_chunk, _with_spread),
    "gradients": Learner(
        GradientHyperparameters.from_config,
        Segment.from_config,
        gradients.train_chunk,
        repeats_actions=False,
        needs_gradients=True,
    ),
}
"""Proximal policy optimisation, which discovers, and the gradient through the world, which refines. The numbers of each
are a field of a stage's configuration that has the learner's name."""

LearnerConfig = PPOConfig | GradientConfig
