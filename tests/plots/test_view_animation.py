"""The moving picture: every step, the final pattern held, the camera never losing a robot."""

import builtins
import dataclasses
import sys
import types

import numpy as np
import pytest
from PIL import Image

from murmurate import plots
from murmurate.errors import InputError
from murmurate.plots.animation import _FRAMES, _camera, _steps


@pytest.fixture(scope="module")
def record(run):
    return plots.Record.open(run)


def test_gif_has_a_frame_for_each_step_and_holds_the_last(record, tmp_path):
    file = tmp_path / "figures" / "episode.gif"
    plots.animate(record, file, episode=1, fps=25)
    durations = []
    with Image.open(file) as picture:
        assert picture.n_frames == record.lengths[1] + 1
        assert picture.info["loop"] == 0
        assert picture.size == (420, 452)
        for frame in range(picture.n_frames):
            picture.seek(frame)
            durations.append(picture.info["duration"])
    assert durations[:-1] == [40] * (len(durations) - 1)
    assert durations[-1] == 1540
    assert file.stat().st_size < 1_000_000
    assert [path.name for path in file.parent.iterdir()] == ["episode.gif"]


def test_a_long_episode_skips_steps():
    positions = np.zeros((1001, 2, 2))
    steps = _steps(plots.Episode(0, positions, (500,), {}, True))
    assert len(steps) == _FRAMES
    assert (steps[0], steps[-1]) == (0, 1000)
    assert _steps(plots.Episode(0, positions[:1], (), {}, True)) == [0]


def test_an_episode_that_starts_at_rest(make_run, tmp_path):
    run = make_run(tmp_path / "run", episodes=1, policies=3)
    arrays = dict(np.load(run / "trajectories.npz"))
    np.savez(run / "trajectories.npz", **arrays | {"lengths": np.zeros(1, int)})
    record = plots.Record.open(run)
    plots.animate(record, tmp_path / "still.gif")
    plots.save(plots.discovery_figure(record), tmp_path / "still.png")
    with Image.open(tmp_path / "still.gif") as picture:
        assert getattr(picture, "n_frames", 1) == 1


@pytest.mark.parametrize("drift", [0, 30])
def test_the_camera_only_zooms_in_and_loses_nobody(record, drift):
    episode = record.episode()
    moving = np.linspace(0, drift, len(episode.positions))[:, None, None]
    positions = np.clip(episode.positions + moving, -45, 45)
    episode = dataclasses.replace(episode, positions=positions)
    centers, halves = _camera(record, episode)
    assert (np.diff(halves) <= 1e-9).all()
    assert halves[-1] < 0.6 * halves[0]
    offset = np.abs(positions - centers[:, None]).max(axis=(1, 2))
    assert (offset <= halves).all()


@pytest.mark.parametrize(("name", "fps"), [("a.avi", 20), ("a", 20), ("a.gif", 0), ("a.gif", 51)])
def test_bad_requests(record, tmp_path, name, fps):
    with pytest.raises(InputError):
        plots.animate(record, tmp_path / "new" / name, fps=fps)
    assert not any(tmp_path.iterdir())


def test_mp4_needs_the_video_extra(record, tmp_path, monkeypatch):
    original = builtins.__import__

    def without(name, *args, **kwargs):
        if name == "imageio_ffmpeg":
            raise ImportError(name)
        return original(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r"murmurate\[video\]"):
        plots.animate(record, tmp_path / "new" / "a.mp4")
    assert not any(tmp_path.iterdir())


def test_mp4_gets_every_frame_and_the_hold(record, tmp_path, monkeypatch):
    frames = []

    def write_frames(path, size, *, fps, **options):
        while True:
            try:
                frame = yield
            except GeneratorExit:
                break
            frames.append(frame)
            assert frame.shape == (size[1], size[0], 3)
            with open(path, "ab") as file:
                file.write(b"frame")

    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", types.SimpleNamespace(write_frames=write_frames))
    plots.animate(record, tmp_path / "a.mp4", episode=0, fps=10)
    assert len(frames) == record.lengths[0] + 1 + 15
    assert (tmp_path / "a.mp4").exists()
