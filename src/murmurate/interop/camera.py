"""What rendering is asked for, before anything is drawn: Matplotlib is loaded with the first frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8

from murmurate.errors import check_choice
from murmurate.interop.gathering import Gathering

if TYPE_CHECKING:
    from murmurate.interop.pictures import Picture

__all__ = ["FPS", "Camera"]

FPS = 20
"""Frames a second, as a viewer should show them."""


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
        self._mode = mode
        self._picture: Picture | None = None

    def frame(self, positions: Float[np.ndarray, "robots 2"]) -> UInt8[np.ndarray, "height width 3"] | None:
        """Draws a configuration, world units; returns its pixels, or None where a window shows them."""
        if self._picture is None:
            from murmurate.interop.pictures import Picture, Window

            self._picture = (Window if self._mode == "human" else Picture)(self._gathering)
        return self._picture.show(positions)

    def close(self) -> None:
        """Closes the window, if there is one; the next frame opens another."""
        if self._picture is not None:
            self._picture.close()
        self._picture = None
