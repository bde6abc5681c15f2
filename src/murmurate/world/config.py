"""Sizes of the world and its robots."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp

from murmurate.errors import MAX_MAGNITUDE, InputError, check_choice, check_number

__all__ = ["Safety", "WorldConfig", "scaled_to", "with_array_leaves"]

Safety = Literal["penalty", "shell"]

MAX_ROBOTS = 10_000


class WorldConfig(eqx.Module):
    """The sizes of the world and its robots; the defaults are those of the paper's ten-robot experiments.

    Numbers are leaves of the PyTree, so that a program compiled for one world serves others of as many robots.

    Attributes:
        robots: Number of robots N.
        half_width: The paper's X: the world is |x| <= X, |y| <= Y.
        half_height: The paper's Y.
        radius: The paper's R_bot.
        scan_radius: The paper's R_scan: robots whose centres are at most this far apart are neighbours.
        safe_distance: The paper's delta_s, between centres.
        max_speed: Bound on each velocity component, world units per step.
        safety: Reading of F_safe: penalty, or shell (as printed).
        collision_penalty: Reward of a step that ends in contact or outside the world, times -1.
    """

    robots: int = eqx.field(default=10, static=True)
    half_width: float = 45.0
    half_height: float = 45.0
    radius: float = 1.0
    scan_radius: float = 20.0
    safe_distance: float = 5.0
    max_speed: float = 1.0
    safety: Safety = eqx.field(default="penalty", static=True)
    collision_penalty: float = 1.0

    def __check_init__(self) -> None:
        check_number("robots", self.robots, 2, integer=True)
        for name in ("half_width", "half_height", "radius", "scan_radius", "safe_distance", "max_speed"):
            check_number(name, getattr(self, name), 0, MAX_MAGNITUDE, exclusive_low=True)
        two_radii = 2 * self.radius
        if self.safe_distance <= two_radii:
            raise InputError("safe_distance", self.safe_distance, f"more than two radii ({two_radii:g})")
        longest = 2 * max(self.half_width, self.half_height)
        if self.max_speed > longest:
            allowed = f"at most {longest:g}, the longer side of the world: no step inside it is longer"
            raise InputError("max_speed", self.max_speed, allowed)
        check_number("collision_penalty", self.collision_penalty, 0, MAX_MAGNITUDE)
        check_choice("safety", self.safety, get_args(Safety))

    def __repr__(self) -> str:
        return (
            f"WorldConfig({self.robots} robots of radius {self.radius:g} in {2 * self.half_width:g} x "
            f"{2 * self.half_height:g})"
        )


def scaled_to(world: WorldConfig, robots: int) -> WorldConfig:
    """Returns the world for a swarm of another size: its robots are the same, its sides and the scan radius grow.

    The paper's worlds have half-sides of 20 + 2.5 N. The smallest ring of robots that all see each other grows as N^2,
    and at 20 robots the half-side is 2.3 times its radius. Larger worlds keep that ratio, so the ring fits at any size.

    Args:
        world: The world.
        robots: Number of robots.

    Raises:
        InputError: There are too few or too many of them.
    """
    check_number("robots", robots, 2, MAX_ROBOTS, integer=True)
    factor = _half_side(robots) / _half_side(world.robots)
    return replace(
        world,
        robots=robots,
        half_width=factor * world.half_width,
        half_height=factor * world.half_height,
        scan_radius=factor * world.scan_radius,
    )


def _half_side(robots: int) -> float:
    return max(20 + 2.5 * robots, 0.175 * robots**2)


def with_array_leaves(tree: Any) -> Any:
    """Turns the Python floats of a PyTree into arrays, so that changing one does not recompile what uses it."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32) if isinstance(leaf, float) else leaf, tree)
