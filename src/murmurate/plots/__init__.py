"""Figures and animations of runs, of studies of many runs, of patterns, and of the robot model.

Example:
    >>> from murmurate import plots  # doctest: +SKIP
    >>> recording = plots.Recording.open("runs/C")  # doctest: +SKIP
    >>> plots.save(plots.discovery_figure(recording), "runs/C/figures/discovery.png")  # doctest: +SKIP
    >>> plots.animate(recording, "runs/C/figures/discovery.gif")  # doctest: +SKIP
"""

from murmurate.plots.animation import animate
from murmurate.plots.model import robot_figure, visibility_figure
from murmurate.plots.plate import PlatePattern, plate_figure
from murmurate.plots.recording import Episode, Recording, TrainingCurve
from murmurate.plots.run import discovery_figure, formation_figure, reward_figure, training_figure
from murmurate.plots.studies import (
    Growth,
    PaperPoint,
    comparison_figure,
    failures_figure,
    growth_figure,
    patterns_figure,
)
from murmurate.plots.style import png, save
from murmurate.plots.swarm import LIGHT, NIGHT, Look, SwarmArtist

__all__ = [
    "LIGHT",
    "NIGHT",
    "Episode",
    "Growth",
    "Look",
    "PaperPoint",
    "PlatePattern",
    "Recording",
    "SwarmArtist",
    "TrainingCurve",
    "animate",
    "comparison_figure",
    "discovery_figure",
    "failures_figure",
    "formation_figure",
    "growth_figure",
    "patterns_figure",
    "plate_figure",
    "png",
    "reward_figure",
    "robot_figure",
    "save",
    "training_figure",
    "visibility_figure",
]
