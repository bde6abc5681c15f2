"""Sizes of the world and its robots."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from murmurate.errors import MAX_MAGNITUDE, InputError, check_choice, check_number, check_type

__all__ = ["MAX_ROBOTS", "Safety", "WorldConfig", "check_pairs", "scaled_to", "with_array_leaves"]

Safety = Literal["penalty", "shell"]

MAX_ROBOTS = 10_000

MAX_PAIRS = 1 << 28
"""Pairs of robots in all worlds of a batch, at most: a number for each takes 1 GiB, and several are needed at once."""

MIN_LENGTH = 1 / MAX_MAGNITUDE
"""Least length in a world: its square, and squares of parts of it, are not rounded to zero in float32."""


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
        bounded: Whether the world ends at its sides. Otherwise it is the whole plane, as in theory: nobody can leave it
            and there are no walls to perceive. Robots still begin in |x| <= X, |y| <= Y, and signals are still measured
            by X and Y.
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
    bounded: bool = eqx.field(default=True, static=True)

    def __check_init__(self) -> None:
        check_number("robots", self.robots, 2, MAX_ROBOTS, integer=True)
        for name in ("half_width", "half_height", "radius", "scan_radius", "safe_distance", "max_speed"):
            check_number(name, getattr(self, name), 0, MAX_MAGNITUDE, exclusive_low=True)
            if getattr(self, name) < MIN_LENGTH:
                raise InputError(name, getattr(self, name), f"at least {MIN_LENGTH:g}")
        two_radii = 2 * self.radius
        if self.safe_distance <= two_radii:
            raise InputError("safe_distance", self.safe_distance, f"more than two radii ({two_radii:g})")
        longest = 2 * max(self.half_width, self.half_height)
        if self.max_speed > longest:
            allowed = f"at most {longest:g}, the longer side of the world: no step inside it is longer"
            raise InputError("max_speed", self.max_speed, allowed)
        check_number("collision_penalty", self.collision_penalty, 0, MAX_MAGNITUDE)
        check_choice("safety", self.safety, get_args(Safety))
        check_type("bounded", self.bounded, bool, "true or false")

    @property
    def bounds(self) -> Float[np.ndarray, "2"]:
        """X and Y as float32, the precision in which the world steps: what is recorded is judged by the same sides.

        A robot that a rule keeps exactly on a wall would otherwise be outside by a rounded digit.
        """
        return np.array([self.half_width, self.half_height], np.float32)

    @property
    def limits(self) -> Float[np.ndarray, "2"]:
        """The greatest |x| and |y| inside the world: its bounds, or infinity where it has none."""
        return self.bounds if self.bounded else np.full(2, np.inf, np.float32)

    def __repr__(self) -> str:
        return (
            f"WorldConfig({self.robots} robots of radius {self.radius:g} in {2 * self.half_width:g} x "
            f"{2 * self.half_height:g})"
        )


def check_pairs(field: str, count: int, robots: int) -> None:
    """Checks that a batch of worlds fits in memory: much of what is computed has a number for each pair of robots.

    Args:
        field: What says how many worlds there are, for the message.
        count: How many.
        robots: Robots in each.

    Raises:
        InputError: They do not fit.
    """
    if count * robots**2 > MAX_PAIRS:
        most = MAX_PAIRS // robots**2
        raise InputError(field, count, f"at most {most} with {robots} robots: memory holds no more pairs of them")


def check_world(world: object) -> None:
    """Checks an argument that is the sizes of a world.

    Raises:
        InputError: It is something else.
    """
    check_type("world", world, WorldConfig, "sizes of a world, such as WorldConfig(robots=8)")


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
    check_world(world)
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
