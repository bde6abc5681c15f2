"""A run as the figures read it: what was recorded, episodes cut at their end, the typical one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.text import Text

from murmurate import plots
from murmurate.errors import InputError, RunError
from murmurate.runs.folder import RunFolder
from tiny import made_up_summary


@pytest.fixture(scope="module")
def folder(recording, tmp_path_factory):
    """The folder of a finished run that holds the recording; not to be changed."""
    return write_run(recording, RunFolder(tmp_path_factory.mktemp("runs") / "C"))


def write_run(recording, folder):
    """Writes a finished run that holds a recording."""
    folder.create()
    folder.write_experiment(recording.experiment)
    folder.append_metrics(
        {
            "policy": policy,
            "name": curve.name,
            "update": update,
            "environment_steps": curve.environment_steps[update],
            "signals": {name: values[update] for name, values in curve.signals.items()},
        }
        for policy, curve in enumerate(recording.training)
        for update in range(len(curve.environment_steps))
    )
    folder.write_policies([{"weight": np.zeros(1)}] * 2)
    folder.write_evaluation(made_up_summary(len(recording.trajectories.lengths)), arrays_of(recording.trajectories))
    folder.write_manifest({}, policies=2)
    return folder.path


def arrays_of(trajectories):
    arrays = {name: getattr(trajectories, name) for name in ("positions", "lengths", "switch", "at_rest", "after_rest")}
    arrays["signals"] = np.stack(list(trajectories.signals.values()), axis=-1).astype(np.float32)
    return arrays | {"signal_names": np.array(list(trajectories.signals))}


def test_a_stranger_s_names_are_not_drawn(recording, change, tmp_path):
    """Policies have the names of their places; what else a run calls something has no character that acts."""
    nasty = "$x^\x1b]0;title\x07\n" + 99 * "x"
    named = replace(recording, training=[replace(curve, name=nasty) for curve in recording.training])
    folder = RunFolder(write_run(named, RunFolder(tmp_path / "C")))
    starts = {"kind": "file", "name": nasty}
    folder.write_evaluation(folder.evaluation() | {"starts": starts}, arrays_of(recording.trajectories))
    opened = plots.Recording.open(folder)
    assert opened.policies == ["base", "auxiliary"]
    assert opened.starts.isprintable()
    assert len(opened.starts) < 80
    for draw in (plots.discovery_figure, plots.training_figure, plots.reward_figure):
        assert all(text.get_text().isprintable() for text in draw(opened).findobj(Text))


def test_metrics_are_of_the_experiment(recording, tmp_path):
    curves = [replace(curve, signals={"\x1b": curve.signals["visible"]}) for curve in recording.training]
    folder = write_run(replace(recording, training=curves), RunFolder(tmp_path / "C"))
    with pytest.raises(RunError, match=r"metrics that are not of its experiment: of the signals \\x1b$"):
        plots.Recording.open(folder)


def test_reads_what_was_recorded(recording, folder):
    opened = plots.Recording.open(str(folder))
    assert opened.experiment == recording.experiment
    assert opened.policies == ["base", "auxiliary"]
    assert opened.gathering_point
    np.testing.assert_array_equal(opened.trajectories.positions, recording.trajectories.positions)
    for curve, expected in zip(opened.training, recording.training, strict=True):
        np.testing.assert_array_equal(curve.environment_steps, expected.environment_steps)
        np.testing.assert_array_equal(curve.signals["visible"], expected.signals["visible"])
    assert opened.valid.all()


def test_what_cannot_be_drawn_is_one_line(recording, change, tmp_path):
    with pytest.raises(RunError, match="holds no run"):
        plots.Recording.open(tmp_path / "nowhere")
    run = RunFolder(write_run(recording, RunFolder(tmp_path / "run")))
    diverged = change(recording, positions=np.full_like(recording.trajectories.positions, np.nan))
    run.write_evaluation(made_up_summary(len(recording.trajectories.lengths)), arrays_of(diverged.trajectories))
    with pytest.raises(RunError, match=r"trajectories\.npz has .* not finite"):
        plots.Recording.open(run)
    (run.path / "trajectories.npz").unlink()
    with pytest.raises(RunError, match=r"trajectories\.npz"):
        plots.Recording.open(run)
    (run.path / "experiment.toml").write_text("changed")
    with pytest.raises(RunError, match="does not match its checksum"):
        plots.Recording.open(run)


def test_an_episode_ends_at_its_rest(recording):
    episode = recording.episode(1)
    assert len(episode.positions) == recording.trajectories.lengths[1] + 1 == episode.steps + 1
    assert set(episode.signals) == {"close", "safety", "neighbors", "visible"}
    (switch,) = episode.switches
    assert episode.policies.tolist() == [0] * switch + [1] * (episode.steps - switch)
    expected = sum(values[1, : episode.steps + 1] for values in recording.trajectories.signals.values())
    np.testing.assert_allclose(recording.objective(episode.signals), expected, rtol=1e-6)


def test_typical_is_the_median_of_the_valid(recording, change):
    lengths = recording.trajectories.lengths
    assert lengths[recording.typical()] == np.sort(lengths)[2]
    slow, fast = int(np.argmax(lengths)), int(np.argmin(lengths))
    assert change(recording, at_rest=np.isin(np.arange(5), [slow, fast])).typical() == fast
    restless = change(recording, at_rest=np.zeros(5, bool))
    assert restless.typical() == recording.typical()
    assert (recording.episode().outcome, restless.episode().outcome) == ("at rest", "not at rest")


def test_a_contact_on_the_path_is_not_valid(recording, change):
    positions = recording.trajectories.positions.copy()
    # Two robots change places within one step and back: apart at both ends, not in between.
    positions[0, 5, :2] = [[-3, 30], [3, 30]]
    positions[0, 6, :2] = [[3, 30], [-3, 30]]
    assert change(recording, positions=positions).valid.tolist() == [False, True, True, True, True]


@pytest.mark.parametrize("index", [-1, 5])
def test_no_such_episode(recording, index):
    with pytest.raises(InputError, match="episode = "):
        recording.episode(index)


def test_a_switch_that_never_happened_falls_on_the_end(recording, change):
    switch = recording.trajectories.switch.copy()
    switch[2] = 10_000
    episode = change(recording, switch=switch).episode(2)
    assert episode.switches == (episode.steps,)


def test_a_recording_is_one_line_and_a_picture(recording):
    assert "\n" not in repr(recording)
    assert repr(recording).startswith("Recording(C: ")
    assert recording._repr_png_().startswith(b"\x89PNG")


def test_policies_without_training_have_names(recording):
    assert replace(recording, training=()).policies == ["base", "auxiliary"]
