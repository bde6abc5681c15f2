r"""The symmetry of one configuration: which turns and mirrors about its centroid map the swarm onto itself.

Learned patterns are symmetric only nearly, so a tolerance decides. What it is compared with is, for the turn by
2 pi / k, the least root mean square distance from the robots to the turned ones, each taken for another (a linear
assignment); for a mirror, the least over all axes through the centroid, found as `geometry.similarity` lays a pattern
onto its mirror image. Both are in root mean square radii.

A small distance alone is not enough: nine robots around a tenth are hardly displaced by a tenth of a turn (0.07), which
is no symmetry of theirs. The k-th repetition of a turn by 2 pi / k, and none before, must bring every robot back to its
place; only one at the centroid stays throughout.
"""

from __future__ import annotations

import cmath
import itertools
import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.optimize import linear_sum_assignment

from murmurate.errors import check_number
from murmurate.geometry.similarity import align, distance, normalized

__all__ = ["SYMMETRY_TOLERANCE", "Symmetry", "symmetry", "upright"]

SYMMETRY_TOLERANCE = 0.1
"""Default tolerance, in root mean square radii, chosen by measurement.

Of 900 patterns of eight and ten robots, relaxed from random starts until nothing moves, 115 have a symmetry to 0.005, 2
miss one by 0.02 to 0.06, and all others miss every one by more than 0.1. Learned patterns come less close: what looks
like a pentagon around a sixth robot misses by 0.05 to 0.1. From 0.12 on, one sees the difference.
"""


_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


@dataclass(frozen=True)
class Symmetry:
    """The symmetry group of a configuration.

    Attributes:
        rotations: The largest k for which turning by 2 pi / k about the centroid maps the swarm onto itself; 1: none.
        mirrored: Whether a reflection does so too; there are then k axes.
        residual: Root mean square distance, in root mean square radii, by which the worse of the generators (the turn,
            the mirror) misses; 0 without any.
    """

    rotations: int
    mirrored: bool
    residual: float

    @property
    def name(self) -> str:
        """C_k for turns alone, D_k for turns and mirrors (D_1: one mirror), "none" for neither."""
        if self.mirrored:
            return f"D_{self.rotations}"
        return f"C_{self.rotations}" if self.rotations > 1 else "none"

    @property
    def symbol(self) -> str:
        """The name with a subscript, so that no group C_2 is taken for the objective C2; empty for none."""
        letter, _, number = self.name.partition("_")
        return letter + number.translate(_SUBSCRIPTS) if number else ""


def symmetry(positions: Float[np.ndarray, "robots 2"], tolerance: float = SYMMETRY_TOLERANCE) -> Symmetry:
    """Finds the symmetry group of a configuration of disjoint robots.

    Args:
        positions: Centres of the robots, world units.
        tolerance: By how much a turn or mirror may miss, in root mean square radii.

    Raises:
        InputError: It is no configuration of finite numbers, or the tolerance is not positive.
    """
    check_number("tolerance", tolerance, 0, exclusive_low=True)
    z = normalized(positions)
    rotations, residual = next(
        ((k, missed) for k in range(len(z), 1, -1) if (missed := _missed(z, k)) <= tolerance), (1, 0.0)
    )
    image = np.asarray(positions, float) * [1, -1]
    mirror = distance(positions, image, reflection=False, limit=tolerance)
    mirrored = mirror <= tolerance
    return Symmetry(rotations, mirrored, max(residual, mirror) if mirrored else residual)


def upright(positions: Float[np.ndarray, "robots 2"]) -> Float[np.ndarray, "robots 2"]:
    """Centres a configuration and turns its best mirror axis upright, its farther end up: as a plate shows it.

    Args:
        positions: Centres of the robots, world units.
    """
    z = normalized(positions, scaling=False)
    # The best reflection turns the mirror image by an angle: its axis lies at half of that.
    angle = align(positions, np.asarray(positions, float) * [1, -1], reflection=False).angle
    z = z * cmath.exp(0.5j * (math.pi - angle))
    if round(z.imag.max() + z.imag.min(), 9) < 0:
        z = -z
    return np.stack([z.real, z.imag], axis=1)


def _missed(z: Complex[np.ndarray, " robots"], k: int) -> float:
    """Returns how far the swarm is from itself turned by 2 pi / k; inf if k such turns move someone."""
    squares = np.abs(z[:, None] - z[None] * cmath.exp(2j * math.pi / k)) ** 2
    robots, images = linear_sum_assignment(squares)
    return math.sqrt(squares[robots, images].mean()) if _repeats(images, k) else math.inf


def _repeats(images: Int[np.ndarray, " robots"], k: int) -> bool:
    """Says whether a relabelling brings every robot, but at most one, back at its k-th repetition and not before."""
    places = list(itertools.accumulate([images] * k, lambda place, step: step[place]))
    returned = np.array(places) == np.arange(len(images))
    return bool(returned[-1].all() and returned[:-1].any(axis=0).sum() <= 1)
