"""The figures of the model: what they call occluded is what the kernels call occluded."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.patches import Circle, Polygon

from murmurate import geometry, view
from murmurate.plots.model import _RADIUS, _SCAN, _SCENES, _SWARM
from murmurate.plots.palette import WARNING
from oracles import visibility as oracle


def robots(ax):
    return [found for found in ax.patches if isinstance(found, Circle)]


def test_the_four_scenes_are_what_they_are_called():
    figure = view.visibility_figure()
    titles = [ax.texts[-2].get_text() for ax in figure.axes]
    assert titles == ["(a)  Occluded", "(b)  Visible", "(c)  Visible one way only", "(d)  Mutually visible"]


@pytest.mark.parametrize("place", range(4))
def test_the_warned_are_occluded_and_shadows_are_the_oracles(place):
    ax, scene = view.visibility_figure().axes[place], _SCENES[place]
    centers = np.array([found.center for found in robots(ax)])
    np.testing.assert_array_equal(centers, [(0, 0), scene.occluder, scene.observed])
    ways = ((0, 2), (2, 0))[: scene.lights]
    clearance = oracle.shadow_clearance(centers, _RADIUS)
    warned = {place for place, found in enumerate(robots(ax)) if to_rgb(found.get_edgecolor()) == to_rgb(WARNING)}
    assert warned == {observed for light, observed in ways if clearance[light, observed] < 0}
    shadows = [found.get_xy() for found in ax.patches if isinstance(found, Polygon)]
    assert len(shadows) == scene.lights
    for (light, _), corners in zip(ways, shadows, strict=True):
        expected = geometry.shadow(centers[light], centers[1], _RADIUS, reach=30.0)
        np.testing.assert_array_equal(corners[:4], expected)


def test_the_limit_is_a_limit():
    scene = _SCENES[1]
    positions = np.array([(0, 0), scene.occluder, scene.observed])
    assert not geometry.occluded(positions, _RADIUS)[0, 2]
    positions[2, 1] -= 1e-6
    assert geometry.occluded(positions, _RADIUS)[0, 2]


def test_the_robot_and_its_neighbours_to_scale():
    figure = view.robot_figure()
    circles = robots(figure.axes[0])
    discs = [found for found in circles if found.radius == _RADIUS]
    np.testing.assert_array_equal([found.center for found in discs], _SWARM)
    assert max(found.radius for found in circles) == _SCAN
    shades = [found.get_facecolor() for found in discs[1:]]
    near = geometry.neighbors(_SWARM, _SCAN)[0, 1:]
    assert [shade == shades[0] for shade in shades] == near.tolist()
    words = [text.get_text() for text in figure.texts]
    assert f"number of its neighbours, here {near.sum()}" in words
    assert {"$P_n$", "$V_n$", "$R_{bot}$", "$R_{scan}$", r"$\delta_s$"} <= set(words)


@pytest.mark.parametrize(("draw", "count"), [(view.robot_figure, 24), (view.visibility_figure, 22)])
def test_labels_within_the_page_and_apart(check_labels, draw, count):
    assert check_labels(draw()) == count


def test_always_the_same(tmp_path):
    for name in ("one", "two"):
        view.save(view.visibility_figure(), tmp_path / f"{name}.png")
    one, two = ((tmp_path / f"{name}.png").read_bytes() for name in ("one", "two"))
    assert one == two
    assert len(one) < 150_000
