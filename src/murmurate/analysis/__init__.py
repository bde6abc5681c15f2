"""What was found: the patterns of many runs sorted into classes, their symmetry, and measures of each.

NumPy and SciPy only. `murmurate.geometry.similarity` says when two configurations are the same pattern.
"""

from murmurate.analysis.catalogue import TOLERANCE, Catalogue, Finding, PatternClass, merge
from murmurate.analysis.measures import convex_layers, nearest_distances, on_hull, visibility_margin
from murmurate.analysis.novelty import unmatched
from murmurate.analysis.symmetry import SYMMETRY_TOLERANCE, Symmetry, symmetry, upright

__all__ = [
    "SYMMETRY_TOLERANCE",
    "TOLERANCE",
    "Catalogue",
    "Finding",
    "PatternClass",
    "Symmetry",
    "convex_layers",
    "merge",
    "nearest_distances",
    "on_hull",
    "symmetry",
    "unmatched",
    "upright",
    "visibility_margin",
]
