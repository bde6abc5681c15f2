"""Policies: networks that map what robots know to their velocities, shields, and hand-written baselines.

Arrays take the batch LAST: positions `(robots, 2, *batch)`, velocities of that shape, values `(actions, *batch)`.
"""

from murmurate.policies.base import Credit, Gaussian, Policy, PolicyNetwork
from murmurate.policies.central import CentralPolicy
from murmurate.policies.equivariant import EquivariantPolicy
from murmurate.policies.formation import FormationPolicy
from murmurate.policies.local import LocalPolicy
from murmurate.policies.shield import ClearanceShield, NoShield, Shield, ShieldedState, ShieldWrapper, WallShield

__all__ = [
    "CentralPolicy",
    "ClearanceShield",
    "Credit",
    "EquivariantPolicy",
    "FormationPolicy",
    "Gaussian",
    "LocalPolicy",
    "NoShield",
    "Policy",
    "PolicyNetwork",
    "Shield",
    "ShieldWrapper",
    "ShieldedState",
    "WallShield",
]
