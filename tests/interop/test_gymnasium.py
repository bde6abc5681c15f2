"""The Gymnasium environment: its checkers pass, and where they are blind, it is the world stepped by hand."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import gymnasium
import numpy as np
import pytest
from by_hand import CONFIG, SWARM, TRIANGLE, close, played, world
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.wrappers import FlattenObservation, RecordVideo
from matplotlib import pyplot
from matplotlib.colors import to_rgb

import murmurate.interop.gymnasium as adapter
from murmurate.errors import InputError
from murmurate.geometry import neighbors_and_visible
from murmurate.interop.gathering import FPS, MAX_PATH, Camera
from murmurate.plots.style import POLICIES
from murmurate.world import ScatteredStart, WorldConfig, scaled_to


def make(**options):
    return gymnasium.make(adapter.ENV_ID, **SWARM | options)


def bare(**options):
    """The environment without Gymnasium's wrappers, which check some of the same."""
    return make(**options).unwrapped


def at(env, positions=TRIANGLE):
    return env.reset(seed=0, options={"positions": positions})


def episode(env, seed):
    """A whole episode of random actions; all that comes out of it."""
    env.action_space.seed(seed)
    result = [env.reset(seed=seed)]
    while True:
        result.append(env.step(env.action_space.sample()))
        if result[-1][2] or result[-1][3]:
            return result


@pytest.mark.parametrize("observations", ["positions", "sensing"])
@pytest.mark.parametrize("objective", ["C1", "C2"])
def test_gymnasium_finds_nothing_wrong(observations, objective):
    check_env(bare(observations=observations, objective=objective))


def test_a_frame_shows_the_configuration():
    with make(render_mode="rgb_array") as env:
        env.reset(seed=0)
        first = env.render()
        assert (first.shape, first.dtype) == ((400, 480, 3), np.uint8)
        env.step(np.ones((3, 2)))
        second = env.render()
        assert (first != second).any()
        env.close()
        np.testing.assert_array_equal(env.render(), second)


def path_pixels(picture):
    """How much of a picture is in the blue of paths: nothing else is as blue."""
    red, _, blue = np.moveaxis(picture.astype(int), -1, 0)
    return (blue - red > 60).sum()


def test_a_frame_shows_sight_lines_paths_and_the_step():
    env = make(render_mode="rgb_array", max_speed=2.0)
    at(env)
    env.render()
    swarm, ax = env.unwrapped._camera._swarm, env.unwrapped._camera._figure.axes[0]
    near, seen = neighbors_and_visible(TRIANGLE, CONFIG.radius, CONFIG.scan_radius)
    assert len(swarm.clear.get_segments()) == np.triu(near & seen & seen.T).sum() == 3
    assert [text.get_text() for text in ax.texts] == ["step 0"]
    places = [TRIANGLE, *(env.step(np.tile([0.9, 0.5], (3, 1)))[0] for _ in range(3))]
    picture = env.render()  # without a picture of the steps between
    assert [text.get_text() for text in ax.texts] == ["step 3"]
    (paths,) = (lines for lines in ax.collections if len(lines.get_paths()) == 9)
    expected = np.stack([places[:-1], places[1:]], axis=2).reshape(-1, 2, 2)
    close(np.array([path.vertices for path in paths.get_paths()]), expected)
    close(paths.get_colors()[-1][:3], to_rgb(POLICIES[0]))
    at(env)
    assert path_pixels(picture) > 10
    assert path_pixels(env.render()) == 0  # a new episode has no path
    assert [text.get_text() for text in ax.texts] == ["step 0"]


def test_every_world_of_many_has_its_own_path():
    env = gymnasium.make_vec(adapter.ENV_ID, num_envs=2, render_mode="rgb_array", **SWARM | {"max_speed": 4.0})
    env.reset(seed=0, options={"positions": np.stack([TRIANGLE, TRIANGLE])})
    moves = np.zeros((2, 3, 2), np.float32)
    moves[1] = 1
    env.step(moves)
    still, moving = env.render()
    assert path_pixels(still) == 0
    assert path_pixels(moving) > 10
    assert still.shape == moving.shape == (400, 480, 3)


def test_paths_of_long_episodes_are_bounded():
    camera = Camera(bare()._gathering, "rgb_array", ["rgb_array"])
    episodes = SimpleNamespace(positions=TRIANGLE[None])
    camera.follow(episodes, np.ones(1, bool))
    for _ in range(MAX_PATH + 50):
        camera.follow(episodes)
    assert len(camera._paths[0]) == MAX_PATH + 1
    assert camera._steps == [MAX_PATH + 50]


def test_a_video_has_a_frame_for_every_step(monkeypatch, tmp_path):
    videos = []

    class ImageSequenceClip:
        def __init__(self, frames, fps):
            videos.append((len(frames), frames[0].shape, frames[0].dtype, fps))

        def write_videofile(self, path, **_):
            Path(path).touch()

    names = ("moviepy", "moviepy.video", "moviepy.video.io", "moviepy.video.io.ImageSequenceClip")
    modules = {name: ModuleType(name) for name in names}
    modules[names[-1]].ImageSequenceClip = ImageSequenceClip
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    env = RecordVideo(
        make(render_mode="rgb_array", horizon=4), str(tmp_path / "videos"), episode_trigger=lambda _: True
    )
    at(env)
    for _ in range(4):
        env.step(np.zeros((3, 2)))
    env.close()
    assert videos == [(5, (400, 480, 3), np.uint8, FPS)]


def test_a_window_is_drawn_at_every_step_and_closed_once():
    env = bare(render_mode="human")
    env.reset(seed=0)
    assert len(pyplot.get_fignums()) == 1
    env.step(np.zeros((3, 2)))
    assert env.render() is None
    pyplot.close("all")
    env.step(np.zeros((3, 2)))  # the user closed the window: nothing is shown any more
    assert not pyplot.get_fignums()
    env.close()
    env.close()


def test_pictures_leave_the_figures_of_others_alone():
    env = bare(render_mode="rgb_array")
    env.reset(seed=0)
    env.render()
    assert not pyplot.get_fignums()


def test_rendering_without_a_mode_is_warned_of():
    env = bare()
    with pytest.raises(ResetNeeded):
        env.render()
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode"):
        assert env.render() is None


def test_registering_again_is_silent():
    adapter.register()
    assert gymnasium.make(f"murmurate.interop.gymnasium:{adapter.ENV_ID}", **SWARM).observation_space.shape == (3, 2)


def test_gymnasiums_own_wrappers_and_vectors_take_it():
    env = FlattenObservation(make(observations="sensing"))
    assert env.reset(seed=0)[0].shape == (3 * 2 + 2 * 9,)
    many = gymnasium.make_vec(adapter.ENV_ID, num_envs=2, vectorization_mode="sync", **SWARM)
    assert many.reset(seed=0)[0].shape == (2, 3, 2)


@pytest.mark.parametrize("scale", ["unit", "world"])
@pytest.mark.parametrize("objective", ["C1", "C2"])
def test_an_episode_is_the_worlds(scale, objective):
    rng = np.random.default_rng(0)
    velocities = rng.uniform(-0.5, 0.5, (6, 3, 2)).astype(np.float32)
    seen, transitions = played(world(objective, horizon=6), TRIANGLE, velocities)
    env = make(objective=objective, horizon=6, action_scale=scale)
    observation, _ = at(env)
    np.testing.assert_array_equal(observation, TRIANGLE)
    for number, (velocity, positions, transition) in enumerate(zip(velocities, seen, transitions, strict=True)):
        observation, reward, terminated, truncated, info = env.step(velocity * (env.action_space.high / 0.5))
        close(observation, positions)
        close(reward, transition.reward)
        assert (terminated, truncated) == (False, number == 5)
        assert info.keys() == transition.signals.keys()
        close(list(info.values()), list(transition.signals.values()))
        assert all(type(value) is float for value in info.values())


def test_weights_count():
    weights = dict.fromkeys(("close", "safety", "neighbors", "visible"), 0.0)
    env = make(weights=weights)
    at(env)
    assert env.step(np.ones((3, 2)))[1] == 0


def test_sensing_says_who_neighbours_and_who_sees_whom():
    env = make(observations="sensing")
    row = np.array([[-8.0, 0.0], [-2.0, 0.0], [4.0, 0.5]])
    observation, _ = at(env, row)
    near, seen = neighbors_and_visible(row, CONFIG.radius, CONFIG.scan_radius)
    np.testing.assert_array_equal(observation["neighbors"], near)
    np.testing.assert_array_equal(observation["visible"], seen)
    assert observation in env.observation_space


def test_robots_that_cross_within_a_step_collide():
    # At the end of the step they are as far apart as before it: only on the way do they touch.
    env = make(max_speed=4.0, collision_penalty=3.0)
    at(env, np.array([[-2.0, 0.0], [2.0, 0.5], [0.0, 8.0]]))
    _, reward, terminated, truncated, _ = env.step(np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 0.0]]))
    assert (reward, terminated, truncated) == (-3.0, True, False)


def test_who_leaves_the_world_is_observed_outside_and_in_the_space():
    env = bare()
    at(env, np.array([[12.0, 10.0], [0.0, 0.0], [-12.0, -10.0]]))
    observation, _, terminated, _, _ = env.step(np.array([[1.0, 1.0], [0.0, 0.0], [-1.0, -1.0]]))
    assert terminated
    np.testing.assert_array_equal(observation[[0, 2]], [[12.5, 10.5], [-12.5, -10.5]])
    assert observation in env.observation_space


def test_actions_beyond_their_bounds_are_clipped():
    wild, tame = np.array([[9.0, -9.0], [1.5, 0.2], [-1e300, 0.0]]), np.array([[1, -1], [1, 0.2], [-1, 0]])
    env = bare()
    at(env)
    first = env.step(wild)[0]
    at(env)
    np.testing.assert_array_equal(first, env.step(tame)[0])
    np.testing.assert_array_equal(first[0], TRIANGLE[0] + [0.5, -0.5])


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.full((3, 2), np.nan), "finite"),
        (np.full((3, 2), -np.inf), "finite"),
        (np.zeros((2, 2)), r"shape \(3, 2\)"),
        (np.zeros(6), r"shape \(3, 2\)"),
        ([[0.0, 0.0], [0.0]], "ragged"),
        (np.full((3, 2), "up"), "real numbers"),
        (None, "shape"),
    ],
)
def test_impossible_actions_are_refused_and_change_nothing(action, message):
    env = bare()
    before, _ = at(env)
    with pytest.raises(InputError, match=message) as error:
        env.step(action)
    assert error.value.field == "action"
    np.testing.assert_array_equal(env.step(np.zeros((3, 2)))[0], before)


def test_steps_belong_to_an_episode():
    for env in (make(horizon=1), bare(horizon=1)):
        with pytest.raises(ResetNeeded, match="reset"):
            env.step(np.zeros((3, 2)))
        env.reset(seed=0)
        assert env.step(np.zeros((3, 2)))[3]
        with pytest.raises(ResetNeeded, match="reset"):
            env.step(np.zeros((3, 2)))
        env.reset()
        env.step(np.zeros((3, 2)))


def test_the_same_seed_gives_the_same_episode_and_another_another():
    env, other = make(observations="sensing", horizon=20), make(observations="sensing", horizon=20)
    for seed in (0, 1):
        assert data_equivalence(episode(env, seed), episode(other, seed), exact=True)
    starts = [env.reset(seed=seed)[0]["positions"] for seed in (0, 1, 0)]
    assert (starts[0] != starts[1]).all()
    np.testing.assert_array_equal(starts[0], starts[2])


def test_without_a_seed_starts_go_on():
    env, other = make(), make()
    for environment in (env, other):
        environment.reset(seed=3)
    starts = [env.reset()[0] for _ in range(3)]
    assert (starts[0] != starts[1]).all()
    assert (starts[1] != starts[2]).all()
    for start in starts:
        np.testing.assert_array_equal(start, other.reset()[0])


def test_arrays_are_handed_out_once():
    env, other = bare(observations="sensing"), bare(observations="sensing")
    given = TRIANGLE.copy()
    env.reset(seed=0, options={"positions": given})
    given[:] = 0
    at(other)
    pairs = []
    for _ in range(4):
        action = np.full((3, 2), 0.25, np.float32)
        observation, *_, info = env.step(action)
        expected, *_ = other.step(np.full((3, 2), 0.25))
        assert data_equivalence(observation, expected, exact=True)
        pairs.append((observation, expected))
        for written in (action, *observation.values()):
            written[:] = 7
        info.clear()
    for observation, expected in pairs:
        assert all((array == 7).all() for array in observation.values())
        assert len(np.unique(expected["positions"])) > 1


def test_spaces_are_the_same_objects():
    env = bare()
    assert env.observation_space is env.observation_space
    assert env.action_space is env.action_space
    assert "autoreset_mode" not in adapter.GatheringEnv.metadata


def test_sizes_grow_with_the_swarm_unless_they_are_given():
    expected = scaled_to(WorldConfig(), 3)
    high = gymnasium.make(adapter.ENV_ID, robots=3, half_height=30.0).observation_space.high
    close(high, np.tile([expected.half_width + 1, 31], (3, 1)))


def test_starts_are_chosen_by_name_or_in_full():
    ends = [env.reset(seed=0)[0] for env in (bare(start="scattered"), bare(start=ScatteredStart()))]
    np.testing.assert_array_equal(*ends)
    still = bare(start=ScatteredStart(noise=0.0)).reset(seed=0)[0]
    close(np.linalg.norm(still, axis=1), 10.0)


@pytest.mark.parametrize(
    ("options", "field", "message"),
    [
        ({"half_widht": 3.0}, "half_widht", "did you mean half_width"),
        ({"robots": 1}, "robots", ">= 2"),
        ({"robots": 2.5}, "robots", "integer"),
        ({"radius": -1.0}, "radius", "> 0"),
        ({"objective": "C3"}, "objective", "C1, C2"),
        ({"start": "anywhere"}, "start", "random"),
        ({"start": "file"}, "start.file", "CSV file"),
        ({"weights": 3}, "weights", "a mapping"),
        ({"horizon": 0}, "horizon", ">= 1"),
        ({"observations": "pixels"}, "observations", "sensing"),
        ({"action_scale": 2.0}, "action_scale", "unit, world"),
    ],
)
def test_wrong_keywords_are_refused_by_name(options, field, message):
    with pytest.raises(InputError, match=message) as error:
        make(**options)
    assert error.value.field == field


def test_unknown_render_modes_are_refused():
    with pytest.raises(InputError, match="rgb_array, human"):
        adapter.GatheringEnv(**SWARM, render_mode="ansi")


@pytest.mark.parametrize(
    ("positions", "message"),
    [
        (TRIANGLE[:2], r"shape \(3, 2\)"),
        (TRIANGLE * np.nan, "finite"),
        (TRIANGLE * 3.1, "inside"),
        (TRIANGLE.astype(float) * 1e300, "inside"),
        (TRIANGLE * 0.1, "apart"),
    ],
)
def test_impossible_starts_are_refused(positions, message):
    env = bare()
    with pytest.raises(InputError, match=message):
        at(env, positions)


@pytest.mark.unchecked
@pytest.mark.parametrize("options", [[1], 3, "positions"])
def test_options_that_are_no_mapping_are_refused(options):
    for env in (bare(), adapter.GatheringVectorEnv(2, **SWARM)):
        with pytest.raises(InputError, match=r"^options = .*: must be a mapping"):
            env.reset(options=options)


def test_unknown_options_are_refused():
    with pytest.raises(InputError, match="positions"):
        bare().reset(options={"position": TRIANGLE})
