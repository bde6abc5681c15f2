"""The losses of proximal policy optimisation on one batch of steps."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from murmurate.learning.environment import Policy, Value
from murmurate.representation import short_repr

__all__ = ["Batch", "policy_loss", "value_loss"]


class Batch(eqx.Module):
    """Steps to learn from, on the last axis."""

    observation: Any
    action: Any
    log_prob: Float[Array, "actions batch"]
    advantage: Float[Array, "actions batch"]
    target: Float[Array, "actions batch"]

    __repr__ = short_repr


def policy_loss(policy: Policy, batch: Batch, clip: Any) -> tuple[Float[Array, ""], dict[str, Array]]:
    """Computes the clipped objective, negated (paper, equations 11 to 13).

    If a step consists of several actions, each has its own advantage, ratio and clip range.

    Returns:
        The loss; and by name the estimated Kullback-Leibler divergence from the policy that collected the batch, and
        the fraction of actions whose ratio was clipped.
    """
    log_ratio = policy.distribution(batch.observation).log_prob(batch.action) - batch.log_prob
    ratio = jnp.exp(log_ratio)
    clipped = jnp.clip(ratio, 1 - clip, 1 + clip)
    objective = jnp.mean(jnp.minimum(ratio * batch.advantage, clipped * batch.advantage))
    # The estimator (r - 1) - log r is unbiased and never negative.
    kl = jnp.mean(ratio - 1 - log_ratio)
    return -objective, {"kl": kl, "clipped": jnp.mean((jnp.abs(ratio - 1) > clip).astype(ratio.dtype))}


def value_loss(value: Value, batch: Batch) -> Float[Array, ""]:
    """Computes the mean squared error of the value network (paper, Algorithm 1, line 8)."""
    return jnp.mean((value(batch.observation) - batch.target) ** 2)
