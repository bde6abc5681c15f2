"""The paper's six experiments as data: settings (Table III), average steps (Table IV), and sizes.

The paper prints no sizes; these are those of the experiments that its authors published (see docs).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from murmurate.errors import InputError, suggestion
from murmurate.representation import short_repr

__all__ = ["ALLOWED", "EXPERIMENTS", "NOISE", "PaperExperiment", "check_experiment"]

NOISE = 2.0
"""Half-width of the uniform noise on every start coordinate, in robot radii."""


@dataclass(frozen=True)
class PaperExperiment:
    """One experiment of the paper.

    Attributes:
        name: A to F.
        robots: Swarm size.
        objective: C1 (gathering target: origin) or C2 (undefined).
        start: Initial states.
        half_side: X and Y; the world is a square.
        radius: R_bot.
        scan_radius: R_scan.
        safe_distance: delta_s.
        max_speed: Bound on each velocity component.
        base_steps: Average steps of the base policy.
        auxiliary_steps: Average steps of the auxiliary policy.
        total_steps: Average steps together, as printed.
    """

    name: str
    robots: int
    objective: Literal["C1", "C2"]
    start: Literal["scattered", "distributed", "packed"]
    half_side: float
    radius: float
    scan_radius: float
    safe_distance: float
    max_speed: float
    base_steps: float
    auxiliary_steps: float
    total_steps: float

    __repr__ = short_repr

    @property
    def summed_steps(self) -> float:
        """Base and auxiliary steps added up; in row E the printed total is another number."""
        return round(self.base_steps + self.auxiliary_steps, 2)


# Without a predefined point "a very large scan-radius" sees everybody: at least the diagonal of the world.
_ROWS = (
    PaperExperiment("A", 6, "C1", "packed", 35.0, 0.4, 105.0, 2.8, 0.4, 113.63, 4.01, 117.64),
    PaperExperiment("B", 8, "C1", "scattered", 40.0, 1.0, 20.0, 5.0, 1.0, 728.37, 18.22, 746.59),
    PaperExperiment("C", 10, "C1", "distributed", 45.0, 1.0, 20.0, 5.0, 1.0, 1730.20, 162.38, 1892.58),
    PaperExperiment("D", 6, "C2", "packed", 35.0, 0.4, 105.0, 2.8, 0.4, 269.88, 2.89, 272.77),
    PaperExperiment("E", 8, "C2", "scattered", 40.0, 1.0, 115.0, 5.0, 1.0, 521.71, 223.56, 1168.83),
    PaperExperiment("F", 10, "C2", "distributed", 45.0, 1.0, 130.0, 5.0, 1.0, 1550.26, 486.97, 2037.23),
)

EXPERIMENTS = {row.name: row for row in _ROWS}
"""The experiments by name."""


ALLOWED = f"{', '.join(EXPERIMENTS)}, or a TOML file"
"""What names an experiment, in words; help and errors say the same."""


def check_experiment(word: str) -> None:
    """Checks that a word names an experiment of the paper or an existing TOML file.

    Raises:
        InputError: It does neither.
    """
    if word in EXPERIMENTS:
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
    hint = suggestion(word.upper(), EXPERIMENTS)
    raise InputError("experiment", word, f"one of {ALLOWED}{hint}")
