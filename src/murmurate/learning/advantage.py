"""Advantages and value targets of a batch of trajectories; time is the first axis."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

__all__ = ["generalized_advantage", "rewards_to_go"]

Trajectories = Float[Array, "time *batch"]
Flags = Bool[Array, "time *batch"]


def generalized_advantage(
    reward: Trajectories,
    value: Trajectories,
    next_value: Trajectories,
    terminated: Flags,
    truncated: Flags,
    discount: float,
    gae_lambda: float,
) -> Trajectories:
    """Estimates advantages (paper, equations 14 and 15).

    Args:
        reward: Rewards of the steps.
        value: Values before the steps.
        next_value: Values after the steps, of the same episode: what bootstraps a truncated one.
        terminated: Steps after which nothing follows.
        truncated: Steps after which the episode was cut off.
        discount: The paper's gamma.
        gae_lambda: The paper's lambda.

    Returns:
        The advantages.
    """
    delta = reward + discount * next_value * ~terminated - value
    carry_on = discount * gae_lambda * ~(terminated | truncated)
    return _backward_sum(delta, carry_on)


def rewards_to_go(reward: Trajectories, next_value: Trajectories, terminated: Flags, truncated: Flags) -> Trajectories:
    """Sums the rewards from each step to its episode's end, undiscounted (paper, Algorithm 1, line 5).

    Where the trajectory is cut off, by a time limit or by the end of the batch, the value of what would have followed
    is added; without it the target would depend on where the cut happens to fall.
    """
    cut = truncated.at[-1].set(True) & ~terminated
    carry_on = (~(terminated | cut)).astype(reward.dtype)
    return _backward_sum(reward + next_value * cut, carry_on)


def _backward_sum(term: Trajectories, carry_on: Trajectories) -> Trajectories:
    def back(later: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        total = now[0] + now[1] * later
        return total, total

    return jax.lax.scan(back, jnp.zeros_like(term[0]), (term, carry_on), reverse=True)[1]
