"""Sizes of the world and its robots."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

from murmurate.errors import GREATEST, InputError, check_number

__all__ = ["Safety", "WorldConfig", "scaled_to"]

Safety = Literal["penalty", "shell"]


MOST_ROBOTS = 10_000


@dataclass(frozen=True)
class WorldConfig:
    """The world's sizes; the defaults are those of the paper's ten-robot experiments.

    Attributes:
        robots: Number of robots N.
        half_width: The paper's X: the world is |x| <= X, |y| <= Y.
        half_height: The paper's Y.
        radius: The paper's R_bot.
        scan_radius: The paper's R_scan: robots whose centres are at most this far apart are neighbours.
        safe_distance: The paper's delta_s, between centres.
        max_speed: Bound on each velocity component, world units per step.
        safety: Reading of F_safe: penalty, or shell (as printed).
        collision_penalty: Reward of a step that ends in a collision or outside the world, times -1.
    """

    robots: int = 10
    half_width: float = 45.0
    half_height: float = 45.0
    radius: float = 1.0
    scan_radius: float = 20.0
    safe_distance: float = 5.0
    max_speed: float = 1.0
    safety: Safety = "penalty"
    collision_penalty: float = 1.0

    def __post_init__(self) -> None:
        if self.robots < 2:
            raise InputError("robots", self.robots, "an integer >= 2")
        for name in ("half_width", "half_height", "radius", "scan_radius", "safe_distance", "max_speed"):
            check_number(name, getattr(self, name), 0, GREATEST, exclusive_low=True)
        if self.safe_distance <= 2 * self.radius:
            raise InputError("safe_distance", self.safe_distance, f"more than two radii ({2 * self.radius:g})")
        check_number("collision_penalty", self.collision_penalty, 0, GREATEST)
        if self.safety not in get_args(Safety):
            raise InputError("safety", self.safety, f"one of {', '.join(get_args(Safety))}")


def scaled_to(config: WorldConfig, robots: int) -> WorldConfig:
    """Returns the same world for a swarm of another size: its robots are the same, its sides and the scan radius grow.

    The paper's worlds have half-sides of 20 + 2.5 N. The smallest ring of robots that all see each other grows as N^2,
    and at 20 robots the half-side is 2.3 times its radius. Beyond, it stays so: there is room for it at any size.

    Args:
        config: The world.
        robots: Number of robots.

    Raises:
        InputError: There are too few or too many of them.
    """
    check_number("robots", robots, 2, MOST_ROBOTS, integer=True)
    factor = _room(robots) / _room(config.robots)
    return replace(
        config,
        robots=robots,
        half_width=factor * config.half_width,
        half_height=factor * config.half_height,
        scan_radius=factor * config.scan_radius,
    )


def _room(robots: int) -> float:
    return max(20 + 2.5 * robots, 0.175 * robots**2)
