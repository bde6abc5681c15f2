"""The plate of patterns: every robot the same size, every pattern in its field, in the order given."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgb

from murmurate import plots
from murmurate.errors import InputError
from murmurate.plots.palette import WARNING
from murmurate.plots.plate import _INSIDE, _centred, _inside, _well_shaped


def ring(robots, size):
    angles = 2 * np.pi * np.arange(robots) / robots
    return size * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def pattern(positions, radius=1.0, caption="C1 · 10 · 143 of 200", note="gap 0.012"):
    return plots.PlatePattern(positions, radius, 130.0, caption, note)


def circles(figure):
    """The fields, then each pattern's robots."""
    return [found for found in figure.axes[0].collections if isinstance(found, EllipseCollection)]


def test_all_robots_have_one_size_and_stand_in_their_fields():
    patterns = [pattern(ring(10, 8.5)), pattern(3.0 + ring(6, 2.0), radius=0.4), pattern(ring(4, 12.0))]
    figure = plots.plate_figure(patterns, "Patterns")
    fields, *robots = circles(figure)
    assert len({width for found in robots for width in found.get_widths()}) == 1
    scale = robots[0].get_widths()[0] / 2
    for place, (one, found) in enumerate(zip(patterns, robots, strict=True)):
        points, center = found.get_offsets(), fields.get_offsets()[place]
        apart = np.linalg.norm(points[1:] - points[0], axis=1) / scale
        np.testing.assert_allclose(
            apart, np.linalg.norm(one.positions[1:] - one.positions[0], axis=1) / one.radius, rtol=1e-9
        )
        assert (np.linalg.norm(points - center, axis=1) + scale <= fields.get_widths()[place] / 2).all()
        np.testing.assert_allclose(np.mean(points, axis=0), center, atol=0.01)


def test_a_field_for_each_pattern_in_the_order_given():
    figure = plots.plate_figure(
        [pattern(ring(5, 6.0), caption=str(place)) for place in range(7)], "Patterns", columns=3
    )
    centers = circles(figure)[0].get_offsets()
    assert len(circles(figure)) == 8
    captions = [text for text in figure.axes[0].texts if text.get_text().isdigit()]
    assert [text.get_text() for text in captions] == [str(place) for place in range(7)]
    np.testing.assert_allclose([text.get_position()[0] for text in captions], centers[:, 0])
    assert len(set(centers[:3, 1])) == 1
    assert centers[0, 1] > centers[3, 1] > centers[6, 1]
    assert centers[6, 0] == pytest.approx(5.0)  # alone in the last row, in its middle


def test_a_line_for_each_pair_and_a_warning_where_sight_is_blocked():
    row = np.array([[0.0, 0.0], [6.0, 0.0], [12.0, 0.0]])
    clear, blocked = (
        found
        for found in plots.plate_figure([pattern(row)], "").axes[0].collections
        if isinstance(found, LineCollection)
    )
    assert len(clear.get_segments()) == 2
    assert len(blocked.get_segments()) == 1
    np.testing.assert_allclose(blocked.get_colors()[0][:3], to_rgb(WARNING))


def test_robots_inside_the_hull_have_another_colour():
    positions = np.concatenate([ring(9, 9.0), [[0.5, 0.3]]])
    figure = plots.plate_figure([pattern(positions)], "")
    robots = circles(figure)[1]
    assert "orange" in figure.axes[0].texts[-1].get_text()
    inside = [tuple(color[:3]) == to_rgb(_INSIDE) for color in robots.get_facecolor()]
    assert inside == [False] * 9 + [True]


@pytest.mark.parametrize(
    ("positions", "inside"),
    [
        ([[0, 0]], [False]),
        ([[0, 0], [1, 0], [2, 0]], [False] * 3),
        ([[0, 0], [4, 0], [4, 4], [0, 4], [2, 0]], [False] * 5),  # on an edge
        ([[0, 0], [4, 0], [4, 4], [0, 4], [2, 0.1]], [False] * 4 + [True]),
    ],
)
def test_who_is_inside(positions, inside):
    np.testing.assert_array_equal(_inside(np.array(positions, float)), inside)


@given(st.integers(1, 12), st.integers(0, 100))
def test_patterns_are_centred_on_their_least_circle(robots, seed):
    points = np.random.default_rng(seed).normal(0, 5, (robots, 2))
    found = np.hypot(*_centred(pattern(points)).T).max()
    for shift in 0.1 * ring(8, 1.0):
        assert np.hypot(*(_centred(pattern(points)) - shift).T).max() > found


@pytest.mark.parametrize("count", range(1, 61))
def test_a_plate_of_any_number_is_well_shaped(count):
    columns = _well_shaped(count)
    rows = -(-count // columns)
    assert 1 <= columns <= min(8, count)
    assert count - (rows - 1) * columns >= columns / 3  # patterns in the last row


@pytest.mark.parametrize("count", [1, 2, 9, 60])
def test_captions_within_the_page_and_apart(check_labels, count):
    figure = plots.plate_figure([pattern(ring(6, 5.0))] * count, "Patterns of six robots", "the best first")
    assert check_labels(figure) == 2 * count + 3


def test_captions_are_no_formulas(tmp_path):
    figure = plots.plate_figure([pattern(ring(3, 5.0), caption="$C_{1", note="")], "$T_{", "$", columns=1)
    plots.save(figure, tmp_path / "plate.png")
    assert (tmp_path / "plate.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("patterns", "columns", "field"),
    [
        ([], None, "patterns"),
        ([pattern(ring(3, 5.0))], 0, "columns"),
        ([pattern(ring(3, 5.0))], 9, "columns"),
        ([pattern(ring(3, 5.0), radius=0.0)], None, "radius"),
        ([pattern(np.full((3, 2), np.nan))], None, "positions"),
        ([pattern(np.zeros((3, 3)))], None, "positions"),
        ([pattern(np.zeros((0, 2)))], None, "positions"),
    ],
)
def test_what_makes_no_plate(patterns, columns, field):
    with pytest.raises(InputError, match=f"^{field} = ") as caught:
        plots.plate_figure(patterns, "Patterns", columns=columns)
    assert "\n" not in str(caught.value)


def test_saved_small_and_always_the_same(tmp_path):
    for name in ("one", "two"):
        plate = plots.plate_figure([pattern(ring(10, 8.5)), pattern(ring(9, 9.0))], "Patterns")
        plots.save(plate, tmp_path / f"{name}.png")
    one, two = ((tmp_path / f"{name}.png").read_bytes() for name in ("one", "two"))
    assert one == two
    assert len(one) < 150_000
