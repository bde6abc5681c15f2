"""Networks and action distributions. Knows arrays only.

Both policies map `(robots, 2, *batch)` positions to velocities of the same shape, or to a `Gaussian` around them, and
both value networks to values `(actions, *batch)`: one a robot, or one for the swarm, as credit is given.
"""

from __future__ import annotations

import jax
from jaxtyping import PRNGKeyArray

from murmurate.policies.central import CentralPolicy, CentralValue
from murmurate.policies.config import Credit, PolicyConfig, PolicyKind, Sizes
from murmurate.policies.equivariant import EquivariantPolicy, EquivariantValue
from murmurate.policies.gaussian import Gaussian

__all__ = [
    "CentralPolicy",
    "CentralValue",
    "Credit",
    "EquivariantPolicy",
    "EquivariantValue",
    "Gaussian",
    "PolicyConfig",
    "PolicyKind",
    "Sizes",
    "make_networks",
]

_KINDS = {"central": (CentralPolicy, CentralValue), "equivariant": (EquivariantPolicy, EquivariantValue)}


def make_networks(
    config: PolicyConfig, sizes: Sizes, key: PRNGKeyArray
) -> tuple[CentralPolicy | EquivariantPolicy, CentralValue | EquivariantValue]:
    """Builds a policy and its value network, two separate networks as in the paper's Algorithm 1."""
    policy, value = _KINDS[config.kind]
    first, second = jax.random.split(key)
    return policy(config, sizes, first), value(config, sizes, second)
