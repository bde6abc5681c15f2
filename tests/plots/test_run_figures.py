"""The figures of one run: to scale, every pair, every policy; curves and rewards are what was recorded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection, LineCollection
from PIL import Image

from murmurate import geometry, plots
from murmurate.discovery import StageConfig
from murmurate.errors import InputError
from murmurate.world import Signal

FIGURES = [plots.discovery_figure, plots.training_figure, plots.reward_figure, plots.formation_figure]


@pytest.fixture(scope="module")
def discovery(recording):
    return plots.discovery_figure(recording)


def words(ax):
    legend = ax.get_legend()
    return [text.get_text() for text in (*ax.texts, *(legend.get_texts() if legend else []))]


def discs(ax):
    return [artist for artist in ax.collections if isinstance(artist, EllipseCollection)][-1]


def test_discovery_shows_start_base_pattern_and_final_pattern(recording, discovery):
    episode, world = recording.episode(), recording.experiment.world
    assert len(discovery.axes) == 5
    for ax, step in zip(discovery.axes[:3], (0, episode.switches[0], episode.steps), strict=True):
        np.testing.assert_array_equal(discs(ax).get_offsets(), episode.positions[step])
        np.testing.assert_array_equal(discs(ax).get_widths(), 2 * world.radius)
        lines = [artist for artist in ax.collections if isinstance(artist, LineCollection)]
        paths, clear, blocked = sorted(lines, key=lambda artist: artist.zorder)
        near = geometry.neighbors(episode.positions[step], world.scan_radius)
        assert len(clear.get_segments()) + len(blocked.get_segments()) == near.sum() / 2
        assert len(paths.get_segments()) == 10 * (step or episode.steps)
    spans = [np.ptp(ax.get_xlim()) for ax in discovery.axes[1:3]]
    assert spans[0] == pytest.approx(spans[1])
    shown = [*(word for ax in discovery.axes for word in words(ax)), *(text.get_text() for text in discovery.texts)]
    assert f"Base pattern · step {episode.switches[0]}" in shown
    assert f"Final pattern · step {episode.steps}" in shown
    assert "all 45 pairs see each other" in shown
    assert "valid: 5 of 5 starts" in shown
    assert "10 robots, distributed start, gathering at the origin" in shown


def test_the_start_shows_the_whole_world(discovery):
    assert (discovery.axes[0].get_xlim(), discovery.axes[0].get_ylim()) == ((-45, 45), (-45, 45))


def test_curves_of_both_policies_and_of_every_signal(recording, discovery):
    training, signal = discovery.axes[3:]
    assert [text.get_text() for text in training.texts] == ["base", "auxiliary"]
    assert [text.get_text() for text in signal.texts] == ["base", "auxiliary", "at rest"]
    labels = {text.get_text() for text in signal.get_legend().get_texts()}
    assert labels == {"objective / 4", "close", "safety", "neighbors", "visible"}
    (switch,), end = recording.episode().switches, recording.episode().steps
    assert [line.get_xdata()[0] for line in signal.lines if len(line.get_xdata()) == 2] == [switch, end]


@pytest.mark.parametrize("policies", [1, 2, 4])
def test_any_number_of_policies(make_recording, policies):
    recording = make_recording(policies=policies, episodes=2, objective="C2")
    discovery, reward = plots.discovery_figure(recording), plots.reward_figure(recording)
    assert len(discovery.axes) == (4 if policies == 1 else 5)
    assert len(discovery.axes[-1].texts) == policies + 1
    assert len(reward.axes) == (2 if policies == 1 else 4)
    assert len(words(reward.axes[0])) == 2 * policies + 1
    for figure in (discovery, reward):
        plots.png(figure, dpi=50)


def test_a_long_name_and_no_training(make_recording):
    recording = replace(make_recording(name="a name that goes on and on and on", episodes=1), training=())
    for draw in FIGURES:
        figure = draw(recording)
        assert "Experiment a name that goes on and…" in [text.get_text() for text in figure.texts]
        plots.png(figure, dpi=50)
    assert all(not ax.lines for ax in plots.training_figure(recording).axes)


def test_an_episode_that_starts_at_rest(make_recording, change):
    recording = change(make_recording(episodes=1, policies=3), lengths=np.zeros(1, int))
    for draw in FIGURES:
        plots.png(draw(recording), dpi=50)
    assert "base: +0.000" in words(plots.reward_figure(recording).axes[0])


def test_training_of_every_policy_and_signal(recording):
    objective, signals = plots.training_figure(recording).axes
    solid = [line for line in objective.lines if line.get_linestyle() == "-"]
    for line, curve in zip(solid, recording.training, strict=True):
        np.testing.assert_array_equal(line.get_xdata(), curve.environment_steps)
        np.testing.assert_allclose(line.get_ydata(), sum(curve.signals.values()) / 4)
    assert {"close", "safety", "neighbors", "visible"} < set(words(signals))
    assert len([line for line in signals.lines if len(line.get_xdata()) > 2]) == 4 * len(recording.training)
    assert [ax.texts[0].get_text() for ax in (objective, signals)] == ["base", "base"]


def test_a_search_for_goals_is_drawn_before_the_first_step(recording):
    """It has updates and no steps; and where it began, which is far below everything else, is cut off."""
    updates, names = np.arange(1.0, 301.0), recording.training[0].signals
    search = plots.TrainingCurve("search", updates, {name: np.linspace(-50, 1, 300) for name in names})
    searched = replace(recording, search=search)
    (ax, signals), (before, _) = plots.training_figure(searched).axes, plots.training_figure(recording).axes
    x = ax.lines[0].get_xdata()
    assert (np.diff(x) > 0).all()
    assert (x[-1], ax.get_xlim()[0]) == (0, x[0])
    assert ax.get_ylim() == before.get_ylim()
    assert ax.get_xlim()[1] == before.get_xlim()[1] == -3 * x[0] * 300 / 299
    assert min(ax.get_xticks()) == 0
    assert [each.texts[0].get_text() for each in (ax, signals)] == ["search", "search"]
    colors = [line.get_color() for line in ax.lines if line.get_linestyle() == "-"]
    assert colors[0] == colors[1], "the base policy's"
    alone = plots.training_figure(replace(searched, training=()))
    plots.png(alone, dpi=50)
    assert {"close", "safety", "neighbors", "visible"} < set(words(alone.axes[1]))


def test_the_reward_is_the_change_of_the_objective(recording):
    episode = recording.episode(1)
    (switch,), end = episode.switches, episode.steps
    cumulative, rewards, later, later_rewards = plots.reward_figure(recording, 1).axes
    objective = sum(episode.signals.values())
    gained = objective - objective[0]
    base, auxiliary, rest = (line for line in cumulative.lines if line.get_linewidth() == 2.0)
    np.testing.assert_allclose(base.get_ydata(), gained[: switch + 1], atol=1e-6)
    np.testing.assert_allclose(auxiliary.get_ydata(), gained[switch:], atol=1e-6)
    np.testing.assert_allclose(rest.get_ydata(), gained[-1], atol=1e-6)
    heights = [bar.get_height() for container in rewards.containers for bar in container]
    np.testing.assert_allclose(heights, np.diff(objective), atol=1e-6)
    assert sum(heights) == pytest.approx(gained[-1], abs=1e-5)
    larger = next(line for line in later.lines if line.get_linewidth() == 2.0)
    np.testing.assert_allclose(larger.get_ydata(), gained[switch:] - gained[switch], atol=1e-6)
    assert len(later_rewards.containers[0]) == end - switch
    assert later.get_xlim() == later_rewards.get_xlim()
    assert f"base: {gained[switch]:+.3f}" in words(cumulative)


def test_formation_shows_the_panels_of_the_discovery(recording, discovery):
    for ax, other in zip(plots.formation_figure(recording).axes, discovery.axes[:3], strict=True):
        assert words(ax) == words(other)
        assert ax.get_xlim() == other.get_xlim()
        np.testing.assert_array_equal(discs(ax).get_offsets(), discs(other).get_offsets())


@pytest.mark.parametrize("draw", [plots.discovery_figure, plots.reward_figure, plots.formation_figure])
def test_no_such_episode(recording, draw):
    with pytest.raises(InputError, match=r"^episode = 99"):
        draw(recording, 99)


def test_labels_and_legends_within_the_discovery_and_apart(discovery):
    FigureCanvasAgg(discovery).draw()
    boxes = [text.get_window_extent() for ax in discovery.axes for text in ax.texts]
    boxes += [text.get_window_extent() for text in discovery.texts]
    boxes += [ax.get_legend().get_window_extent() for ax in discovery.axes if ax.get_legend()]
    for index, box in enumerate(boxes):
        assert box.x0 >= 0
        assert box.x1 <= discovery.bbox.width
        assert not any(box.overlaps(other) for other in boxes[index + 1 :])


@pytest.mark.parametrize("draw", FIGURES[1:])
def test_labels_within_the_page_and_apart(check_labels, recording, draw):
    assert check_labels(draw(recording)) >= 8


@pytest.mark.parametrize("draw", FIGURES)
def test_saved_small_and_always_the_same(recording, tmp_path, draw):
    for name in ("one", "two"):
        plots.save(draw(recording), tmp_path / "figures" / f"{name}.png")
    first, second = ((tmp_path / "figures" / f"{name}.png").read_bytes() for name in ("one", "two"))
    assert first == second
    assert len(first) < 300_000
    with Image.open(tmp_path / "figures" / "one.png") as picture:
        assert picture.width == 1800
    assert sorted(path.name for path in (tmp_path / "figures").iterdir()) == ["one.png", "two.png"]


def test_an_objective_of_other_signals_says_which(recording):
    def rewarded(*names):
        signals = {name: Signal.registered()[name](weight=0.0 if name == "neighbors" else 1.0) for name in names}
        stages = {"base": StageConfig(), "auxiliary": StageConfig()}
        config = replace(recording.experiment, objective="custom", signals=signals, **stages)
        return replace(recording, experiment=config)

    figure = plots.discovery_figure(rewarded("safety", "neighbors"))
    assert "10 robots, distributed start, safety" in [text.get_text() for text in figure.texts]
    training = figure.axes[3].get_legend().get_texts()
    assert [text.get_text() for text in training] == ["objective / 1"]
    figure = plots.discovery_figure(rewarded("close", "visible"))
    assert "10 robots, distributed start, gathering at the origin" in [text.get_text() for text in figure.texts]
    training = figure.axes[3].get_legend().get_texts()
    assert [text.get_text() for text in training] == ["objective / 2", "visible"]
