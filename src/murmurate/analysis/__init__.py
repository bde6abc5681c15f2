"""What was found: the patterns of many runs sorted into classes, their symmetry, and measures of each.

NumPy and SciPy only. `murmurate.geometry.similarity` says when two configurations are the same pattern.
"""

from murmurate.analysis.catalogue import TOLERANCE, Catalogue, Finding, PatternClass, unmatched
from murmurate.analysis.measures import nearest_distances, visibility_margin
from murmurate.analysis.symmetry import SYMMETRY_TOLERANCE, Symmetry, symmetry, upright

__all__ = [
    "SYMMETRY_TOLERANCE",
    "TOLERANCE",
    "Catalogue",
    "Finding",
    "PatternClass",
    "Symmetry",
    "nearest_distances",
    "symmetry",
    "unmatched",
    "upright",
    "visibility_margin",
]
