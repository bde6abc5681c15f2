"""Pure kernels on one configuration: who sees whom, and who touches whom. No word of learning.

Example:
    >>> import numpy as np
    >>> from murmurate import geometry
    >>> geometry.visible(np.array([[0.0, 0.0], [4.0, 0.0], [8.0, 0.0]]), radius=1.0, scan_radius=20.0)[0]
    array([False,  True, False])
"""

from murmurate.geometry.contact import (
    clearances,
    closest_approach,
    collides,
    contacts,
    distances,
    leaves,
    outside,
    touches,
)
from murmurate.geometry.visibility import (
    Counts,
    counts,
    hides,
    neighbors,
    neighbors_and_visible,
    occluded,
    shadow,
    visible,
)

__all__ = [
    "Counts",
    "clearances",
    "closest_approach",
    "collides",
    "contacts",
    "counts",
    "distances",
    "hides",
    "leaves",
    "neighbors",
    "neighbors_and_visible",
    "occluded",
    "outside",
    "shadow",
    "touches",
    "visible",
]
