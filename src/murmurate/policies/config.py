"""Which policy, and how large."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from murmurate.errors import InputError

__all__ = ["Credit", "PolicyConfig", "PolicyKind", "Sizes"]

PolicyKind = Literal["central", "equivariant", "local"]
Credit = Literal["robots", "swarm"]


@dataclass(frozen=True)
class PolicyConfig:
    """Which policy, and how large.

    Attributes:
        kind: central (the paper's: one network over all positions), equivariant (shared by all robots, which see all)
            or local (shared by all robots, each of which acts on what it alone perceives).
        hidden: Widths of the tanh layers (central), or of the node and edge layers (others).
        basis: Number of radial basis functions (not central).
        credit: Who answers for a step while learning: every robot for its own velocity, by its share of the objective,
            or the swarm as one (the paper's; central only).
    """

    kind: PolicyKind = "equivariant"
    hidden: tuple[int, ...] = (128, 128)
    basis: int = 8
    credit: Credit = "robots"

    def __post_init__(self) -> None:
        if self.kind not in get_args(PolicyKind):
            raise InputError("kind", self.kind, f"one of {', '.join(get_args(PolicyKind))}")
        if not self.hidden or min(self.hidden) < 1:
            raise InputError("hidden", self.hidden, "one or more integers >= 1")
        if self.kind != "central" and len(self.hidden) > 2:
            raise InputError("hidden", self.hidden, f"at most two widths for {self.kind}: nodes, edges")
        if self.basis < 2:
            raise InputError("basis", self.basis, "an integer >= 2")
        if self.credit not in get_args(Credit):
            raise InputError("credit", self.credit, f"one of {', '.join(get_args(Credit))}")
        if self.credit == "swarm" and self.kind != "central":
            raise InputError("credit", self.credit, f"robots: with the policy {self.kind} each acts for itself")


@dataclass(frozen=True)
class Sizes:
    """What a network has to know of the world to scale its inputs and outputs.

    Attributes:
        robots: Number of robots.
        half_width: The world's X.
        half_height: The world's Y.
        radius: The paper's R_bot.
        safe_distance: The paper's delta_s: the unit of length of the equivariant policy.
        max_speed: Bound on velocities.
        landmark: Whether the gathering point is known (objective C1).
    """

    robots: int
    half_width: float
    half_height: float
    radius: float
    safe_distance: float
    max_speed: float
    landmark: bool
