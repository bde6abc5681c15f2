"""Catalogues: the valid patterns of any number of runs, sorted into classes of the same pattern.

Findings are sorted, best first. Each joins the class of the nearest leader within the tolerance or, where there is
none, leads a class of its own. So the leader, which represents the class, has the greatest value. Classes depend on the
findings alone, not on their order; to merge catalogues, make one of all their findings.

Values of different objectives are not comparable: findings for C1 come before those for C2.
"""

from __future__ import annotations

import bisect
import dataclasses
import math
import operator
from collections import Counter
from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from murmurate.analysis.measures import elongation, nearest_distances, visibility_margin
from murmurate.analysis.symmetry import SYMMETRY_TOLERANCE, Symmetry, symmetry
from murmurate.errors import MAX_INTEGER, MAX_MAGNITUDE, InputError, check_all, check_choice, check_number, check_type
from murmurate.geometry.hull import convex_layers
from murmurate.geometry.similarity import (
    configuration,
    distance,
    lower_bound,
    neighborhood_bound,
    neighborhoods,
    profile,
)
from murmurate.representation import short_repr

__all__ = ["TOLERANCE", "Catalogue", "Cell", "Finding", "PatternClass", "unmatched"]

TOLERANCE = 0.125
"""Default tolerance, in root mean square radii, chosen by measurement.

Patterns of eight and ten robots, relaxed from random starts until nothing moves, are either the same to 0.015 or, but
for 12 of 21,000 pairs, more than 0.125 apart (the 12 have a single robot elsewhere). Learned patterns of eight and ten
robots agree to 0.03 (experiments B, C, E and F). Six small robots have room to drift: in A patterns of one kind differ
by up to 0.12, and the next kind is 0.15 away; in D all distances up to 0.5 occur, fewest from 0.125 to 0.175. The eye
agrees: when two patterns of six are superposed, all discs overlap or touch up to a distance of about 0.12, and at 0.15
one robot is clearly at another place.
"""

ELONGATIONS, MARGINS = (0.1, 0.25, 0.5), (0.02, 0.1, 0.5)
"""Where the ranges of a map's cells end. Tight patterns have margins near 0, below the first end."""

FORMAT = 1
ROUNDING = 1e-12
"""By how much rounding may lift a lower bound above the distance, of the size of the patterns."""

_LENGTH, _VALUE = (1 / MAX_MAGNITUDE, MAX_MAGNITUDE), (-MAX_MAGNITUDE, MAX_MAGNITUDE)
_NUMBERS = {"radius": _LENGTH, "safe_distance": _LENGTH, "scan_radius": _LENGTH, "value": _VALUE, "gap": _VALUE}
_INTEGERS = {"seed": 2**32 - 1, "episode": MAX_INTEGER}
_TEXTS = ("experiment", "policy", "start", "run")
_OPTIONS = ("tolerance", "symmetry_tolerance", "scaling", "reflection")

HEADER = (
    *("name", "count", "symmetry", "residual", "layers", "objective", "value", "gap", "spread", "margin"),
    *("nearest_min", "nearest_mean", "nearest_max", "elongation", "starts", "seeds"),
)

MAP_HEADER = ("hull", "symmetry", "elongation", "margin", "patterns", "best", "objective", "value", "gap")


class Cell(NamedTuple):
    """A cell of the map of a catalogue: what the patterns in it have in common.

    Attributes:
        hull: Robots on the convex hull.
        symmetry: Order of the symmetry group: rotations, twice as many with reflections.
        elongation: Least elongation of the cell; the next one begins at the next of `ELONGATIONS`.
        margin: Least visibility margin, in radii, likewise; the first cell, of 0, also has what is below.
    """

    hull: int
    symmetry: int
    elongation: float
    margin: float

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Finding:
    """One valid pattern and its origin.

    It has no `WorldConfig`: a catalogue records three sizes of the world, and neither its sides nor the speed limit.

    Attributes:
        positions: Centres of the robots at rest, world units.
        radius: The paper's R_bot, world units.
        safe_distance: The paper's delta_s, world units.
        scan_radius: The paper's R_scan, world units.
        objective: C1, C2, or custom for any other.
        value: The objective that was reached, with the signals' own weights (the paper's are all 1).
        gap: Difference of the best known value to it; None where no value is known.
        experiment: The experiment that found it.
        policy: The name of its policy.
        start: The name of its start.
        seed: Its seed.
        run: Identifies the run, such as a checksum.
        episode: The episode of the run that ended in it.
    """

    positions: Float[np.ndarray, "robots 2"]
    radius: float
    safe_distance: float
    scan_radius: float
    objective: str
    value: float
    gap: float | None
    experiment: str
    policy: str
    start: str
    seed: int
    run: str
    episode: int

    __repr__ = short_repr

    def __post_init__(self) -> None:
        points = configuration(self.positions) + 0.0  # without -0.0, which would be written in another way
        if len(points) < 2 or np.abs(points).max() > MAX_MAGNITUDE:
            raise InputError("positions", points.shape, f"of two or more robots, each number within {MAX_MAGNITUDE:g}")
        points.flags.writeable = False
        object.__setattr__(self, "positions", points)
        check_choice("objective", self.objective, ("C1", "C2", "custom"))
        for name, (low, high) in _NUMBERS.items():
            number = getattr(self, name)
            if name == "gap" and number is None:
                continue
            check_number(name, number, low, high)
            object.__setattr__(self, name, float(number) + 0.0)
        for name, high in _INTEGERS.items():
            check_number(name, getattr(self, name), 0, high, integer=True)
            object.__setattr__(self, name, int(getattr(self, name)))
        for name in _TEXTS:
            text = getattr(self, name)
            if not isinstance(text, str) or not text or not text.isprintable():
                raise InputError(name, text, "a line of text")

    def to_dict(self) -> dict[str, Any]:
        """Returns the finding as a dictionary for JSON, without loss."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return values | {"positions": self.positions.tolist()}

    @classmethod
    def from_dict(cls, data: Any, where: str = "finding") -> Finding:
        """Reads what `to_dict` wrote.

        Raises:
            InputError: A field is missing, unknown or not allowed.
        """
        _check_fields(data, {field.name for field in dataclasses.fields(cls)}, where)
        try:
            return cls(**{**data, "positions": configuration(data["positions"])})
        except InputError as error:
            raise InputError(f"{where}.{error.field}", error.value, error.allowed) from None

    @property
    def source(self) -> str:
        """The experiment, the policy and the seed."""
        return f"{self.experiment} {self.policy} {self.seed}"


@dataclass(frozen=True, eq=False)
class PatternClass:
    """Findings that are the same pattern. Symmetry and measures are those of the representative.

    Attributes:
        name: P1 for the class of greatest value, then P2 and so on.
        members: The findings, best first.
        spread: Greatest distance of a member from the representative.
        symmetry: Symmetry of the representative.
        layers: Robots on its convex hull, on the hull of those inside, and so on.
        nearest: Each robot's distance to the nearest other one, world units.
        margin: Least gap between a disc and a shadow, in radii.
        elongation: How much longer than wide it is, from 0 to 1: 1 - width / length.
    """

    name: str
    members: tuple[Finding, ...]
    spread: float
    symmetry: Symmetry
    layers: tuple[int, ...]
    nearest: Float[np.ndarray, " robots"]
    margin: float
    elongation: float

    __repr__ = short_repr

    @property
    def representative(self) -> Finding:
        """The member of greatest value."""
        return self.members[0]

    @property
    def cell(self) -> Cell:
        """The cell of the map that it is in."""
        return Cell(
            hull=self.layers[0],
            symmetry=self.symmetry.rotations * (2 if self.symmetry.mirrored else 1),
            elongation=(0.0, *ELONGATIONS)[bisect.bisect_right(ELONGATIONS, self.elongation)],
            margin=(0.0, *MARGINS)[bisect.bisect_right(MARGINS, self.margin)],
        )

    @property
    def count(self) -> int:
        """Number of findings."""
        return len(self.members)

    @property
    def value(self) -> float:
        """The objective of the representative."""
        return self.representative.value

    @property
    def gap(self) -> float | None:
        """Difference of the best known value to the representative's; None where no value is known."""
        return self.representative.gap

    @property
    def starts(self) -> dict[str, int]:
        """Number of findings by start."""
        return _counts(member.start for member in self.members)

    @property
    def seeds(self) -> dict[str, int]:
        """Number of findings by experiment, policy and seed."""
        return _counts(member.source for member in self.members)


@dataclass(frozen=True, eq=False)
class Catalogue:
    """Findings and their classes; made by `from_findings` and `from_dict`.

    Attributes:
        findings: All findings, best first.
        classes: Their classes, best first.
        tolerance: Greatest distance of a member from the representative of its class.
        symmetry_tolerance: Greatest residual of a symmetry, in root mean square radii.
        scaling: Ignore size: distances are then in root mean square radii, otherwise in world units.
        reflection: Count mirror images as the same pattern.
    """

    findings: tuple[Finding, ...]
    classes: tuple[PatternClass, ...]
    tolerance: float
    symmetry_tolerance: float
    scaling: bool
    reflection: bool

    __repr__ = short_repr

    @classmethod
    def from_findings(
        cls,
        findings: Iterable[Finding],
        *,
        tolerance: float | None = None,
        symmetry_tolerance: float = SYMMETRY_TOLERANCE,
        scaling: bool = True,
        reflection: bool = True,
    ) -> Catalogue:
        """Sorts findings into classes; a finding that occurs twice counts once.

        Args:
            findings: The findings, in any order.
            tolerance: Greatest distance of a member from the representative of its class; by default `TOLERANCE`, which
                is for `scaling`.
            symmetry_tolerance: Greatest residual of a symmetry, in root mean square radii.
            scaling: Ignore size: distances are then in root mean square radii, otherwise in world units.
            reflection: Count mirror images as the same pattern.

        Raises:
            InputError: There are no findings, they are not comparable, or a tolerance is not positive.
        """
        if tolerance is None:
            if not scaling:
                raise InputError("tolerance", None, "given, in world units, where patterns are not scaled")
            tolerance = TOLERANCE
        check_number("tolerance", tolerance, 0, MAX_MAGNITUDE, exclusive_low=True)
        check_number("symmetry_tolerance", symmetry_tolerance, 0, MAX_MAGNITUDE, exclusive_low=True)
        findings = list(findings) if isinstance(findings, Iterable) else findings
        check_all("findings", findings, Finding, "findings, such as runs.catalogues.read_findings(folder)")
        unique = _unique(findings)
        _check_comparable(unique, scaling)
        classes = tuple(
            _describe(f"P{number}", group, symmetry_tolerance)
            for number, group in enumerate(_group(unique, tolerance, scaling, reflection), start=1)
        )
        return cls(tuple(unique), classes, float(tolerance), float(symmetry_tolerance), scaling, reflection)

    def to_dict(self) -> dict[str, Any]:
        """Returns the findings and options as a dictionary for JSON; the classes follow from them."""
        options = {name: getattr(self, name) for name in _OPTIONS}
        return {"format": FORMAT} | options | {"findings": [finding.to_dict() for finding in self.findings]}

    @classmethod
    def from_dict(cls, data: Any) -> Catalogue:
        """Reads what `to_dict` wrote.

        Raises:
            InputError: A field is missing, unknown or not allowed.
        """
        _check_fields(data, {"format", *_OPTIONS, "findings"}, "catalogue")
        if data["format"] != FORMAT:
            raise InputError("format", data["format"], f"{FORMAT}, which this version of murmurate reads")
        for name in ("scaling", "reflection"):
            if not isinstance(data[name], bool):
                raise InputError(name, data[name], "true or false")
        if not isinstance(data["findings"], list):
            raise InputError("findings", type(data["findings"]).__name__, "a list")
        findings = [Finding.from_dict(item, f"findings[{index}]") for index, item in enumerate(data["findings"])]
        return cls.from_findings(findings, **{name: data[name] for name in _OPTIONS})

    def rows(self) -> list[tuple[Any, ...]]:
        """Returns the rows of a CSV file: the header, then one row for each class."""
        return [HEADER, *map(_row, self.classes)]

    def cells(self) -> dict[Cell, tuple[PatternClass, ...]]:
        """Returns the map: the classes in each cell, best first, by the cell."""
        cells: dict[Cell, list[PatternClass]] = {}
        for pattern in self.classes:
            cells.setdefault(pattern.cell, []).append(pattern)
        return {cell: tuple(cells[cell]) for cell in sorted(cells)}

    def map_rows(self) -> list[tuple[Any, ...]]:
        """Returns the rows of a CSV file: the header, then one row for each cell of the map, with its best class."""
        rows = [
            (*cell, len(patterns), best.name, best.representative.objective, best.value, best.gap)
            for cell, patterns in self.cells().items()
            for best in patterns[:1]
        ]
        return [MAP_HEADER, *rows]


def unmatched(
    catalogue: Catalogue, configurations: Iterable[Float[np.ndarray, "robots 2"]]
) -> tuple[PatternClass, ...]:
    """Returns the classes whose representative is the same pattern as none of the given configurations.

    They are compared as the catalogue compares its findings: by its tolerance, with or without scaling and reflection.

    Args:
        catalogue: The catalogue.
        configurations: Configurations from elsewhere, such as an annealer, world units.

    Returns:
        The classes that have no match, best first.
    """
    check_type("catalogue", catalogue, Catalogue, "a catalogue")
    check_type("configurations", configurations, Iterable, "configurations, each (robots, 2)")
    others, scaling, limit = list(map(configuration, configurations)), catalogue.scaling, catalogue.tolerance

    def matched(pattern: PatternClass) -> bool:
        positions = pattern.representative.positions
        # The cheap lower bound rules most of them out; the most promising are compared first.
        bounds = sorted((lower_bound(positions, other, scaling=scaling), index) for index, other in enumerate(others))
        return any(
            distance(positions, others[index], scaling=scaling, reflection=catalogue.reflection, limit=limit) <= limit
            for bound, index in bounds
            if bound <= limit
        )

    return tuple(pattern for pattern in catalogue.classes if not matched(pattern))


def _unique(findings: Iterable[Finding]) -> list[Finding]:
    """Returns findings, best first, without repetitions of the same episode of the same run."""
    unique: dict[tuple[Any, ...], Finding] = {}
    for rank, finding in sorted(((_rank(finding), finding) for finding in findings), key=operator.itemgetter(0)):
        unique.setdefault(rank[2:5], finding)
    return list(unique.values())


def _rank(finding: Finding) -> tuple[Any, ...]:
    """Returns the key by which findings are sorted: all fields, so that the order is always the same."""
    gap = math.inf if finding.gap is None else finding.gap
    identity = (finding.run, finding.episode, tuple(map(tuple, finding.positions.tolist())))
    numbers = (finding.seed, gap, finding.radius, finding.safe_distance, finding.scan_radius)
    return (finding.objective, -finding.value, *identity, finding.experiment, finding.policy, finding.start, *numbers)


def _check_comparable(findings: Iterable[Finding], scaling: bool) -> None:
    robots = sorted({len(finding.positions) for finding in findings})
    radii = sorted({finding.radius for finding in findings})
    if not robots:
        raise InputError("findings", 0, "one or more")
    if len(robots) > 1:
        raise InputError("robots", robots, "the same number in all findings")
    if len(radii) > 1 and not scaling:
        raise InputError("radius", radii, "the same in all findings, where patterns are not scaled")


def _group(
    findings: list[Finding], tolerance: float, scaling: bool, reflection: bool
) -> list[list[tuple[Finding, float]]]:
    """Sorts findings, best first, into classes: lists of members and their distances from the first."""
    profiles = np.array([profile(finding.positions, scaling=scaling) for finding in findings])
    around = [neighborhoods(finding.positions, scaling=scaling) for finding in findings]
    rounding = ROUNDING * max(1.0, float(profiles.max()))
    leaders: list[int] = []
    groups: list[list[tuple[Finding, float]]] = []
    for index, finding in enumerate(findings):
        bounds = np.sqrt(np.mean((profiles[leaders] - profiles[index]) ** 2, axis=1))
        joined, nearest = None, tolerance
        for number in np.argsort(bounds, kind="stable"):
            if bounds[number] > nearest + rounding:
                break
            # Most of those that the first bound leaves are ruled out by the second, at a tenth of the time.
            if neighborhood_bound(around[leaders[number]], around[index]) > nearest + rounding:
                continue
            leader = findings[leaders[number]].positions
            apart = distance(leader, finding.positions, scaling=scaling, reflection=reflection, limit=nearest)
            if apart <= nearest:
                joined, nearest = int(number), apart
        if joined is None:
            leaders.append(index)
            groups.append([(finding, 0.0)])
        else:
            groups[joined].append((finding, nearest))
    return groups


def _describe(name: str, group: list[tuple[Finding, float]], tolerance: float) -> PatternClass:
    members, distances = zip(*group, strict=True)
    best = members[0]
    return PatternClass(
        name=name,
        members=members,
        spread=max(distances),
        symmetry=symmetry(best.positions, tolerance),
        layers=convex_layers(best.positions),
        nearest=nearest_distances(best.positions),
        margin=visibility_margin(best.positions, best.radius),
        elongation=elongation(best.positions),
    )


def _counts(labels: Iterable[str]) -> dict[str, int]:
    return dict(sorted(Counter(labels).items()))


def _row(pattern: PatternClass) -> tuple[Any, ...]:
    nearest = pattern.nearest
    return (
        pattern.name,
        pattern.count,
        pattern.symmetry.name,
        pattern.symmetry.residual,
        "+".join(map(str, pattern.layers)),
        pattern.representative.objective,
        pattern.value,
        pattern.gap,
        pattern.spread,
        pattern.margin,
        *(float(nearest.min()), float(nearest.mean()), float(nearest.max()), pattern.elongation),
        *(
            "; ".join(f"{label}: {count}" for label, count in counts.items())
            for counts in (pattern.starts, pattern.seeds)
        ),
    )


def _check_fields(data: Any, names: Set[str], where: str) -> None:
    """Checks that data is a dictionary with exactly these fields."""
    if not isinstance(data, Mapping):
        raise InputError(where, type(data).__name__, f"an object with the fields {', '.join(sorted(names))}")
    for name in sorted(names - data.keys()):
        raise InputError(f"{where}.{name}", None, "given")
    for name in sorted(data.keys() - names, key=str):
        raise InputError(f"{where}.{name}", data[name], f"one of the fields {', '.join(sorted(names))}")
