"""The figures of the model: what they call occluded is what the kernels call occluded."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection
from matplotlib.colors import to_rgb
from matplotlib.patches import Circle, Polygon

from murmurate import geometry, plots
from murmurate.plots.model import _RADIUS, _SCAN, _SCENES, _SWARM
from murmurate.plots.style import WARNING
from oracles import visibility as oracle


def robots(ax):
    (discs,) = (artist for artist in ax.collections if isinstance(artist, EllipseCollection))
    return discs


def test_the_four_scenes_are_what_they_are_called():
    figure = plots.visibility_figure()
    titles = [ax.texts[-2].get_text() for ax in figure.axes]
    assert titles == ["(a)  Occluded", "(b)  Visible", "(c)  Visible one way only", "(d)  Mutually visible"]


@pytest.mark.parametrize("index", range(4))
def test_the_outlined_are_occluded_and_shadows_are_the_kernels(index):
    ax, scene = plots.visibility_figure().axes[index], _SCENES[index]
    centers = np.asarray(robots(ax).get_offsets())
    np.testing.assert_array_equal(centers, [(0, 0), scene.occluder, scene.observed])
    directions = ((0, 2), (2, 0))[: scene.lights]
    clearance = oracle.shadow_clearance(centers, _RADIUS)
    edges = robots(ax).get_edgecolor()
    outlined = {robot for robot, edge in enumerate(edges) if edge[3] and tuple(edge[:3]) == to_rgb(WARNING)}
    assert outlined == {observed for light, observed in directions if clearance[light, observed] < 0}
    shadows = [patch.get_xy() for patch in ax.patches if isinstance(patch, Polygon)]
    assert len(shadows) == scene.lights
    for (light, _), corners in zip(directions, shadows, strict=True):
        expected = geometry.shadow(centers[light], centers[1], _RADIUS, reach=30.0)
        np.testing.assert_array_equal(corners[:4], expected)


def test_the_limit_is_a_limit():
    scene = _SCENES[1]
    positions = np.array([(0, 0), scene.occluder, scene.observed])
    assert not geometry.occluded(positions, _RADIUS)[0, 2]
    positions[2, 1] -= 1e-6
    assert geometry.occluded(positions, _RADIUS)[0, 2]


def test_the_robot_and_its_neighbours_to_scale():
    figure = plots.robot_figure()
    discs = robots(figure.axes[0])
    np.testing.assert_array_equal(discs.get_offsets(), _SWARM)
    np.testing.assert_array_equal(discs.get_widths(), 2 * _RADIUS)
    assert max(patch.radius for patch in figure.axes[0].patches if isinstance(patch, Circle)) == _SCAN
    shades = discs.get_facecolor()[1:]
    near = geometry.neighbors(_SWARM, _SCAN)[0, 1:]
    assert [(shade == shades[0]).all() for shade in shades] == near.tolist()
    arguments = [text.get_text() for text in figure.texts]
    assert f"number of its neighbours, here {near.sum()}" in arguments
    assert {"$P_n$", "$V_n$", "$R_{bot}$", "$R_{scan}$", r"$\delta_s$"} <= set(arguments)


@pytest.mark.parametrize(("draw", "count"), [(plots.robot_figure, 24), (plots.visibility_figure, 22)])
def test_labels_within_the_page_and_apart(check_labels, draw, count):
    assert check_labels(draw()) == count


def test_always_the_same(tmp_path):
    for name in ("one", "two"):
        plots.save(plots.visibility_figure(), tmp_path / f"{name}.png")
    first, second = ((tmp_path / f"{name}.png").read_bytes() for name in ("one", "two"))
    assert first == second
    assert len(first) < 150_000
