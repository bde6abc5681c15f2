"""The artist: robots to scale, every pair of neighbours joined, blocked sight marked, in motion as well."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from murmurate import plots
from murmurate.plots.style import WARNING
from murmurate.plots.swarm import NIGHT, draw_robots, path_segments, show_window, sight_pairs, window
from murmurate.world import WorldConfig

ROW = np.array([[0.0, 0.0], [6.0, 0.0], [12.0, 0.0], [40.0, 0.0]])
WORLD = WorldConfig(robots=4, radius=1.0, scan_radius=20.0, safe_distance=5.0)


def draw(positions, half=15.0, **options):
    figure = Figure((4, 4), dpi=100)
    ax = figure.add_axes((0, 0, 1, 1))
    show_window(ax, np.mean(positions, axis=0), half)
    return figure, ax, plots.SwarmArtist(ax, positions, WORLD, **options)


def test_a_sight_line_for_each_pair_of_neighbours():
    _, _, swarm = draw(ROW)
    assert len(swarm.clear.get_segments()) == 2  # the fourth robot is farther away than the scan radius
    (blocked,) = swarm.blocked.get_segments()
    np.testing.assert_array_equal(blocked, ROW[[0, 2]])
    np.testing.assert_allclose(swarm.blocked.get_colors()[0][:3], to_rgb(WARNING))
    clear, hidden = sight_pairs(ROW, WORLD)
    assert np.argwhere(clear).tolist() == [[0, 1], [1, 2]]
    assert np.argwhere(hidden).tolist() == [[0, 2]]


def test_the_occluded_are_outlined():
    _, _, swarm = draw(ROW)
    outlined = [tuple(color[:3]) == to_rgb(WARNING) and color[3] == 1 for color in swarm.discs.get_edgecolor()]
    assert outlined == [True, False, True, False]


def test_robots_have_their_radius_in_world_units():
    figure, ax, swarm = draw(np.array([[0.0, 0.0]]), half=2.0)
    np.testing.assert_array_equal(swarm.discs.get_widths(), 2.0)
    np.testing.assert_array_equal(swarm.shells.get_widths(), 5.0)
    canvas = FigureCanvasAgg(figure)
    for half in (2.0, 4.0):  # to scale when zoomed as well
        show_window(ax, np.zeros(2), half)
        swarm.shells.set_visible(False)
        canvas.draw()
        dark = (np.asarray(canvas.buffer_rgba())[..., :3].sum(axis=-1) < 450).sum()
        assert dark == pytest.approx(np.pi * (400 / (2 * half)) ** 2, rel=0.02)


def test_the_artist_moves():
    _, _, swarm = draw(ROW)
    bent = ROW + np.array([[0, 0], [0, 5], [0, 0], [-34, -5]])
    swarm.update(bent)
    assert len(swarm.clear.get_segments()) == 6
    assert swarm.blocked.get_segments() == []
    np.testing.assert_array_equal(swarm.discs.get_offsets(), bent)


def test_sight_lines_have_the_strength_that_is_asked_for():
    _, _, swarm = draw(ROW, look=NIGHT)
    strength = np.zeros((4, 4))
    strength[0, 1], strength[0, 3] = 0.5, 0.25
    swarm.update(ROW, strength)
    np.testing.assert_array_equal(swarm.clear.get_segments(), ROW[[[0, 1], [0, 3]]])
    np.testing.assert_allclose(swarm.clear.get_colors()[:, 3], NIGHT.clear[1] * np.array([0.5, 0.25]))


@pytest.mark.parametrize("gathering_point", [True, False])
def test_the_gathering_point_is_marked(gathering_point):
    _, ax, _ = draw(ROW, gathering_point=gathering_point)
    assert sum(line.get_marker() == "+" for line in ax.lines) == gathering_point


def test_what_can_be_left_out():
    _, _, swarm = draw(ROW, shells=False, clear=False, min_radius=3.0, colors=["red", "blue", "red", "blue"])
    assert swarm.clear.get_segments() == []
    assert not swarm.shells.get_visible()
    np.testing.assert_array_equal(swarm.discs.get_widths(), 6.0)
    assert [tuple(color[:3]) for color in swarm.discs.get_facecolor()] == [(1, 0, 0), (0, 0, 1)] * 2


def test_robots_of_any_colour():
    ax = Figure().add_subplot()
    discs = draw_robots(ax, ROW, 1.5, "white", ["red", "none", "none", "none"])
    np.testing.assert_array_equal(discs.get_widths(), 3.0)
    assert [color[3] for color in discs.get_edgecolor()] == [1, 0, 0, 0]


def test_paths_have_the_colour_of_the_policy_and_fade():
    positions = np.cumsum(np.ones((5, 2, 2)), axis=0)
    segments, colors = path_segments(positions, np.array([0, 0, 1, 1]))
    assert segments.shape == (8, 2, 2)
    np.testing.assert_array_equal(segments[:2, 0], positions[0])  # robots vary fastest
    assert [len(np.unique(colors[i : i + 4, :3], axis=0)) for i in (0, 4)] == [1, 1]
    assert (colors[0, :3] != colors[-1, :3]).any()
    assert (np.diff(colors[::2, 3]) > 0).all()
    empty, none = path_segments(positions[:1], np.array([], int))
    assert len(empty) == len(none) == 0


def test_a_window_holds_all_robots_with_its_margin():
    center, half = window(ROW, margin=2.0)
    np.testing.assert_array_equal(center, [20, 0])
    assert half == 22
