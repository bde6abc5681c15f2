"""The look of every figure: colours, the page, axes, and how a figure becomes a file.

A page is an opaque white card with a thin border, so that a figure reads the same on a light and on a dark screen.
The colours are Okabe and Ito's: readers of every colour vision tell them apart. Vermilion always means blocked sight.
"""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from murmurate.errors import InputError, check_number, check_path, check_type
from murmurate.runs import files

__all__ = [
    "COLORS",
    "FAINT",
    "FIELD",
    "HEAD",
    "INK",
    "INSIDE",
    "LEFT",
    "MUTED",
    "NEIGHBORS",
    "NIGHT_POLICIES",
    "POLICIES",
    "ROBOT",
    "SIGHT",
    "TEXT",
    "TITLE",
    "WARNING",
    "WIDTH",
    "add_axes",
    "add_legend",
    "draw_head",
    "new_page",
    "png",
    "policy_color",
    "quantize",
    "save",
    "separate_labels",
    "style_axes",
    "write_file",
]

INK = "#22303C"
MUTED = "#66727F"
FAINT = "#C5CDD6"
FIELD = "#F3F6F9"
ROBOT = "#44576B"
SIGHT = "#8A97A5"
WARNING = "#D55E00"
INSIDE = "#E69F00"
NEIGHBORS = "#B8860B"
POLICIES = ("#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
NIGHT_POLICIES = ("#56B4E9", "#3CCB9F", "#F0A8CE", "#F5C056", "#A5DBFA")
"""Colours of the policies of the list on white and, lighter, on a dark background."""
COLORS = (INK, MUTED, FAINT, ROBOT, SIGHT, WARNING, NEIGHBORS, *POLICIES)
"""Every colour that tells things apart: pictures keep them exactly, however little of one there is."""

WIDTH = 10.0
"""Width of a page, inches; where it is shown 1000 pixels wide, a point is 1.4 pixels."""

LEFT = 0.25
"""Margin at both sides, inches."""

TEXT, TITLE, HEAD = 8.5, 10.0, 13.0
"""Sizes of plain text, of the title of axes, and of the title of the page, points."""

_PACK = np.array([1 << 16, 1 << 8, 1])


def policy_color(index: int) -> str:
    """Returns the colour of a policy of the list: 0 is the base policy."""
    return POLICIES[index % len(POLICIES)]


# The page


def new_page(height: float) -> Figure:
    """Returns an empty page, `height` inches high."""
    return Figure(figsize=(WIDTH, height), facecolor="white", edgecolor=FAINT, linewidth=1.5)


def add_axes(figure: Figure, left: float, bottom: float, width: float, height: float, **options: Any) -> Axes:
    """Adds axes at a position given in inches."""
    page_width, page_height = figure.get_size_inches()
    position = (left / page_width, bottom / page_height, width / page_width, height / page_height)
    return figure.add_axes(position, **options)


def draw_head(figure: Figure, title: str, subtitle: str = "", remark: str = "") -> None:
    """Writes title and subtitle on one line at the top of the page, and a remark at its right end."""
    width, height = figure.get_size_inches()
    y = 1 - 0.32 / height
    plain: dict[str, Any] = {"fontsize": TITLE, "parse_math": False}
    name = figure.text(LEFT / width, y, title, fontsize=HEAD, fontweight="bold", color=INK, parse_math=False)
    x = name.get_window_extent().x1 / figure.bbox.width + 0.012
    figure.text(x, y, subtitle, color=MUTED, **plain)
    figure.text(1 - LEFT / width, y, remark, color=INK, ha="right", **plain)


def style_axes(ax: Axes, title: str, xlabel: str, ylabel: str, pad: float = 20) -> None:
    """Gives axes of curves their look: a title at the left, muted labels, a faint grid, no frame.

    Args:
        ax: The axes.
        title: What they show.
        xlabel: Label of the horizontal axis.
        ylabel: Label of the vertical axis.
        pad: Points between axes and title.
    """
    ax.set_title(title, loc="left", fontsize=TITLE, fontweight="bold", color=INK, pad=pad)
    ax.set_xlabel(xlabel, fontsize=TEXT, color=MUTED, labelpad=2)
    ax.set_ylabel(ylabel, fontsize=TEXT, color=MUTED, labelpad=3)
    ax.tick_params(labelsize=TEXT, colors=MUTED, length=3, width=0.7)
    ax.grid(axis="y", color=FAINT, linewidth=0.5, alpha=0.7)
    ax.set_axisbelow(True)
    for side, spine in ax.spines.items():
        spine.set(visible=side in ("left", "bottom"), color=FAINT, linewidth=0.8)


def add_legend(ax: Axes, handles: Sequence[Artist], **options: Any) -> None:
    """Adds a legend without a frame; `options` are those of Matplotlib's `legend`."""
    look: dict[str, Any] = {"fontsize": TEXT, "labelcolor": INK, "edgecolor": "none", "facecolor": "white"}
    space: dict[str, Any] = {"borderpad": 0.3, "handlelength": 2.0, "labelspacing": 0.4}
    ax.legend(handles=list(handles), **look | space | options)


def separate_labels(centers: Sequence[float], widths: Sequence[float], gap: float) -> list[float]:
    """Shifts labels along the line from 0 to 1 by as little as keeps them apart and, if they fit, within it.

    Args:
        centers: Where the labels should be, ascending.
        widths: Their widths.
        gap: Least distance between two of them.

    Returns:
        The centres to use.
    """
    lefts, edge = [], 0.0
    for center, width in zip(centers, widths, strict=True):
        lefts.append(max(edge, center - width / 2))
        edge = lefts[-1] + width + gap
    edge = 1.0
    for index in reversed(range(len(lefts))):
        lefts[index] = min(lefts[index], edge - widths[index])
        edge = lefts[index] - gap
    return [left + width / 2 for left, width in zip(lefts, widths, strict=True)]


# Files


def save(figure: Figure, path: str | os.PathLike[str], dpi: int = 180) -> None:
    """Writes a figure as a small PNG, whole or not at all; the same figure gives the same bytes.

    Args:
        figure: The figure.
        path: A name that ends in .png; its folder is made if it is missing.
        dpi: Pixels an inch.

    Raises:
        InputError: The name does not end in .png.
        RunError: The file cannot be written.
    """
    check_path("path", path)
    if Path(path).suffix.lower() != ".png":
        raise InputError("path", str(path), "a name that ends in .png")
    write_file(path, png(figure, dpi))


MAX_DPI = 2400


def write_file(path: str | os.PathLike[str], data: bytes) -> None:
    """Writes a file whole or not at all, in a folder that is made if it is missing.

    Raises:
        RunError: The file cannot be written.
    """
    files.make_folder(Path(path).parent)
    files.write_bytes(Path(path), data)


def png(figure: Figure, dpi: int = 180) -> bytes:
    """Returns a figure as a PNG of few colours; the same figure gives the same bytes."""
    check_type("figure", figure, Figure, "a figure, such as plots.discovery_figure(recording)")
    check_number("dpi", dpi, 1, MAX_DPI)
    full, small = io.BytesIO(), io.BytesIO()
    figure.savefig(full, format="png", dpi=dpi, metadata={"Software": None}, edgecolor=figure.get_edgecolor())
    picture = quantize(np.asarray(Image.open(full).convert("RGB")), levels=8, frequent=150)
    picture.save(small, format="PNG", optimize=True)
    return small.getvalue()


def quantize(
    pixels: UInt8[np.ndarray, "height width 3"],
    levels: int,
    frequent: int = 0,
    colors: Sequence[str] = COLORS,
    background: str = "white",
) -> Image.Image:
    """Reduces a picture to a palette: each pixel becomes the nearest colour, without dithering.

    Pillow's own choice of colours drops the hues of thin lines, and its search for the nearest colour is approximate.

    Args:
        pixels: The picture, RGB.
        levels: Number of steps in which each colour is blended with the background.
        frequent: How many of the picture's own most frequent colours to add.
        colors: The colours that were drawn with.
        background: The colour that they were drawn on.

    Returns:
        An image of mode "P"; its palette depends on the picture only where `frequent` is not 0.
    """
    values, inverse, counts = np.unique(pixels @ _PACK, return_inverse=True, return_counts=True)
    shares = np.linspace(0, 1, levels + 1)[:, None, None]
    drawn, empty = np.array([to_rgb(color) for color in colors]), np.array(to_rgb(background))
    blends = np.round(255 * (shares * drawn + (1 - shares) * empty)).astype(int) @ _PACK
    palette = np.unique(np.concatenate([blends.ravel(), values[np.argsort(-counts, kind="stable")][:frequent]]))
    # As floating-point numbers, which NumPy multiplies much faster: these are whole and far below 2^24, so exact.
    bits = np.array([16, 8, 0])
    candidates, wanted = (((packed[:, None] >> bits) & 255).astype(np.float32) for packed in (palette, values))
    # |a - b|^2 less |a|^2, which is the same for all candidates.
    nearest = ((candidates**2).sum(axis=1) - 2 * wanted @ candidates.T).argmin(axis=1)
    picture = Image.fromarray(nearest[inverse].reshape(pixels.shape[:2]).astype(np.uint8))
    picture.putpalette(candidates.astype(np.uint8).tobytes())
    return picture
