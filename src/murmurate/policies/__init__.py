"""Networks and action distributions. Knows arrays only.

Policies map `(robots, 2, *batch)` positions, or what robots perceive of them, to velocities of that shape, or to a
`Gaussian` around them; value networks to values `(actions, *batch)`: one a robot, or one for the swarm.
"""

from __future__ import annotations

import jax
from jaxtyping import PRNGKeyArray

from murmurate.policies.central import CentralPolicy, CentralValue
from murmurate.policies.config import Credit, PolicyConfig, PolicyKind, Sizes
from murmurate.policies.equivariant import EquivariantPolicy, EquivariantValue
from murmurate.policies.gaussian import Gaussian
from murmurate.policies.local import LocalPolicy, LocalValue

__all__ = [
    "CentralPolicy",
    "CentralValue",
    "Credit",
    "EquivariantPolicy",
    "EquivariantValue",
    "Gaussian",
    "LocalPolicy",
    "LocalValue",
    "PolicyConfig",
    "PolicyKind",
    "Sizes",
    "make_networks",
]

_KINDS = {
    "central": (CentralPolicy, CentralValue),
    "equivariant": (EquivariantPolicy, EquivariantValue),
    "local": (LocalPolicy, LocalValue),
}


def make_networks(
    config: PolicyConfig, sizes: Sizes, key: PRNGKeyArray
) -> tuple[CentralPolicy | EquivariantPolicy | LocalPolicy, CentralValue | EquivariantValue | LocalValue]:
    """Builds a policy and its value network, two separate networks as in the paper's Algorithm 1."""
    policy, value = _KINDS[config.kind]
    first, second = jax.random.split(key)
    return policy(config, sizes, first), value(config, sizes, second)
