"""The losses of proximal policy optimisation, apart from how their batches were collected."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

__all__ = ["Batch", "policy_loss", "value_loss"]


class Batch(eqx.Module):
    """Steps to learn from, on the last axis."""

    observation: Any
    action: Any
    log_prob: Float[Array, "actions batch"]
    advantage: Float[Array, "actions batch"]
    target: Float[Array, "actions batch"]


def policy_loss(policy: Any, batch: Batch, clip: Any) -> tuple[Float[Array, ""], dict[str, Array]]:
    """The clipped objective, negated (paper, equations 11 to 13).

    Where a step consists of several actions, each has an advantage, a ratio and a clip range of its own.

    Returns:
        The loss, and by name the estimated divergence from the policy that collected the batch and the clipped share.
    """
    log_ratio = policy.distribution(batch.observation).log_prob(batch.action) - batch.log_prob
    ratio = jnp.exp(log_ratio)
    clipped = jnp.clip(ratio, 1 - clip, 1 + clip)
    objective = jnp.mean(jnp.minimum(ratio * batch.advantage, clipped * batch.advantage))
    kl = jnp.mean(ratio - 1 - log_ratio)
    return -objective, {"kl": kl, "clipped": jnp.mean((jnp.abs(ratio - 1) > clip).astype(ratio.dtype))}


def value_loss(value: Any, batch: Batch) -> Float[Array, ""]:
    """The mean squared error of the value network (paper, Algorithm 1, line 8)."""
    return jnp.mean((value(batch.observation) - batch.target) ** 2)
