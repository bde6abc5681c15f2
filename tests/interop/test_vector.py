"""The vector environment: each of its worlds is the single environment, and ends as Gymnasium's autoreset modes say."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from by_hand import SWARM, TRIANGLE, close, played, signals_of, world
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from murmurate.errors import InputError
from murmurate.interop import gathering
from murmurate.interop.gymnasium import ENV_ID, GatheringEnv, GatheringVectorEnv

ENVS = 4
STILL = np.zeros((ENVS, 3, 2), np.float32)
MODES = list(AutoresetMode)


def make(mode=AutoresetMode.NEXT_STEP, **options):
    options = {"num_envs": ENVS, "autoreset_mode": mode} | SWARM | options
    return gymnasium.make_vec(ENV_ID, vectorization_mode="vector_entry_point", **options)


def triangles(*at_wall):
    """Starts of which some have a robot at the wall."""
    starts = np.tile(TRIANGLE, (ENVS, 1, 1))
    for index in at_wall:
        starts[index, 2] = [0.0, 10.0]
    return starts


def up(*which):
    """Actions: the last robot of these worlds, at the wall, leaves."""
    actions = STILL.copy()
    for index in which:
        actions[index, 2, 1] = 1.0
    return actions


def begin(mode, at_wall=(1,), **options):
    env = make(mode, **options)
    env.reset(seed=5, options={"positions": triangles(*at_wall)})
    return env


def fresh(observation):
    return not np.isin(observation, TRIANGLE).any() and (np.abs(observation) <= [12, 10]).all()


def test_make_vec_makes_one_program_of_many_worlds():
    env = make(AutoresetMode.SAME_STEP, render_mode="rgb_array")
    assert isinstance(env, GatheringVectorEnv)
    # Gymnasium's own vector environments have both, and other packages read either.
    assert env.metadata["autoreset_mode"] is env.autoreset_mode is AutoresetMode.SAME_STEP
    assert "autoreset_mode" not in GatheringVectorEnv.metadata
    assert make("Disabled").metadata["autoreset_mode"] is AutoresetMode.DISABLED
    assert env.single_observation_space.shape == (3, 2)
    assert env.observation_space.shape == (ENVS, 3, 2)
    assert env.observation_space is env.observation_space
    assert env.action_space is env.action_space
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    assert (observation.dtype, env.unwrapped) == (np.float32, env)
    frames = env.render()
    assert [frame.shape for frame in frames] == [(400, 480, 3)] * ENVS
    assert (frames[0] != frames[1]).any()
    env.close()
    env.close()


@pytest.mark.parametrize("observations", ["positions", "sensing"])
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_a_vector_of_one_is_gymnasiums_vector_of_the_single_environment(mode, observations):
    vector = make(mode, num_envs=1, observations=observations, horizon=9)
    maker = [lambda: GatheringEnv(**SWARM, observations=observations, horizon=9)]
    sync_vector = SyncVectorEnv(maker, autoreset_mode=mode)
    assert vector.observation_space == sync_vector.observation_space
    assert vector.action_space == sync_vector.action_space
    assert data_equivalence(vector.reset(seed=2), sync_vector.reset(seed=2), exact=True)
    vector.action_space.seed(2)
    ends = 0
    for _ in range(40):
        actions = vector.action_space.sample()
        result, expected = vector.step(actions), sync_vector.step(actions)
        assert data_equivalence(list(result), list(expected), exact=True)
        ends += result[2][0] or result[3][0]
    assert ends >= 3


def test_every_world_is_stepped_as_by_hand():
    velocities = np.random.default_rng(0).uniform(-0.4, 0.4, (ENVS, 5, 3, 2)).astype(np.float32)
    env, starts = make(action_scale="world"), triangles() + np.arange(ENVS, dtype=np.float32)[:, None, None]
    env.reset(seed=0, options={"positions": starts})
    hand = [played(world(), starts[index], velocities[index]) for index in range(ENVS)]
    for number in range(5):
        observation, reward, terminated, truncated, infos = env.step(velocities[:, number])
        assert not (terminated | truncated).any()
        for index, (seen, transitions) in enumerate(hand):
            close(observation[index], seen[number])
            close(reward[index], transitions[number].reward)
            for name, value in transitions[number].signals.items():
                close(infos[name][index], value)
                assert infos[f"_{name}"].all()


def test_next_step_hands_out_the_end_and_then_a_fresh_start():
    env = begin(AutoresetMode.NEXT_STEP)
    (seen,), (transition,) = played(world(), triangles(1)[1], [up(1)[1]])
    observation, reward, terminated, truncated, _ = env.step(up(1))
    assert terminated.tolist() == [False, True, False, False]
    assert not truncated.any()
    close(observation[1], seen)
    close(reward[1], transition.reward)
    observation, reward, terminated, truncated, infos = env.step(np.ones_like(STILL))
    assert not (terminated | truncated).any()
    assert reward[1] == 0
    assert fresh(observation[1])
    close(observation[0], TRIANGLE + 0.5)
    assert "final_obs" not in infos


def test_same_step_hands_out_the_end_beside_a_fresh_start():
    env = begin(AutoresetMode.SAME_STEP)
    outside = np.concatenate([TRIANGLE[:2], [[0.0, 10.5]]], dtype=np.float32)
    observation, reward, terminated, _, infos = env.step(up(1))
    assert terminated.tolist() == [False, True, False, False]
    assert reward[1] == -1
    assert fresh(observation[1])
    np.testing.assert_array_equal(observation[0], TRIANGLE)
    np.testing.assert_array_equal(infos["_final_obs"], terminated)
    np.testing.assert_array_equal(infos["_final_info"], terminated)
    np.testing.assert_array_equal(infos["final_obs"][1], outside)
    assert [infos["final_obs"][index] for index in (0, 2, 3)] == [None] * 3
    final = infos["final_info"]
    for name, value in signals_of(world(), outside).items():
        close(final[name][1], value)
        np.testing.assert_array_equal(final[f"_{name}"], terminated)
        close(infos[name][1], signals_of(world(), observation[1])[name])
    observation, reward, *_, infos = env.step(STILL)
    assert reward.tolist() == [0.0] * ENVS
    assert "final_obs" not in infos


def test_disabled_waits_for_a_mask():
    env = begin(AutoresetMode.DISABLED)
    observation, *_ = env.step(up(1))
    assert observation[1, 2, 1] == 10.5
    with pytest.raises(ResetNeeded):
        env.step(STILL)
    mask = np.array([False, True, False, False])
    observation, infos = env.reset(options={"reset_mask": mask})
    assert fresh(observation[1])
    np.testing.assert_array_equal(observation[[0, 2, 3]], triangles()[[0, 2, 3]])
    np.testing.assert_array_equal(infos["_close"], mask)
    assert (infos["close"] != 0).tolist() == mask.tolist()
    env.step(STILL)


def test_a_mask_restarts_at_given_positions_too():
    env, mask = begin(AutoresetMode.DISABLED), np.array([False, True, True, False])
    given = np.full_like(STILL, np.nan)
    given[mask] = TRIANGLE + 1
    observation, _ = env.reset(options={"reset_mask": mask, "positions": given})
    np.testing.assert_array_equal(observation[mask], given[mask])
    np.testing.assert_array_equal(observation[[0, 3]], triangles()[[0, 3]])


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_a_time_limit_counts_from_every_start_anew(mode):
    env = begin(mode, horizon=3)
    ends = []
    for number in range(12):
        *_, terminated, truncated, _ = env.step(up(1) if number == 0 else STILL)
        ends.append((terminated | truncated).astype(int).tolist())
        assert not (terminated & truncated).any()
    pause = mode is AutoresetMode.NEXT_STEP
    expected = np.zeros((12, ENVS), int)
    expected[2 :: 3 + pause, [0, 2, 3]] = 1
    expected[0, 1] = 1
    expected[3 + pause :: 3 + pause, 1] = 1
    np.testing.assert_array_equal(ends, expected)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_whole_runs_repeat_and_starts_never_do(mode):
    runs = []
    for seed in (0, 0, 1):
        env = make(mode, horizon=4)
        env.action_space.seed(0)
        result = [env.reset(seed=seed)[0]]
        result += [env.step(env.action_space.sample())[0] for _ in range(16)]
        runs.append(np.stack(result))
    np.testing.assert_array_equal(runs[0], runs[1])
    assert (runs[0][0] != runs[2][0]).any(axis=(1, 2)).all()
    # Nobody is ever twice at the very same place, least of all at a start.
    places = runs[0].reshape(-1, 2)
    assert len(np.unique(places, axis=0)) == len(places)


def test_starts_go_on_without_a_seed():
    env = make()
    first, second = env.reset(seed=0)[0], env.reset()[0]
    assert (first != second).all()
    assert len(np.unique(first.reshape(-1, 2), axis=0)) == 3 * ENVS
    np.testing.assert_array_equal(env.reset(seed=0)[0], first)


def test_arrays_are_handed_out_once():
    env, other = begin(AutoresetMode.SAME_STEP), begin(AutoresetMode.SAME_STEP)
    for number in range(4):
        actions = up(1) if number == 1 else STILL.copy()
        result, expected = env.step(actions), other.step(actions.copy())
        assert data_equivalence(list(result), list(expected), exact=True)
        *arrays, infos = result
        for array in (actions, *arrays, infos["close"], infos["_close"]):
            array[:] = 1
        if "final_obs" in infos:
            infos["final_obs"][1][:] = 1
            infos["_final_obs"][:] = True


@pytest.mark.parametrize("mode", MODES)
def test_nothing_is_compiled_after_the_first_steps(mode):
    programs = (gathering._begin, gathering._advance, gathering._draw, gathering._replace)
    env = begin(mode)
    seen = None
    for number in range(6):
        *_, terminated, truncated, _ = env.step(up(1) if number in (0, 3) else STILL)
        if mode is AutoresetMode.DISABLED and (terminated | truncated).any():
            env.reset(options={"reset_mask": terminated | truncated})
        env.reset(seed=number, options={"positions": triangles(1)}) if number == 2 else None
        if number == 1:
            seen = [program._cache_size() for program in programs]
    assert [program._cache_size() for program in programs] == seen


def test_actions_are_clipped_and_checked():
    env = begin(AutoresetMode.NEXT_STEP, at_wall=())
    np.testing.assert_array_equal(env.step(STILL + 5)[0], triangles() + 0.5)
    for wrong in (STILL + np.nan, STILL[:2], STILL[0]):
        with pytest.raises(InputError) as error:
            env.step(wrong)
        assert error.value.field == "action"


def test_steps_and_masks_come_after_a_reset():
    env = make(render_mode="rgb_array")
    for call in (lambda: env.step(STILL), env.render):
        with pytest.raises(ResetNeeded):
            call()
    with pytest.raises(ResetNeeded):
        env.reset(options={"reset_mask": np.ones(ENVS, bool)})


@pytest.mark.parametrize("mask", [[True], [False] * ENVS, [1] * ENVS, "all"])
def test_impossible_masks_are_refused(mask):
    with pytest.raises(InputError, match="boolean"):
        begin(AutoresetMode.DISABLED).reset(options={"reset_mask": mask})


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"num_envs": 0}, "num_envs"),
        ({"num_envs": 2.5}, "num_envs"),
        ({"mode": "Never"}, "autoreset_mode"),
        ({"render_mode": "human"}, "render_mode"),
        ({"widht": 3}, "widht"),
    ],
)
def test_wrong_keywords_are_refused_by_name(options, field):
    with pytest.raises(InputError) as error:
        make(**options)
    assert error.value.field == field


def test_impossible_starts_are_refused():
    env = make()
    with pytest.raises(InputError, match=rf"\({ENVS}, 3, 2\)"):
        env.reset(options={"positions": TRIANGLE})
    with pytest.raises(InputError, match="start 2"):
        env.reset(options={"positions": triangles() * np.array([1, 1, 9, 1])[:, None, None]})
    with pytest.raises(InputError, match="reset_mask"):
        env.reset(options={"mask": None})


def test_every_world_may_have_a_seed_of_its_own():
    env, single = make(), gymnasium.make(ENV_ID, **SWARM)
    seeds = [7, 1, 7, 3]
    observation, _ = env.reset(seed=seeds)
    for index, seed in enumerate(seeds):
        np.testing.assert_array_equal(observation[index], single.reset(seed=seed)[0])
    again = single.reset()[0]  # the starts that follow are those of the seed, too
    np.testing.assert_array_equal(env.reset()[0][3], again)
    np.testing.assert_array_equal(env.reset(seed=np.array(seeds))[0], observation)
    np.testing.assert_array_equal(env.reset(seed=tuple(seeds))[0], observation)


def test_a_world_without_a_seed_goes_on_as_it_was():
    env, twin = make(), make()
    for environment in (env, twin):
        environment.reset(seed=5)
    observation = env.reset(seed=[None, 2, None, None])[0]
    np.testing.assert_array_equal(observation, twin.reset(seed=[None, 2, None, None])[0])
    np.testing.assert_array_equal(observation[1], gymnasium.make(ENV_ID, **SWARM).reset(seed=2)[0])
    assert len(np.unique(observation.reshape(-1, 2), axis=0)) == 3 * ENVS
    following = env.reset(seed=[2, None, None, None])[0]
    np.testing.assert_array_equal(following[0], observation[1])
    np.testing.assert_array_equal(following[1:], twin.reset()[0][1:])


def test_a_new_start_is_of_the_worlds_own_seed():
    env, single = make(AutoresetMode.SAME_STEP, horizon=2), gymnasium.make(ENV_ID, **SWARM)
    env.reset(seed=[3, 4, 5, 6], options={"positions": triangles(1)})
    starts = env.step(up(1))[0][1], env.step(STILL)[0][[0, 2, 3]]
    single.reset(seed=4)
    np.testing.assert_array_equal(starts[0], single.reset()[0])
    for seed, start in zip([3, 5, 6], starts[1], strict=True):
        single.reset(seed=seed)
        np.testing.assert_array_equal(start, single.reset()[0])


def test_masked_worlds_alone_take_their_seeds():
    env, twin = make(AutoresetMode.DISABLED), make(AutoresetMode.DISABLED)
    for environment in (env, twin):
        environment.reset(seed=[1, 2, 3, 4])
    mask = np.array([True, False, False, True])
    env.reset(seed=[9, 9, 9, None], options={"reset_mask": mask})
    starts, twin_starts = env.reset()[0], twin.reset()[0]
    np.testing.assert_array_equal(starts[1:3], twin_starts[1:3])
    assert (starts[0] != twin_starts[0]).all()
    np.testing.assert_array_equal(starts[3], twin.reset()[0][3])


@pytest.mark.parametrize(
    ("seed", "field"),
    [([1, 2], "seed"), ("1234", "seed"), (2.5, "seed"), ([0, -1, 0, 0], "seed[1]"), ([0.5] * 4, "seed[0]")],
)
def test_impossible_seeds_are_refused(seed, field):
    env = make()
    before = env.reset(seed=1)[0]
    with pytest.raises(InputError) as error:
        env.reset(seed=seed)
    assert error.value.field == field
    assert (env.reset(seed=1)[0] == before).all()
