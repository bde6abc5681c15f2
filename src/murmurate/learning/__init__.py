"""Proximal policy optimisation on anything that is an `Environment`. Knows nothing of robots."""

from murmurate.learning.advantage import generalized_advantage, rewards_to_go
from murmurate.learning.config import Hyperparameters, PPOConfig, Schedule, Shape, ValueTarget
from murmurate.learning.environment import Environment, Transition, step_with_autoreset
from murmurate.learning.losses import Batch, policy_loss, value_loss
from murmurate.learning.ppo import Rollout, TrainState, collect, init, train_chunk
from murmurate.learning.sharding import check_divides
from murmurate.learning.together import Chunk, train_together

__all__ = [
    "Batch",
    "Chunk",
    "Environment",
    "Hyperparameters",
    "PPOConfig",
    "Rollout",
    "Schedule",
    "Shape",
    "TrainState",
    "Transition",
    "ValueTarget",
    "check_divides",
    "collect",
    "generalized_advantage",
    "init",
    "policy_loss",
    "rewards_to_go",
    "step_with_autoreset",
    "train_chunk",
    "train_together",
    "value_loss",
]
