"""The learners by name: each trains a policy and a value network in an environment, one chunk of updates at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from jaxtyping import PRNGKeyArray

from murmurate.learning import goals, gradients, ppo
from murmurate.learning.config import Hyperparameters, PPOConfig, Shape
from murmurate.learning.goals import GoalConfig, GoalHyperparameters
from murmurate.learning.gradients import GradientConfig, GradientHyperparameters, Segment
from murmurate.learning.ppo import TrainState

__all__ = ["LEARNERS", "Learner", "LearnerConfig"]


def _begin_ppo(policy: Any, value: Any, env_state: Any, key: PRNGKeyArray, config: PPOConfig) -> TrainState:
    return ppo.init(ppo.set_log_std(policy, config.log_std), value, env_state, key)


@dataclass(frozen=True)
class Learner:
    """One way to train a policy.

    Attributes:
        hyperparameters: Returns the numbers of its configuration that can change without recompiling.
        shape: Returns those that cannot.
        train_chunk: Runs some updates: see `ppo.train_chunk`.
        begin: Returns the state of training before the first update, of a policy network, a value network, the states
            of the environment, a key and the configuration.
        repeats_actions: Whether each action is kept up for the steps that a stage's `repeat` says.
        needs_gradients: Whether it improves signals by their gradients.
        searches_goals: Whether it trains the goals of a policy network, of which the best counts in the end.
    """

    hyperparameters: Callable[[Any], Any]
    shape: Callable[[Any], Any]
    train_chunk: Callable[..., tuple[Any, dict[str, Any]]]
    begin: Callable[..., TrainState]
    repeats_actions: bool = True
    needs_gradients: bool = False
    searches_goals: bool = False


LEARNERS: dict[str, Learner] = {
    "ppo": Learner(Hyperparameters.from_config, Shape.from_config, ppo.train_chunk, _begin_ppo),
    "gradients": Learner(
        GradientHyperparameters.from_config,
        Segment.from_config,
        gradients.train_chunk,
        gradients.begin,
        repeats_actions=False,
        needs_gradients=True,
    ),
    "goals": Learner(
        GoalHyperparameters.from_config,
        lambda _: None,
        goals.train_chunk,
        goals.begin,
        repeats_actions=False,
        needs_gradients=True,
        searches_goals=True,
    ),
}
"""Proximal policy optimisation, which discovers; the gradient through the world, which refines; and the search for
goals, of policies that have any. The numbers of each are a field of a stage's configuration that has the learner's
name."""

LearnerConfig = PPOConfig | GradientConfig | GoalConfig
