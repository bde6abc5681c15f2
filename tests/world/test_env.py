"""The decision process: what a step moves, pays and ends."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from murmurate.errors import InputError
from murmurate.world import (
    AsyncScheduler,
    DeadZone,
    GlobalSensing,
    LocalObservation,
    MotionCost,
    ScatteredStart,
    SchedulerWrapper,
    SlowMoves,
    Transition,
    VisibleSensing,
    World,
    WorldConfig,
    Wrapper,
    apply_dead_zone,
    with_array_leaves,
)
from oracles import contact, visibility
from oracles import signals as oracle

CONFIG = WorldConfig(robots=4, half_width=20.0, half_height=15.0, scan_radius=12.0, collision_penalty=0.75)
HORIZON = 7
SQUARE = 6.0 * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
PLAIN = (1.0, 1.0, 1.0, 1.0)
WEIGHTS = (0.5, 2.0, 3.0, 7.0)
GATHERING = {"C1": "close", "C2": "nclose"}


def build(config=CONFIG, objective="C1", weights=PLAIN, horizon=HORIZON, per_robot=False):
    names = (GATHERING.get(objective, ""), "safety", "neighbors", "visible")
    named = dict(zip(names, weights, strict=True)) if objective in GATHERING else None
    world = World.create(config, ScatteredStart(), objective, named, jnp.asarray(horizon), per_robot)
    # Arrays, as under a jit: the step below then compiles once for all numbers.
    return with_array_leaves(world)


@pytest.fixture(scope="module")
def world():
    return build()


step = jax.jit(World.step)
state_of = jax.jit(World.state)
reset_batch = jax.jit(World.reset_batch, static_argnums=2)


def begin(world, positions):
    return state_of(world, jnp.asarray(positions, jnp.float32))


def move(world, positions, velocities):
    return step(world, begin(world, positions), jnp.asarray(velocities, jnp.float32))


def objective_of(positions, gathering="close", config=CONFIG, weights=PLAIN):
    """The oracle's objective of one configuration."""
    values = oracle.signals(
        np.asarray(positions, float),
        gathering,
        config.half_width,
        config.half_height,
        config.radius,
        config.scan_radius,
        config.safe_distance,
        config.safety,
    )
    return sum(w * v for w, v in zip(weights, values.values(), strict=True))


def still(**moving):
    """Velocities of four robots: all rest but those given by number."""
    velocities = np.zeros((4, 2))
    for name, velocity in moving.items():
        velocities[int(name[1:])] = velocity
    return velocities


def test_velocities_move_robots_by_one_step(world):
    velocities = np.array([[0.5, -0.25], [-1.0, 1.0], [0.0, 0.125], [0.0, 0.0]])
    state, transition = move(world, SQUARE, velocities)
    np.testing.assert_array_equal(state.positions, (SQUARE + velocities).astype(np.float32))
    np.testing.assert_array_equal(world.observe(state), state.positions)
    assert state.step == 1
    assert not transition.terminated
    assert not transition.truncated


def test_each_component_is_clipped_to_the_speed_limit(world):
    state, _ = move(world, SQUARE, still(r0=(50.0, 0.25), r1=(-3.0, np.inf), r2=(0.5, -1.5)))
    expected = SQUARE + still(r0=(1.0, 0.25), r1=(-1.0, 1.0), r2=(0.5, -1.0))
    np.testing.assert_array_equal(state.positions, expected.astype(np.float32))


@pytest.mark.parametrize(("objective", "gathering"), [("C1", "close"), ("C2", "nclose")])
@pytest.mark.parametrize("safety", ["penalty", "shell"])
@pytest.mark.parametrize("weights", [PLAIN, WEIGHTS], ids=["plain", "weighted"])
def test_the_reward_is_the_change_of_the_objective(objective, gathering, safety, weights):
    config = WorldConfig(robots=4, half_width=20.0, half_height=15.0, scan_radius=12.0, safety=safety)
    measure = partial(objective_of, gathering=gathering, config=config, weights=weights)
    first = np.array([[3.0, 2.0], [-4.0, 3.0], [-1.0, -6.0], [7.0, -3.0]])
    velocities = np.array([[1.0, -1.0], [0.5, 0.25], [-0.75, 1.0], [-1.0, 0.5]])
    state, transition = move(build(config, objective, weights), first, velocities)
    np.testing.assert_allclose(transition.reward, measure(first + velocities) - measure(first), atol=2e-5)
    np.testing.assert_allclose(state.objective, measure(first + velocities), rtol=1e-5)
    assert set(transition.signals) == {gathering, "safety", "neighbors", "visible"}


def test_rewards_telescope_over_an_episode(world):
    rng = np.random.default_rng(0)
    state = begin(world, SQUARE)
    first, total = state.objective, 0.0
    for _ in range(HORIZON):
        state, transition = step(world, state, jnp.asarray(rng.uniform(-0.5, 0.5, (4, 2)), jnp.float32))
        assert not transition.terminated
        total += float(transition.reward)
    np.testing.assert_allclose(total, state.objective - first, atol=1e-5)
    np.testing.assert_allclose(state.objective, objective_of(state.positions), rtol=1e-5)


def test_robots_that_pass_through_each_other_collide(world):
    """Both end points are clean: 2.2 apart before and after, and coincident in between."""
    config = WorldConfig(robots=4, half_width=20.0, half_height=15.0, max_speed=2.2, collision_penalty=0.75)
    fast = build(config)
    positions = np.array([[-1.1, 0.0], [1.1, 0.0], [10.0, 10.0], [-10.0, -10.0]])
    crossing = still(r0=(2.2, 0.0), r1=(-2.2, 0.0))
    state, transition = move(fast, positions, crossing)
    np.testing.assert_allclose(np.linalg.norm(state.positions[0] - state.positions[1]), 2.2, rtol=1e-5)
    assert transition.terminated
    assert transition.reward == -0.75
    # The same two ways, one after the other and out of reach of each other, are no collision.
    assert not move(fast, positions + 4 * still(r1=(0, 1.0)), crossing)[1].terminated


@pytest.mark.parametrize("towards", [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])
def test_leaving_the_world_terminates(world, towards):
    edge = np.array(towards) * [CONFIG.half_width, CONFIG.half_height]
    positions = SQUARE / 2 + 0.0
    positions[0] = edge
    assert not move(world, positions, still())[1].terminated, "the border belongs to the world"
    _, transition = move(world, positions, still(r0=0.01 * np.array(towards)))
    assert transition.terminated
    assert not transition.truncated
    assert transition.reward == -0.75


@pytest.mark.parametrize("penalty", [0.0, 0.75, 12.5])
def test_the_penalty_is_fixed(penalty):
    config = WorldConfig(robots=4, half_width=20.0, half_height=15.0, collision_penalty=penalty)
    for name in ("C1", "C2"):
        close = np.array([[0.0, 0.0], [2.5, 0.0], [9.0, 9.0], [-9.0, -9.0]])
        _, transition = move(build(config, name, WEIGHTS), close, still(r0=(1.0, 0.0)))
        assert transition.terminated
        assert transition.reward == -penalty


def test_a_velocity_that_is_no_number_terminates(world):
    """The robot is nowhere, so outside: the episode ends with the penalty, and learning never sees the NaN."""
    _, transition = move(world, SQUARE, still(r2=(np.nan, 0.0)))
    assert transition.terminated
    assert not transition.truncated
    assert transition.reward == -0.75


def test_the_horizon_truncates_and_nothing_resets(world):
    state = begin(world, SQUARE)
    for count in range(1, HORIZON + 3):
        state, transition = step(world, state, jnp.full((4, 2), 0.125))
        assert state.step == count
        assert transition.truncated == (count >= HORIZON)
        assert not transition.terminated
        assert transition.reward != -0.75
        np.testing.assert_array_equal(state.positions, (SQUARE + 0.125 * count).astype(np.float32))


def test_an_end_is_terminated_or_truncated_never_both(world):
    def last_step(positions, velocities):
        state = eqx.tree_at(lambda s: s.step, begin(world, positions), jnp.asarray(HORIZON - 1))
        return step(world, state, jnp.asarray(velocities, jnp.float32))[1]

    timeout = last_step(SQUARE, still())
    assert (bool(timeout.terminated), bool(timeout.truncated)) == (False, True)
    hit = last_step([[0.0, 0.0], [2.1, 0.0], [9.0, 9.0], [-9.0, -9.0]], still(r0=(1.0, 0.0)))
    assert (bool(hit.terminated), bool(hit.truncated)) == (True, False)


def test_credit_is_the_reward_unless_it_is_shared(world):
    velocities = np.array([[1.0, -1.0], [0.5, 0.25], [-0.75, 1.0], [-1.0, 0.5]])
    for positions in (SQUARE, [[0.0, 0.0], [2.1, 0.0], [9.0, 9.0], [-9.0, -9.0]]):
        _, transition = move(world, positions, velocities)
        np.testing.assert_array_equal(transition.credit, transition.reward[None])


@pytest.mark.parametrize("objective", ["C1", "C2"])
def test_shared_credit_of_one_mover_is_its_difference_reward(objective):
    """When one robot alone moves, its credit is N / 2 times the reward; the weights count in both."""
    world = build(objective=objective, weights=WEIGHTS, per_robot=True)
    rng = np.random.default_rng(5)
    for mover in range(4):
        velocity = rng.uniform(-1, 1, 2)
        _, transition = move(world, SQUARE + rng.uniform(-2, 2, (4, 2)), still(**{f"r{mover}": velocity}))
        assert transition.credit.shape == (4,)
        np.testing.assert_allclose(transition.credit[mover], 4 / 2 * transition.reward, atol=1e-4)


def test_the_penalty_is_shared_by_those_who_collided_or_left():
    world = build(per_robot=True)
    crowd = [[0.0, 0.0], [2.1, 0.0], [9.0, 9.0], [-9.0, -9.0]]
    _, hit = move(world, crowd, still(r0=(1.0, 0.0)))
    np.testing.assert_array_equal(hit.credit, [-0.75, -0.75, 0.0, 0.0])
    _, left = move(world, [[0.0, 0.0], [5.0, 0.0], [9.0, 15.0], [-9.0, -9.0]], still(r2=(0.0, 1.0)))
    np.testing.assert_array_equal(left.credit, [0.0, 0.0, -0.75, 0.0])
    assert hit.reward == left.reward == -0.75


wrapped_step = jax.jit(lambda env, state, velocities: env.step(state, velocities))


def test_a_robot_stands_still_by_its_own_wish_alone(world):
    """A robot that wants less than the dead zone stays exactly where it is; the others do what they want."""
    env = DeadZone(world, SlowMoves(jnp.asarray(0.3)), CONFIG)
    assert (env.unwrapped, env.period, env.keeps_rest) == (world, 1, True)
    wishes = np.array([[0.2, 0.2], [0.21, -0.22], [-0.3, 0.0], [0.0, -0.29999]])
    after, _ = wrapped_step(env, begin(world, SQUARE), jnp.asarray(wishes, jnp.float32))
    executed = wishes * [[0], [1], [1], [0]]
    np.testing.assert_allclose(after.positions, SQUARE + executed, atol=1e-6)
    np.testing.assert_array_equal(np.asarray(after.positions)[[0, 3]], SQUARE[[0, 3]])
    expected, _ = move(world, SQUARE, executed)
    np.testing.assert_allclose(after.objective, expected.objective, atol=1e-6)


def test_a_dead_zone_of_nothing_stops_nobody():
    wishes = np.random.default_rng(0).normal(size=(4, 2, 3)).astype(np.float32)
    np.testing.assert_array_equal(apply_dead_zone(wishes, None, SlowMoves(0.0), CONFIG), wishes)
    slow = np.linalg.norm(wishes, axis=1, keepdims=True) < 0.8
    np.testing.assert_array_equal(apply_dead_zone(wishes, None, SlowMoves(0.8), CONFIG), np.where(slow, 0, wishes))


def test_slow_moves_are_damped_the_more_the_slower_they_are():
    lengths = np.array([0.0, 0.1, 0.19, 0.2, 0.4, 0.5, 0.8])
    wishes = lengths[:, None] * np.array([[0.6, -0.8]])
    kept = np.array([0, 0, 0, 1 - 0.4 * 0.6, 1 - 0.4 * 0.2, 1, 1])
    slow = SlowMoves(0.195, damped_speed=0.5, damping=0.4)
    decided = apply_dead_zone(jnp.asarray(wishes, jnp.float32), None, slow, CONFIG)
    np.testing.assert_allclose(decided, wishes * kept[:, None], atol=1e-6)


def test_robots_nearer_than_the_safe_distance_step_apart_instead_of_standing_still(world):
    """By half of what is missing, at least a fifth of the slowest move; from several, mostly from the nearest."""
    safe = CONFIG.safe_distance
    pairs = np.array([[-9.0, 8.0], [-9.0 + safe - 1.0, 8.0], [9.0, -8.0], [9.0, -8.0 + safe - 0.01]])
    sensing = VisibleSensing(rotation=True, reflection=True, unit_ratio=2.0)
    env = DeadZone(LocalObservation(world, sensing, CONFIG), SlowMoves(jnp.asarray(0.1), sidestep=0.9), CONFIG)

    def moved(positions):
        state = env.state(jnp.asarray(positions, jnp.float32), 7)
        return np.asarray(wrapped_step(env, state, jnp.zeros((4, 2)))[0].positions) - positions

    expected = np.array([[-0.51, 0], [0.51, 0], [0, -0.02], [0, 0.02]])
    np.testing.assert_allclose(moved(pairs), expected, atol=1e-5)
    np.testing.assert_allclose(moved(np.array([[-9.0, 0.0], [-9.0 + safe, 0], [9.0, 0], [9.0, 6.0]])), 0, atol=1e-6)
    corner = np.array([[0.0, 0.0], [safe - 2.0, 0.0], [0.0, safe - 1.0], [14.0, 14.0]])
    away = moved(corner)[0]
    np.testing.assert_allclose(away, -0.9 * np.array([2, 1]) / np.sqrt(5), atol=1e-5)


def test_a_robot_between_two_that_it_sees_steps_aside_instead_of_standing_still(world):
    """In line, the second and the third robot see both of their neighbours, which are hidden from each other."""
    sensing = VisibleSensing(rotation=True)
    line = np.array([[-9.0, 3.0], [-3.0, 3.0], [3.0, 3.0], [9.0, 3.0]])
    env = DeadZone(LocalObservation(world, sensing, CONFIG), SlowMoves(jnp.asarray(0.3), sidestep=0.5), CONFIG)
    state = env.state(jnp.asarray(line, jnp.float32), 7)
    first_axes = np.stack([state.frames.cos, state.frames.sin], axis=1)
    assert len(np.unique(first_axes, axis=0)) == 4
    second_axes = np.stack([-state.frames.sin, state.frames.cos], axis=1)
    oblique = np.cos(1.0) * first_axes + np.sin(1.0) * second_axes
    for wishes, moving in ((np.zeros((4, 2)), [1, 2]), (np.array([[0, 0], [0, 0], [0.4, 0], [0, 0]]), [1])):
        after, _ = wrapped_step(env, state, jnp.asarray(wishes, jnp.float32))
        expected = np.zeros((4, 2))
        expected[moving] = 0.5 * oblique[moving]
        expected[2] = expected[2] if 2 in moving else 0.4 * first_axes[2]
        np.testing.assert_allclose(after.positions, line + expected, atol=1e-6)
    # Where everybody sees everybody, nobody has to move.
    after, _ = wrapped_step(env, env.state(jnp.asarray(SQUARE, jnp.float32), 7), jnp.zeros((4, 2)))
    np.testing.assert_array_equal(after.positions, np.float32(SQUARE))


@pytest.mark.parametrize("walls", [False, True])
@pytest.mark.parametrize("side", [0, 1, 2, 3], ids=["right", "upper", "left", "lower"])
def test_a_sidestep_leaves_the_line_and_goes_away_from_near_walls(world, side, walls):
    """Along whichever wall robots are in line, in frames parallel to it: those in the middle step off it."""
    sensing = GlobalSensing(walls=walls)
    env = DeadZone(LocalObservation(world, sensing, CONFIG), SlowMoves(jnp.asarray(0.3), sidestep=0.5), CONFIG)
    line = along_wall(side, [-6.0, 0.0, 6.0, 12.0])
    after, _ = wrapped_step(env, env.state(jnp.asarray(line, jnp.float32), 7), jnp.zeros((4, 2)))
    size = np.array([CONFIG.half_width, CONFIG.half_height])
    is_near = size - line < 2 * CONFIG.safe_distance
    direction = 0.5 * np.array([np.cos(1.0), np.sin(1.0)])
    expected = np.zeros((4, 2))
    expected[[1, 2]] = np.where(walls & is_near, -direction, direction)[[1, 2]]
    np.testing.assert_allclose(after.positions, line + expected, atol=1e-5)
    assert (np.abs(after.positions) <= size).all() == (walls or side > 1)


@pytest.mark.parametrize("speed", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("side", [0, 1, 2, 3], ids=["right", "upper", "left", "lower"])
def test_sidesteps_lead_a_robot_away_from_a_line_along_a_wall_for_good(side, speed):
    config = replace(CONFIG, robots=3)
    env = LocalObservation(build(config), GlobalSensing(walls=True), config)
    env = DeadZone(env, SlowMoves(jnp.asarray(0.1 * speed), sidestep=speed), config)
    state = env.state(jnp.asarray(along_wall(side, [-6.0, 0.0, 6.0]), jnp.float32), 7)
    for _ in range(20):
        state, _ = wrapped_step(env, state, jnp.zeros((3, 2)))
    assert not visibility.occluded(np.asarray(state.positions, np.float64), config.radius).any()
    after, _ = wrapped_step(env, state, jnp.zeros((3, 2)))
    np.testing.assert_array_equal(after.positions, state.positions)


def along_wall(side, places):
    """Returns robots exactly on the right, upper, left or lower wall."""
    half = [CONFIG.half_width, CONFIG.half_height, -CONFIG.half_width, -CONFIG.half_height][side]
    on_wall = np.full(len(places), half)
    return np.stack([places, on_wall] if side % 2 else [on_wall, places], axis=1)


@pytest.mark.parametrize("bounded", [True, False])
def test_robots_that_act_on_all_positions_step_aside_and_apart_in_the_common_frame(bounded):
    """As robots with global sensing do whose frames are the world's."""
    config = replace(CONFIG, bounded=bounded)
    world, slow = build(config), SlowMoves(jnp.asarray(0.1), sidestep=0.9)
    alone = DeadZone(world, slow, config)
    seeing = DeadZone(LocalObservation(world, GlobalSensing(walls=True), config), slow, config)
    starts = np.random.default_rng(3).uniform(-1, 1, (40, 4, 2)).astype(np.float32) * np.float32([12, 6])
    starts[:10, :, 1] = starts[:10, :1, 1]
    stepped = []
    for positions in starts:
        expected, actual = (
            np.asarray(wrapped_step(env, env.state(jnp.asarray(positions), 7), jnp.zeros((4, 2)))[0].positions)
            for env in (seeing, alone)
        )
        np.testing.assert_allclose(actual, expected, atol=1e-6)
        stepped.append(np.linalg.norm(actual - positions, axis=1))
    moves = np.array(stepped)
    assert np.isclose(moves, 0.9, atol=1e-5).any(), "nobody steps aside"
    assert ((moves > 0) & (moves < 0.89)).any(), "nobody steps apart"


@pytest.mark.parametrize("per_robot", [False, True])
def test_motion_costs_what_is_learned_from_and_not_what_is_recorded(per_robot):
    world = build(CONFIG, per_robot=per_robot)
    env = MotionCost(world, jnp.asarray(0.1))
    velocities = np.array([[3.0, 0.0], [0.0, 0.0], [0.6, -0.8], [0.0, 0.25]])  # the first is clipped to 1
    _, plain = move(world, SQUARE, velocities)
    _, paid = wrapped_step(env, begin(world, SQUARE), jnp.asarray(velocities, jnp.float32))
    cost = 0.1 * np.array([1.0, 0.0, 1.0, 0.25])
    np.testing.assert_allclose(plain.credit - paid.credit, cost if per_robot else [cost.mean()], atol=1e-6)
    np.testing.assert_array_equal(paid.reward, plain.reward)


class Free(Wrapper):
    """A world in which nothing but the cost of motion counts."""

    def step(self, state, action):
        zero = jnp.zeros(4)
        after = eqx.tree_at(lambda s: s.positions, state, state.positions + action)
        return after, Transition(zero[0], zero[0] > 0, zero[0] > 0, {}, zero)


def test_the_cost_of_motion_has_a_gradient_also_where_nobody_moves(world):
    env, state = MotionCost(Free(world), jnp.asarray(0.1)), begin(world, SQUARE)
    velocities = jnp.zeros((4, 2)).at[1].set(jnp.asarray([0.6, 0.8]))
    gradient = jax.grad(lambda v: env.step(state, v)[1].credit.sum())(velocities)
    np.testing.assert_allclose(gradient, -0.1 * velocities, atol=1e-6)


def test_what_is_known_of_robots_at_rest(world):
    """Whether they go on to see the same, and within how many steps each of them looks."""
    subclass = type("Own", (GlobalSensing,), {})
    for sensing, keeps in [
        (GlobalSensing(rotation=True, unit_ratio=2.0), True),
        (GlobalSensing(range_noise=0.1), False),
        (GlobalSensing(bearing_noise=0.1), False),
        (GlobalSensing(miss_probability=0.1), False),
        (GlobalSensing(rotation=True, resample_frames=True), False),
        (subclass(), False),
    ]:
        env = DeadZone(
            LocalObservation(SchedulerWrapper(world, AsyncScheduler()), sensing, CONFIG), SlowMoves(0.1), CONFIG
        )
        assert (env.keeps_rest, env.period) == (keeps, AsyncScheduler().period), sensing
    foreign = type("Later", (AsyncScheduler,), {})
    assert not SchedulerWrapper(world, foreign()).keeps_rest


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_a_batch_is_its_members_one_by_one(world, seed):
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-14.0, 14.0, (4, 2, 8)).astype(np.float32)
    velocities = rng.uniform(-1.5, 1.5, (4, 2, 8)).astype(np.float32)
    after, transition = step(world, state_of(world, jnp.asarray(positions)), jnp.asarray(velocities))
    clipped = np.clip(velocities, -1, 1)
    approach = contact.closest_approach(np.moveaxis(positions, -1, 0), np.moveaxis(clipped, -1, 0))
    approach = approach[:, ~np.eye(4, dtype=bool)].min(axis=1)
    for member in range(8):
        single, its = move(world, positions[..., member], velocities[..., member])
        np.testing.assert_array_equal(single.positions, after.positions[..., member])
        np.testing.assert_allclose(single.objective, after.objective[member], rtol=1e-5)
        np.testing.assert_allclose(its.reward, transition.reward[member], atol=2e-5)
        assert its.terminated == transition.terminated[member]
        if abs(approach[member] - 2 * CONFIG.radius) > 1e-4:
            outside = contact.leaves(np.asarray(single.positions), CONFIG.half_width, CONFIG.half_height)
            assert its.terminated == ((approach[member] <= 2 * CONFIG.radius) | outside)


def test_vmap_of_a_step_is_the_batch(world):
    rng = np.random.default_rng(3)
    positions = jnp.asarray(rng.uniform(-14.0, 14.0, (5, 4, 2)), jnp.float32)
    velocities = jnp.asarray(rng.uniform(-1.0, 1.0, (5, 4, 2)), jnp.float32)

    def single_step(positions, velocities):
        return world.step(world.state(positions), velocities)

    after, transition = jax.jit(jax.vmap(single_step))(positions, velocities)
    batched, its = step(world, state_of(world, jnp.moveaxis(positions, 0, -1)), jnp.moveaxis(velocities, 0, -1))
    np.testing.assert_array_equal(after.positions, np.moveaxis(batched.positions, -1, 0))
    np.testing.assert_array_equal(transition.terminated, its.terminated)
    np.testing.assert_allclose(transition.reward, its.reward, atol=2e-5)


def test_a_batch_of_episodes_begins_at_starts_of_its_own(world):
    state = reset_batch(world, jax.random.key(0), 16)
    assert state.positions.shape == (4, 2, 16)
    assert state.step.shape == state.objective.shape == (16,)
    assert len(np.unique(np.asarray(state.positions[0, 0]))) == 16
    np.testing.assert_allclose(state.objective[3], objective_of(state.positions[..., 3]), rtol=1e-5)
    np.testing.assert_array_equal(reset_batch(world, jax.random.key(0), 16).positions, state.positions)
    assert (reset_batch(world, jax.random.key(1), 16).positions != state.positions).any()


def test_numbers_change_without_compiling_again():
    traces = 0

    @jax.jit
    def counted(world, state, velocities):
        nonlocal traces
        traces += 1
        return world.step(state, velocities)

    state = begin(build(), SQUARE)
    velocities = jnp.full((4, 2), 0.5)
    rewards = [float(counted(build(), state, velocities)[1].reward)]
    for change in ({"half_width": 30.0}, {"radius": 0.5}, {"scan_radius": 6.0}, {"safe_distance": 13.0}):
        world = build(WorldConfig(**{**vars(CONFIG), **change}), weights=WEIGHTS, horizon=99)
        rewards.append(float(counted(world, state, velocities)[1].reward))
    assert traces == 1
    assert len(set(rewards)) > 3, "the numbers changed nothing"


@pytest.mark.parametrize("value", [-1.0, 0.0, float("nan"), float("inf")])
@pytest.mark.parametrize(
    "field", ["half_width", "half_height", "radius", "scan_radius", "safe_distance", "max_speed", "collision_penalty"]
)
def test_sizes_are_finite_and_positive(field, value):
    if (field, value) == ("collision_penalty", 0.0):
        assert WorldConfig(collision_penalty=0.0).collision_penalty == 0
        return
    with pytest.raises(InputError, match=f"^{field} = ") as error:
        WorldConfig(**{field: value})
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "fields", [{"robots": 1}, {"robots": -3}, {"safety": "none"}, {"radius": 2.5, "safe_distance": 5.0}]
)
def test_no_such_world(fields):
    with pytest.raises(InputError):
        WorldConfig(**fields)


def test_there_is_no_such_objective():
    with pytest.raises(InputError, match=r"^objective = 'C9': must be one of C1, C2, custom$"):
        build(objective="C9")


@pytest.mark.unchecked
@pytest.mark.parametrize("shape", [(5, 4, 2), (5, 2, 2), (2, 4), (4,)])
def test_arrays_of_another_shape_than_the_worlds_are_refused(world, shape):
    for method in (world.signals, world.state):
        with pytest.raises(InputError, match=r"^positions = .*must be"):
            method(jnp.zeros(shape))
    with pytest.raises(InputError, match=r"^velocities = .*must be of shape \(4, 2, 1\)$"):
        world.step(world.state(jnp.asarray(SQUARE)[:, :, None]), jnp.zeros(shape))
