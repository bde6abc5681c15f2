"""Who sees whom, from the definition: shadows as polygons, and the distance of every disc from every shadow."""

from __future__ import annotations

import numpy as np
import shapely

# Nearer to tangency than this many radii, the precision of the numbers decides, and no kernel is held to an answer.
FLOAT64_TANGENCY = 1e-9
FLOAT32_TANGENCY = 1e-4


def pairwise_distances(positions: np.ndarray) -> np.ndarray:
    """Returns the distances between centres, `(*batch, robots, robots)`."""
    centres = shapely.points(np.asarray(positions, np.float64))
    return shapely.distance(centres[..., :, None], centres[..., None, :])


def shadows(positions: np.ndarray, radius: float) -> np.ndarray:
    """Builds the shadow of every robot (last axis) in the light of every other (the axis before it).

    Two tangents from the light touch the disc at the ends of a chord; the shadow is what lies between the tangents
    and beyond the chord, here a quadrilateral that ends beyond every robot. (What is shadowed before the chord belongs
    to the casting disc itself, where no part of a disjoint disc can be.)

    Args:
        positions: Centres of disjoint robots, `(*batch, robots, 2)`.
        radius: Of the robots, world units.

    Returns:
        Polygons, `(*batch, robots, robots)`; None on the diagonal.

    Raises:
        ValueError: Robots overlap.
    """
    positions = np.asarray(positions, np.float64)
    other = ~np.eye(positions.shape[-2], dtype=bool)
    light = positions[..., :, None, :]
    towards = positions[..., None, :, :] - light
    across = np.stack([-towards[..., 1], towards[..., 0]], -1)
    distance = np.where(other, np.hypot(towards[..., 0], towards[..., 1]), np.inf)[..., None]
    if distance.min(initial=np.inf) < 2 * radius * (1 - FLOAT64_TANGENCY):
        raise ValueError("robots overlap: their shadows are not defined by tangents alone")
    sine = radius / distance
    cosine = np.sqrt((1 - sine) * (1 + sine))
    left = cosine * (cosine * towards + sine * across)
    right = cosine * (cosine * towards - sine * across)
    # The far edge, too, is a chord; with tangents at most 60 degrees apart it is beyond 3.4 times the robots' extent.
    stretch = 4 * (np.ptp(positions, axis=-2).max() + radius) / (distance * cosine)
    corners = np.stack([left, stretch * left, stretch * right, right, left], -2) + light[..., None, :]
    polygons = np.full(towards.shape[:-1], None)
    polygons[..., other] = shapely.polygons(corners[..., other, :, :])
    return polygons


def shadow_clearance(positions: np.ndarray, radius: float) -> np.ndarray:
    """Measures how far each disc (last axis) keeps from all shadows, for each observer (the axis before it).

    Args:
        positions: Centres of disjoint robots, `(*batch, robots, 2)`.
        radius: Of the robots, world units.

    Returns:
        `(*batch, robots, robots)`, world units: positive, the gap between the disc and the nearest shadow; 0, tangent;
        negative, how deep the disc reaches into a shadow (at most R: from there on its centre is in the shadow).
        inf on the diagonal, and where there is no third robot.
    """
    positions = np.asarray(positions, np.float64)
    observer, occluder, observed = np.ogrid[tuple(slice(n) for n in 3 * positions.shape[-2:-1])]
    third = (observer != occluder) & (occluder != observed) & (observed != observer)
    centres = shapely.points(positions)
    casts, discs, third = np.broadcast_arrays(shadows(positions, radius)[..., None], centres[..., None, None, :], third)
    gap = shapely.distance(casts, discs, where=third, out=np.full(third.shape, np.inf))
    return gap.min(-2) - radius


def neighbors(positions: np.ndarray, scan_radius: float) -> np.ndarray:
    """Returns which robots are within scanning distance of which; False on the diagonal."""
    return (pairwise_distances(positions) <= scan_radius) & ~np.eye(np.shape(positions)[-2], dtype=bool)


def occluded(positions: np.ndarray, radius: float) -> np.ndarray:
    """Returns which robots lie, in part or whole, in a shadow thrown by any third robot."""
    return shadow_clearance(positions, radius) < 0


def decided(positions: np.ndarray, radius: float, scan_radius: float, tolerance: float) -> np.ndarray:
    """Returns which answers do not depend on precision: farther than `tolerance` radii from shadows and scan."""
    edges = np.abs(shadow_clearance(positions, radius)), np.abs(pairwise_distances(positions) - scan_radius)
    return np.minimum(*edges) > tolerance * radius
