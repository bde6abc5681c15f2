"""Geometry of one configuration or a batch of them: visibility, contact, obstacles, similarity, hulls and rings.

Positions are `(..., robots, 2)` with any batch axes first, in NumPy or JAX. Arguments are checked: a last axis that is
not 2, NaN, or a radius <= 0 is an `InputError`.

Example:
    >>> import numpy as np
    >>> from murmurate import geometry
    >>> geometry.visible(np.array([[0.0, 0.0], [4.0, 0.0], [8.0, 0.0]]), radius=1.0, scan_radius=20.0)[0]
    array([False,  True, False])
"""

from murmurate.geometry.contact import (
    any_contact,
    any_outside,
    clearances,
    closest_approach,
    contact_matrix,
    distances,
    in_contact,
    outside,
)
from murmurate.geometry.hull import convex_layers, on_hull
from murmurate.geometry.obstacles import obstacle_approach, obstacle_clearances, occluded_by_obstacles
from murmurate.geometry.rings import Ring, smallest_ring
from murmurate.geometry.visibility import (
    neighbors,
    neighbors_and_visible,
    occluded,
    shadow,
    sole_occluder_counts,
    visible,
)

__all__ = [
    "Ring",
    "any_contact",
    "any_outside",
    "clearances",
    "closest_approach",
    "contact_matrix",
    "convex_layers",
    "distances",
    "in_contact",
    "neighbors",
    "neighbors_and_visible",
    "obstacle_approach",
    "obstacle_clearances",
    "occluded",
    "occluded_by_obstacles",
    "on_hull",
    "outside",
    "shadow",
    "smallest_ring",
    "sole_occluder_counts",
    "visible",
]
