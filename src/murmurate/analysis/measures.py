"""Measures of one configuration: nearest distances, visibility margin and elongation; and a line fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from murmurate.errors import check_number
from murmurate.geometry import distances
from murmurate.geometry.similarity import configuration
from murmurate.representation import short_repr

__all__ = ["Line", "elongation", "fit_line", "nearest_distances", "visibility_margin"]


def nearest_distances(positions: Float[np.ndarray, "robots 2"]) -> Float[np.ndarray, " robots"]:
    """Returns each robot's distance to the robot nearest to it, world units; inf for a robot alone.

    Raises:
        InputError: The positions are not finite numbers of shape (robots, 2).
    """
    distance = distances(configuration(positions))
    np.fill_diagonal(distance, np.inf)
    return distance.min(axis=1)


def elongation(positions: Float[np.ndarray, "robots 2"]) -> float:
    """Returns how much longer than wide a configuration is, from 0 to 1: 1 - width / length.

    Length and width are its root mean square extents along its principal axes. A ring has 0 and a line has 1; robots
    that are all at one point have 0.

    Raises:
        InputError: The positions are not finite numbers of shape (robots, 2).
    """
    points = configuration(positions)
    # The singular values of centred points; squares of their covariance would lose half of the digits.
    length, width = (*np.linalg.svd(points - points.mean(axis=0), compute_uv=False), 0.0)[:2]
    return float(1 - width / length) if length > 0 else 0.0


def visibility_margin(positions: Float[np.ndarray, "robots 2"], radius: float) -> float:
    """Returns the least gap between the disc of any robot and the shadow that another one throws from a third.

    Seen from k, the shadow of j is what lies between the two tangents to the disc of j and beyond the chord between
    the points where they touch it.

    Args:
        positions: Centres of the robots, world units.
        radius: The paper's R_bot, world units.

    Returns:
        The gap in radii: positive where no robot is occluded, 0 where a disc touches a shadow, negative where one
        reaches into a shadow, by at most 1 where its centre is in it. inf for fewer than three robots.

    Raises:
        InputError: The positions are not finite numbers of shape (robots, 2), or the radius is not positive.
    """
    check_number("radius", radius, 0, exclusive_low=True)
    points = configuration(positions) / radius
    z = points[:, 0] + 1j * points[:, 1]
    # From observer k (row) to j (column), in radii; j covers the angle a to either side.
    offset = z[None] - z[:, None]
    distance = np.abs(offset)
    apart = distance > 0
    sine = 1 / np.maximum(distance, 1)
    cosine = np.sqrt((1 - sine) * (1 + sine))
    towards = offset / np.where(apart, distance, 1)

    # Robot i (third axis) in coordinates with k at the origin and j on the positive x-axis, mirrored to y >= 0.
    seen = offset[:, None, :] * towards.conj()[:, :, None]
    x, y = seen.real, np.abs(seen.imag)
    sin, cos, far = sine[:, :, None], cosine[:, :, None], distance[:, :, None]
    touch_x, touch_y = far * cos * cos, far * cos * sin
    beyond_touch = x * cos + y * sin >= far * cos
    gap = np.where(
        beyond_touch,
        np.maximum(y * cos - x * sin, 0),
        np.where(y <= touch_y, np.maximum(touch_x - x, 0), np.hypot(x - touch_x, y - touch_y)),
    )
    third = apart[:, :, None] & ~np.eye(len(z), dtype=bool)[:, None, :] & ~np.eye(len(z), dtype=bool)[None]
    return float(gap.min(where=third, initial=np.inf)) - 1.0


@dataclass(frozen=True)
class Line:
    """A straight line by least squares.

    Attributes:
        slope: Increase of y for an increase of x by 1.
        intercept: y where x is 0.
        r_squared: Share of the variance of y that the line explains.
    """

    slope: float
    intercept: float
    r_squared: float

    __repr__ = short_repr


def fit_line(x: Sequence[float], y: Sequence[float]) -> Line | None:
    """Fits a straight line; returns None for fewer than three points, numbers that are not finite, or a single x."""
    across, up = np.asarray(x, float), np.asarray(y, float)
    if len(across) < 3 or not np.isfinite(up).all() or np.ptp(across) == 0:
        return None
    slope, intercept = np.polyfit(across, up, 1)
    total = float(((up - up.mean()) ** 2).sum())
    residual = float(((up - intercept - slope * across) ** 2).sum())
    return Line(float(slope), float(intercept), 1 - residual / total if total else 1.0)
