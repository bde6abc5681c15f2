"""The page and its files: labels apart, pictures small, whole, of the nearest colours, and always the same."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from murmurate import plots
from murmurate.errors import InputError, RunError
from murmurate.plots import animation, model, run, studies, swarm
from murmurate.plots.style import COLORS, FAINT, INSIDE, POLICIES, WARNING, new_page, quantize, separate_labels


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


LEGENDS = {
    "signals": [color for color, _ in (*run._SIGNALS.values(), *run._OTHER_SIGNALS)],
    "starts": [color for color, _ in studies._STARTS.values()],
    "model": [*model._LIGHTS, INSIDE, WARNING],
    "policies": POLICIES,
    "sight": [swarm.LIGHT.clear[0], swarm.LIGHT.blocked[0], swarm.LIGHT.robot, swarm.LIGHT.shell],
}


def crowded(colors):
    """Returns a picture of thousands of colours, in which few pixels have those given."""
    pixels = np.random.default_rng(0).integers(0, 256, (200, 200, 3), dtype=np.uint8)
    common = np.random.default_rng(1).integers(0, 256, (150, 3), dtype=np.uint8)
    pixels[:100] = np.repeat(common, -(-20000 // 150), axis=0)[:20000].reshape(100, 200, 3)
    wanted = np.round(255 * np.array([to_rgb(color) for color in colors])).astype(int)
    pixels[-1, : len(wanted)] = wanted
    return pixels, wanted


@pytest.mark.parametrize("legend", LEGENDS)
def test_every_colour_of_a_legend_survives(legend):
    """Even that of a thin dotted line in a picture that is full of other colours."""
    pixels, wanted = crowded(LEGENDS[legend])
    result = np.asarray(quantize(pixels, levels=8, frequent=150).convert("RGB")).astype(int)[-1, : len(wanted)]
    assert np.abs(result - wanted).max() <= 2
    assert len(COLORS) * 8 + 1 + 150 <= 256


def test_every_policy_of_an_animation_has_its_colour(monkeypatch):
    night = swarm.NIGHT
    pixels, wanted = crowded([*night.policies, night.clear[0], night.blocked[0], night.robot])
    colors = []

    def recorded(picture, levels, **given):
        colors.append(given)
        return quantize(picture, levels, **given)

    monkeypatch.setattr(animation, "quantize", recorded)
    animation._gif(iter([pixels]), 10)
    result = np.asarray(quantize(pixels, 6, **colors[0]).convert("RGB")).astype(int)[-1, : len(wanted)]
    assert np.abs(result - wanted).max() <= 2
