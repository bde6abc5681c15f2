"""The animation: every step in its time, the final pattern held, sight lines that fade in, no robot out of view."""

from __future__ import annotations

import builtins
import dataclasses
import sys
import types

import numpy as np
import pytest
from PIL import Image

from murmurate import plots
from murmurate.errors import InputError
from murmurate.plots import animation
from murmurate.plots.animation import HEIGHT, MAX_BYTES, WIDTH, _camera, _frames, _times


@pytest.mark.parametrize(("suffix", "size"), [("gif", (480, 300)), ("webp", (WIDTH, HEIGHT))])
def test_pictures_loop_hold_the_last_frame_and_are_small(recording, tmp_path, suffix, size):
    file = tmp_path / "figures" / f"episode.{suffix}"
    plots.animate(recording, file, episode=1, fps=10)
    durations = []
    with Image.open(file) as picture:
        assert picture.n_frames == len(_times(recording.trajectories.lengths[1], 10))
        assert picture.info["loop"] == 0
        assert picture.size == size
        for frame in range(picture.n_frames):
            picture.seek(frame)
            picture.load()
            durations.append(picture.info["duration"])
    assert durations == [100] * (len(durations) - 1) + [1600]
    assert file.stat().st_size < MAX_BYTES
    assert [path.name for path in file.parent.iterdir()] == [file.name]


def test_large_animations_lose_frames_but_not_the_last(recording, tmp_path, monkeypatch):
    monkeypatch.setattr(animation, "MAX_BYTES", 1)
    plots.animate(recording, tmp_path / "a.gif", episode=1, fps=5)
    frames = len(_times(recording.trajectories.lengths[1], 5))
    with Image.open(tmp_path / "a.gif") as picture:
        assert picture.n_frames == (frames + 1) // 2


@pytest.mark.parametrize(("steps", "seconds"), [(0, 0), (1, 1 / 3), (9, 3), (33, 4.5), (60, 5), (1000, 6.5)])
def test_an_episode_takes_its_time(steps, seconds):
    times = _times(steps, 30)
    assert len(times) == round(30 * seconds) + 1
    assert (times[0], times[-1]) == (0, steps)


def test_an_episode_that_starts_at_rest(make_recording, change, tmp_path):
    recording = change(make_recording(episodes=1, policies=3), lengths=np.zeros(1, int))
    plots.animate(recording, tmp_path / "still.gif")
    with Image.open(tmp_path / "still.gif") as picture:
        assert getattr(picture, "n_frames", 1) == 1


def test_sight_lines_are_switched_on_gradually(recording, monkeypatch):
    strengths = []
    update = plots.SwarmArtist.update

    def record(self, positions, strength=None):
        strengths.append(strength)
        update(self, positions, strength)

    monkeypatch.setattr(plots.SwarmArtist, "update", record)
    assert len(list(_frames(recording, recording.episode(), 10))) == len(strengths) - 1
    changes = np.abs(np.diff(strengths[1:-1], axis=0))
    assert 0 < changes.max() <= 0.4 + 1e-9
    np.testing.assert_array_equal(strengths[-1], np.triu(np.ones((10, 10)), 1))


@pytest.mark.parametrize("drift", [0, 30])
def test_the_camera_only_zooms_in_and_keeps_every_robot_in_view(recording, drift):
    world, positions = recording.experiment.world, recording.episode().positions
    positions = np.clip(positions + np.linspace(0, drift, len(positions))[:, None, None], -45, 45)
    centers, halves = _camera(positions, world)
    assert (np.diff(halves, axis=0) <= 1e-9).all()
    assert (halves[-1] < 0.6 * halves[0]).all()
    assert (np.abs(positions - centers[:, None]) <= halves[:, None]).all()
    np.testing.assert_allclose(halves[:, 0] / halves[:, 1], halves[0, 0] / halves[0, 1])


@pytest.mark.parametrize(("name", "fps"), [("a.avi", 20), ("a", 20), ("a.gif", 0), ("a.gif", 51)])
def test_bad_requests(recording, tmp_path, name, fps):
    with pytest.raises(InputError):
        plots.animate(recording, tmp_path / "new" / name, fps=fps)
    assert not any(tmp_path.iterdir())


def test_mp4_needs_the_video_extra(recording, tmp_path, monkeypatch):
    original = builtins.__import__

    def without(name, *args, **kwargs):
        if name == "imageio_ffmpeg":
            raise ImportError(name)
        return original(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r"murmurate\[video\]"):
        plots.animate(recording, tmp_path / "new" / "a.mp4")
    assert not any(tmp_path.iterdir())


def test_mp4_gets_every_frame_and_the_hold(recording, tmp_path, monkeypatch):
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
    plots.animate(recording, tmp_path / "a.mp4", episode=0, fps=10)
    assert len(frames) == len(_times(recording.trajectories.lengths[0], 10)) + 15
    assert (tmp_path / "a.mp4").read_bytes() == b"frame" * len(frames)


def test_the_next_policy_is_named_in_its_colour(make_recording):
    """Frames change where the auxiliary policy takes over, even if no robot moves."""
    recording = make_recording(episodes=1)
    episode = recording.episode(0)
    still = dataclasses.replace(episode, positions=np.repeat(episode.positions[-1:], 13, axis=0), switches=(6,))
    first, *_, last = _frames(recording, still, 2)
    middle = list(_frames(recording, still, 2))[-2]
    assert (first[:40] != middle[:40]).any()
    assert (middle[:40] != last[:40]).any()
