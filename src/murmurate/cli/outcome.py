"""What `discover` and `evaluate` say and draw when they are done."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from murmurate.runs import table
from murmurate.runs.evaluate import RECORD
from murmurate.runs.paper import PaperExperiment

__all__ = ["PICTURE", "draw", "print_comparison", "print_record"]

PICTURE = Path("figures") / "discovery.png"


def print_comparison(summary: Mapping[str, Any], row: PaperExperiment | None) -> None:
    """Prints an evaluation, beside the paper's where it has one."""
    Console().print(table.as_rich(*table.comparison(summary, row)))


def print_record(folder: Path) -> None:
    """Says so where a run beat the best-known pattern."""
    if (folder / RECORD).is_file():
        print(f"A valid pattern beats the best known: {folder / RECORD} is the new record.")


def draw(folder: Path, episode: int | None = None) -> Path:
    """Draws the figure of a run folder.

    Returns:
        The picture.

    Raises:
        InputError: There is no such episode.
        RunError: The run is damaged, or the picture cannot be written.
    """
    from murmurate import plots

    path = folder / PICTURE
    plots.save(plots.discovery_figure(plots.Recording.open(folder), episode), path)
    return path
