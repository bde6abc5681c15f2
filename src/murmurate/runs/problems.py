"""The problems that come with the package beside the paper's experiments: TOML files, written as a user would."""

from __future__ import annotations

from pathlib import Path

__all__ = ["PROBLEMS", "problem_file"]

FOLDER = Path(__file__).parent.parent / "problems"

PROBLEMS = {
    "circle": "on a circle of any radius, at equal angles",
    "convex": "all at corners of their convex hull",
    "surround": "around a point, at a distance from it",
}
"""What robots are to form, by the problem's name."""


def problem_file(name: str) -> Path:
    """Returns the TOML file of a problem."""
    return FOLDER / f"{name}.toml"
