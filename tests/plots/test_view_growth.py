"""Growth with the swarm's size: every point, the line that fits them, the bound, and the paper's beside them."""

import numpy as np
import pytest

from murmurate import plots
from murmurate.errors import InputError
from murmurate.plots.growth import _fit

DISTRIBUTED = plots.Growth("distributed", range(4, 11), [50, 60, 70, 80, 90, 100, 110], [38] * 7, [1] * 6 + [0.97])
SCATTERED = plots.Growth("scattered", [4, 6, 8, 10], [40.0, 42.0, 47.0, 60.0], [31.0] * 4, [1.0, 0.995, 1.0, 1.0])
PAPER = [
    plots.PaperPoint("A", 6, 117.64, "packed"),
    plots.PaperPoint("C", 10, 1892.58, "distributed"),
    plots.PaperPoint("F", 10, 2037.23, "distributed"),
]


def words(ax):
    legend = ax.get_legend()
    return [text.get_text() for text in (*ax.texts, *(legend.get_texts() if legend else []))]


def test_the_line_that_fits_best():
    slope, intercept, determination = _fit(DISTRIBUTED)
    assert (slope, intercept, determination) == pytest.approx((10, 10, 1))
    slope, intercept, determination = _fit(SCATTERED)
    expected = np.polyfit(SCATTERED.robots, SCATTERED.steps, 1)
    assert (slope, intercept) == pytest.approx(tuple(expected))
    assert determination == pytest.approx(np.corrcoef(SCATTERED.robots, SCATTERED.steps)[0, 1] ** 2)
    assert _fit(plots.Growth("packed", [4, 5], [7, 7], [1, 1], [1, 1])) == pytest.approx((0, 7, 1))


def test_growth_with_its_fit_its_bound_and_the_valid_fraction():
    (ax,) = plots.growth_figure([DISTRIBUTED, SCATTERED]).axes
    shown = words(ax)
    assert "distributed: +10.0 steps a robot, R² = 1.00" in shown
    assert {"97%", "99.5%", "kinematic bound"} < set(shown)
    dashed = [line for line in ax.lines if line.is_dashed()]
    np.testing.assert_array_equal(dashed[0].get_ydata(), DISTRIBUTED.bound)
    points = [line for line in ax.lines if len(line.get_xdata()) == 1]
    assert [(line.get_xdata()[0], line.get_ydata()[0]) for line in points[:7]] == [
        *zip(DISTRIBUTED.robots, DISTRIBUTED.steps, strict=True)
    ]
    hollow = [line.get_markerfacecolor() == "white" for line in points]
    assert hollow == [*(one < 1 for one in (*DISTRIBUTED.valid, *SCATTERED.valid))]


def test_the_papers_points_beside_ours():
    measured, paper = plots.growth_figure([DISTRIBUTED, SCATTERED], PAPER).axes
    assert paper.get_yscale() == "log"
    assert measured.get_yscale() == "linear"
    assert {"A", "C: 17 times ours", "F: 19 times ours"} <= set(words(paper))
    low, high = paper.get_ylim()
    assert low < 40
    assert high > 2037.23


@pytest.mark.parametrize("start", ["random", "a start of one's own"])
def test_a_single_size_of_an_unknown_start(start, tmp_path):
    figure = plots.growth_figure(
        [plots.Growth(start, [5], [9.5], [4.0], [0.0])], [plots.PaperPoint("$X_{", 5, 10, start)]
    )
    assert start in words(figure.axes[0])
    plots.save(figure, tmp_path / "growth.png")


@pytest.mark.parametrize(
    ("growths", "field"),
    [
        ([], "growths"),
        ([plots.Growth("packed", [], [], [], [])], "growth"),
        ([plots.Growth("packed", [4, 5], [7], [1, 1], [1, 1])], "growth"),
        ([plots.Growth("packed", [4], [float("nan")], [1], [1])], "steps"),
        ([plots.Growth("packed", [4], [0], [1], [1])], "steps"),
        ([plots.Growth("packed", [4], [7], [-1], [1])], "bound"),
        ([plots.Growth("packed", [4], [7], [1], [1.5])], "valid"),
        ([plots.Growth("packed", [0], [7], [1], [1])], "robots"),
        ([plots.Growth("packed", [4.5], [7], [1], [1])], "robots"),
    ],
)
def test_what_cannot_be_drawn(growths, field):
    with pytest.raises(InputError, match=f"^{field} = ") as caught:
        plots.growth_figure(growths)
    assert "\n" not in str(caught.value)


def test_the_papers_numbers_are_checked():
    with pytest.raises(InputError, match=r"^steps = "):
        plots.growth_figure([SCATTERED], [plots.PaperPoint("A", 6, -1.0, "packed")])


def test_labels_within_the_page_and_apart(check_labels):
    assert check_labels(plots.growth_figure([DISTRIBUTED, SCATTERED], PAPER)) == 11


def test_always_the_same(tmp_path):
    for name in ("one", "two"):
        plots.save(plots.growth_figure([DISTRIBUTED, SCATTERED], PAPER), tmp_path / f"{name}.png")
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()
