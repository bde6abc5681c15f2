"""Pictures of a configuration while it moves: as an array of pixels, or in a window."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from murmurate.interop.camera import FPS
from murmurate.interop.gathering import Gathering
from murmurate.plots.drawing import Drawing, draw_configuration, draw_world
from murmurate.plots.record import Sizes

__all__ = ["Picture", "Window"]

SIDE, DPI, MARGIN = 4.8, 100, 1.04
"""The longer side of a frame in inches, its pixels an inch, and how much more than the world it shows."""


class Picture:
    """A figure without a window; it keeps away from whatever else the process draws with pyplot."""

    def __init__(self, gathering: Gathering) -> None:
        config = gathering.config
        size = np.array([config.half_width, config.half_height])
        self.figure = self._figure(tuple(SIDE * size / size.max()))
        ax = self.figure.add_axes((0, 0, 1, 1))
        self._drawing = _drawn(ax, gathering)
        ax.set(xlim=MARGIN * size[0] * np.array([-1, 1]), ylim=MARGIN * size[1] * np.array([-1, 1]))
        ax.set_axis_off()

    def _figure(self, size: Any) -> Figure:
        figure = Figure(figsize=size, dpi=DPI)
        FigureCanvasAgg(figure)
        return figure

    def show(self, positions: Float[np.ndarray, "robots 2"]) -> UInt8[np.ndarray, "height width 3"] | None:
        """Draws a configuration.

        Args:
            positions: Centres, world units.

        Returns:
            The pixels: red, green, blue.
        """
        self._drawing.update(positions)
        self.figure.canvas.draw()
        return np.array(self.figure.canvas.buffer_rgba())[..., :3].copy()  # pyright: ignore[reportAttributeAccessIssue]

    def close(self) -> None:
        """Lets go of the figure."""


class Window(Picture):
    """A figure in a window of pyplot's; without a display, pyplot has none to offer, and nothing is shown."""

    def _figure(self, size: Any) -> Figure:
        from matplotlib import pyplot  # only now, because it chooses how windows are made

        return pyplot.figure(figsize=size, dpi=DPI)

    def show(self, positions: Float[np.ndarray, "robots 2"]) -> None:
        """Draws a configuration and lets the window live for a frame, unless the user has closed it."""
        from matplotlib import pyplot

        if not pyplot.fignum_exists(self.figure.number):  # pyright: ignore[reportAttributeAccessIssue]
            return
        self._drawing.update(positions)
        canvas = self.figure.canvas
        canvas.draw()
        if canvas.required_interactive_framework:
            self.figure.show()
            canvas.start_event_loop(1 / FPS)

    def close(self) -> None:
        """Closes the window."""
        from matplotlib import pyplot

        pyplot.close(self.figure)


def _drawn(ax: Any, gathering: Gathering) -> Drawing:
    config = gathering.config
    names = ("robots", "half_width", "half_height", "radius", "scan_radius", "safe_distance")
    draw_world(ax, Sizes(**{name: getattr(config, name) for name in names}), whole=True)
    nobody = np.zeros((config.robots, 2))
    nobody[:, 0] = np.arange(config.robots) * 3 * config.radius  # anywhere: the first frame moves them
    sizes = (config.radius, config.scan_radius, config.safe_distance)
    return draw_configuration(ax, nobody, *sizes, gathering.objective)
