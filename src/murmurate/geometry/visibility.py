r"""Who neighbours whom, and who sees whom, in one configuration of fat opaque robots.

Seen from the centre of robot k, the disc of robot i (radius R, centre at distance d) covers the open angular interval
[theta - alpha, theta + alpha], sin(alpha) = R / d. Robot j throws a shadow on i exactly when j is nearer to k than i is
and their intervals overlap: the angle gamma between the two centres is below A = alpha_i + alpha_j. With gamma and A
both in [0, pi] that is sin(A - gamma) > 0, which needs no inverse trigonometry and loses no digits near tangency.

Where discs overlap (no collision-free run gets there) the same formulas hold with sin(alpha) = min(1, R / d): a disc
over the observer's centre covers half of its view, and a coincident one, having no direction, throws no shadow.

Kernels take `(robots, 2, *batch)` and work in the namespace of their argument: NumPy in, NumPy out in that precision;
JAX in, JAX out. The batch stands last because it is the axis that the machine's vector units run along.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from murmurate.errors import InputError
from murmurate.geometry.loops import repeat, updated
from murmurate.geometry.sweep import Sight, overlap, sweep

__all__ = ["Counts", "counts", "hides", "neighbors", "occluded", "shadow", "visible"]

FEW = 48
"""Up to so many robots each is asked about every other; beyond, the swarm is swept.

Compiled in float32 for two cores, asking is 4 times faster at 48 robots. Beyond about 50 XLA no longer fuses it, and
sweeping is 2.5 times faster at 56 robots in a batch of 256, 3 times at 64. For one configuration alone it is the slower
up to 170 robots, by less than half a millisecond.
"""

Array = Any  # a NumPy or a JAX array: the kernels use only what both have


class Counts(NamedTuple):
    """The paper's readings of every robot's sensor: G_all, G_vis and G_occ."""

    all: Int[Array, "robots *batch"]
    vis: Int[Array, "robots *batch"]
    occ: Int[Array, "robots *batch"]


def as_configuration(positions: Float[Array, "robots 2 *batch"]) -> tuple[Any, Any]:
    """Returns the array namespace and the positions as a floating array of it."""
    if not hasattr(positions, "__array_namespace__"):
        positions = np.asarray(positions)
    xp = positions.__array_namespace__()
    if not xp.isdtype(positions.dtype, "real floating"):
        positions = positions.astype(float)
    return xp, positions


def offsets(xp: Any, positions: Float[Array, "robots 2 *batch"]) -> tuple[Any, Any, Any]:
    """Returns dx, dy and the distance from each observer (row) to each observed (column)."""
    dx = positions[None, :, 0] - positions[:, None, 0]
    dy = positions[None, :, 1] - positions[:, None, 1]
    return dx, dy, xp.sqrt(dx * dx + dy * dy)


def off_diagonal(xp: Any, like: Any) -> Bool[Array, "robots robots *ones"]:
    """Returns True off the diagonal, with as many trailing axes of length 1 as `like` has batch axes."""
    robots = like.shape[0]
    return xp.reshape(~xp.eye(robots, dtype=bool), (robots, robots) + (1,) * (like.ndim - 2))


def fold(combine: Callable[[Any, Any], Any], array: Any, axis: int = 0) -> Any:
    """Reduces an axis by combining its slices one after another.

    XLA's CPU backend does not vectorise a reduction over a leading axis once what makes its operand is fused into it.
    Combining slices it does vectorise, along the batch: up to 15 times faster for a swarm of ten. A long axis is folded
    onto itself first, since a program grows with the slices that it combines.
    """
    before = (slice(None),) * axis
    while isinstance(length := array.shape[axis], int) and length > FEW:
        half = length // 2
        rest = array[(*before, slice(2 * half, length))]
        array = combine(array[(*before, slice(half))], array[(*before, slice(half, 2 * half))])
        if length % 2:
            array = rest.__array_namespace__().concat([array, rest], axis=axis)
    return functools.reduce(combine, (array[(*before, index)] for index in range(array.shape[axis])))


def neighbors(positions: Float[Array, "robots 2 *batch"], scan_radius: float) -> Bool[Array, "robots robots *batch"]:
    """Says who is within scanning distance of whom (centres at most `scan_radius` apart).

    Args:
        positions: Centres of the robots, world units.
        scan_radius: The paper's R_scan, world units.

    Returns:
        True where the robot of the column is a neighbour of the robot of the row; False on the diagonal.
    """
    xp, positions = as_configuration(positions)
    _, _, distance = offsets(xp, positions)
    return (distance <= scan_radius) & off_diagonal(xp, distance)


def occluded(positions: Float[Array, "robots 2 *batch"], radius: float) -> Bool[Array, "robots robots *batch"]:
    """Says who lies, in part or whole, in a shadow thrown by any third robot.

    Args:
        positions: Centres of the robots, world units.
        radius: The paper's R_bot, world units.

    Returns:
        True where the robot of the column is occluded from the robot of the row; False on the diagonal.
    """
    xp, positions = as_configuration(positions)
    dx, dy, distance = offsets(xp, positions)
    return _occluded(xp, dx, dy, distance, radius)


def sight_of(xp: Any, dx: Any, dy: Any, distance: Any, radius: float) -> Sight:
    """Returns where each robot stands in each other's view: observer (row), observed (column)."""
    safe = xp.where(distance > 0, distance, 1)
    sin = xp.where(distance > radius, radius / safe, 1)
    # A robot does not see itself: an unreachable distance keeps it from ever being the nearer of a pair.
    reach = xp.where(off_diagonal(xp, distance), distance, xp.inf)
    return Sight(dx / safe, dy / safe, sin, xp.sqrt((1 - sin) * (1 + sin)), reach)


def _shadows(xp: Any, sight: Sight) -> Callable[[Any], Any]:
    """Returns the function that says who lies in the shadow of robot j: observer k (row), observed i (column).

    Given `slice(None)` instead of a number it says so of every j at once, on an axis between these two.
    """
    other = off_diagonal(xp, sight.reach)

    def shadowed_by(j: Any) -> Any:
        at_once = isinstance(j, slice)
        observed, apart = (Sight(*(a[:, None] for a in sight)), other[:, None]) if at_once else (sight, other)
        return overlap(xp, observed, Sight(*(a[:, j, None] for a in sight))) & apart

    return shadowed_by


def _occluded(xp: Any, dx: Any, dy: Any, distance: Any, radius: float) -> Any:
    sight, robots = sight_of(xp, dx, dy, distance, radius), distance.shape[0]
    if not isinstance(robots, int):  # in a program for swarms of any size, nobody can be taken one after another
        return xp.any(_shadows(xp, sight)(slice(None)), axis=1)
    return sweep(xp, sight) if robots > FEW else directly(xp, sight)


def directly(xp: Any, sight: Sight) -> Any:
    """Says who is occluded by asking about every robot, as `sweep` says it of large swarms."""
    # One robot after another instead of a reduction over a third axis: no N^3 array, and XLA's CPU backend vectorises
    # this along the batch, which it does not do for a reduction over a middle axis.
    return functools.reduce(operator.or_, map(_shadows(xp, sight), range(sight.reach.shape[0])))


def shadow(
    observer: Float[np.ndarray, "2"], occluder: Float[np.ndarray, "2"], radius: float, reach: float
) -> Float[np.ndarray, "4 2"]:
    """Returns the shadow that one robot throws in the light at another's centre, to be drawn: NumPy only.

    Two tangents from the light touch the occluder; the shadow lies between them, beyond the chord of the two points of
    contact. (The occluder's own disc covers what the chord cuts off.)

    Args:
        observer: Where the light is, world units.
        occluder: Centre of the robot that throws the shadow.
        radius: The paper's R_bot, world units.
        reach: How far from the light the tangents are followed, world units.

    Returns:
        The corners, clockwise from the point of contact on the left as seen from the light.

    Raises:
        InputError: The light is not outside the occluder, or the tangents end before they touch it.
    """
    light = np.asarray(observer, dtype=float)
    towards = np.asarray(occluder, dtype=float) - light
    distance = math.hypot(*towards)
    if not radius < distance < math.inf:
        raise InputError("occluder", distance, f"farther than the radius, {radius:g}, from the observer")
    length = math.sqrt((distance - radius) * (distance + radius))
    if not length <= reach < math.inf:
        raise InputError("reach", reach, f"finite and at least {length:g}, where the tangents touch the occluder")
    across = np.array([-towards[1], towards[0]])
    # Unit vectors along the tangents: the direction to the occluder turned by +-alpha, sin(alpha) = R / d.
    left, right = ((length * towards + side * radius * across) / distance**2 for side in (1, -1))
    return light + np.stack([length * left, reach * left, reach * right, length * right])


def hides(
    positions: Float[Array, "robots 2 *batch"], radius: float, scan_radius: float
) -> Float[Array, "robots *batch"]:
    """Counts the pairs of other robots that each robot alone hides: they would see each other were it not there.

    Args:
        positions: Centres of the robots, world units.
        radius: The paper's R_bot, world units.
        scan_radius: The paper's R_scan, world units; pairs farther apart do not count.

    Returns:
        Ordered pairs (observer, observed) for each robot, in the precision of the positions.
    """
    xp, positions = as_configuration(positions)
    dx, dy, distance = offsets(xp, positions)
    sight = sight_of(xp, dx, dy, distance, radius)
    alone_of = _alone if distance.shape[0] <= FEW else _alone_among_many
    alone = xp.where(distance <= scan_radius, alone_of(xp, sight), -1)
    tally = _tally if distance.shape[0] <= FEW else _tally_of_many
    return xp.astype(tally(xp, alone), positions.dtype)


def _alone(xp: Any, sight: Sight) -> Any:
    """Returns the number of the only robot that hides each pair, or -1 where that is not one robot."""
    shadowed_by = _shadows(xp, sight)
    shadows = [shadowed_by(j).astype(sight.sin.dtype) for j in range(sight.reach.shape[0])]
    hiders = functools.reduce(operator.add, shadows)
    # Where there is one hider, the sum of the hiders' numbers is its own.
    hider = functools.reduce(operator.add, (j * shadow for j, shadow in enumerate(shadows)))
    return xp.where(hiders == 1, hider, -1)


def _alone_among_many(xp: Any, sight: Sight) -> Any:
    """The same in a loop: no N^3 array, and a program that does not grow with N."""
    shadowed_by = _shadows(xp, sight)

    def meet(j: Any, state: tuple[Any, Any]) -> tuple[Any, Any]:
        hiders, hider = state
        shadowed = shadowed_by(j)
        return hiders + xp.astype(shadowed, xp.int32), xp.where(shadowed, j, hider)

    nobody = xp.zeros(sight.reach.shape, dtype=xp.int32)
    hiders, hider = repeat(xp, sight.reach.shape[0], meet, (nobody, nobody))
    return xp.where(hiders == 1, hider, -1)


def _tally(xp: Any, alone: Any) -> Any:
    """Counts how often each robot is named."""
    robots, dtype = alone.shape[0], alone.dtype
    number = xp.reshape(xp.arange(robots, dtype=dtype), (robots,) + (1,) * (alone.ndim - 1))
    # By hider and observed, then by hider.
    hidden = functools.reduce(operator.add, ((alone[None, k] == number).astype(dtype) for k in range(robots)))
    return fold(operator.add, hidden, axis=1)


def _tally_of_many(xp: Any, alone: Any) -> Any:
    robots, _, *batch = alone.shape
    named = xp.reshape(alone, (robots * robots, -1))
    nothing = xp.zeros((robots, named.shape[1]), dtype=xp.int32)
    tally = updated(xp, "add", nothing, xp.maximum(named, 0), xp.astype(named >= 0, xp.int32))
    return xp.reshape(tally, (robots, *batch))


def visible(
    positions: Float[Array, "robots 2 *batch"], radius: float, scan_radius: float
) -> Bool[Array, "robots robots *batch"]:
    """Says who is a fully visible neighbour of whom: within `scan_radius` and occluded by nobody.

    Args:
        positions: Centres of the robots, world units.
        radius: The paper's R_bot, world units.
        scan_radius: The paper's R_scan, world units.

    Returns:
        True where the robot of the column is visible from the robot of the row; False on the diagonal.
    """
    return neighbors_and_visible(positions, radius, scan_radius)[1]


def neighbors_and_visible(
    positions: Float[Array, "robots 2 *batch"], radius: float, scan_radius: float
) -> tuple[Bool[Array, "robots robots *batch"], Bool[Array, "robots robots *batch"]]:
    """Returns `neighbors` and `visible` from one pass over the pairs."""
    xp, positions = as_configuration(positions)
    dx, dy, distance = offsets(xp, positions)
    near = (distance <= scan_radius) & off_diagonal(xp, distance)
    return near, near & ~_occluded(xp, dx, dy, distance, radius)


def counts(positions: Float[Array, "robots 2 *batch"], radius: float, scan_radius: float) -> Counts:
    """Counts every robot's neighbours: all of them, the fully visible and the occluded (paper, System Model).

    Args:
        positions: Centres of the robots, world units.
        radius: The paper's R_bot, world units.
        scan_radius: The paper's R_scan, world units.

    Returns:
        G_all, G_vis and G_occ, each `(robots, *batch)`; G_all = G_vis + G_occ.
    """
    near, seen = neighbors_and_visible(positions, radius, scan_radius)
    everyone, vis = near.sum(axis=1), seen.sum(axis=1)
    return Counts(everyone, vis, everyone - vis)
