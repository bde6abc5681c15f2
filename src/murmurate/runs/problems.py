"""The problems that come with the package beside the paper's experiments: TOML files, written as a user would."""

from __future__ import annotations

from pathlib import Path

__all__ = ["PROBLEMS", "problem_file"]

FOLDER = Path(__file__).parent.parent / "problems"

PROBLEMS = {
    "arrow": "a given pattern: an arrow of eight",
    "chain": "linked from one point to another",
    "circle": "on a circle of any radius, at equal angles",
    "convex": "all at corners of their convex hull",
    "groups": "two groups of equal size, apart from each other",
    "line": "on a straight line, at equal distances",
    "spread": "far from each other, all over the world",
    "surround": "around a point, at a distance from it",
    "visibility": "anywhere, but all see each other",
}
"""What robots are to form, by the problem's name."""


def problem_file(name: str) -> Path:
    """Returns the TOML file of a problem."""
    return FOLDER / f"{name}.toml"
