"""The interfaces of learning: an environment, a policy and a value network; and the step that starts new episodes."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

__all__ = ["ActionDistribution", "Environment", "Policy", "Transition", "Value", "features_of", "step_with_autoreset"]

MAX_DRAWN = 256
"""Most starts that are drawn at once. Of a larger batch few episodes end at the same step: for these it would be a
waste to draw as many starts as there are episodes."""


@runtime_checkable
class Transition(Protocol):
    """The result of one step; the batch is the last axis."""

    @property
    def reward(self) -> Float[Array, " batch"]:
        """Reward of the step."""
        ...

    @property
    def terminated(self) -> Bool[Array, " batch"]:
        """Whether the episode ended in the environment, so that its value is zero from here on."""
        ...

    @property
    def truncated(self) -> Bool[Array, " batch"]:
        """Whether a time limit ended the episode, so that the value of its last state is bootstrapped."""
        ...

    @property
    def credit(self) -> Float[Array, "actions batch"]:
        """Reward of each action of the step: the whole reward, or the action's own part of it."""
        ...

    @property
    def signals(self) -> dict[str, Float[Array, " batch"]]:
        """Quantities by name; the metrics hold their means."""
        ...


@runtime_checkable
class Environment(Protocol):
    """A batch of Markov decision processes; `step` never starts a new episode."""

    def reset_batch(self, key: PRNGKeyArray, batch: int) -> Any:
        """Returns the states of a batch of new episodes, each from a newly drawn start."""
        ...

    def step(self, state: Any, action: Any) -> tuple[Any, Transition]:
        """Advances every episode by one step."""
        ...

    def observe(self, state: Any) -> Any:
        """Returns the input of the policy and value networks; the batch is the last axis of every array."""
        ...


@runtime_checkable
class ActionDistribution(Protocol):
    """The distribution of the actions in a batch of episodes; the batch is the last axis."""

    def sample(self, key: PRNGKeyArray) -> Any:
        """Returns one action for each episode, as the environment's `step` takes them."""
        ...

    def log_prob(self, action: Any) -> Float[Array, "actions batch"]:
        """Returns the log density of an action, one number for each entry of the transition's `credit`."""
        ...


@runtime_checkable
class Policy(Protocol):
    """A policy network: an Equinox module whose floating-point arrays are trained.

    If it has an array `log_std`, the logarithm of the standard deviation of its actions, training sets this array
    before the first update, and at every update with `exploration = "scheduled"`. Without one, use
    `exploration = "learned"`.

    If it has a method `features`, policy and value network are called with `features(observation)` in place of the
    observation. It is computed once for each observation, so what no weight takes part in belongs there.
    """

    def distribution(self, observation: Any) -> ActionDistribution:
        """Returns the distribution of the actions."""
        ...


@runtime_checkable
class Value(Protocol):
    """A value network: an Equinox module whose floating-point arrays are trained."""

    def __call__(self, observation: Any) -> Float[Array, "actions batch"]:
        """Returns the estimated return of each action's credit; of the same shape as `credit`."""
        ...


def features_of(policy: Policy, observation: Any) -> Any:
    """Returns what PPO calls both networks with: the policy's features of an observation, where it has any."""
    features = getattr(policy, "features", None)
    return observation if features is None else features(observation)


def step_with_autoreset(env: Environment, state: Any, action: Any, key: PRNGKeyArray) -> tuple[Any, Transition, Any]:
    """Steps every episode, then replaces the ended ones by new ones.

    Args:
        env: The environment.
        state: A batch of its states.
        action: One action for each episode.
        key: The key of the new starts.

    Returns:
        The states to continue from, the transition, and the observation after the step but BEFORE any reset (its value
        bootstraps a truncated episode).
    """
    after, transition = env.step(state, action)
    done = transition.terminated | transition.truncated
    batch = done.shape[0]

    def reset(after: Any) -> Any:
        fresh = env.reset_batch(key, batch)
        return jax.tree.map(lambda new, old: jnp.where(done, new, old), fresh, after)

    def reset_some(carry: tuple[Any, Bool[Array, " batch"], PRNGKeyArray]) -> tuple[Any, Array, PRNGKeyArray]:
        state, ended, key = carry
        key, draw_key = jax.random.split(key)
        fresh = env.reset_batch(draw_key, MAX_DRAWN)
        place = jnp.cumsum(ended) - 1
        begins = ended & (place < MAX_DRAWN)
        place = jnp.where(begins, place, 0)
        state = jax.tree.map(lambda new, old: jnp.where(begins, new[..., place], old), fresh, state)
        return state, ended & ~begins, key

    if batch <= MAX_DRAWN:
        state = jax.lax.cond(jnp.any(done), reset, lambda after: after, after)
    else:
        state, _, _ = jax.lax.while_loop(lambda carry: jnp.any(carry[1]), reset_some, (after, done, key))
    return state, transition, env.observe(after)
