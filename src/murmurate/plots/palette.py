"""The colours of all pictures; and pictures of few colours that stay small without losing a faint line's hue.

Colours are Okabe and Ito's, told apart by readers of every colour vision. Vermilion warns: sight is
blocked.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import UInt8
from matplotlib.colors import to_rgb
from PIL import Image

__all__ = ["COLORS", "FAINT", "INK", "MUTED", "ROBOT", "SIGHT", "WARNING", "limited", "policy_color"]

INK = "#22303C"
MUTED = "#66727F"
FAINT = "#C5CDD6"
ROBOT = "#44576B"
SIGHT = "#8A97A5"
WARNING = "#D55E00"
_POLICIES = ("#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
COLORS = (INK, MUTED, FAINT, ROBOT, SIGHT, WARNING, *_POLICIES)
_PACK = np.array([1 << 16, 1 << 8, 1])


def policy_color(place: int) -> str:
    """Returns the colour of the policy at a place of the list: 0 for the base policy."""
    return _POLICIES[place % len(_POLICIES)]


def limited(pixels: UInt8[np.ndarray, "height width 3"], levels: int, frequent: int = 0) -> Image.Image:
    """Turns a picture into one of a palette: each pixel the nearest colour, exactly, without dithering.

    Pillow's own choice of colours forgets hues that only thin lines have, and its search for the nearest is rough.

    Args:
        pixels: The picture, RGB.
        levels: In how many steps each colour of the drawings is blended with white.
        frequent: How many of the picture's own most frequent colours to add.

    Returns:
        An image of mode "P"; the same palette for all pictures where `frequent` is 0.
    """
    values, places, counts = np.unique(pixels @ _PACK, return_inverse=True, return_counts=True)
    palette = np.unique(np.concatenate([_blends(levels), values[np.argsort(-counts, kind="stable")][:frequent]]))
    colors, wanted = ((packed[:, None] >> np.array([16, 8, 0])) & 255 for packed in (palette, values))
    # |a - b|^2 less |a|^2, which is the same for all candidates.
    nearest = ((colors**2).sum(axis=1) - 2 * wanted @ colors.T).argmin(axis=1)
    picture = Image.fromarray(nearest[places].reshape(pixels.shape[:2]).astype(np.uint8))
    picture.putpalette(colors.astype(np.uint8).tobytes())
    return picture


def _blends(levels: int) -> np.ndarray:
    shares = np.linspace(0, 1, levels + 1)[:, None, None]
    colors = 1 - shares * (1 - np.array([to_rgb(color) for color in COLORS]))
    return np.unique(np.round(255 * colors).astype(int) @ _PACK)
