"""Learners for any `Environment`, `Policy` and `Value`; nothing here depends on robots.

An environment holds a batch of episodes, the batch on the last axis. A policy maps an observation to a distribution of
actions, a value network to the expected returns; both are Equinox modules. `init` begins a training, and each call of
`train_chunk` runs some updates of it.
"""

from murmurate.learning.advantage import generalized_advantage, rewards_to_go
from murmurate.learning.config import Hyperparameters, PPOConfig, Schedule, Shape, ValueTarget
from murmurate.learning.environment import (
    ActionDistribution,
    Environment,
    Policy,
    Transition,
    Value,
    features_of,
    step_with_autoreset,
)
from murmurate.learning.goals import GoalConfig, GoalEnvironment, GoalHyperparameters
from murmurate.learning.gradients import GradientConfig, GradientHyperparameters, Segment
from murmurate.learning.learners import LEARNERS, Learner, LearnerConfig
from murmurate.learning.losses import Batch, policy_loss, value_loss
from murmurate.learning.ppo import Rollout, TrainState, collect, init, set_log_std, train_chunk
from murmurate.learning.sharding import check_divides
from murmurate.learning.together import Chunk, train_together

__all__ = [
    "LEARNERS",
    "ActionDistribution",
    "Batch",
    "Chunk",
    "Environment",
    "GoalConfig",
    "GoalEnvironment",
    "GoalHyperparameters",
    "GradientConfig",
    "GradientHyperparameters",
    "Hyperparameters",
    "Learner",
    "LearnerConfig",
    "PPOConfig",
    "Policy",
    "Rollout",
    "Schedule",
    "Segment",
    "Shape",
    "TrainState",
    "Transition",
    "Value",
    "ValueTarget",
    "check_divides",
    "collect",
    "features_of",
    "generalized_advantage",
    "init",
    "policy_loss",
    "rewards_to_go",
    "set_log_std",
    "step_with_autoreset",
    "train_chunk",
    "train_together",
    "value_loss",
]
