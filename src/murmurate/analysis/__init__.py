"""Analysis of patterns: catalogues of the patterns of many runs, their symmetry and measures, and the best known.

It needs NumPy and SciPy only, except `optimum`, which anneals in JAX.
"""

from murmurate.analysis.catalogue import TOLERANCE, Catalogue, Cell, Finding, PatternClass, unmatched
from murmurate.analysis.measures import elongation, nearest_distances, visibility_margin
from murmurate.analysis.symmetry import SYMMETRY_TOLERANCE, Symmetry, symmetry, upright

__all__ = [
    "SYMMETRY_TOLERANCE",
    "TOLERANCE",
    "Catalogue",
    "Cell",
    "Finding",
    "PatternClass",
    "Symmetry",
    "elongation",
    "nearest_distances",
    "symmetry",
    "unmatched",
    "upright",
    "visibility_margin",
]
