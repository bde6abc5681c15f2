"""The page and its files: labels apart, pictures small, whole, of the nearest colours, and always the same."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from murmurate import plots
from murmurate.errors import InputError, RunError
from murmurate.plots.style import FAINT, new_page, quantize, separate_labels


def test_labels_move_only_as_far_as_they_must():
    assert separate_labels([0.2, 0.8], [0.1, 0.1], gap=0.02) == pytest.approx([0.2, 0.8])
    assert separate_labels([0.5, 0.52], [0.1, 0.1], gap=0.02) == pytest.approx([0.5, 0.62])
    assert separate_labels([0.9, 0.98], [0.1, 0.1], gap=0.02) == pytest.approx([0.83, 0.95])


def test_a_page_is_an_opaque_card_with_a_border(tmp_path):
    plots.save(new_page(1.0), tmp_path / "page.png", dpi=100)
    with Image.open(tmp_path / "page.png") as picture:
        pixels = np.asarray(picture.convert("RGBA"))
    assert pixels.shape == (100, 1000, 4)
    assert (pixels[..., 3] == 255).all()
    assert (pixels[5:-5, 5:-5] == 255).all()
    for edge in (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]):
        np.testing.assert_allclose(edge[:, :3], np.full((len(edge), 3), 255 * np.array(to_rgb(FAINT))), atol=30)


def test_saving_fails_in_one_line_and_leaves_nothing(tmp_path):
    with pytest.raises(InputError, match=r"\.png"):
        plots.save(Figure(), tmp_path / "figure.jpeg")
    (tmp_path / "figure.png").mkdir()
    with pytest.raises(RunError, match="cannot write") as caught:
        plots.save(Figure(), tmp_path / "figure.png")
    assert "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["figure.png"]


def test_saving_makes_the_folder(tmp_path):
    plots.save(Figure((1, 1)), tmp_path / "new" / "figure.png")
    assert (tmp_path / "new" / "figure.png").read_bytes() == plots.png(Figure((1, 1)))


def test_colours_are_the_nearest():
    pixels = np.array([[[255, 255, 255], [213, 94, 0], [214, 95, 1], [1, 2, 3]]], np.uint8)
    exact = np.asarray(quantize(pixels, levels=6, frequent=4).convert("RGB"))
    np.testing.assert_array_equal(exact, pixels)
    few = np.asarray(quantize(pixels, levels=6).convert("RGB"))
    np.testing.assert_array_equal(few[0, :3], [[255, 255, 255], [213, 94, 0], [213, 94, 0]])
    dark = np.asarray(quantize(pixels, levels=1, colors=["white"], background="black").convert("RGB"))
    np.testing.assert_array_equal(dark[0, [0, 3]], [[255, 255, 255], [0, 0, 0]])
