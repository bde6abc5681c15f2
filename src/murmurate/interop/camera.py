"""Frames of a swarm while it moves, as arrays of pixels or in a window. Matplotlib is loaded with the first frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, UInt8

from murmurate.errors import check_choice
from murmurate.interop.gathering import Gathering

if TYPE_CHECKING:
    from murmurate.plots import SwarmArtist

__all__ = ["FPS", "Camera"]

FPS = 20
"""Frames a second, as a viewer should show them."""

SIDE, DPI, MARGIN = 4.8, 100, 1.04
"""The longer side of a frame in inches, its pixels an inch, and the width of the view in widths of the world."""


class Camera:
    """Draws frames in the mode that the user chose."""

    def __init__(self, gathering: Gathering, mode: str | None, modes: Sequence[str]) -> None:
        """Prepares to draw.

        Args:
            gathering: What is drawn.
            mode: rgb_array or human; None: nothing will be drawn.
            modes: The modes that there are.

        Raises:
            InputError: There is no such mode.
        """
        if mode is not None:
            check_choice("render_mode", mode, modes)
        self._gathering = gathering
        self._in_window = mode == "human"
        self._figure: Any = None
        self._swarm: SwarmArtist | None = None

    def frame(self, positions: Float[np.ndarray, "robots 2"]) -> UInt8[np.ndarray, "height width 3"] | None:
        """Draws a configuration.

        Args:
            positions: Centres, world units.

        Returns:
            The pixels, or None where a window shows them. A window that the user has closed stays closed.
        """
        if self._swarm is None:
            self._swarm = self._open(positions)
        elif not self._is_closed():
            self._swarm.update(positions)
        canvas = self._figure.canvas
        if not self._in_window:
            canvas.draw()
            return np.array(canvas.buffer_rgba())[..., :3].copy()
        if not self._is_closed():
            canvas.draw()
            # Without a display there is no event loop, and nothing is shown.
            if canvas.required_interactive_framework:
                self._figure.show()
                canvas.start_event_loop(1 / FPS)
        return None

    def close(self) -> None:
        """Closes the window, if there is one; the next frame opens another."""
        if self._in_window and self._figure is not None:
            from matplotlib import pyplot

            pyplot.close(self._figure)
        self._figure = self._swarm = None

    def _open(self, positions: Float[np.ndarray, "robots 2"]) -> SwarmArtist:
        from murmurate.plots import SwarmArtist
        from murmurate.plots.swarm import draw_world

        world = self._gathering.config
        half = np.array([world.half_width, world.half_height])
        size = tuple(SIDE * half / half.max())
        if self._in_window:
            from matplotlib import pyplot  # only here: it chooses how windows are made

            self._figure = pyplot.figure(figsize=size, dpi=DPI)
        else:
            from matplotlib.backends.backend_agg import FigureCanvasAgg
            from matplotlib.figure import Figure

            self._figure = Figure(figsize=size, dpi=DPI)
            FigureCanvasAgg(self._figure)
        ax = self._figure.add_axes((0, 0, 1, 1))
        draw_world(ax, world, clip=False)
        swarm = SwarmArtist(ax, positions, world, gathering_point=self._gathering.objective == "C1")
        ax.set(xlim=MARGIN * half[0] * np.array([-1, 1]), ylim=MARGIN * half[1] * np.array([-1, 1]))
        ax.set_axis_off()
        return swarm

    def _is_closed(self) -> bool:
        if not self._in_window:
            return False
        from matplotlib import pyplot

        return not pyplot.fignum_exists(self._figure.number)
