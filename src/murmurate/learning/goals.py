"""Goals: improves the states that a policy steers to, by the gradient of what these states are worth.

A policy that brings every episode to one of its goals, and keeps it there, earns in the long run what the goal is
worth. So the gradient of its return by a goal, as the horizon grows, is that of the goal's own value, and no step of
the environment is needed to compute it. Many goals ascend side by side; which are best is known in the end. Nothing
here knows what the environment is about.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate.errors import MAX_INTEGER, MAX_MAGNITUDE, check_number
from murmurate.learning import sharding
from murmurate.learning.config import MAX_RATE
from murmurate.learning.ppo import TrainState, all_finite, descend, init, scan_state
from murmurate.representation import short_repr

__all__ = ["GoalConfig", "GoalEnvironment", "GoalHyperparameters", "train_chunk"]


@dataclass(frozen=True)
class GoalConfig:
    """Configuration of the search for goals.

    Attributes:
        updates: Number of updates; each improves every goal of the policy.
        rate: Learning rate at the first update.
        rate_end: The same at the last update; it falls geometrically.
        weights: Weights of signals that have a gradient, by name: of the objective, of one's own, or of the package;
            gathering stands for centered (C1) or compact (C2).
        margins: Margins of the package's signals among them, by name, in place of their own.
        softness: Shortfall of a signal up to which it is penalised by its square, and beyond which in proportion; at
            the first update, for the signals that have a softness.
        softness_end: The same at the last update; it falls geometrically. In the end almost every shortfall is
            penalised in proportion, so that none is left where the weights are large enough.
        emphasis: Factor on the weights of the signals that have a softness, at the first update; it falls to 1. At
            first robots sort out who sees whom, then they close up.
    """

    # No step is taken, in no episode.
    worlds: ClassVar[int] = 0
    steps: ClassVar[int] = 0
    minibatches: ClassVar[int] = 1

    updates: int = 3000
    rate: float = 1e-2
    rate_end: float = 5e-5
    weights: Mapping[str, float] = field(
        default_factory=lambda: {
            "gathering": 1.0,
            "smooth_safety": 3.0,
            "smooth_neighbors": 3.0,
            "smooth_visible": 10.0,
        }
    )
    margins: Mapping[str, float] = field(default_factory=lambda: {"smooth_safety": 1e-3, "smooth_visible": 1e-3})
    softness: float = 0.1
    softness_end: float = 1e-3
    emphasis: float = 10.0

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_number("updates", self.updates, 1, MAX_INTEGER, integer=True)
        for name in ("rate", "rate_end"):
            check_number(name, getattr(self, name), 0, MAX_RATE, exclusive_low=True)
        for name in ("softness", "softness_end", "emphasis"):
            check_number(name, getattr(self, name), 0, MAX_MAGNITUDE, exclusive_low=True)
        for name, weight in self.weights.items():
            check_number(f"weights.{name}", weight, 0, MAX_MAGNITUDE)
        for name, margin in self.margins.items():
            check_number(f"margins.{name}", margin, 0, MAX_MAGNITUDE)


@runtime_checkable
class GoalEnvironment(Protocol):
    """An environment that says what the goals of a policy network are worth."""

    def goal_value(self, policy: Any, progress: Float[Array, ""]) -> tuple[Float[Array, " goals"], dict[str, Any]]:
        """Returns what all goals are worth at a share of the training, and quantities by name for the metrics."""
        ...


class GoalHyperparameters(eqx.Module):
    """The numbers of `GoalConfig` that can change without recompiling."""

    updates: Any
    rate: Any
    rate_end: Any

    __repr__ = short_repr

    @classmethod
    def from_config(cls, config: GoalConfig) -> GoalHyperparameters:
        """Returns the numbers of a configuration."""
        rates = (jnp.asarray(rate, jnp.float32) for rate in (config.rate, config.rate_end))
        return cls(jnp.asarray(config.updates, jnp.int32), *rates)


def begin(policy: Any, value: Any, env_state: Any, key: PRNGKeyArray, config: GoalConfig) -> TrainState:
    """Returns the state of training before its first update.

    Args:
        policy: The policy network.
        value: The value network, which stays as it is.
        env_state: The states of the environment, which stay as they are.
        key: The key of the training.
        config: The configuration.
    """
    del config
    return init(policy, value, env_state, key)


@eqx.filter_jit
def train_chunk(
    state: TrainState, env: GoalEnvironment, hyper: GoalHyperparameters, shape: None, updates: int
) -> tuple[TrainState, dict[str, Any]]:
    """Runs some updates without returning to Python; arguments and results are those of `ppo.train_chunk`.

    Args:
        state: The state of training.
        env: The environment.
        hyper: Numbers that can change without recompiling.
        shape: None: there are no others.
        updates: Number of updates.

    Returns:
        The state of training after the updates, and the metrics of every update: means over the goals.
    """
    del shape

    def step(state: TrainState, _: None) -> tuple[TrainState, dict[str, Any]]:
        progress = state.update.astype(jnp.float32) / jnp.maximum(hyper.updates - 1, 1).astype(jnp.float32)

        def loss(policy: Any) -> tuple[Float[Array, ""], Any]:
            values, quantities = env.goal_value(policy, progress)
            return -jnp.sum(values), (values, quantities)

        (total, (values, quantities)), gradient = eqx.filter_value_and_grad(loss, has_aux=True)(state.policy)
        norm = optax.tree.norm(gradient)
        # What is not finite of a gradient moves nothing.
        gradient = jax.tree.map(lambda g: jnp.where(jnp.isfinite(g), g, 0.0), gradient)
        rate = hyper.rate * (hyper.rate_end / hyper.rate) ** progress
        policy, moments = descend(state.policy, state.policy_moments, gradient, rate, jnp.inf)
        metrics = {
            "reward": values.mean(),
            "terminated": jnp.zeros(()),
            "signals": jax.tree.map(jnp.mean, quantities),
            "policy_loss": total / values.size,
            "value_loss": jnp.zeros(()),
            "gradient": norm,
            "finite": all_finite((policy, values)),
        }
        state = eqx.tree_at(
            lambda s: (s.policy, s.policy_moments, s.update), state, (policy, moments, state.update + 1)
        )
        return state, metrics

    return sharding.replicate(scan_state(step, state, None, length=updates))
