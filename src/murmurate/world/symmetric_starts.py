"""Initial configurations that are computed from a few uniform numbers; exactly symmetric ones."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate.errors import InputError, check_choice
from murmurate.world.config import WorldConfig
from murmurate.world.starts import Start, does_not_fit

__all__ = ["ComputedStart", "Family", "SymmetricStart", "symmetric_layout"]


class ComputedStart(Start):
    """A start that computes its configurations from uniform numbers, without drawing any of them again: a base class.

    It computes in the namespace and precision of the numbers: in JAX's single precision under a jit, and in NumPy's
    double precision for sets of starts, whose digits must be the same on every machine.
    """

    def sample(self, key: PRNGKeyArray, batch: int, world: WorldConfig) -> Float[Array, "batch robots 2"]:
        """Draws uniform numbers and places the robots by them."""
        return self.place(self.uniforms(key, batch, world.robots), world)

    @abstractmethod
    def uniforms(self, key: PRNGKeyArray, batch: int, robots: int) -> tuple[Array, ...]:
        """Draws the numbers that `place` needs for a batch of configurations."""

    @abstractmethod
    def place(self, numbers: tuple[Any, ...], world: WorldConfig) -> Any:
        """Returns the centres, world units, `(batch, robots, 2)`."""


Family = Literal["polygon", "line", "grid", "rings"]

MIN_SPACING, MAX_EXTENT = 1.5, 0.8
"""Symmetric neighbours begin at least so many diameters apart, and no robot farther out than this share of the way to
the wall."""


@Start.register("symmetric")
class SymmetricStart(ComputedStart):
    """Exactly symmetric configurations around the origin, each of a random width and direction.

    They are the hardest for robots that are all alike: a deterministic policy that depends only on what is seen keeps
    every symmetry that all robots share. Rounding, noise, a scheduler that moves some robots and not others, or frames
    without a common handedness break it.

    Attributes:
        family: polygon (a regular one), line (evenly spaced), grid (as square as it can be, full rows but for the last,
            which is centred), rings (two regular polygons, one inside the other, and one robot in the middle where the
            number is odd), or any of them with equal chances.
    """

    family: Literal["any", "polygon", "line", "grid", "rings"] = eqx.field(default="any", static=True)

    def __check_init__(self) -> None:
        check_choice("family", self.family, ("any", *get_args(Family)))

    def uniforms(self, key: PRNGKeyArray, batch: int, robots: int) -> tuple[Array, ...]:
        """Draws families, shares of the range of widths, and directions."""
        family_key, size_key, angle_key = jax.random.split(key, 3)
        return (
            jax.random.randint(family_key, (batch,), 0, len(self._families(robots)), jnp.int32),
            jax.random.uniform(size_key, (batch,), jnp.float32),
            jax.random.uniform(angle_key, (batch,), jnp.float32, maxval=2 * jnp.pi),
        )

    def place(self, numbers: tuple[Any, ...], world: WorldConfig) -> Any:
        """Places robots at widths between the least without contact and the greatest that stays off the walls."""
        family, share, angle = numbers
        xp = namespace(angle)
        layouts = np.stack([symmetric_layout(family, world.robots) for family in self._families(world.robots)])
        low, high = self._sizes(layouts, world)
        high = xp.asarray(high, angle.dtype)[family]
        size = low + (high - low) * share
        cos, sin = xp.cos(angle)[:, None], xp.sin(angle)[:, None]
        points = size[:, None, None] * xp.asarray(layouts, angle.dtype)[family]
        x, y = points[..., 0], points[..., 1]
        return xp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)

    def prepare(self, world: WorldConfig) -> Start:
        """Checks that there is room for every family."""
        for family in self._families(world.robots):
            low, high = self._sizes(symmetric_layout(family, world.robots)[None], world)
            if low > high[0]:
                raise does_not_fit(world, f"the start {family}")
        return self

    def _families(self, robots: int) -> tuple[Family, ...]:
        if self.family != "any":
            return (self.family,)
        return tuple(family for family in get_args(Family) if family != "rings" or robots >= 4)

    def _sizes(self, layouts: np.ndarray, world: WorldConfig) -> tuple[Any, Any]:
        """Returns the least distance of nearest neighbours, and the greatest for each layout."""
        extent = np.linalg.norm(layouts, axis=2).max(axis=1)
        minimum = jnp.minimum if isinstance(world.half_width, jax.Array) else min
        half_side = minimum(world.half_width, world.half_height)
        return MIN_SPACING * 2 * world.radius, MAX_EXTENT * half_side / extent


def symmetric_layout(family: Family, robots: int) -> Float[np.ndarray, "robots 2"]:
    """Places robots symmetrically, the middle at the origin and nearest neighbours 1 apart.

    Args:
        family: polygon, line, grid or rings; see `SymmetricStart`.
        robots: Number of robots.

    Raises:
        InputError: There is no such family, or too few robots for it.
    """
    check_choice("family", family, get_args(Family))
    if robots < 2 or (family == "rings" and robots < 4):
        raise InputError("robots", robots, f"at least {4 if family == 'rings' else 2} for the start {family}")
    if family == "line":
        points = np.stack([np.arange(robots, dtype=float), np.zeros(robots)], axis=1)
    elif family == "grid":
        across = math.ceil(math.sqrt(robots))
        rows = [min(across, robots - first) for first in range(0, robots, across)]
        points = np.array([[i - (n - 1) / 2, row] for row, n in enumerate(rows) for i in range(n)])
    elif family == "rings":
        inner = _polygon(robots // 2)
        points = np.concatenate([inner, 2 * inner, np.zeros((robots % 2, 2))])
    else:
        points = _polygon(robots)
    points = points - (points.max(axis=0) + points.min(axis=0)) / 2 if family in ("line", "grid") else points
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    return points / apart[~np.eye(robots, dtype=bool)].min()


def _polygon(corners: int) -> Float[np.ndarray, "corners 2"]:
    angle = 2 * np.pi * np.arange(corners) / corners
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def namespace(array: Any) -> Any:
    """Returns NumPy or JAX's NumPy, whichever an array is of."""
    return np if isinstance(array, np.ndarray) else jnp
