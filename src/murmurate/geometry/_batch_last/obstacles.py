r"""Kernels, batch last: obstacles that stand still, discs of any radius and straight walls without thickness.

Discs are `(discs, 3, *batch)`, x, y and radius; a disc of radius -inf is absent. Walls are `(walls, 4, *batch)`, both
ends. Batch axes broadcast against those of the positions. Obstacles are numbered discs first.

Robot i is occluded by an obstacle from k when any part of disc i lies in the shadow that the obstacle throws in the
light of a point source at the centre of k. The segments from that point to all points of disc i fill their convex hull,
a triangle with a round base. So an obstacle occludes i exactly when it meets the interior of that hull.
"""

from __future__ import annotations

from typing import Any

from jaxtyping import Bool, Float

from murmurate.geometry._batch_last.loops import fori_loop
from murmurate.geometry._batch_last.visibility import as_floating, offsets

__all__ = [
    "distances_between_walls",
    "distances_to_walls",
    "nearest_points",
    "obstacle_approach",
    "obstacle_clearances",
    "occluded_by_obstacles",
]

Array = Any  # a NumPy or a JAX array: the kernels use only what both have
Scalar = Any  # a number, or a traced array without axes


def obstacle_clearances(
    positions: Float[Array, "robots 2 *batch"],
    radius: Scalar,
    discs: Float[Array, "discs 3 *#batch"],
    walls: Float[Array, "walls 4 *#batch"],
) -> Float[Array, "robots obstacles *batch"]:
    """Returns the gaps between robots and obstacles, world units; negative where they overlap, inf of absent discs."""
    xp, positions = as_floating(positions)
    x, y = positions[:, None, 0], positions[:, None, 1]
    from_discs = _length(xp, discs[None, :, 0] - x, discs[None, :, 1] - y) - discs[None, :, 2]
    return _joined(xp, positions, from_discs, distances_to_walls(positions, walls)) - radius


def nearest_points(
    positions: Float[Array, "robots 2 *batch"],
    discs: Float[Array, "discs 3 *#batch"],
    walls: Float[Array, "walls 4 *#batch"],
) -> Float[Array, "robots obstacles 2 *batch"]:
    """Returns the point of each obstacle that is nearest to each robot's centre: on a disc's edge, or of a wall.

    From the middle of a disc it is in the direction of the x axis. The x of an absent disc is inf.
    """
    xp, positions = as_floating(positions)
    x, y = positions[:, None, 0], positions[:, None, 1]
    center_x, center_y, size = discs[None, :, 0], discs[None, :, 1], discs[None, :, 2]
    dx, dy = x - center_x, y - center_y
    distance = _length(xp, dx, dy)
    is_there, somewhere = size > -xp.inf, distance > 0
    scale = xp.where(is_there, size, 0.0) / xp.where(somewhere, distance, 1.0)
    disc_x = center_x + scale * xp.where(somewhere, dx, 1.0)
    disc_x, disc_y = xp.where(is_there, disc_x, xp.inf), center_y + scale * dy
    wall_x, wall_y = _nearest_on_walls(xp, x, y, walls[None])
    parts = ((disc_x, wall_x), (disc_y, wall_y))
    return xp.stack([_joined(xp, positions, *part) for part in parts], axis=2)


def distances_to_walls(
    positions: Float[Array, "robots 2 *batch"], walls: Float[Array, "walls 4 *#batch"]
) -> Float[Array, "robots walls *batch"]:
    """Returns the distances of points from walls, world units."""
    xp, positions = as_floating(positions)
    x, y = positions[:, None, 0], positions[:, None, 1]
    wall_x, wall_y = _nearest_on_walls(xp, x, y, walls[None])
    return _length(xp, wall_x - x, wall_y - y)


def distances_between_walls(
    first: Float[Array, "some 4 *batch"], second: Float[Array, "others 4 *#batch"]
) -> Float[Array, "some others *batch"]:
    """Returns the distances between segments, world units: 0 where they cross."""
    xp, first = as_floating(first)
    return _between_segments(xp, first[:, None], second[None])


def obstacle_approach(
    positions: Float[Array, "robots 2 *batch"],
    velocities: Float[Array, "robots 2 *batch"],
    radius: Scalar,
    discs: Float[Array, "discs 3 *#batch"],
    walls: Float[Array, "walls 4 *#batch"],
) -> Float[Array, "robots obstacles *batch"]:
    """Returns the least gap between robots and obstacles at any moment of one step, as `obstacle_clearances` does.

    A robot's centre moves along a segment: the least gap is that between this segment and the obstacle.
    """
    xp, positions = as_floating(positions)
    paths = xp.concat([positions, positions + velocities], axis=1)
    centers = xp.moveaxis(discs[:, :2][None], 2, 0)
    path_x, path_y = _nearest_on_walls(xp, centers[0], centers[1], paths[:, None])
    from_discs = _length(xp, path_x - centers[0], path_y - centers[1]) - discs[None, :, 2]
    return _joined(xp, positions, from_discs, _between_segments(xp, paths[:, None], walls[None])) - radius


def occluded_by_obstacles(
    positions: Float[Array, "robots 2 *batch"],
    radius: Scalar,
    discs: Float[Array, "discs 3 *#batch"],
    walls: Float[Array, "walls 4 *#batch"],
) -> Bool[Array, "robots robots *batch"]:
    """Returns which robots (column) an obstacle occludes from which (row); False on the diagonal."""
    xp, positions = as_floating(positions)
    discs, walls = xp.asarray(discs), xp.asarray(walls)  # a loop's number is no index of another library's array
    dx, dy, distance = offsets(xp, positions)
    apart = xp.where(distance > 0, distance, 1.0)
    # Of overlapping discs the hull is the disc of the observed robot: its sides have no length.
    sine = xp.where(distance > radius, radius / apart, 1.0)
    cosine = xp.sqrt((1 - sine) * (1 + sine))
    side = cosine * distance
    axis_x, axis_y = xp.where(distance > 0, dx / apart, 1.0), dy / apart

    def in_frame(x: Any, y: Any) -> tuple[Any, Any]:
        """Returns a point as the observer sees it: along the axis to the observed robot, and across it."""
        x, y = x - positions[:, None, 0], y - positions[:, None, 1]
        return x * axis_x + y * axis_y, y * axis_x - x * axis_y

    def by_disc(number: Any, occluded: Any) -> Any:
        x, y, size = (discs[number][place][None, None] for place in range(3))
        ahead, aside = in_frame(x, y)
        aside = abs(aside)
        along, across = ahead * cosine + aside * sine, aside * cosine - ahead * sine
        beside = xp.where(across > 0, across, 0.0)
        beyond = _length(xp, ahead - distance, aside) - radius
        apart = xp.where(along <= 0, _length(xp, ahead, aside), xp.where(along <= side, beside, beyond))
        return occluded | (apart < size)

    def by_wall(number: Any, occluded: Any) -> Any:
        ends = [walls[number][place][None, None] for place in range(4)]
        a, b = in_frame(*ends[:2]), in_frame(*ends[2:])
        x, y = _nearest_on_segment(xp, distance, 0.0, *a, *b)
        meets_base = _length(xp, x - distance, y) < radius
        touching = (side * cosine, side * sine)
        meets_sides = _cross(*a, *b, 0.0, 0.0, *touching) | _cross(*a, *b, 0.0, 0.0, touching[0], -touching[1])
        begins_inside = (a[0] < touching[0]) & (abs(a[1]) * cosine < a[0] * sine)
        return occluded | meets_base | meets_sides | begins_inside

    occluded = distance < 0
    for obstacles, by_kind in ((discs, by_disc), (walls, by_wall)):
        if len(obstacles):  # what none has cannot be indexed, even where the loop has no turn
            occluded = fori_loop(xp, len(obstacles), by_kind, occluded)
    return occluded & ~xp.reshape(xp.eye(len(positions), dtype=bool), (*distance.shape[:2], *[1] * (distance.ndim - 2)))


def _nearest_on_walls(xp: Any, x: Any, y: Any, walls: Any) -> tuple[Any, Any]:
    """Returns the point of each wall `(_, walls, 4, *batch)` that is nearest to each point."""
    return _nearest_on_segment(xp, x, y, walls[:, :, 0], walls[:, :, 1], walls[:, :, 2], walls[:, :, 3])


def _nearest_on_segment(xp: Any, x: Any, y: Any, x0: Any, y0: Any, x1: Any, y1: Any) -> tuple[Any, Any]:
    dx, dy = x1 - x0, y1 - y0
    square = dx * dx + dy * dy
    share = ((x - x0) * dx + (y - y0) * dy) / xp.where(square > 0, square, 1.0)
    share = xp.where(share > 0, xp.where(share < 1, share, 1.0), 0.0)
    return x0 + share * dx, y0 + share * dy


def _between_segments(xp: Any, first: Any, second: Any) -> Any:
    """Returns the distances between segments `(_, _, 4, *batch)`: from an end of one to the other, or 0."""
    ends = [tuple(segment[:, :, place] for place in range(4)) for segment in (first, second)]
    zero = xp.zeros((), dtype=ends[0][0].dtype)
    least = xp.where(_cross(*ends[0], *ends[1]), zero, zero + xp.inf)
    for one, other in (ends, ends[::-1]):
        for x, y in (one[:2], one[2:]):
            near_x, near_y = _nearest_on_segment(xp, x, y, *other)
            least = xp.minimum(least, _length(xp, near_x - x, near_y - y))
    return least


def _cross(ax: Any, ay: Any, bx: Any, by: Any, cx: Any, cy: Any, dx: Any, dy: Any) -> Any:
    """Returns which segments a-b and c-d cross at a point that is inside both."""

    def side(px: Any, py: Any, qx: Any, qy: Any, x: Any, y: Any) -> Any:
        return (qx - px) * (y - py) - (qy - py) * (x - px)

    separated = side(ax, ay, bx, by, cx, cy) * side(ax, ay, bx, by, dx, dy) < 0
    return separated & (side(cx, cy, dx, dy, ax, ay) * side(cx, cy, dx, dy, bx, by) < 0)


def _joined(xp: Any, positions: Any, of_discs: Any, of_walls: Any) -> Any:
    """Returns what was computed for discs and for walls as one array, `(robots, obstacles, *batch)`."""
    parts = [xp.broadcast_to(x, (*x.shape[:2], *positions.shape[2:])) for x in (of_discs, of_walls)]
    return xp.concat(parts, axis=1)


def _length(xp: Any, x: Any, y: Any) -> Any:
    """Returns the lengths of vectors; the gradient at 0 is 0."""
    square = x * x + y * y
    return xp.where(square == 0, 0.0, xp.sqrt(xp.where(square == 0, 1.0, square)))
