r"""The symmetry of one configuration: which rotations about its centroid and reflections map the swarm onto itself.

Learned patterns are symmetric only approximately, so a residual is compared with a tolerance. For the rotation by
2 pi / k it is the least root mean square distance between the robots and the rotated robots (a linear assignment). For
a reflection it is the distance of the pattern to its mirror image (`geometry.similarity`), over all axes through the
centroid. Both are in root mean square radii.

A small residual alone is not enough: nine robots around a tenth are displaced by only 0.07 by a tenth of a turn, which
is not a symmetry. The k-th repetition of the rotation by 2 pi / k, and none before, must bring every robot back to its
own place; only a robot at the centroid stays throughout.
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
from murmurate.representation import short_repr

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
        rotations: The largest k for which rotation by 2 pi / k about the centroid maps the swarm onto itself; 1: none.
        mirrored: Whether a reflection maps the swarm onto itself; there are then k axes.
        residual: Residual of the worse of the generators, rotation and reflection, in root mean square radii; 0 without
            any.
    """

    rotations: int
    mirrored: bool
    residual: float

    __repr__ = short_repr

    @property
    def name(self) -> str:
        """C_k for rotations alone, D_k for rotations and reflections (D_1: one reflection), "none" for neither."""
        if self.mirrored:
            return f"D_{self.rotations}"
        return f"C_{self.rotations}" if self.rotations > 1 else "none"

    @property
    def symbol(self) -> str:
        """The name with a subscript, so that no group C_2 is taken for the objective C2; empty for none."""
        letter, _, number = self.name.partition("_")
        return letter + number.translate(_SUBSCRIPTS) if number else ""


def symmetry(positions: Float[np.ndarray, "robots 2"], tolerance: float = SYMMETRY_TOLERANCE) -> Symmetry:
    """Returns the symmetry group of a configuration of disjoint robots.

    Args:
        positions: Centres of the robots, world units.
        tolerance: Greatest residual of a rotation or reflection, in root mean square radii.

    Raises:
        InputError: The positions are not finite numbers of shape (robots, 2), or the tolerance is not positive.
    """
    check_number("tolerance", tolerance, 0, exclusive_low=True)
    z = normalized(positions)
    rotations, residual = next(
        ((k, error) for k in range(len(z), 1, -1) if (error := _rotation_residual(z, k)) <= tolerance), (1, 0.0)
    )
    image = np.asarray(positions, float) * [1, -1]
    mirror = distance(positions, image, reflection=False, limit=tolerance)
    mirrored = mirror <= tolerance
    return Symmetry(rotations, mirrored, max(residual, mirror) if mirrored else residual)


def upright(positions: Float[np.ndarray, "robots 2"]) -> Float[np.ndarray, "robots 2"]:
    """Returns a configuration centred and rotated so that its best mirror axis is vertical, the farther end up.

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


def _rotation_residual(z: Complex[np.ndarray, " robots"], k: int) -> float:
    """Returns the residual of the rotation by 2 pi / k; inf if its k-th repetition moves a robot."""
    squares = np.abs(z[:, None] - z[None] * cmath.exp(2j * math.pi / k)) ** 2
    robots, images = linear_sum_assignment(squares)
    return math.sqrt(squares[robots, images].mean()) if _repeats(images, k) else math.inf


def _repeats(images: Int[np.ndarray, " robots"], k: int) -> bool:
    """Returns whether a relabelling returns all robots, but at most one, at its k-th repetition and not before."""
    repetitions = list(itertools.accumulate([images] * k, lambda labels, step: step[labels]))
    returned = np.array(repetitions) == np.arange(len(images))
    return bool(returned[-1].all() and returned[:-1].any(axis=0).sum() <= 1)
