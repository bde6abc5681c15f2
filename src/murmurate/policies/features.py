"""Features that describe a robot's surroundings independently of any frame: distances, and angles between directions.

The features have no parameters, so no gradient passes through the pairs and triples of robots below. On a CPU these
wide, cheap sums cost less than learned layers of the same width would.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from murmurate.geometry._batch_last import other_robots, sum_over_third_robots, sum_terms
from murmurate.representation import short_repr
from murmurate.world.config import WorldConfig

__all__ = [
    "SHADOW_CHANNELS",
    "PositionFeatures",
    "Surroundings",
    "offsets_between",
    "pair_and_robot_features",
    "pair_channels",
    "position_features",
    "radial_basis",
    "robot_channels",
    "surroundings",
]

SHADOW_CHANNELS = 6
"""Number of channels of `_shadows`."""

MIN_DISTANCE, MAX_DISTANCE = 0.4, 16.0
"""Centres of the first and the last function of the radial basis, in safe distances."""

NEIGHBOR_DISTANCE, MEAN_DISTANCE = 2.0, 8.0
"""Where normalised distances put the neighbours on a ring and the mean distance, in safe distances."""

NEIGHBOR_FACTOR, MIN_LOG_NEIGHBOR = -0.2, 1 / 3
"""Neighbours on a ring are as far as the square root of the mean distance times the exponential of the first number.
The second is the logarithm of the least distance, in safe distances, that is normalised to theirs."""

SPREAD_CENTERS, SPREAD_WIDTH = (-0.6, -0.3, 0.0, 0.3, 0.6, 1.2), 0.3
"""Centres and width of the Gaussians in the logarithm of the relative spread."""

TIE = 0.03
"""Width of two ranges in which a shadow passes from one kind to another: of the logarithm of two distances' ratio, on
either side of a tie, and of the cosine of an angle, beyond a right one. In symmetric swarms many robots are equally
far away or at right angles. A comparison would let rounding decide there, and rounding changes as the swarm turns."""

MIN_MEAN_DISTANCE = 2.5
"""Mean distance, in safe distances, below which denser swarms are not normalised any further."""


class Surroundings(NamedTuple):
    """What every robot sees: the observer is the first robot axis, the observed robot the second.

    Attributes:
        ux: x of the unit vectors to the others; 0 on the diagonal.
        uy: y of them.
        logarithm: Logarithms of the distances in safe distances; normalised where features are free of scale.
        pair: Scalars of each pair, which do not change when the swarm is moved or turned.
        robot: Scalars of each robot, which do not change either.
    """

    ux: Float[Array, "robots others *batch"]
    uy: Float[Array, "robots others *batch"]
    logarithm: Float[Array, "robots others *batch"]
    pair: Float[Array, "pair_channels robots others *batch"]
    robot: Float[Array, "robot_channels robots *batch"]

    __repr__ = short_repr


class PositionFeatures(NamedTuple):
    """Positions, and those features that take longest to compute from them.

    Attributes:
        positions: Positions of all robots, world units.
        shadows: How near third robots come to each line of sight: see `_shadows`.
    """

    positions: Float[Array, "robots 2 *batch"]
    shadows: Float[Array, "shadow_channels robots others *batch"]

    __repr__ = short_repr


def pair_channels(basis: int) -> int:
    """Returns the number of scalars of a pair."""
    return basis + 2 * (basis // 2) + SHADOW_CHANNELS


def robot_channels(basis: int, landmark: bool, scale_free: bool = False) -> int:
    """Returns the number of scalars of a robot."""
    spread = 1 + len(SPREAD_CENTERS) if scale_free else 0
    return 2 * basis + SHADOW_CHANNELS + (2 * basis if landmark else 0) + spread


def centers(count: int) -> Float[Array, " basis"]:
    """Returns logarithms of the centres of the radial basis, in safe distances: dense nearby, sparse far away."""
    return jnp.linspace(math.log(MIN_DISTANCE), math.log(MAX_DISTANCE), count)


def radial_basis(logarithm: Float[Array, "*shape"], count: int) -> Float[Array, "basis *shape"]:
    """Returns Gaussians in the logarithm of the distance.

    Args:
        logarithm: Logarithms of the distances, in safe distances.
        count: Number of basis functions.
    """
    middle = centers(count)
    z = (logarithm - middle.reshape((-1,) + (1,) * logarithm.ndim)) / (middle[1] - middle[0])
    return jnp.exp(-0.5 * z * z)


def normalize_distances(
    logarithm: Float[Array, "robots others *batch"], mean: Float[Array, "robots *batch"]
) -> Float[Array, "robots others *batch"]:
    """Rescales distances beyond the safe distance so that neighbours and the mean always lie at the same two values.

    On the smallest ring of N robots that all see each other the mean distance grows as N^2. The distance of neighbours
    grows as N, in proportion to the geometric mean of the mean distance and the safe distance. Between these points
    logarithms are mapped linearly.

    Args:
        logarithm: Logarithms of the distances, in safe distances; the observer is the first axis.
        mean: Mean distance of the robots that each robot sees, in safe distances.
    """
    middle = jnp.log(jnp.maximum(mean, MIN_MEAN_DISTANCE))[:, None]
    near = jnp.maximum(0.5 * middle + NEIGHBOR_FACTOR, MIN_LOG_NEIGHBOR)
    inner = logarithm * (math.log(NEIGHBOR_DISTANCE) / near)
    slope = math.log(MEAN_DISTANCE / NEIGHBOR_DISTANCE) / (middle - near)
    outer = math.log(NEIGHBOR_DISTANCE) + (logarithm - near) * slope
    return jnp.where(logarithm > near, outer, jnp.where(logarithm > 0, inner, logarithm))


def count_weights(others: Float[Array, "robots *batch"], count: int) -> Float[Array, "basis robots *batch"]:
    """Returns weights by which sums over a robot's view are similar on rings of any size, for each basis function.

    Robots as near as neighbours on a ring are counted: only so many fit. Robots as far as the mean distance are
    averaged. In between, where their number on a ring grows as a power of N, the weight is that power.

    Args:
        others: How many robots each robot sees.
        count: Number of basis functions.
    """
    span = math.log(MEAN_DISTANCE / NEIGHBOR_DISTANCE)
    exponent = jnp.clip((centers(count) - math.log(NEIGHBOR_DISTANCE)) / span, 0.0, 1.0)
    return (MEAN_DISTANCE / others) ** exponent.reshape((-1,) + (1,) * others.ndim)


def relative_spread(
    mean: Float[Array, "robots *batch"], others: Float[Array, "robots *batch"], world: WorldConfig
) -> Float[Array, "spread_channels robots *batch"]:
    """Returns how wide the visible swarm is, relative to the smallest ring of as many robots that all see each other.

    On a ring of radius r the mean distance is about 4 r / pi. The smallest radius is 0.076 N^2 radii where robots must
    not occlude each other, and N safe distances / (2 pi) where neighbours must keep the safe distance.

    Args:
        mean: Mean distance of the robots that each robot sees, world units.
        others: How many robots each robot sees.
        world: Sizes of the world and its robots.
    """
    robots = others + 1
    smallest = jnp.maximum(0.0967 * world.radius * robots**2, 0.2026 * world.safe_distance * robots**2 / others)
    logarithm = jnp.log(mean / smallest + 1e-3)
    gaussians = [jnp.exp(-0.5 * ((logarithm - center) / SPREAD_WIDTH) ** 2) for center in SPREAD_CENTERS]
    return jnp.stack([jnp.tanh(logarithm), *gaussians])


def _shadows(ux: Array, uy: Array, distance: Array, radius: float) -> Float[Array, "6 robots others *batch"]:
    """Returns how near third robots come to each line of sight, in units of the angle at which occlusion begins.

    For observer k, observed robot i and a third robot j the terms are a bell of j's angular offset, and the bell times
    the offset, which tells the side. They are summed over three kinds of j: those nearer than i, which may occlude it;
    those farther, which i may occlude; and those behind k, which k may occlude from i. One kind passes continuously
    into the next, and a robot as far as i is half of it nearer; see `TIE`.
    """
    half = radius / distance
    # Computed once for each pair: fused into the sum below, a logarithm would be computed for each triple.
    wx, wy, level = jax.lax.optimization_barrier((ux * (1 / TIE), uy * (1 / TIE), jnp.log(distance) * (0.5 / TIE)))

    def third(first: tuple[Array, ...], other: tuple[Array, ...], same: Array) -> tuple[Array, ...]:
        (ux, uy, wx, wy, half, level), (jx, jy, _, _, jh, jl) = first, other
        sin, cos, width = ux * jy - uy * jx, wx * jx + wy * jy, half + jh
        # The offset z is sin / width, and the bell (1 + z^2)^-2, here by a single division.
        inverse = 1 / (sin * sin + width * width)
        # Robot i itself is no third robot. Where k is i or j the unit vector is 0, and so is the cosine.
        near = jnp.where(same, 0.0, width * inverse)
        root = width * near
        bell, odd = root * root, sin * near * root
        facing = jnp.clip(cos, -1.0, 1.0)
        ahead = jnp.maximum(facing, 0.0)
        nearer = jnp.clip(0.5 + level - jl, 0.0, 1.0) * ahead
        return tuple(w * factor for w in (nearer, ahead - nearer, ahead - facing) for factor in (bell, odd))

    return jnp.stack(sum_over_third_robots(third, (ux, uy, wx, wy, half, level)))


def point(
    x: Float[Array, "robots *batch"], y: Float[Array, "robots *batch"], basis: int, scale: float
) -> tuple[Float[Array, "robots *batch"], Float[Array, "robots *batch"], Float[Array, "basis robots *batch"]]:
    """Returns the direction to a point, shortened within a quarter of a safe distance, and the basis of its distance.

    Args:
        x: First coordinate of the point, relative to each robot.
        y: Second coordinate.
        basis: Number of radial basis functions.
        scale: The safe distance.
    """
    square = x * x + y * y
    # The gradient of the square root at 0 is not finite.
    distance = jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)
    soft = jnp.sqrt(distance**2 + (0.25 * scale) ** 2)
    return x / soft, y / soft, radial_basis(jnp.log(distance / scale + 1e-6), basis)


def position_features(positions: Float[Array, "robots 2 *batch"], world: WorldConfig) -> PositionFeatures:
    """Returns positions with those features that take longest to compute from them."""
    ux, uy, distance = _directions(*offsets_between(positions))
    return PositionFeatures(positions, _shadows(ux, uy, distance, world.radius))


def surroundings(
    positions: Float[Array, "robots 2 *batch"],
    basis: int,
    world: WorldConfig,
    landmark: bool,
    *,
    scale_free: bool = False,
    shadows: Float[Array, "shadow_channels robots others *batch"] | None = None,
) -> Surroundings:
    """Returns the features of every robot where each knows all positions; for the arguments see below."""
    offsets = offsets_between(positions)
    target = (-positions[:, 0], -positions[:, 1])
    return pair_and_robot_features(*offsets, *target, basis, world, landmark, scale_free=scale_free, shadows=shadows)


def offsets_between(positions: Float[Array, "robots 2 *batch"]) -> tuple[Array, Array, Array]:
    """Returns every robot's coordinates relative to every other, and which robots are at different places."""
    dx = positions[None, :, 0] - positions[:, None, 0]
    dy = positions[None, :, 1] - positions[:, None, 1]
    return dx, dy, (dx * dx + dy * dy > 0) & other_robots(jnp, positions)


def _directions(dx: Array, dy: Array, apart: Array) -> tuple[Array, Array, Array]:
    """Returns unit vectors, 0 where robots are not apart, and distances, 1 there."""
    distance = jnp.sqrt(jnp.where(apart, dx * dx + dy * dy, 1.0))
    return jnp.where(apart, dx / distance, 0.0), jnp.where(apart, dy / distance, 0.0), distance


def pair_and_robot_features(
    dx: Float[Array, "robots others *batch"],
    dy: Float[Array, "robots others *batch"],
    apart: Bool[Array, "robots others *batch"],
    landmark_x: Float[Array, "robots *batch"],
    landmark_y: Float[Array, "robots *batch"],
    basis: int,
    world: WorldConfig,
    landmark: bool,
    *,
    scale_free: bool = False,
    shadows: Float[Array, "shadow_channels robots others *batch"] | None = None,
) -> Surroundings:
    """Returns the features of every robot and pair, from the robots that each robot sees.

    Args:
        dx: First coordinate of each robot (second axis) relative to the observer (first axis).
        dy: Second coordinate.
        apart: Which robots the observer sees, at another place than its own; the coordinates of the others are ignored.
        landmark_x: First coordinate of the gathering point relative to the observer.
        landmark_y: Second coordinate.
        basis: Number of radial basis functions.
        world: Sizes of the world and its robots.
        landmark: Whether the gathering point is known.
        scale_free: Whether distances beyond the safe distance are normalised by the mean distance, and far robots are
            averaged instead of counted, so that large, wide swarms look like small, narrow ones.
        shadows: What `position_features` returns, if it is known already.
    """
    ux, uy, distance = _directions(dx, dy, apart)
    others = jnp.maximum(jnp.sum(apart, axis=1), 1).astype(dx.dtype)
    logarithm = jnp.log(distance / world.safe_distance + 1e-6)
    mean = jnp.sum(jnp.where(apart, distance, 0.0), axis=1) / others
    if scale_free:
        logarithm = normalize_distances(logarithm, mean / world.safe_distance)
    radial = radial_basis(logarithm, basis)
    radial = radial * apart.astype(dx.dtype)

    def seen(i: int) -> tuple[Array, Array, Array]:
        return radial[:, :, i], radial[:, :, i] * ux[:, i], radial[:, :, i] * uy[:, i]

    crowd, sx, sy = (total * 0.25 for total in sum_terms(seen, dx.shape[1]))
    if scale_free:
        crowd, sx, sy = (count_weights(others, basis) * total for total in (crowd, sx, sy))
    # The direction to i along and across the mean direction of the robots in each range of distances, two basis
    # functions to a range.
    ranges = basis // 2
    rx, ry = (s[: 2 * ranges].reshape((ranges, 2, *s.shape[1:])).sum(axis=1)[:, :, None] for s in (sx, sy))
    shadows = _shadows(ux, uy, distance, world.radius) if shadows is None else shadows
    pair = jnp.concatenate([radial, rx * ux + ry * uy, rx * uy - ry * ux, shadows])
    robot = [crowd, jnp.sqrt(sx * sx + sy * sy), shadows.sum(axis=2) / 4]
    if landmark:
        px, py, near = point(landmark_x, landmark_y, basis, world.safe_distance)
        robot += [near, sx * px + sy * py]
    if scale_free:
        robot.append(relative_spread(mean, others, world))
    return Surroundings(ux, uy, logarithm, pair, jnp.concatenate(robot))
