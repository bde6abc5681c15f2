"""Private kernels of the package: arrays are `(robots, 2, *batch)`, the batch axes LAST, and nothing is checked.

The batch is last because vector units run along the last axis: with ten robots this is at least twice as fast as batch
first. Users call the functions of the same names in `murmurate.geometry`, which take the batch first and check it.

Kernels compute in the namespace and precision of their arguments: NumPy in, NumPy out; JAX in, JAX out. NaN positions
are allowed: comparisons with NaN are false, so a robot at NaN neighbours, occludes and touches none, and is outside.
"""

from murmurate.geometry._batch_last.contact import (
    any_contact,
    any_outside,
    clearances,
    closest_approach,
    contact_matrix,
    distances,
    in_contact,
    outside,
)
from murmurate.geometry._batch_last.hull import hull_neighbors, hull_shares, on_hull
from murmurate.geometry._batch_last.loops import other_robots, sum_over_third_robots, sum_terms
from murmurate.geometry._batch_last.obstacles import (
    distances_between_walls,
    distances_to_walls,
    nearest_points,
    obstacle_approach,
    obstacle_clearances,
    occluded_by_obstacles,
)
from murmurate.geometry._batch_last.visibility import (
    as_floating,
    fold,
    neighbors,
    neighbors_and_visible,
    occluded,
    sole_occluder_counts,
    stands_between,
    visible,
)

__all__ = [
    "any_contact",
    "any_outside",
    "as_floating",
    "clearances",
    "closest_approach",
    "contact_matrix",
    "distances",
    "distances_between_walls",
    "distances_to_walls",
    "fold",
    "hull_neighbors",
    "hull_shares",
    "in_contact",
    "nearest_points",
    "neighbors",
    "neighbors_and_visible",
    "obstacle_approach",
    "obstacle_clearances",
    "occluded",
    "occluded_by_obstacles",
    "on_hull",
    "other_robots",
    "outside",
    "sole_occluder_counts",
    "stands_between",
    "sum_over_third_robots",
    "sum_terms",
    "visible",
]
