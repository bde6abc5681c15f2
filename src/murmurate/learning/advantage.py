"""Advantages and value targets of a batch of trajectories; time is the first axis."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

__all__ = ["generalized_advantage", "rewards_to_go"]

Trajectories = Float[Array, "time *batch"]
Flags = Bool[Array, "time *#batch"]


def generalized_advantage(
    reward: Trajectories,
    value: Trajectories,
    next_value: Trajectories,
    terminated: Flags,
    truncated: Flags,
    discount: float,
    gae_lambda: float,
) -> Trajectories:
    """Computes generalised advantage estimates (paper, equations 14 and 15).

    Args:
        reward: Rewards of the steps.
        value: Values of the states before the steps.
        next_value: Values of the states after the steps, before any reset; they bootstrap truncated episodes.
        terminated: Steps that ended their episode in the environment.
        truncated: Steps at which a time limit ended the episode.
        discount: The paper's gamma.
        gae_lambda: The paper's lambda.

    Returns:
        The advantages.
    """
    delta = reward + discount * next_value * ~terminated - value
    carry_on = discount * gae_lambda * ~(terminated | truncated)
    return _backward_sum(delta, carry_on)


def rewards_to_go(reward: Trajectories, next_value: Trajectories, terminated: Flags, truncated: Flags) -> Trajectories:
    """Computes the undiscounted sum of rewards from each step to the end of its episode (paper, Algorithm 1, line 5).

    Where a time limit or the end of the batch cuts the trajectory, the value of the next state is added. Without it the
    target would depend on where the cut falls.
    """
    cut = truncated.at[-1].set(True) & ~terminated
    carry_on = (~(terminated | cut)).astype(reward.dtype)
    return _backward_sum(reward + next_value * cut, carry_on)


def _backward_sum(term: Trajectories, carry_on: Float[Array, "time *#batch"]) -> Trajectories:
    def back(later: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        total = now[0] + now[1] * later
        return total, total

    return jax.lax.scan(back, jnp.zeros_like(term[0]), (term, carry_on), reverse=True)[1]
