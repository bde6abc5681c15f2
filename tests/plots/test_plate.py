"""The plate of patterns: every robot the same size, every pattern in its field, in the order given."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgb
from matplotlib.patches import Circle

from murmurate import plots
from murmurate.errors import InputError
from murmurate.plots.plate import _best_columns
from murmurate.plots.style import INSIDE
from murmurate.plots.swarm import NIGHT


def ring(robots, size):
    angles = 2 * np.pi * np.arange(robots) / robots
    return size * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def pattern(positions, radius=1.0, caption="C1 · 10 · 143 of 200", note="gap 0.012"):
    return plots.PlatePattern(positions, radius, 130.0, caption, note)


def robots(ax):
    return [artist for artist in ax.collections if isinstance(artist, EllipseCollection)][-1]


def test_all_robots_have_one_size_and_lie_on_their_discs():
    patterns = [pattern(ring(10, 8.5)), pattern(3.0 + ring(6, 2.0), radius=0.4), pattern(ring(4, 12.0))]
    figure = plots.plate_figure(patterns, "Patterns")
    sizes = []
    for ax, shown in zip(figure.axes, patterns, strict=True):
        width = ax.get_window_extent().width / np.ptp(ax.get_xlim())
        sizes.append(robots(ax).get_widths()[0] * width)
        np.testing.assert_allclose(robots(ax).get_offsets(), shown.positions - np.mean(shown.positions, axis=0))
        (disc,) = (patch for patch in ax.patches if isinstance(patch, Circle))
        assert np.hypot(*robots(ax).get_offsets().T).max() + shown.radius <= disc.radius
    np.testing.assert_allclose(sizes, sizes[0])


def test_a_disc_for_each_pattern_in_the_order_given():
    patterns = [pattern(ring(5, 6.0), caption=str(index)) for index in range(7)]
    figure = plots.plate_figure(patterns, "Patterns", columns=3)
    boxes = [ax.get_position() for ax in figure.axes]
    captions = [text for text in figure.texts if text.get_text().isdigit()]
    assert [text.get_text() for text in captions] == [str(index) for index in range(7)]
    np.testing.assert_allclose([text.get_position()[0] for text in captions], [(b.x0 + b.x1) / 2 for b in boxes])
    assert len({round(box.y0, 9) for box in boxes[:3]}) == 1
    assert boxes[0].y0 > boxes[3].y0 > boxes[6].y0
    assert (boxes[6].x0 + boxes[6].x1) / 2 == pytest.approx(0.5)  # alone in the last row, in its middle


def test_a_line_for_each_pair_and_a_warning_where_sight_is_blocked():
    row = np.array([[0.0, 0.0], [6.0, 0.0], [12.0, 0.0]])
    figure = plots.plate_figure([pattern(row)], "")
    clear, blocked = (artist for artist in figure.axes[0].collections if isinstance(artist, LineCollection))
    assert len(clear.get_segments()) == 2
    assert len(blocked.get_segments()) == 1
    np.testing.assert_allclose(blocked.get_colors()[0][:3], to_rgb(NIGHT.blocked[0]))
    assert "sight is blocked" in figure.texts[-1].get_text()


def test_robots_inside_the_hull_have_another_colour():
    positions = np.concatenate([ring(9, 9.0), [[0.5, 0.3]]])
    figure = plots.plate_figure([pattern(positions)], "")
    assert "orange" in figure.texts[-1].get_text()
    inside = [tuple(color[:3]) == to_rgb(INSIDE) for color in robots(figure.axes[0]).get_facecolor()]
    assert inside == [False] * 9 + [True]


@pytest.mark.parametrize("count", range(1, 61))
def test_a_plate_of_any_number_is_best_columns(count):
    columns = _best_columns(count)
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
    ("make", "field"),
    [
        (lambda: plots.plate_figure([], "Patterns"), "patterns"),
        (lambda: plots.plate_figure([pattern(ring(3, 5.0))], "Patterns", columns=0), "columns"),
        (lambda: plots.plate_figure([pattern(ring(3, 5.0))], "Patterns", columns=9), "columns"),
        (lambda: pattern(ring(3, 5.0), radius=0.0), "radius"),
        (lambda: pattern(np.full((3, 2), np.nan)), "positions"),
        (lambda: pattern(np.zeros((3, 3))), "positions"),
        (lambda: pattern(np.zeros((0, 2))), "positions"),
    ],
)
def test_what_makes_no_plate(make, field):
    with pytest.raises(InputError, match=f"^{field} = ") as caught:
        make()
    assert "\n" not in str(caught.value)


def test_saved_small_and_always_the_same(tmp_path):
    for name in ("one", "two"):
        plate = plots.plate_figure([pattern(ring(10, 8.5)), pattern(ring(9, 9.0))], "Patterns")
        plots.save(plate, tmp_path / f"{name}.png")
    first, second = ((tmp_path / f"{name}.png").read_bytes() for name in ("one", "two"))
    assert first == second
    assert len(first) < 150_000
