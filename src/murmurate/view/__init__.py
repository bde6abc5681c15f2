"""Figures and animations of recorded runs, patterns and the model. Needs NumPy and Matplotlib; does not need JAX.

Example:
    >>> from murmurate import view  # doctest: +SKIP
    >>> record = view.Record.open("runs/C")  # doctest: +SKIP
    >>> view.save(view.discovery_figure(record), "runs/C/figures/discovery.png")  # doctest: +SKIP
    >>> view.animate(record, "runs/C/figures/discovery.gif")  # doctest: +SKIP
"""

from murmurate.view.animation import animate
from murmurate.view.comparison import comparison_figure, failures_figure
from murmurate.view.drawing import Drawing, draw_configuration
from murmurate.view.figures import discovery_figure, patterns_figure
from murmurate.view.files import save
from murmurate.view.growth import Growth, PaperPoint, growth_figure
from murmurate.view.model import robot_figure, visibility_figure
from murmurate.view.plate import PlatePattern, plate_figure
from murmurate.view.record import Episode, Record, Sizes, Training
from murmurate.view.report import formation_figure, reward_figure, training_figure

__all__ = [
    "Drawing",
    "Episode",
    "Growth",
    "PaperPoint",
    "PlatePattern",
    "Record",
    "Sizes",
    "Training",
    "animate",
    "comparison_figure",
    "discovery_figure",
    "draw_configuration",
    "failures_figure",
    "formation_figure",
    "growth_figure",
    "patterns_figure",
    "plate_figure",
    "reward_figure",
    "robot_figure",
    "save",
    "training_figure",
    "visibility_figure",
]
