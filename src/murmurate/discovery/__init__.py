"""Algorithms 1 and 2: base and auxiliary policies, the cascade that executes them, and what counts as valid."""

from murmurate.discovery.build import (
    build_cascade,
    build_environment,
    build_networks,
    build_world,
    check_parts,
    policy_templates,
)
from murmurate.discovery.cascade import STATIONARY_STEPS, Cascade
from murmurate.discovery.curriculum import Curriculum
from murmurate.discovery.limits import MAX_REST_STEPS, rollout
from murmurate.discovery.problem import DiscoveryConfig, Problem, StageConfig
from murmurate.discovery.rest import RestRule
from murmurate.discovery.search import Search, Snapshot, advance_together
from murmurate.discovery.stage import Stage, policy_name
from murmurate.discovery.validity import Validity, bound_steps, check_validity
from murmurate.types import Trajectories

__all__ = [
    "MAX_REST_STEPS",
    "STATIONARY_STEPS",
    "Cascade",
    "Curriculum",
    "DiscoveryConfig",
    "Problem",
    "RestRule",
    "Search",
    "Snapshot",
    "Stage",
    "StageConfig",
    "Trajectories",
    "Validity",
    "advance_together",
    "bound_steps",
    "build_cascade",
    "build_environment",
    "build_networks",
    "build_world",
    "check_parts",
    "check_validity",
    "policy_name",
    "policy_templates",
    "rollout",
]
