"""The best-known patterns as a table: what is known, what is proved."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from murmurate.analysis import symmetry, visibility_margin
from murmurate.analysis.optimum.best_known import BestKnown
from murmurate.analysis.optimum.bounds import PROVED, upper_bound
from murmurate.geometry import convex_layers, smallest_ring
from murmurate.runs.table import NONE, Row

__all__ = ["OPTIMA", "rows"]

OPTIMA = ("N", "for", "R", "safe", "scan", "best known", "bound", "status", "ring", "symmetry", "layers", "margin")

EXACT = 1e-3
"""Best-known patterns are symmetric to rounding, or not at all."""


def rows(entries: Iterable[BestKnown]) -> Iterator[Row]:
    """Yields a row for each entry, under the header `OPTIMA`."""
    for entry in entries:
        target = entry.target
        circle = smallest_ring(entry.robots, entry.radius, entry.safe_distance).positions
        proved = (entry.objective, entry.robots) in PROVED
        yield (
            str(entry.robots),
            entry.objective,
            f"{entry.radius:g}",
            f"{entry.safe_distance:g}",
            f"{entry.scan_radius:g}",
            f"{entry.value:.6f}",
            f"{upper_bound(target):.6f}",
            "proved" if proved else "best known",
            f"{target.value(circle):.6f}" if target.is_valid(circle) else NONE,
            symmetry(entry.positions, EXACT).name,
            "+".join(map(str, convex_layers(entry.positions))),
            f"{visibility_margin(entry.positions, entry.radius):.2f} R",
        )
