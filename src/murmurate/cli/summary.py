"""What `discover` and `evaluate` print and draw when they are done."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from murmurate.runs import presets, table
from murmurate.runs.evaluate import evaluated
from murmurate.runs.failures import describe_failures
from murmurate.runs.folder import RunFolder
from murmurate.runs.run import Run
from murmurate.terminal import say

__all__ = ["draw", "print_results"]


def print_results(run: Run, folder: RunFolder) -> None:
    """Prints the evaluation of a run beside the paper's, where it has one, what failed and why, and a new record.

    Args:
        run: The run.
        folder: The folder of its evaluation.
    """
    Console().print(table.as_rich(*table.comparison(evaluated(folder, trust=True), presets.paper_row(run.experiment))))
    for line in describe_failures(run.experiment, folder.trajectories(run.experiment)):
        say(line)
    if folder.record() is not None:
        say(f"A valid pattern beats the best known: {folder.record_file} is the new record.")


def draw(folder: RunFolder) -> Path:
    """Draws the figure of a run folder.

    Returns:
        The picture.

    Raises:
        RunError: The run is damaged, or the picture cannot be written.
    """
    from murmurate import plots

    path = folder.figures / "discovery.png"
    plots.save(plots.discovery_figure(plots.Recording.open(folder, trust=True)), path)
    return path
