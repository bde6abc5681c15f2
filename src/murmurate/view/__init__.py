"""Figures and animations of recorded runs. Reads run folders with NumPy and Matplotlib; does not need JAX.

Example:
    >>> from murmurate import view  # doctest: +SKIP
    >>> record = view.Record.open("runs/C")  # doctest: +SKIP
    >>> view.save(view.discovery_figure(record), "runs/C/figures/discovery.png")  # doctest: +SKIP
    >>> view.animate(record, "runs/C/figures/discovery.gif")  # doctest: +SKIP
"""

from murmurate.view.animation import animate
from murmurate.view.drawing import Drawing, draw_configuration
from murmurate.view.figures import discovery_figure, patterns_figure, save
from murmurate.view.record import Episode, Record, Sizes, Training

__all__ = [
    "Drawing",
    "Episode",
    "Record",
    "Sizes",
    "Training",
    "animate",
    "discovery_figure",
    "draw_configuration",
    "patterns_figure",
    "save",
]
