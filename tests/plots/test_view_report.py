"""Training, the reward of an episode, and the formation of a pattern: what is drawn is what was recorded."""

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection

from murmurate import plots
from murmurate.errors import InputError


@pytest.fixture(scope="module")
def record(run):
    return plots.Record.open(run)


def words(ax):
    legend = ax.get_legend()
    return [text.get_text() for text in (*ax.texts, *(legend.get_texts() if legend else []))]


def test_training_of_every_policy_and_signal(record):
    objective, signals = plots.training_figure(record).axes
    solid = [line for line in objective.lines if line.get_linestyle() == "-"]
    for line, curve in zip(solid, record.training, strict=True):
        np.testing.assert_array_equal(line.get_xdata(), curve.environment_steps)
        np.testing.assert_allclose(line.get_ydata(), curve.objective / 4)
    assert {"close", "safety", "neighbors", "visible"} < set(words(signals))
    curves = [line for line in signals.lines if len(line.get_xdata()) > 2]
    assert len(curves) == 4 * len(record.training)
    assert [ax.texts[0].get_text() for ax in (objective, signals)] == ["base", "base"]


def test_the_reward_is_the_change_of_the_objective(record):
    episode = record.episode(1)
    (switch,), end = episode.switches, episode.steps
    summed, steps, rest, rest_steps = plots.reward_figure(record, 1).axes
    gained = episode.objective - episode.objective[0]
    base, auxiliary, still = (line for line in summed.lines if line.get_linewidth() == 2.0)
    np.testing.assert_allclose(base.get_ydata(), gained[: switch + 1], atol=1e-6)
    np.testing.assert_allclose(auxiliary.get_ydata(), gained[switch:], atol=1e-6)
    np.testing.assert_allclose(still.get_ydata(), gained[-1], atol=1e-6)
    heights = [bar.get_height() for bar in steps.containers[0]] + [bar.get_height() for bar in steps.containers[1]]
    np.testing.assert_allclose(heights, np.diff(episode.objective), atol=1e-6)
    assert sum(heights) == pytest.approx(gained[-1], abs=1e-5)
    larger = next(line for line in rest.lines if line.get_linewidth() == 2.0)
    np.testing.assert_allclose(larger.get_ydata(), gained[switch:] - gained[switch], atol=1e-6)
    assert len(rest_steps.containers[0]) == end - switch
    assert rest.get_xlim() == rest_steps.get_xlim()
    assert f"base: {gained[switch]:+.3f}" in words(summed)


@pytest.mark.parametrize("policies", [1, 2, 4])
def test_rewards_of_any_number_of_policies(make_run, tmp_path, policies):
    record = plots.Record.open(make_run(tmp_path / "run", policies=policies, episodes=2))
    figure = plots.reward_figure(record)
    assert len(figure.axes) == (2 if policies == 1 else 4)
    assert len(words(figure.axes[0])) == 2 * policies + 1
    plots.save(figure, tmp_path / "reward.png")


def test_an_episode_that_starts_at_rest_earns_nothing(make_run, tmp_path):
    run = make_run(tmp_path / "run", episodes=1, policies=3)
    arrays = dict(np.load(run / "trajectories.npz"))
    np.savez(run / "trajectories.npz", **arrays | {"lengths": np.zeros(1, int)})
    record = plots.Record.open(run)
    for figure in (plots.reward_figure(record), plots.formation_figure(record)):
        plots.save(figure, tmp_path / "still.png")
    assert "base: +0.000" in words(plots.reward_figure(record).axes[0])


def test_no_training_no_curves(make_run, tmp_path):
    run = make_run(tmp_path / "run", episodes=1)
    (run / "metrics.jsonl").write_text("")
    figure = plots.training_figure(plots.Record.open(run))
    plots.save(figure, tmp_path / "training.png")
    assert all(not ax.lines for ax in figure.axes)


def test_formation_shows_the_panels_of_the_discovery(record):
    formation, discovery = plots.formation_figure(record).axes, plots.discovery_figure(record).axes[:3]
    for one, other in zip(formation, discovery, strict=True):
        assert words(one) == words(other)
        assert one.get_xlim() == other.get_xlim()
        discs = [[c for c in ax.collections if isinstance(c, EllipseCollection)][-1] for ax in (one, other)]
        np.testing.assert_array_equal(discs[0].get_offsets(), discs[1].get_offsets())


@pytest.mark.parametrize("draw", [plots.reward_figure, plots.formation_figure])
def test_no_such_episode(record, draw):
    with pytest.raises(InputError, match=r"^episode = 99"):
        draw(record, 99)


@pytest.mark.parametrize("draw", [plots.training_figure, plots.reward_figure, plots.formation_figure])
def test_labels_within_the_page_and_apart(check_labels, record, draw):
    assert check_labels(draw(record)) >= 8


@pytest.mark.parametrize("name", ["training", "reward", "formation"])
def test_saved_small_and_always_the_same(record, tmp_path, name):
    for copy in ("one", "two"):
        plots.save(getattr(view, f"{name}_figure")(record), tmp_path / f"{copy}.png")
    one, two = ((tmp_path / f"{copy}.png").read_bytes() for copy in ("one", "two"))
    assert one == two
    assert len(one) < 200_000
