"""Figures of many runs: growth with its line and bound, patterns side by side, methods compared, failures."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection
from matplotlib.text import Text

from murmurate import plots
from murmurate.errors import InputError
from murmurate.plots.studies import MAX_FAILURES
from murmurate.world import WorldConfig

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
    assert hollow == [*(valid < 1 for valid in (*DISTRIBUTED.valid, *SCATTERED.valid))]


def test_the_papers_points_beside_ours():
    measured, paper = plots.growth_figure([DISTRIBUTED, SCATTERED], PAPER).axes
    assert paper.get_yscale() == "log"
    assert measured.get_yscale() == "linear"
    assert {"A", "C: 17 times ours", "F: 19 times ours"} <= set(words(paper))
    low, high = paper.get_ylim()
    assert low < 40
    assert high > 2037.23


@pytest.mark.parametrize("start", ["random", "a start of one's own"])
def test_a_single_size_of_an_unknown_start(start):
    figure = plots.growth_figure(
        [plots.Growth(start, [5], [9.5], [4.0], [0.0])], [plots.PaperPoint("$X_{", 5, 10, start)]
    )
    assert start in words(figure.axes[0])
    plots.png(figure, dpi=50)


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


@pytest.mark.parametrize(("count", "size"), [(1, (10.0, 4.12)), (3, (10.0, 4.12)), (5, (10.0, 8.14))])
def test_patterns_of_several_runs(recording, count, size):
    figure = plots.patterns_figure([recording] * count, "ABCDEF"[:count])
    assert len(figure.axes) == 2 * count
    assert tuple(figure.get_size_inches()) == pytest.approx(size)
    assert "A" in words(figure.axes[0])
    assert "all 45 pairs see each other" in words(figure.axes[0])


def test_patterns_need_a_label_each(recording):
    for recordings, labels in (([], []), ([recording], [])):
        with pytest.raises(InputError, match="labels"):
            plots.patterns_figure(recordings, labels)


def row(method="learned", robots=4, valid=95, **fields):
    share = valid / 100
    interval = [share - 0.02, min(1.0, share + 0.02)]
    usual = {"sensing": "visible", "scheduler": "fsync", "start": "random", "episodes": 100, "worst": []}
    return {"method": method, "robots": robots, "valid": valid, "interval": interval} | usual | fields


ROWS = [row(method, robots, 90 + robots) for method in ("learned", "circle") for robots in (4, 6, 8)]


def test_methods_are_compared_panel_by_panel(check_labels):
    others = [row(robots=robots, scheduler="ssync", start="packed", valid=80) for robots in (4, 6)]
    alone = row(robots=4, scheduler="async")
    figure = plots.comparison_figure([*ROWS, *others, alone])
    assert [ax.get_title(loc="left") for ax in figure.axes] == ["visible sight, fsync", "visible sight, ssync, packed"]
    learned, circle = figure.axes[0].containers
    np.testing.assert_array_equal(learned.lines[0].get_ydata(), [94, 96, 98])
    # Intervals do not cover each other, and every point is over the number of robots that it has.
    figure.canvas.draw()
    places = [container.lines[0].get_transform().transform([[0, 94]])[0, 0] for container in (learned, circle)]
    tick = figure.axes[0].transData.transform([[0, 94]])[0, 0]
    assert learned.lines[0].get_xdata().tolist() == circle.lines[0].get_xdata().tolist() == [0, 1, 2]
    assert places[0] < tick < places[1]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["learned", "circle"]
    check_labels(figure)
    single = plots.comparison_figure([alone])
    assert len(single.axes) == 1


@pytest.mark.parametrize("methods", [1, 2, 13])
def test_no_point_is_farther_from_its_number_of_robots_than_a_marker(methods):
    rows = [row(f"method {index}", robots=robots) for index in range(methods) for robots in range(4, 29)]
    figure = plots.comparison_figure(rows)
    figure.canvas.draw()
    ax = figure.axes[0]
    for container in ax.containers:
        line = container.lines[0]
        drawn = line.get_transform().transform(line.get_xydata())[:, 0]
        ticks = ax.transData.transform([[index, 0] for index in range(25)])[:, 0]
        marker = line.get_markersize() * figure.dpi / 72
        assert np.abs(drawn - ticks).max() <= marker * (1 + 1e-9)


def test_many_sizes_leave_some_unnamed():
    figure = plots.comparison_figure([row(robots=robots) for robots in range(4, 30)])
    ticks = [label.get_text() for label in figure.axes[0].get_xticklabels()]
    assert ticks[-1] == "29"
    assert 0 < sum(map(bool, ticks)) <= 12


def failure(free=True):
    return {"positions": [[0.0, 0.0], [6.0, 0.0], [12.0, 0.0], [6.0, 9.0]], "free": free}


def test_failures_show_blocked_sight_and_contacts(check_labels):
    worlds = {4: WorldConfig(robots=4)}
    figure = plots.failures_figure([row(worst=[failure(), failure(False)]), row("circle")], worlds)
    first, second = figure.axes
    lines = [line for line in first.collections if not isinstance(line, EllipseCollection)]
    assert sorted(len(line.get_segments()) for line in lines) == [0, 1]
    assert first.spines["left"].get_edgecolor() != second.spines["left"].get_edgecolor()
    check_labels(figure)
    many = [row(worst=[failure()] * MAX_FAILURES), row("circle", worst=[failure()] * 2)]
    assert len(plots.failures_figure(many, worlds).axes) == 2


def test_methods_are_drawn_without_what_a_font_has_not():
    nasty = "$x^\x1b]0;title\x07\n"
    rows = [row(nasty, worst=[failure()])]
    for figure in (plots.comparison_figure(rows), plots.failures_figure(rows, {4: WorldConfig(robots=4)})):
        named = [text.get_text() for text in figure.findobj(Text) if "title" in text.get_text()]
        assert named
        assert all("$x^\\x1b]0;title\\x07" in text and text.isprintable() for text in named)
        plots.png(figure, dpi=20)


def test_nothing_to_compare():
    with pytest.raises(InputError, match=r"^rows = "):
        plots.comparison_figure([])
    with pytest.raises(InputError, match=r"^rows = "):
        plots.failures_figure([], {4: WorldConfig(robots=4)})


def test_no_failures_are_said():
    figure = plots.failures_figure([row(), row("circle")], {4: WorldConfig(robots=4)})
    assert not figure.axes
    assert "none in 200 episodes" in [text.get_text() for text in figure.texts]
