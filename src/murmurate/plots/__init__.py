"""Figures and animations of recorded runs, patterns and the model. Needs NumPy and Matplotlib; does not need JAX.

Example:
    >>> from murmurate import plots  # doctest: +SKIP
    >>> record = plots.Record.open("runs/C")  # doctest: +SKIP
    >>> plots.save(plots.discovery_figure(record), "runs/C/figures/discovery.png")  # doctest: +SKIP
    >>> plots.animate(record, "runs/C/figures/discovery.gif")  # doctest: +SKIP
"""

from murmurate.plots.animation import animate
from murmurate.plots.comparison import comparison_figure, failures_figure
from murmurate.plots.drawing import Drawing, draw_configuration
from murmurate.plots.figures import discovery_figure, patterns_figure
from murmurate.plots.files import save
from murmurate.plots.growth import Growth, PaperPoint, growth_figure
from murmurate.plots.model import robot_figure, visibility_figure
from murmurate.plots.plate import PlatePattern, plate_figure
from murmurate.plots.record import Episode, Record, Sizes, Training
from murmurate.plots.report import formation_figure, reward_figure, training_figure

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
