"""All that learning knows of an environment, and the one wrapper that begins new episodes."""

from __future__ import annotations

from typing import Any, Protocol

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

__all__ = ["Environment", "Transition", "step_with_autoreset"]


class Transition(Protocol):
    """What one step brought; the batch is last."""

    @property
    def reward(self) -> Float[Array, " batch"]:
        """Reward of the step."""
        ...

    @property
    def terminated(self) -> Bool[Array, " batch"]:
        """The episode ended in the environment: nothing follows."""
        ...

    @property
    def truncated(self) -> Bool[Array, " batch"]:
        """The episode was cut off by a time limit: something would have followed."""
        ...

    @property
    def credit(self) -> Float[Array, "actions batch"]:
        """What each action of the step is taught by: the reward, or its part of the reward where that is known."""
        ...

    @property
    def signals(self) -> dict[str, Float[Array, " batch"]]:
        """Named quantities worth averaging in the metrics."""
        ...


class Environment(Protocol):
    """A batch of Markov decision processes; no step begins a new episode by itself."""

    def reset_batch(self, key: PRNGKeyArray, batch: int) -> Any:
        """Begins a batch of episodes, each at a fresh start."""
        ...

    def step(self, state: Any, action: Any) -> tuple[Any, Transition]:
        """Advances every episode by one step."""
        ...

    def observe(self, state: Any) -> Any:
        """Returns what policy and value networks are given, the batch last."""
        ...


def step_with_autoreset(env: Environment, state: Any, action: Any, key: PRNGKeyArray) -> tuple[Any, Transition, Any]:
    """Steps every episode, then replaces those that ended by fresh ones.

    Args:
        env: The environment.
        state: Its batch of states.
        action: One action for each.
        key: Randomness of the fresh starts.

    Returns:
        The states to go on from, the transition, and the observation after the step BEFORE any new episode began (the
        one whose value bootstraps a truncated episode).
    """
    after, transition = env.step(state, action)
    done = transition.terminated | transition.truncated

    def restart(after: Any) -> Any:
        fresh = env.reset_batch(key, done.shape[0])
        return jax.tree.map(lambda new, old: jnp.where(done, new, old), fresh, after)

    return jax.lax.cond(jnp.any(done), restart, lambda after: after, after), transition, env.observe(after)
