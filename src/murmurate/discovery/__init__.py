"""Algorithms 1 and 2: base and auxiliary policies, the cascade that executes them, and what counts as valid."""

from murmurate.discovery.algorithm import Discovery, Snapshot, advance_together, policy_name
from murmurate.discovery.cascade import Cascade, RestRule, Trajectories
from murmurate.discovery.config import DiscoveryConfig, StageConfig
from murmurate.discovery.problem import Problem
from murmurate.discovery.validity import Validity, bound_steps, check_validity

__all__ = [
    "Cascade",
    "Discovery",
    "DiscoveryConfig",
    "Problem",
    "RestRule",
    "Snapshot",
    "StageConfig",
    "Trajectories",
    "Validity",
    "advance_together",
    "bound_steps",
    "check_validity",
    "policy_name",
]
