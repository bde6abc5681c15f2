"""The rest rule, with policies whose steps can be counted."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from handmade import Turn, approach, shake

import murmurate
from murmurate import prng
from murmurate.discovery import STATIONARY_STEPS, Cascade, RestRule, check_validity
from murmurate.discovery import cascade as cascade_module
from murmurate.errors import InputError
from murmurate.policies.baselines import Baseline
from murmurate.world import (
    AsyncScheduler,
    DeadZone,
    JitteredStart,
    LocalObservation,
    SchedulerWrapper,
    SlowMoves,
    UniformStart,
    VisibleSensing,
    World,
    WorldConfig,
    draw_starts,
    episodes_at_once,
    with_array_leaves,
)
from murmurate.world import starts as starts_module
from oracles import signals as oracle

CONFIG = WorldConfig(robots=2, half_width=20.0, half_height=20.0, scan_radius=100.0, safe_distance=5.0)
WINDOW = 4
RULE = RestRule(window=WINDOW, switch_tolerance=1e-3, max_steps=30)


def world():
    return with_array_leaves(World.create(CONFIG, JitteredStart(jnp.zeros((1, 2, 2))), "C2", horizon=3))


def run(policies, *distances, rule=RULE, on_chunk=None):
    """Runs a cascade from two robots at x and -x, one episode for each x; the world's horizon is 3."""
    assert len(distances) == 4, "one size, one compilation"
    starts = np.array([[[x, 0.0], [-x, 0.0]] for x in distances])
    return Cascade(tuple(policies), world(), rule).rollout(starts, on_chunk=on_chunk)


def assert_holds_still(trajectories):
    for positions, length in zip(trajectories.positions, trajectories.lengths, strict=True):
        np.testing.assert_array_equal(positions[length:], np.broadcast_to(positions[length], positions[length:].shape))


def test_a_policy_rests_a_window_after_its_last_move():
    trajectories = run([approach(5)], 5, 6, 10, 18)
    np.testing.assert_array_equal(trajectories.lengths, np.array([0, 1, 5, 13]) + WINDOW)
    assert trajectories.at_rest.all()
    assert not trajectories.terminated.any()
    assert trajectories.switch.shape == (4, 0)
    assert trajectories.positions.shape == (4, 13 + WINDOW + 1, 2, 2)
    np.testing.assert_array_equal(trajectories.final, np.tile([[5.0, 0.0], [-5.0, 0.0]], (4, 1, 1)))
    assert_holds_still(trajectories)


def test_the_next_policy_takes_over_at_rest():
    trajectories = run([approach(8), approach(4)], 10, 8, 5, 4)
    np.testing.assert_array_equal(trajectories.switch[:, 0], np.array([2, 0, 0, 0]) + WINDOW)
    np.testing.assert_array_equal(trajectories.lengths, np.array([2 + 4, 4, 1, 0]) + 2 * WINDOW)
    np.testing.assert_array_equal(trajectories.positions[0, trajectories.switch[0, 0], :, 0], [8, -8])
    np.testing.assert_array_equal(trajectories.final[..., 0], np.tile([4.0, -4.0], (4, 1)))
    assert trajectories.at_rest.all()
    assert_holds_still(trajectories)


def test_every_chunk_is_reported_and_may_end_the_rollout():
    reported = []
    run([shake(), approach(4)], 8.5, 4, 8.5, 7.5, on_chunk=lambda *numbers: reported.append(numbers))
    assert reported == [(30 + 5 + WINDOW, 60, 4)]

    def interrupt(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run([shake(), approach(4)], 8.5, 4, 8.5, 7.5, on_chunk=interrupt)


def test_chunks_of_large_swarms_are_short_and_change_nothing(monkeypatch):
    whole = run([approach(5)], 5, 6, 10, 18)
    monkeypatch.setattr(cascade_module, "CHUNK_TRIPLES", episodes_at_once(2) * 2**3 * 4)
    reported = []
    short = run([approach(5)], 5, 6, 10, 18, on_chunk=lambda *numbers: reported.append(numbers))
    assert reported == [(4, 30, 1), (8, 30, 2), (12, 30, 3), (16, 30, 3), (17, 30, 4)]
    np.testing.assert_array_equal(short.positions, whole.positions)
    np.testing.assert_array_equal(short.lengths, whole.lengths)


@pytest.mark.parametrize(
    ("starts", "line"),
    [
        (["a", "b"], "starts = ['a', 'b']: must be finite numbers of shape (episodes, 2, 2)"),
        (None, "starts = 'an array ()': must be finite numbers"),
        (3, "starts = 'an array ()': must be finite numbers"),
        (np.zeros((2, 2)), "starts = 'an array (2, 2)': must be finite numbers of shape (episodes, 2, 2)"),
        (np.zeros((1, 3, 2)), "starts = 'an array (1, 3, 2)': must be finite numbers of shape (episodes, 2, 2)"),
        (np.zeros((0, 2, 2)), "starts = 'an array (0, 2, 2)': must be finite numbers"),
        ([[[0, 0], [np.nan, 0]]], "starts = 'numbers that are not finite': must be finite"),
        ([[[0, 0]], [[1, 0], [2, 0]]], "starts = [[[0, 0]], [[1, 0], [2, 0]]]: must be finite numbers"),
    ],
)
def test_starts_that_are_none_are_refused(starts, line):
    with pytest.raises(InputError) as caught:
        Cascade((approach(5),), world(), RULE).rollout(starts)
    assert str(caught.value).startswith(line)


@pytest.mark.parametrize("seed", [None, "x", 1.5, -1, 2**32, True])
def test_seeds_that_are_none_are_refused(seed):
    with pytest.raises(InputError, match=r"^seed = .*: must be an integer >= 0 and <= 4294967295$"):
        Cascade((approach(5),), world(), RULE).rollout(np.zeros((1, 2, 2)), seed)


def test_a_restless_policy_is_cut_off_and_the_next_takes_over():
    trajectories = run([shake(), approach(4)], 8.5, 7.5, 8.5, 7.5)
    np.testing.assert_array_equal(trajectories.switch[:, 0], 30)
    np.testing.assert_array_equal(trajectories.lengths, 30 + np.array([5, 4, 5, 4]) + WINDOW)
    assert trajectories.at_rest.all()
    assert_holds_still(trajectories)


def test_a_cascade_that_is_cut_off_is_not_at_rest():
    trajectories = run([approach(8), shake()], 10, 8, 9, 5)
    np.testing.assert_array_equal(trajectories.switch[:, 0], np.array([2, 0, 1, 0]) + WINDOW)
    np.testing.assert_array_equal(trajectories.lengths, trajectories.switch[:, 0] + 30)
    assert not trajectories.at_rest.any()
    assert not trajectories.terminated.any()


def test_a_long_episode_goes_on_from_look_to_look():
    """The host looks every 50 steps whether all is over; nothing may happen at the seam."""
    trajectories = run([shake(), shake()], 8.5, 8.5, 7.5, 6.0, rule=dataclasses.replace(RULE, max_steps=60))
    np.testing.assert_array_equal(trajectories.lengths, 120)
    np.testing.assert_array_equal(trajectories.switch, np.full((4, 1), 60))
    np.testing.assert_array_equal(trajectories.positions[0, :, 0, 0], 8.5 - np.arange(121) % 2)


def test_a_collision_ends_the_episode_and_no_policy_follows():
    trajectories = run([approach(0.5), approach(4)], 10, 1.5, 5.5, 3)
    np.testing.assert_array_equal(trajectories.lengths, [9, 1, 5, 2])
    np.testing.assert_array_equal(trajectories.switch[:, 0], trajectories.lengths, err_msg="where it never took over")
    assert trajectories.terminated.all()
    assert not trajectories.at_rest.any()
    assert_holds_still(trajectories)


def test_a_collision_of_the_last_policy_is_no_rest():
    trajectories = run([approach(8), approach(0.5)], 10, 19, 8, 9)
    np.testing.assert_array_equal(trajectories.switch[:, 0], np.array([2, 11, 0, 1]) + WINDOW)
    np.testing.assert_array_equal(trajectories.lengths, trajectories.switch[:, 0] + 7)
    assert trajectories.terminated.all()
    assert not trajectories.at_rest.any()


def test_a_policy_that_is_followed_need_not_settle_as_the_last_one_must():
    """A creep that changes the objective by 5e-4 a step is rest for the first policy only."""
    creep = approach(0, speed=5e-4 * 20 * 2**0.5)
    trajectories = run([creep, creep], 10, 9, 8, 7)
    np.testing.assert_array_equal(trajectories.switch, np.full((4, 1), WINDOW))
    np.testing.assert_array_equal(trajectories.lengths, WINDOW + 30)
    assert not trajectories.at_rest.any()


def after_rest(trajectories):
    """Returns how far each robot is from where it came to rest, at each step after that."""
    return np.linalg.norm(trajectories.after_rest - trajectories.final[:, None], axis=-1)


def test_robots_that_stand_still_at_rest_are_not_executed_any_further():
    """Robots that remember nothing and see without noise go on to decide what they decided."""
    trajectories = run([approach(5)], 5, 6, 10, 18)
    assert trajectories.after_rest.shape == (4, 0, 2, 2)


def test_a_creep_is_rest_but_not_for_long():
    """Robots that move by 0.9 of what counts as still come to rest, and are then seen to move on."""
    trajectories = run([approach(5, speed=0.9e-3)], 10, 5.0004, 5, 5.1)
    assert trajectories.at_rest.all()
    np.testing.assert_array_equal(trajectories.lengths, WINDOW)
    assert trajectories.after_rest.shape == (4, STATIONARY_STEPS, 2, 2)
    moved = after_rest(trajectories)
    np.testing.assert_allclose(moved[0, :, 0], 0.9e-3 * np.arange(1, STATIONARY_STEPS + 1), rtol=1e-2)
    assert (moved[1:3] == 0).all()
    np.testing.assert_allclose(moved[3, -1], 0.1 - 0.9e-3 * WINDOW, atol=1e-3)
    assert check_validity(trajectories, CONFIG).stationary.all(), "within a quarter of the radius"


def test_a_creep_that_leaves_is_not_stationary():
    """0.9 of a stillness of 2e-3 radii, for 200 steps, is farther than a quarter of a radius."""
    trajectories = run([approach(5, speed=1.8e-3)], 10, 5.2, 5, 5.5, rule=dataclasses.replace(RULE, stillness=2e-3))
    assert trajectories.at_rest.all()
    validity = check_validity(trajectories, CONFIG)
    assert validity.formed.all()
    np.testing.assert_array_equal(validity.stationary, [False, True, True, False])


def test_robots_that_turn_in_a_circle_are_never_at_rest():
    """Though nothing that the objective measures ever changes."""
    trajectories = run([Turn(jnp.asarray(0.02))], 5, 6, 7, 8)
    assert not trajectories.at_rest.any()
    np.testing.assert_array_equal(trajectories.lengths, RULE.max_steps)
    np.testing.assert_allclose(np.ptp(trajectories.signals["nclose"], axis=1), 0, atol=1e-6)
    assert trajectories.after_rest.shape[1] == 0, "only a swarm at rest is watched"


def test_a_policy_that_is_followed_hands_over_though_its_robots_turn():
    trajectories = run([Turn(jnp.asarray(0.02)), approach(5)], 5, 6, 7, 8)
    np.testing.assert_array_equal(trajectories.switch, np.full((4, 1), WINDOW))


def test_stillness_may_be_none_at_all():
    rule = dataclasses.replace(RULE, stillness=0.0)
    trajectories = run([approach(5, speed=1e-4)], 5, 5.0001, 5.001, 10, rule=rule)
    np.testing.assert_array_equal(trajectories.at_rest, [True, True, True, False])


def test_the_window_is_the_rules():
    trajectories = run([approach(5)], 10, 5, 6, 19, rule=dataclasses.replace(RULE, window=1))
    np.testing.assert_array_equal(trajectories.lengths, np.array([5, 0, 1, 14]) + 1)


def test_signals_are_those_of_the_recorded_positions():
    trajectories = run([approach(8), approach(2)], 10, 3, 8, 5)
    assert set(trajectories.signals) == {"nclose", "safety", "neighbors", "visible"}
    for episode in range(4):
        for step, positions in enumerate(trajectories.positions[episode].astype(float)):
            expected = oracle.signals(positions, "nclose", 20.0, 20.0, 1.0, 100.0, 5.0, "penalty")
            for name, value in expected.items():
                np.testing.assert_allclose(trajectories.signals[name][episode, step], value, atol=1e-5, err_msg=name)


AT_ONCE = 16
COMPANY = 20
SCHEDULER = AsyncScheduler(rigid=False, max_delay=1, max_move_steps=2)
SIX = WorldConfig(robots=6, half_width=35.0, half_height=35.0, scan_radius=105.0)


@pytest.fixture(scope="module")
def asynchronous():
    """Rolls out robots that circle, each in its own time with noisy sight: the first 1, or 1 and 20 others."""
    world = with_array_leaves(World.create(SIX, UniformStart(), "C2"))
    sensing = VisibleSensing(rotation=True, bearing_noise=0.01)
    env = DeadZone(LocalObservation(SchedulerWrapper(world, SCHEDULER), sensing, SIX), SlowMoves(0.3), SIX)
    rule = RestRule(window=5 * SCHEDULER.period, max_steps=130)
    cascade = Cascade((Baseline.registered()["circle"](SIX, False),), env, rule)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(starts_module, "BATCH_EPISODES", AT_ONCE)
        starts = draw_starts(world.start, jax.random.key(5), COMPANY + 1, SIX)
        return [cascade.rollout(starts[:count], seed=3) for count in (1, COMPANY + 1)]


def test_an_ended_episode_does_not_complete_the_moves_that_its_robots_had_begun(asynchronous):
    _, all_of_them = asynchronous
    assert_holds_still(all_of_them)
    for values in all_of_them.signals.values():
        for episode, length in enumerate(all_of_them.lengths):
            np.testing.assert_array_equal(values[episode, length:], values[episode, length])
    assert len(set(all_of_them.lengths)) > 5


def test_an_episode_is_the_same_alone_and_in_company(asynchronous):
    """What it does, by which dice, and what it is judged by."""
    alone, together = asynchronous
    length = int(alone.lengths[0])
    assert length < together.lengths.max()
    np.testing.assert_array_equal(together.positions[0, : length + 1], alone.positions[0])
    np.testing.assert_array_equal(together.final[0], alone.final[0])
    for field in ("lengths", "switch", "at_rest", "terminated", "epochs"):
        np.testing.assert_array_equal(getattr(together, field)[0], getattr(alone, field)[0], err_msg=field)
    first, second = (check_validity(trajectories, SIX) for trajectories in (alone, together))
    for field in ("contact_free", "inside", "mutually_visible", "gathered", "safe", "at_rest", "stationary"):
        assert getattr(first, field)[0] == getattr(second, field)[0], field


def test_robots_that_see_with_noise_are_watched_after_rest(asynchronous):
    """Nobody moved, but the noise may be another at the next look; cycles count, not steps."""
    alone, together = asynchronous
    last, most = alone.after_rest.shape[1], together.after_rest.shape[1]
    assert STATIONARY_STEPS < most <= STATIONARY_STEPS * SCHEDULER.period
    np.testing.assert_array_equal(together.after_rest[0, :last], alone.after_rest[0])
    still = np.concatenate([alone.final[:, None], alone.after_rest], axis=1)[0, -1]
    np.testing.assert_array_equal(together.after_rest[0, last:], np.broadcast_to(still, (most - last, 6, 2)))
    cut_off = np.flatnonzero(~together.at_rest)
    assert len(cut_off)
    np.testing.assert_array_equal(
        together.after_rest[cut_off], np.broadcast_to(together.final[cut_off][:, None], (len(cut_off), most, 6, 2))
    )
    assert (after_rest(together)[together.at_rest, -1].max(axis=-1) > 0).any()


def test_networks_move_a_swarm_alike_alone_and_in_company(tiny_run):
    """To the last bit, wherever the episode is in the batch, also in one that is executed in two parts."""
    run = murmurate.load(tiny_run("equivariant"))
    starts = run.starts(episodes_at_once(3) + 6, key=1)
    together = run.cascade.rollout(starts)
    for episode in (0, 5, episodes_at_once(3), episodes_at_once(3) + 5):
        alone = run.cascade.rollout(starts[episode : episode + 1])
        length = alone.lengths[0]
        assert length == together.lengths[episode]
        np.testing.assert_array_equal(together.positions[episode, : length + 1], alone.positions[0])
        assert together.switch[episode].tolist() == alone.switch[0].tolist()
        for name, values in alone.signals.items():
            np.testing.assert_array_equal(together.signals[name][episode, : length + 1], values[0])
    assert_holds_still(together)


def test_the_dice_of_an_episode_depend_on_its_index_alone():
    """The second of three episodes from one and the same start is the second of two, and is not the first."""
    world = with_array_leaves(World.create(SIX, UniformStart(), "C2"))
    env = LocalObservation(
        SchedulerWrapper(world, AsyncScheduler()), VisibleSensing(rotation=True, miss_probability=0.2), SIX
    )
    with prng.reproducible():
        start = jnp.moveaxis(jnp.tile(draw_starts(world.start, jax.random.key(5), 1, SIX), (3, 1, 1)), 0, -1)
        begin = eqx.filter_jit(lambda positions: env.state(positions, jnp.asarray(7, jnp.uint32)))
        two, three = (begin(start[..., :count]) for count in (2, 3))
    for few, many in zip(jax.tree.leaves(two), jax.tree.leaves(three), strict=True):
        np.testing.assert_array_equal(few, many[..., :2])
    assert (three.frames.cos[:, 0] != three.frames.cos[:, 1]).all()
    assert (three.key[:, 0] != three.key[:, 1]).any()


@pytest.mark.parametrize(
    "fields",
    [
        {"window": 0},
        {"stillness": -1e-3},
        {"stillness": float("nan")},
        {"switch_tolerance": float("inf")},
        {"dead_zone": -0.1},
        {"dead_zone": 1.0},
        {"damping": 1.0},
        {"damping": -0.1},
        {"damping": 0.4, "dead_zone": 0.0},
        {"sidestep": 1.5},
        {"sidestep": 0.05},
        {"sidestep": 0.5, "dead_zone": 0.0},
        {"max_steps": 0},
    ],
)
def test_no_such_rule(fields):
    with pytest.raises(InputError, match=f"^{next(iter(fields))} = "):
        RestRule(**fields)
