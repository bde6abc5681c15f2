"""Convex hulls: which robots are on the hull, layer by layer."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from murmurate.geometry import _batch_last
from murmurate.geometry._checks import robots_first, to_batch_last
from murmurate.geometry.similarity import normalized

__all__ = ["convex_layers", "on_hull"]

Array = Any  # a NumPy or a JAX array


def on_hull(positions: Float[Array, "*batch robots 2"]) -> Bool[Array, "*batch robots"]:
    """Returns which robots are on the convex hull; those on an edge of it are, so all robots of a line are.

    Args:
        positions: Centres of the robots, world units.

    Raises:
        InputError: The positions are not finite numbers of that shape.
    """
    xp, positions = to_batch_last("positions", positions)
    return robots_first(xp, _batch_last.on_hull(positions))


def convex_layers(positions: Float[np.ndarray, "robots 2"]) -> tuple[int, ...]:
    """Returns how many robots are on the convex hull, on the hull of the robots inside it, and so on.

    Args:
        positions: Centres of the robots of one configuration, world units.

    Returns:
        The number of robots on each layer, the hull first.

    Raises:
        InputError: The positions are not finite numbers of that shape.
    """
    z, layers = normalized(positions), []
    remaining = np.stack([np.real(z), np.imag(z)], axis=1)
    while len(remaining):
        outermost = on_hull(remaining)
        layers.append(int(outermost.sum()))
        remaining = remaining[~outermost]
    return tuple(layers)
