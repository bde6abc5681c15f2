"""Which patterns of a catalogue are none of those that something else found."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from murmurate.analysis.catalogue import Catalogue, PatternClass
from murmurate.geometry.similarity import distance, lower_bound

__all__ = ["unmatched"]


def unmatched(
    catalogue: Catalogue, configurations: Iterable[Float[np.ndarray, "robots 2"]]
) -> tuple[PatternClass, ...]:
    """Returns the classes whose representative is the same pattern as none of the given configurations.

    They are compared as the catalogue compares its findings: by its tolerance, with or without scaling and reflection.

    Args:
        catalogue: What runs found.
        configurations: What something else found, such as an annealer, world units.

    Returns:
        The classes that have no match, best first.
    """
    others, scaling, limit = list(configurations), catalogue.scaling, catalogue.tolerance

    def matched(pattern: PatternClass) -> bool:
        ours = pattern.representative.positions
        # Most are far apart, which the cheap bound tells; the nearest by it come first.
        near = sorted((lower_bound(ours, other, scaling=scaling), place) for place, other in enumerate(others))
        return any(
            distance(ours, others[place], scaling=scaling, reflection=catalogue.reflection, limit=limit) <= limit
            for bound, place in near
            if bound <= limit
        )

    return tuple(pattern for pattern in catalogue.classes if not matched(pattern))
