"""The PettingZoo environment: its checkers pass, and every agent perceives and moves as its robot does."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_hand import CONFIG, SWARM, TRIANGLE, close, played, world
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import data_equivalence
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, render_test, state_test
from pettingzoo.utils import parallel_to_aec

from murmurate import Signal
from murmurate.errors import InputError
from murmurate.geometry import neighbors_and_visible
from murmurate.interop.pettingzoo import parallel_env
from murmurate.world import GlobalSensing, LocalObservation, VisibleSensing
from murmurate.world.signals import Close

NAMES = ["robot_0", "robot_1", "robot_2"]
ROW = np.array([[-5.0, 0.0], [-1.0, 0.0], [4.0, 0.25]], np.float32)
"""Whoever stands at an end does not see the other end."""


state_of, step, observe = (
    jax.jit(kernel) for kernel in (LocalObservation.state, LocalObservation.step, LocalObservation.observe)
)


def make(**options):
    return parallel_env(**SWARM | options)


def at(env, positions=TRIANGLE, seed=0):
    return env.reset(seed=seed, options={"positions": positions})


def everyone(velocity):
    return {name: np.array(velocity, np.float32) for name in NAMES}


def one_by_one(velocities):
    return dict(zip(NAMES, velocities, strict=True))


ROUGH = VisibleSensing(
    rotation=True,
    reflection=True,
    unit_ratio=2.0,
    resample_frames=True,
    range_noise=0.1,
    bearing_noise=0.1,
    miss_probability=0.2,
)


# A robot that perceives nobody has nothing but zeros, and neither observations nor states are images.
@pytest.mark.filterwarnings("ignore:Observation numpy array is all zeros")
@pytest.mark.filterwarnings("ignore:The (observation|state) contains negative numbers")
@pytest.mark.parametrize("options", [{}, {"objective": "C2", "sensing": ROUGH}])
def test_pettingzoo_finds_nothing_wrong(options):
    parallel_api_test(make(horizon=20, **options), num_cycles=60)
    parallel_seed_test(lambda: make(horizon=20, **options))
    api_test(parallel_to_aec(make(horizon=20, **options)), num_cycles=60)
    state_test(parallel_to_aec(make(**options)), make(**options))


def test_pettingzoo_draws_in_every_mode():
    render_test(lambda render_mode: parallel_to_aec(make(render_mode=render_mode)))
    env = make(render_mode="rgb_array")
    env.reset(seed=0)
    assert (env.render().shape, env.render().dtype) == ((400, 480, 3), np.uint8)
    env.close()
    env.close()


def test_agents_and_spaces_are_constant():
    env = make()
    spaces = [(env.observation_space(name), env.action_space(name)) for name in NAMES]
    env.reset(seed=0)
    assert env.possible_agents == env.agents == NAMES
    for name, (observation, action) in zip(NAMES, spaces, strict=True):
        assert env.observation_space(name) is observation
        assert env.action_space(name) is action
    assert len({id(space) for pair in spaces for space in pair}) == 6


@pytest.mark.parametrize("kind", ["global", "scan", "visible"])
def test_agents_perceive_as_their_sensing_says(kind):
    observations, infos = at(make(sensing=kind), ROW)
    near, seen = neighbors_and_visible(ROW, CONFIG.radius, CONFIG.scan_radius)
    who = {"global": ~np.eye(3, dtype=bool), "scan": near, "visible": seen}[kind]
    for index, name in enumerate(NAMES):
        offsets = (ROW - ROW[index])[who[index]]
        offsets = offsets[np.argsort(np.linalg.norm(offsets, axis=1))]
        expected = np.zeros((3, 3))
        expected[: len(offsets)] = np.column_stack([offsets, np.ones(len(offsets))])
        expected[2] = [*-ROW[index], 1]
        close(observations[name], expected)
    assert infos["robot_0"].keys() == {"close", "safety", "neighbors", "visible"}


def test_without_a_landmark_nobody_is_told_where_to_gather():
    for options in ({"objective": "C2"}, {"sensing": GlobalSensing(landmark=False)}):
        env = make(**options)
        assert env.observation_space("robot_0").shape == at(env)[0]["robot_0"].shape == (2, 3)


class Home(Signal):
    """A signal of one's own, measured from the origin."""

    needs_landmark = True

    def __call__(self, configuration):
        return -(configuration.positions**2).sum(axis=1)


class Still(Signal):
    """A signal of one's own that is the same everywhere."""

    def __call__(self, configuration):
        return 0 * configuration.positions[:, 0]


def test_a_landmark_is_shown_where_a_signal_needs_it_whatever_its_name():
    own = {"objective": "custom", "sensing": "global"}
    for name, signal, rows in (("home", Home(), 3), ("middle", Close(), 3), ("close", Still(), 2)):
        env = make(**own, signals={name: signal})
        observations, _ = at(env)
        assert env.observation_space("robot_0").shape == observations["robot_0"].shape == (rows, 3)
        if rows == 3:
            close(observations["robot_1"][2], [*-TRIANGLE[1], 1])


def test_walls_are_shown_where_they_are_perceived():
    env = make(sensing=GlobalSensing(walls=True), half_width=20.0, half_height=15.0)
    observations, _ = at(env)
    for name, (x, y) in zip(NAMES, TRIANGLE, strict=True):
        assert env.observation_space(name).contains(observations[name])
        close(observations[name][3:], [[20 - x, 0, 1], [0, 15 - y, 1], [-20 - x, 0, 1], [0, -15 - y, 1]])


def test_frames_are_the_robots_own():
    sensing = GlobalSensing(rotation=True, reflection=True, unit_ratio=3.0)
    env = make(sensing=sensing)
    observations, _ = at(env)
    angles = []
    for index, name in enumerate(NAMES):
        others, landmark, size = observations[name][:2, :2], observations[name][2, :2], observations[name][3]
        unit = 1 / size[0]  # the radius is 1 in the world
        assert 1 / 3 <= unit <= 3
        assert size.tolist()[1:] == [0, 1]
        apart = np.sort(np.linalg.norm(np.delete(TRIANGLE, index, axis=0) - TRIANGLE[index], axis=1))
        close(unit * np.linalg.norm(others, axis=1), apart)
        close(unit * np.linalg.norm(landmark), np.linalg.norm(TRIANGLE[index]))
        angles.append(np.arctan2(*landmark) - np.arctan2(*-TRIANGLE[index]))
    assert len(np.unique(np.round(angles, 3))) == 3
    again, *_ = env.step(everyone([0.0, 0.0]))
    for name in NAMES:  # frames are kept for the episode
        close(again[name], observations[name])


def test_velocities_are_in_the_robots_own_frames():
    # Towards the landmark, wherever it seems to be, is towards the origin.
    env = make(sensing=GlobalSensing(rotation=True, reflection=True), action_scale="world")
    observations, _ = at(env)
    towards = {name: 0.4 * rows[2, :2] / np.linalg.norm(rows[2, :2]) for name, rows in observations.items()}
    env.step(towards)
    close(env.state(), TRIANGLE * (1 - 0.4 / np.linalg.norm(TRIANGLE, axis=1, keepdims=True)))


def test_an_episode_is_that_of_a_perceived_world():
    env = make(sensing=ROUGH, objective="C2", horizon=6)
    twin = jax.tree.map(jnp.asarray, LocalObservation(world("C2", 6), ROUGH, CONFIG))
    at(env, seed=7)
    # What the seed of an episode becomes, by hand.
    seed = np.random.default_rng(7).integers(2**32, size=2, dtype=np.uint32)[1]
    state = state_of(twin, jnp.asarray(TRIANGLE[..., None]), seed)
    rng = np.random.default_rng(0)
    for number in range(6):
        velocities = rng.uniform(-0.3, 0.3, (3, 2)).astype(np.float32)
        observations, rewards, terminated, truncated, _ = env.step(one_by_one(velocities / 0.5))
        state, transition = step(twin, state, jnp.asarray(velocities[..., None]))
        close(env.state(), state.positions[..., 0])
        close(list(rewards.values()), [transition.reward[0]] * 3)
        view = observe(twin, state).view
        for index, name in enumerate(NAMES):
            assert observations[name] in env.observation_space(name)
            seen = np.asarray(view.seen[index, :, 0])
            assert observations[name][:2, 2].sum() == seen.sum()
            close(np.sort(observations[name][: seen.sum(), 0]), np.sort(np.asarray(view.x[index, :, 0])[seen]))
        assert set(truncated.values()) == {number == 5}
        assert set(terminated.values()) == {False}
    assert env.agents == []


@pytest.mark.parametrize("actions", [{}, everyone([0.0, 0.0]), {"robot_0": None}])
def test_after_the_end_a_step_is_of_nobody(actions):
    env = make(horizon=2)
    assert env.agents == []
    at(env)
    env.step(everyone([0.5, 0.0]))
    observations, *_ = env.step(everyone([0.5, 0.0]))
    assert observations.keys() == set(NAMES)
    for _ in range(2):
        assert env.agents == []
        assert env.step(actions) == ({}, {}, {}, {}, {})
    close(env.state(), TRIANGLE + np.float32([0.5, 0]))
    env.reset()
    assert env.agents == NAMES
    with pytest.raises(InputError):
        env.step({})


def test_loops_that_go_on_with_whom_is_left_see_everyone_and_then_nobody():
    # As wrappers do that give dead agents blank observations, and vectors that step all environments together.
    env, alive = make(horizon=3), []
    env.reset(seed=0)
    for _ in range(5):
        observations, rewards, terminated, truncated, infos = env.step({name: np.zeros(2) for name in env.agents})
        assert observations.keys() == rewards.keys() == terminated.keys() == truncated.keys() == infos.keys()
        alive.append(len(observations))
    assert alive == [3, 3, 3, 0, 0]


def test_rewards_are_shared_or_each_robots_own():
    velocities = np.array([[0.5, 0.25], [0.0, 0.0], [-0.5, 0.5]], np.float32)
    shared, individual = make(), make(reward="robots")
    at(shared)
    at(individual)
    together = shared.step(one_by_one(velocities / 0.5))[1]
    apart = individual.step(one_by_one(velocities / 0.5))[1]
    _, (transition,) = played(world(per_robot_credit=True), TRIANGLE, [velocities])
    close(list(together.values()), [float(transition.reward)] * 3)
    close(list(apart.values()), transition.credit)
    assert len(set(apart.values())) == 3
    assert {type(value) for value in (together | apart).values()} == {float}


def test_a_collision_ends_the_episode_for_all_and_is_charged_to_whom_it_concerns():
    # They pass through each other within one step.
    env = make(reward="robots", max_speed=4.0, sensing="global")
    at(env, np.array([[-2.0, 0.0], [2.0, 0.5], [0.0, 8.0]]))
    observations, rewards, terminated, truncated, infos = env.step(one_by_one([[1.0, 0], [-1.0, 0], [0, 0]]))
    assert list(rewards.values()) == [-1, -1, 0]
    assert set(terminated.values()) == {True}
    assert set(truncated.values()) == {False}
    assert observations.keys() == infos.keys() == set(NAMES)
    assert env.agents == []
    close(env.state(), [[2, 0], [-2, 0.5], [0, 8]])


def test_whoever_leaves_the_world_is_still_in_the_spaces():
    env = make(sensing="global")
    at(env, np.array([[12.0, 10.0], [0.0, 0.0], [-12.0, -10.0]]))
    observations, _, terminated, *_ = env.step(one_by_one([[1.0, 1.0], [0, 0], [-1.0, -1.0]]))
    assert all(terminated.values())
    assert env.state() in env.state_space
    for name in NAMES:
        assert observations[name] in env.observation_space(name)


def test_the_same_seed_gives_the_same_episodes_and_another_others():
    first, second = make(sensing=ROUGH, objective="C2"), make(sensing=ROUGH, objective="C2")
    assert data_equivalence(first.reset(seed=1), second.reset(seed=1), exact=True)
    for _ in range(5):
        actions = everyone([0.3, -0.2])
        assert data_equivalence(first.step(actions), second.step(actions), exact=True)
        if not first.agents:
            assert data_equivalence(first.reset(), second.reset(), exact=True)
    state = first.state()
    first.reset(seed=2)
    assert (first.state() != state).all()
    second.reset(seed=3)
    assert (first.state() != second.state()).all()


def test_arrays_are_handed_out_once():
    env, other = make(), make()
    at(env)
    at(other)
    for _ in range(3):
        actions = everyone([0.3, -0.2])
        result, expected = env.step(actions), other.step(everyone([0.3, -0.2]))
        assert data_equivalence(result, expected, exact=True)
        np.testing.assert_array_equal(env.state(), other.state())
        for array in (*actions.values(), *result[0].values(), env.state()):
            array[:] = 1
        result[4]["robot_0"].clear()
        result[4].clear()


def test_actions_are_clipped_and_checked():
    env = make()
    at(env)
    env.step(everyone([9.0, -9.0]))
    np.testing.assert_array_equal(env.state(), TRIANGLE + np.float32([0.5, -0.5]))
    good = everyone([0.0, 0.0])
    for wrong in (
        good | {"robot_1": np.array([np.nan, 0])},
        good | {"robot_1": np.zeros(3)},
        good | {"robot_3": np.zeros(2)},
        {"robot_0": np.zeros(2)},
    ):
        with pytest.raises(InputError, match="action"):
            env.step(wrong)


def test_everything_comes_after_a_reset():
    env = make(render_mode="rgb_array")
    for call in (lambda: env.step(everyone([0, 0])), env.state, env.render):
        with pytest.raises(ResetNeeded, match="reset"):
            call()


def test_rendering_without_a_mode_is_warned_of():
    env = make()
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode"):
        assert env.render() is None


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"sensing": "sonar"}, "sensing"),
        ({"reward": "team"}, "reward"),
        ({"render_mode": "ansi"}, "render_mode"),
        ({"robots": 0}, "robots"),
        ({"speed": 1.0}, "speed"),
    ],
)
def test_wrong_keywords_are_refused_by_name(options, field):
    with pytest.raises(InputError) as error:
        make(**options)
    assert error.value.field == field


@pytest.mark.unchecked
def test_options_and_actions_that_are_no_mappings_are_refused():
    env = make()
    with pytest.raises(InputError, match=r"^options = 3: must be a mapping"):
        env.reset(options=3)
    env.reset(seed=0)
    for actions in (None, 3, NAMES):
        with pytest.raises(InputError, match=r"^actions = .*: must be a mapping with one for each of robot_0"):
            env.step(actions)


def test_impossible_starts_are_refused():
    with pytest.raises(InputError, match="apart"):
        at(make(), TRIANGLE * 0.1)
