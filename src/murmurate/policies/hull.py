"""The convex hull of what a robot sees: whether it is a corner of it, between whom, and how far it stands out."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from murmurate.policies.layers import fold

__all__ = ["CORNER_CHANNELS", "EDGE_CHANNELS", "Hull", "hull"]

EDGE_CHANNELS, CORNER_CHANNELS = 2, 3

ROUNDING = 1e-6
"""Sine of the angle within which two robots lie in the same direction."""

BROAD = 4.0
"""Radii by which a robot stands out far."""


class Hull(NamedTuple):
    """Each robot's own corner of the hull of what it sees, itself included; the observer is the first axis.

    Attributes:
        pair: Scalars of each pair: whether they share an edge of the hull (a corner does with two others, a robot
            inside with none), and on which side of it everybody else is.
        robot: Scalars of each robot: whether it is a corner, and how far it stands out from the line between the two
            next ones. In order to all see each other, robots must stand out by more than about a radius, whatever their
            number and distances.
    """

    pair: Float[Array, "edge_channels robots robots *batch"]
    robot: Float[Array, "corner_channels robots *batch"]


def hull(
    ux: Float[Array, "robots robots *batch"],
    uy: Float[Array, "robots robots *batch"],
    distance: Float[Array, "robots robots *batch"],
    seen: Bool[Array, "robots robots *batch"],
) -> Hull:
    """Finds whom nobody seen is to the left of, and whom nobody seen is to the right of.

    Args:
        ux: x of the unit vectors to those that each robot sees; 0 for the others.
        uy: y of them.
        distance: Of those seen, in radii.
        seen: Which robots each one sees.
    """
    dtype = ux.dtype

    def beside(j: int) -> tuple[Array, Array]:
        turn = ux * uy[:, j, None] - uy * ux[:, j, None]
        return (turn > ROUNDING).astype(dtype), (turn < -ROUNDING).astype(dtype)

    left, right = fold(beside, ux.shape[1])
    last, first = (seen & (count == 0) for count in (left, right))
    (ax, ay), (bx, by) = _middle(last, ux, uy, distance), _middle(first, ux, uy, distance)
    width = jnp.sqrt((ax - bx) ** 2 + (ay - by) ** 2 + 1e-6)
    # Where everybody is in one line, rounding would be all that is left of the product, over next to no width.
    bulge = jnp.where(jnp.any(last & first, axis=1), 0.0, jnp.abs(ax * by - ay * bx) / width)
    corner = jnp.any(last, axis=1).astype(dtype)
    robot = [corner, corner / (1 + bulge**2) ** 2, corner * bulge / (BROAD + bulge)]
    pair = [(last | first).astype(dtype), last.astype(dtype) - first.astype(dtype)]
    return Hull(jnp.stack(pair), jnp.stack(robot))


def _middle(chosen: Array, ux: Array, uy: Array, distance: Array) -> tuple[Array, Array]:
    """Mean position of those chosen; several are in one line with the observer."""
    share = chosen / jnp.maximum(jnp.sum(chosen, axis=1), 1)[:, None]
    return jnp.sum(share * distance * ux, axis=1), jnp.sum(share * distance * uy, axis=1)
