"""The paper's six experiments as data: settings (Table III), average steps (Table IV), and sizes.

The paper prints no sizes; these are those of the experiments that its authors published (see docs).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from murmurate.errors import InputError, suggestion
from murmurate.representation import short_repr
from murmurate.runs.problems import PROBLEMS
from murmurate.world import WorldConfig

__all__ = ["ALLOWED", "EXPERIMENTS", "NOISE", "PaperExperiment", "check_experiment"]

NOISE = 2.0
"""Half-width of the uniform noise on every start coordinate, in robot radii."""


@dataclass(frozen=True)
class PaperExperiment:
    """One experiment of the paper.

    Attributes:
        name: A to F.
        objective: C1 (gathering target: origin) or C2 (undefined).
        start: Initial states.
        world: Sizes of the world, which is a square, and its robots.
        base_steps: Average steps of the base policy.
        auxiliary_steps: Average steps of the auxiliary policy.
        total_steps: Average steps together, as printed.
    """

    name: str
    objective: Literal["C1", "C2"]
    start: Literal["scattered", "distributed", "packed"]
    world: WorldConfig
    base_steps: float
    auxiliary_steps: float
    total_steps: float

    __repr__ = short_repr

    @property
    def summed_steps(self) -> float:
        """Base and auxiliary steps added up; in row E the printed total is another number."""
        return round(self.base_steps + self.auxiliary_steps, 2)

    def to_dict(self) -> dict[str, Any]:
        """Returns the experiment as a dictionary for JSON."""
        world = self.world
        return {
            "name": self.name,
            "robots": world.robots,
            "objective": self.objective,
            "start": self.start,
            "half_side": world.half_width,
            "radius": world.radius,
            "scan_radius": world.scan_radius,
            "safe_distance": world.safe_distance,
            "max_speed": world.max_speed,
            "base_steps": self.base_steps,
            "auxiliary_steps": self.auxiliary_steps,
            "total_steps": self.total_steps,
            "summed_steps": self.summed_steps,
        }


def _square(
    robots: int, half_side: float, radius: float, scan_radius: float, safe_distance: float, max_speed: float
) -> WorldConfig:
    return WorldConfig(
        robots=robots,
        half_width=half_side,
        half_height=half_side,
        radius=radius,
        scan_radius=scan_radius,
        safe_distance=safe_distance,
        max_speed=max_speed,
    )


# Without a predefined point "a very large scan-radius" sees everybody: at least the diagonal of the world.
_ROWS = (
    PaperExperiment("A", "C1", "packed", _square(6, 35.0, 0.4, 105.0, 2.8, 0.4), 113.63, 4.01, 117.64),
    PaperExperiment("B", "C1", "scattered", _square(8, 40.0, 1.0, 20.0, 5.0, 1.0), 728.37, 18.22, 746.59),
    PaperExperiment("C", "C1", "distributed", _square(10, 45.0, 1.0, 20.0, 5.0, 1.0), 1730.20, 162.38, 1892.58),
    PaperExperiment("D", "C2", "packed", _square(6, 35.0, 0.4, 105.0, 2.8, 0.4), 269.88, 2.89, 272.77),
    PaperExperiment("E", "C2", "scattered", _square(8, 40.0, 1.0, 115.0, 5.0, 1.0), 521.71, 223.56, 1168.83),
    PaperExperiment("F", "C2", "distributed", _square(10, 45.0, 1.0, 130.0, 5.0, 1.0), 1550.26, 486.97, 2037.23),
)

EXPERIMENTS = {row.name: row for row in _ROWS}
"""The experiments by name."""


ALLOWED = f"{', '.join((*EXPERIMENTS, *PROBLEMS))}, or a TOML file"
"""What names an experiment, in words; help and errors say the same."""


def check_experiment(word: str) -> None:
    """Checks that a word names an experiment of the paper, a problem of the package or an existing TOML file.

    Raises:
        InputError: It does neither.
    """
    if word in EXPERIMENTS or word in PROBLEMS:
        return
    is_file = Path(word).is_file()
    if word.endswith(".toml"):
        if is_file:
            return
        special = "it is a folder" if Path(word).is_dir() else "it is no regular file"
        reason = special if Path(word).exists() else "no such file"
        raise InputError("experiment", word, f"an existing TOML file: {reason}")
    if is_file:
        raise InputError("experiment", word, f"one of {ALLOWED}, whose name ends in .toml")
    hint = suggestion(word.upper(), EXPERIMENTS) or suggestion(word.lower(), PROBLEMS)
    raise InputError("experiment", word, f"one of {ALLOWED}{hint}")
