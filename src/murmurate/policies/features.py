"""What a robot can tell of its swarm without a frame: distances, and angles between directions.

All of it is free of parameters, so no gradient ever passes through the pairs and triples below: on a CPU these wide,
cheap sums cost less than learned layers of the same breadth would.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from murmurate.policies.layers import fold
from murmurate.world.config import WorldConfig

__all__ = ["SHADOWS", "Surroundings", "measured", "pair_channels", "radial_basis", "robot_channels", "surroundings"]

SHADOWS = 6
"""Channels of `_shadows`."""

NEAREST, FARTHEST = 0.4, 16.0
"""Ends of the radial basis, in safe distances."""

NEIGHBOR, MEAN = 2.0, 8.0
"""Where the neighbours on a ring and the mean distance lie in it if distances are stretched, in safe distances."""

NEIGHBOR_FACTOR, LEAST_NEIGHBOR = -0.2, 1 / 3
"""Neighbours on a ring are as far as the root of the mean distance times this factor's exponential; and the logarithm
of the least distance that is stretched to theirs, in safe distances."""

ROOM, ROOM_WIDTH = (-0.6, -0.3, 0.0, 0.3, 0.6, 1.2), 0.3
"""Centres of the bells in how roomy it is, logarithms of widths in least ones, and their own width."""

LEAST_MEAN = 2.5
"""Mean distance, in safe distances, of crowds so tight that they are stretched no further."""


class Surroundings(NamedTuple):
    """What every robot sees: the observer is the first robot axis, the observed the second.

    Attributes:
        ux: x of the unit vectors towards the others; 0 on the diagonal.
        uy: y of them.
        logarithm: Of the distances in safe distances, stretched where they are measured free of scale.
        pair: Scalars of each pair, unchanged by moving or turning the swarm.
        robot: Scalars of each robot, likewise.
    """

    ux: Float[Array, "robots robots *batch"]
    uy: Float[Array, "robots robots *batch"]
    logarithm: Float[Array, "robots robots *batch"]
    pair: Float[Array, "pair_channels robots robots *batch"]
    robot: Float[Array, "robot_channels robots *batch"]


def pair_channels(basis: int) -> int:
    """Returns the number of scalars of a pair."""
    return basis + 2 * (basis // 2) + SHADOWS


def robot_channels(basis: int, landmark: bool, scale_free: bool = False) -> int:
    """Returns the number of scalars of a robot."""
    return 2 * basis + SHADOWS + (2 * basis if landmark else 0) + (1 + len(ROOM) if scale_free else 0)


def centers(count: int) -> Float[Array, " basis"]:
    """Logarithms of the centres of the radial basis, in safe distances: fine near by, coarse far away."""
    return jnp.linspace(math.log(NEAREST), math.log(FARTHEST), count)


def radial_basis(logarithm: Float[Array, "*shape"], count: int) -> Float[Array, "basis *shape"]:
    """Gaussians in the logarithm of the distance, in safe distances.

    Args:
        logarithm: Of the distances.
        count: Number of basis functions.
    """
    middle = centers(count)
    z = (logarithm - middle.reshape((-1,) + (1,) * logarithm.ndim)) / (middle[1] - middle[0])
    return jnp.exp(-0.5 * z * z)


def stretched(
    logarithm: Float[Array, "robots robots *batch"], mean: Float[Array, "robots *batch"]
) -> Float[Array, "robots robots *batch"]:
    """Stretches what is beyond the safe distance so that neighbours and the mean always lie at the same two places.

    On the smallest ring of N robots that all see each other the mean distance grows as N^2 and that of neighbours as N,
    in proportion to its geometric mean with the safe distance. In between logarithms are stretched evenly.

    Args:
        logarithm: Of the distances, in safe distances; the observer is the first axis.
        mean: Mean distance of those that each robot sees, in safe distances.
    """
    middle = jnp.log(jnp.maximum(mean, LEAST_MEAN))[:, None]
    near = jnp.maximum(0.5 * middle + NEIGHBOR_FACTOR, LEAST_NEIGHBOR)
    inner = logarithm * (math.log(NEIGHBOR) / near)
    outer = math.log(NEIGHBOR) + (logarithm - near) * (math.log(MEAN / NEIGHBOR) / (middle - near))
    return jnp.where(logarithm > near, outer, jnp.where(logarithm > 0, inner, logarithm))


def counted(others: Float[Array, "robots *batch"], count: int) -> Float[Array, "basis robots *batch"]:
    """Weights by which sums over a robot's view are alike on rings of any size, basis function by basis function.

    As near as neighbours, so many fit in and they are counted; those as far as the mean distance are counted by their
    share; in between, where on a ring their number grows as a power of N, by that.
    """
    place = jnp.clip((centers(count) - math.log(NEIGHBOR)) / math.log(MEAN / NEIGHBOR), 0.0, 1.0)
    return (MEAN / others) ** place.reshape((-1,) + (1,) * others.ndim)


def roominess(
    mean: Float[Array, "robots *batch"], others: Float[Array, "robots *batch"], world: WorldConfig
) -> Float[Array, "room_channels robots *batch"]:
    """Says how much wider what each robot sees is than the least ring of as many robots that all see each other.

    On a ring whose radius is r the mean distance is about 4 r / pi. The least radius is 0.076 N^2 radii where robots
    are not to hide each other, and N safe distances / (2 pi) where neighbours are to keep the safe distance.

    Args:
        mean: Mean distance of those that each robot sees, world units.
        others: How many it sees.
        world: Units of length.
    """
    robots = others + 1
    least = jnp.maximum(0.0967 * world.radius * robots**2, 0.2026 * world.safe_distance * robots**2 / others)
    logarithm = jnp.log(mean / least + 1e-3)
    bells = [jnp.exp(-0.5 * ((logarithm - place) / ROOM_WIDTH) ** 2) for place in ROOM]
    return jnp.stack([jnp.tanh(logarithm), *bells])


def _shadows(ux: Array, uy: Array, distance: Array, radius: float) -> Float[Array, "6 robots robots *batch"]:
    """Says how third robots crowd each line of sight, in units of the angle at which shadows begin to fall.

    For observer k, observed i and a third robot j: a bell and a slope (which side) of j's angular offset, summed over
    the j nearer than i (they hide i), over the j farther (i hides them), and over the j behind k (k stands between).
    """
    half = radius / distance
    number = jax.lax.broadcasted_iota(jnp.int32, distance.shape[1:], 0)

    def third(j: int) -> tuple[Array, ...]:
        jx, jy, jd, jh = (a[:, j, None] for a in (ux, uy, distance, half))
        z = (ux * jy - uy * jx) / (half + jh)
        cos = ux * jx + uy * jy
        # j is no third robot where i is j itself; where k is i or j the unit vector, so the cosine, is 0.
        bell = jnp.where(number == j, 0.0, 1 / (1 + z * z) ** 2)
        ahead = jnp.where(cos > 0, bell, 0.0)
        hiding = jnp.where(jd < distance, ahead, 0.0)
        behind = jnp.where(cos < 0, bell, 0.0)
        return tuple(w * factor for w in (hiding, ahead - hiding, behind) for factor in (1.0, z))

    return jnp.stack(fold(third, distance.shape[1]))


def point(
    x: Float[Array, "robots *batch"], y: Float[Array, "robots *batch"], basis: int, scale: float
) -> tuple[Float[Array, "robots *batch"], Float[Array, "robots *batch"], Float[Array, "basis robots *batch"]]:
    """Direction of the gathering point, fading within a quarter of a safe distance, and the basis of its distance.

    Args:
        x: Coordinate of the point, from where each robot is.
        y: The other one.
        basis: Number of radial basis functions.
        scale: The safe distance.
    """
    distance = jnp.sqrt(x * x + y * y)
    soft = jnp.sqrt(distance**2 + (0.25 * scale) ** 2)
    return x / soft, y / soft, radial_basis(jnp.log(distance / scale + 1e-6), basis)


def surroundings(
    positions: Float[Array, "robots 2 *batch"],
    basis: int,
    world: WorldConfig,
    landmark: bool,
    *,
    scale_free: bool = False,
) -> Surroundings:
    """Measures what every robot sees of every other, and of the gathering point where there is one."""
    dx = positions[None, :, 0] - positions[:, None, 0]
    dy = positions[None, :, 1] - positions[:, None, 1]
    apart = dx * dx + dy * dy > 0
    return measured(dx, dy, apart, -positions[:, 0], -positions[:, 1], basis, world, landmark, scale_free=scale_free)


def measured(
    dx: Float[Array, "robots robots *batch"],
    dy: Float[Array, "robots robots *batch"],
    apart: Bool[Array, "robots robots *batch"],
    point_x: Float[Array, "robots *batch"],
    point_y: Float[Array, "robots *batch"],
    basis: int,
    world: WorldConfig,
    landmark: bool,
    *,
    scale_free: bool = False,
) -> Surroundings:
    """Measures what every robot sees, of those that it does see; the observer is the first axis.

    Args:
        dx: Coordinate of each robot, from where the observer is.
        dy: The other one.
        apart: Which robots it sees, and which are not where it is itself. What the others' coordinates are is ignored.
        point_x: Coordinate of the gathering point, likewise.
        point_y: The other one.
        basis: Number of radial basis functions.
        world: Units of length.
        landmark: Whether the gathering point is known.
        scale_free: Whether those beyond the safe distance are measured by the mean distance of all that are seen, and
            by their share of these: then large, wide swarms look to a robot as small, narrow ones do.
    """
    square = dx * dx + dy * dy
    distance = jnp.sqrt(jnp.where(apart, square, 1.0))
    ux, uy = (jnp.where(apart, d / distance, 0.0) for d in (dx, dy))
    others = jnp.maximum(jnp.sum(apart, axis=1), 1).astype(dx.dtype)
    logarithm = jnp.log(distance / world.safe_distance + 1e-6)
    mean = jnp.sum(jnp.where(apart, distance, 0.0), axis=1) / others
    if scale_free:
        logarithm = stretched(logarithm, mean / world.safe_distance)
    radial = radial_basis(logarithm, basis)
    radial = radial * apart.astype(dx.dtype)

    def seen(i: int) -> tuple[Array, Array, Array]:
        return radial[:, :, i], radial[:, :, i] * ux[:, i], radial[:, :, i] * uy[:, i]

    crowd, sx, sy = (total * 0.25 for total in fold(seen, dx.shape[1]))
    if scale_free:
        crowd, sx, sy = (counted(others, basis) * total for total in (crowd, sx, sy))
    # Where i lies in the crowd around k, ring by ring, two basis functions to a ring.
    rings = basis // 2
    rx, ry = (s[: 2 * rings].reshape((rings, 2, *s.shape[1:])).sum(axis=1)[:, :, None] for s in (sx, sy))
    shadows = _shadows(ux, uy, distance, world.radius)
    pair = jnp.concatenate([radial, rx * ux + ry * uy, rx * uy - ry * ux, shadows])
    robot = [crowd, jnp.sqrt(sx * sx + sy * sy), shadows.sum(axis=2) / 4]
    if landmark:
        px, py, near = point(point_x, point_y, basis, world.safe_distance)
        robot += [near, sx * px + sy * py]
    if scale_free:
        robot.append(roominess(mean, others, world))
    return Surroundings(ux, uy, logarithm, pair, jnp.concatenate(robot))
