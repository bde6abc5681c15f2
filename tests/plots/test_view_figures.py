"""What the figures show: to scale, every pair, every policy, and files that are small, whole and always the same."""

import subprocess
import sys

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from murmurate import geometry, view
from murmurate.errors import InputError, RunError
from murmurate.plots.drawing import show_window
from murmurate.plots.page import spread
from murmurate.plots.palette import WARNING, limited

ROW = np.array([[0.0, 0.0], [6.0, 0.0], [12.0, 0.0], [40.0, 0.0]])


def draw(positions, scan_radius=20.0, objective="C2", half=15.0):
    figure = Figure((4, 4), dpi=100)
    ax = figure.add_axes((0, 0, 1, 1))
    show_window(ax, np.mean(positions, axis=0), half)
    return figure, ax, view.draw_configuration(ax, positions, 1.0, scan_radius, 5.0, objective)


def words(figure):
    return [text.get_text() for ax in figure.axes for text in ax.texts] + [text.get_text() for text in figure.texts]


def test_a_sight_line_for_each_pair_of_neighbours():
    _, _, drawing = draw(ROW)
    assert len(drawing.clear.get_segments()) == 2  # the fourth robot is out of everybody's scanning distance
    (blocked,) = drawing.blocked.get_segments()
    np.testing.assert_array_equal(blocked, ROW[[0, 2]])
    np.testing.assert_allclose(drawing.blocked.get_colors()[0][:3], to_rgb(WARNING))


def test_the_occluded_are_outlined():
    _, _, drawing = draw(ROW)
    outlined = [tuple(color[:3]) == to_rgb(WARNING) and color[3] == 1 for color in drawing.discs.get_edgecolor()]
    assert outlined == [True, False, True, False]


def test_robots_have_their_radius_in_world_units():
    figure, ax, drawing = draw(np.array([[0.0, 0.0]]), half=2.0)
    np.testing.assert_array_equal(drawing.discs.get_widths(), 2.0)
    np.testing.assert_array_equal(drawing.shells.get_widths(), 5.0)
    canvas = FigureCanvasAgg(figure)
    for half in (2.0, 4.0):  # to scale when zoomed as well
        show_window(ax, np.zeros(2), half)
        drawing.shells.set_visible(False)
        canvas.draw()
        dark = (np.asarray(canvas.buffer_rgba())[..., :3].sum(axis=-1) < 450).sum()
        assert dark == pytest.approx(np.pi * (400 / (2 * half)) ** 2, rel=0.02)


def test_a_drawing_moves():
    _, _, drawing = draw(ROW)
    bent = ROW + np.array([[0, 0], [0, 5], [0, 0], [-34, -5]])
    drawing.update(bent)
    assert len(drawing.clear.get_segments()) == 6
    assert drawing.blocked.get_segments() == []
    np.testing.assert_array_equal(drawing.discs.get_offsets(), bent)


@pytest.mark.parametrize(("objective", "crosses"), [("C1", 1), ("C2", 0)])
def test_the_gathering_point_is_marked(objective, crosses):
    _, ax, _ = draw(ROW, objective=objective)
    assert sum(line.get_marker() == "+" for line in ax.lines) == crosses


def test_discovery_shows_start_base_pattern_and_final_pattern(run):
    record = view.Record.open(run)
    episode = record.episode()
    figure = view.discovery_figure(record)
    assert len(figure.axes) == 5
    for ax, step in zip(figure.axes[:3], (0, episode.switches[0], episode.steps), strict=True):
        discs = [found for found in ax.collections if isinstance(found, EllipseCollection)][-1]
        np.testing.assert_array_equal(discs.get_offsets(), episode.positions[step])
        np.testing.assert_array_equal(discs.get_widths(), 2 * record.sizes.radius)
        paths, clear, blocked = sorted(
            (found for found in ax.collections if isinstance(found, LineCollection)), key=lambda found: found.zorder
        )
        near = geometry.neighbors(episode.positions[step], record.sizes.scan_radius)
        assert len(clear.get_segments()) + len(blocked.get_segments()) == near.sum() / 2
        assert len(paths.get_segments()) == 10 * (step or episode.steps)
    spans = [np.ptp(ax.get_xlim()) for ax in figure.axes[1:3]]
    assert spans[0] == pytest.approx(spans[1])
    shown = words(figure)
    assert f"Base pattern · step {episode.switches[0]}" in shown
    assert f"Final pattern · step {episode.steps}" in shown
    assert "all 45 pairs see each other" in shown
    assert "valid: 5 of 5 fresh starts" in shown


def test_the_start_shows_the_whole_world(run):
    ax = view.discovery_figure(view.Record.open(run)).axes[0]
    assert (ax.get_xlim(), ax.get_ylim()) == ((-45, 45), (-45, 45))


def test_curves_of_both_policies_and_of_every_signal(run):
    record = view.Record.open(run)
    training, signal = view.discovery_figure(record).axes[3:]
    assert [text.get_text() for text in training.texts] == ["base", "auxiliary"]
    assert [text.get_text() for text in signal.texts] == ["base", "auxiliary", "at rest"]
    labels = {text.get_text() for text in signal.get_legend().get_texts()}
    assert labels == {"objective / 4", "close", "safety", "neighbors", "visible"}
    (switch,), end = record.episode().switches, record.episode().steps
    marks = [line.get_xdata()[0] for line in signal.lines if len(line.get_xdata()) == 2]
    assert marks == [switch, end]


@pytest.mark.parametrize("policies", [1, 2, 4])
def test_any_number_of_policies(make_run, tmp_path, policies):
    record = view.Record.open(make_run(tmp_path / "run", policies=policies, episodes=2))
    figure = view.discovery_figure(record)
    assert len(figure.axes) == (4 if policies == 1 else 5)
    assert len(figure.axes[-1].texts) == policies + 1
    view.save(figure, tmp_path / "figure.png")


def test_an_odd_name_and_no_training(make_run, tmp_path):
    run = make_run(tmp_path / "run", name="a name that $goes_{on} and on and on", episodes=1)
    (run / "metrics.jsonl").write_text("")
    view.save(view.discovery_figure(view.Record.open(run)), tmp_path / "figure.png")


def test_labels_within_the_figure_and_apart(run):
    figure = view.discovery_figure(view.Record.open(run))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    boxes = [text.get_window_extent() for ax in figure.axes for text in ax.texts]
    boxes += [text.get_window_extent() for text in figure.texts]
    boxes += [ax.get_legend().get_window_extent() for ax in figure.axes if ax.get_legend()]
    for place, box in enumerate(boxes):
        assert box.x0 >= 0
        assert box.x1 <= figure.bbox.width
        assert not any(box.overlaps(other) for other in boxes[place + 1 :])


def test_labels_spread_only_as_far_as_they_must():
    assert spread([0.2, 0.8], [0.1, 0.1], gap=0.02) == pytest.approx([0.2, 0.8])
    assert spread([0.5, 0.52], [0.1, 0.1], gap=0.02) == pytest.approx([0.5, 0.62])
    assert spread([0.9, 0.98], [0.1, 0.1], gap=0.02) == pytest.approx([0.83, 0.95])


@pytest.mark.parametrize(("count", "size"), [(1, (10.0, 4.12)), (3, (10.0, 4.12)), (5, (10.0, 8.14))])
def test_patterns_of_several_runs(run, count, size):
    figure = view.patterns_figure([view.Record.open(run)] * count, "ABCDEF"[:count])
    assert len(figure.axes) == 2 * count
    assert tuple(figure.get_size_inches()) == pytest.approx(size)
    assert "A" in words(figure)


def test_patterns_need_a_label_each(run):
    for records, labels in (([], []), ([view.Record.open(run)], [])):
        with pytest.raises(InputError, match="labels"):
            view.patterns_figure(records, labels)


def test_saved_small_and_always_the_same(run, tmp_path):
    record = view.Record.open(run)
    for name in ("one", "two"):
        view.save(view.discovery_figure(record), tmp_path / "figures" / f"{name}.png")
    one, two = ((tmp_path / "figures" / f"{name}.png").read_bytes() for name in ("one", "two"))
    assert one == two
    assert len(one) < 300_000
    with Image.open(tmp_path / "figures" / "one.png") as picture:
        assert picture.size == (1800, 1251)
    assert sorted(path.name for path in (tmp_path / "figures").iterdir()) == ["one.png", "two.png"]


def test_saving_fails_in_one_line_and_leaves_nothing(tmp_path):
    with pytest.raises(InputError, match=r"\.png"):
        view.save(Figure(), tmp_path / "figure.jpeg")
    (tmp_path / "taken").mkdir()
    (tmp_path / "figure.png").mkdir()
    with pytest.raises(RunError, match="cannot write") as caught:
        view.save(Figure(), tmp_path / "figure.png")
    assert "\n" not in str(caught.value)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["figure.png", "taken"]


def test_limited_colours_are_the_nearest():
    pixels = np.array([[[255, 255, 255], [213, 94, 0], [214, 95, 1], [1, 2, 3]]], np.uint8)
    exact = np.asarray(limited(pixels, levels=6, frequent=4).convert("RGB"))
    np.testing.assert_array_equal(exact, pixels)
    few = np.asarray(limited(pixels, levels=6).convert("RGB"))
    np.testing.assert_array_equal(few[0, :3], [[255, 255, 255], [213, 94, 0], [213, 94, 0]])


def test_view_needs_no_jax():
    code = "import sys, murmurate.plots; assert not {'jax', 'equinox', 'matplotlib.pyplot'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
