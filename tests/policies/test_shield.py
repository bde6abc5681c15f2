"""Moves that nobody can be touched by, against policies that try to touch, under every scheduler, in float64."""

from __future__ import annotations

import functools
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from murmurate.discovery import RestRule, build_environment, build_world
from murmurate.errors import InputError
from murmurate.policies import ClearanceShield, NoShield, ShieldWrapper, WallShield
from murmurate.policies.shield import ROOM, safe_share
from murmurate.runs import presets
from murmurate.world import (
    Activation,
    AsyncScheduler,
    FsyncScheduler,
    LocalObservation,
    Scheduler,
    SchedulerWrapper,
    SsyncScheduler,
    UniformStart,
    VisibleSensing,
    World,
    WorldConfig,
    with_array_leaves,
)
from oracles import contact as oracle

RADIUS = 1.0
SIDE = 60.0
BATCH = 64

SCHEDULERS = {
    "fsync": FsyncScheduler(),
    "fsync, stopped anywhere": FsyncScheduler(rigid=False, min_move=1e-6),
    "ssync": SsyncScheduler(),
    "ssync, adversary, stopped anywhere": SsyncScheduler(adversarial=True, rigid=False, min_move=1e-6),
    "async": AsyncScheduler(),
    "async, stopped anywhere": AsyncScheduler(rigid=False, min_move=1e-6),
    "async, long delays": AsyncScheduler(max_delay=6, max_move_steps=1),
    "async, in step": AsyncScheduler(max_delay=0, max_move_steps=1),
}


def world_of(robots):
    return WorldConfig(robots=robots, half_width=SIDE, half_height=SIDE, scan_radius=30.0, max_speed=3.0)


def crowds(robots, rng):
    """Returns tight triangular packings, turned and moved, whose gaps are from 1e-5 to 1 of a robot's size."""
    side = int(np.ceil(np.sqrt(robots)))
    column, row = np.divmod(np.arange(robots), side)
    lattice = np.stack([row + 0.5 * (column % 2), np.sqrt(0.75) * column], axis=1)
    gap = 10 ** rng.uniform(-5, 0, (BATCH, 1, 1))
    angle = rng.uniform(0, 2 * np.pi, BATCH)
    turn = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], axis=-1).reshape(-1, 2, 2)
    points = 2 * RADIUS * (1 + gap) * (lattice - lattice.mean(axis=0)) @ turn
    return (points + rng.uniform(-10, 10, (BATCH, 1, 2))).astype(np.float32)


def wishes(positions, step, key):
    """Returns what three quarrelsome kinds of robots want: to the nearest, to the middle, and anywhere."""
    offsets = positions[None] - positions[:, None]
    distance = jnp.hypot(offsets[:, :, 0], offsets[:, :, 1])
    distance = jnp.where(jnp.eye(len(positions), dtype=bool)[:, :, None], jnp.inf, distance)
    nearest = jnp.take_along_axis(offsets, jnp.argmin(distance, axis=1)[:, None, None], axis=1)[:, 0]
    middle = positions.mean(axis=0) - positions
    anywhere = jax.random.normal(jax.random.fold_in(key, step), positions.shape)
    kind = jnp.arange(BATCH) % 3
    wanted = jnp.where(kind == 0, nearest, jnp.where(kind == 1, middle, anywhere))
    return 100 * wanted  # as fast as the speed limit allows


@functools.cache
def roll(robots, scheduler, shield, steps, sensing=None, walls=False):
    """Returns the positions of robots that try to touch each other, or to leave the world."""
    config = world_of(robots)
    env = with_array_leaves(World.create(config, UniformStart(), "C2", {"visible": 0, "neighbors": 0}))
    env = env if scheduler.is_trivial else SchedulerWrapper(env, scheduler)
    env = env if sensing is None else LocalObservation(env, sensing, config)
    env = ShieldWrapper(env, with_array_leaves(shield), config)

    @eqx.filter_jit
    def execute(env, positions):
        def step(state, number):
            wanted = wishes(state.positions, number, jax.random.key(1))
            if walls:
                wanted = 100 * state.positions * (1 + 0 * wanted)
            if sensing is not None:  # in each robot's own frame
                frames = state.inner.frames
                wanted = jnp.stack(frames.to_local(wanted[:, 0], wanted[:, 1]), axis=1)
            after, _ = env.step(state, wanted)
            return after, after.positions

        state = env.state(positions, jnp.asarray(3, jnp.uint32))
        state, visited = jax.lax.scan(step, state, jnp.arange(steps))
        return jnp.concatenate([positions[None], visited]), state.interventions

    starts = np.moveaxis(crowds(robots, np.random.default_rng(robots)), 0, -1)
    visited, interventions = execute(env, jnp.asarray(starts))
    return np.asarray(visited).astype(float), np.asarray(interventions)


def least_distances(visited):
    """Returns the least distance of any two robots between two steps, moving in straight lines, in float64."""
    robots = visited.shape[1]
    first, second = np.triu_indices(robots, 1)
    offset = visited[:-1, first] - visited[:-1, second]
    motion = np.diff(visited[:, first] - visited[:, second], axis=0)
    squared = (motion**2).sum(axis=2)
    when = np.clip(-(offset * motion).sum(axis=2) / np.where(squared > 0, squared, 1), 0, 1)
    return np.sqrt(((offset + when[:, :, None] * motion) ** 2).sum(axis=2))


CASES = [
    (2, "fsync"),
    (8, "fsync"),
    (48, "fsync"),
    (5, "fsync, stopped anywhere"),
    (24, "ssync"),
    (3, "ssync, adversary, stopped anywhere"),
    (12, "async"),
    (6, "async, stopped anywhere"),
    (4, "async, long delays"),
    (7, "async, in step"),
]


@pytest.mark.parametrize(("robots", "name"), CASES)
def test_nobody_touches_whatever_anybody_wants(robots, name):
    """Over a million steps of robots in all."""
    scheduler = SCHEDULERS[name]
    visited, interventions = roll(robots, scheduler, ClearanceShield().prepare(scheduler), 160)
    assert least_distances(visited).min() > 2 * RADIUS
    assert (np.abs(visited) <= SIDE).all()
    assert np.abs(np.diff(visited, axis=0)).max() > 0.01  # they do move
    assert (interventions > 0).all()
    assert sum(BATCH * 160 * count for count, _ in CASES) > 1e6


def test_a_share_of_more_than_a_half_is_found_out():
    visited, _ = roll(2, FsyncScheduler(), ClearanceShield(0.51), 160)
    assert least_distances(visited).min() <= 2 * RADIUS


def test_what_is_safe_in_step_is_not_by_stale_looks():
    """The share of FSYNC under ASYNC: a robot moves by what it saw while the other one has come nearer."""
    visited, _ = roll(12, AsyncScheduler(), ClearanceShield(safe_share(FsyncScheduler())), 160)
    assert least_distances(visited).min() <= 2 * RADIUS


def test_without_a_shield_they_touch_and_nothing_is_counted():
    visited, interventions = roll(8, FsyncScheduler(), NoShield(), 160)
    assert least_distances(visited).min() <= 2 * RADIUS
    assert (interventions == 0).all()


@pytest.mark.parametrize("sensing", [None, VisibleSensing(rotation=True, reflection=True, unit_ratio=2.0, walls=True)])
def test_nobody_leaves_the_world(sensing):
    visited, _ = roll(8, FsyncScheduler(), ClearanceShield().prepare(FsyncScheduler()), 160, sensing, walls=True)
    assert (np.abs(visited) <= SIDE).all()
    assert (np.abs(visited[-1]).max(axis=(0, 1)) > SIDE - 0.1).mean() > 0.5
    assert least_distances(visited).min() > 2 * RADIUS


@pytest.mark.parametrize("steps", [1, 5, 12])
def test_the_shield_of_the_walls_keeps_robots_inside_however_long_moves_take(steps):
    scheduler = AsyncScheduler(max_move_steps=steps)
    visited, _ = roll(4, scheduler, WallShield().prepare(scheduler), 160, walls=True)
    assert (np.abs(visited) <= SIDE).all()
    assert np.abs(visited[-1]).max() > SIDE - 0.1


def test_a_share_of_a_fifth_is_too_much_for_moves_of_many_steps():
    visited, _ = roll(4, AsyncScheduler(max_move_steps=12), WallShield(), 160, walls=True)
    assert (np.abs(visited) > SIDE).any()


@pytest.mark.parametrize("name", ["ssync", "async"])
def test_only_moves_that_begin_are_counted(name):
    """Far from each other, each robot that looks begins to move, and its wish is always shortened."""
    config = world_of(3)
    env = SchedulerWrapper(with_array_leaves(World.create(config, UniformStart(), "C2")), SCHEDULERS[name])
    env = ShieldWrapper(env, with_array_leaves(ClearanceShield(0.01)), config)
    positions = 15.0 * np.stack([np.eye(3, 2)] * 4, axis=-1)
    state, begun = env.state(jnp.asarray(positions, jnp.float32), jnp.asarray(3, jnp.uint32)), 0
    for _ in range(12):
        after, _ = eqx.filter_jit(ShieldWrapper.step)(env, state, 9.0 * jnp.ones_like(state.positions))
        moves = after.inner.committed_velocity, state.inner.committed_velocity
        begun += (np.abs(np.subtract(*moves)).max(axis=1) > 0).sum(axis=0)
        state = after
    np.testing.assert_array_equal(state.interventions, begun)
    assert (begun > 0).all()
    assert (begun < 3 * 12).all()


@pytest.mark.parametrize(("robots", "name"), [(9, "fsync"), (5, "ssync, adversary, stopped anywhere"), (6, "async")])
@pytest.mark.parametrize("sensing", ["global", "visible"])
def test_sidesteps_and_steps_apart_go_through_the_shield(robots, name, sensing):
    """Robots that want nothing, in tight crowds at the walls, in the environment that a policy is executed in."""
    scheduler, config = SCHEDULERS[name], replace(world_of(robots), max_speed=9.0)
    rest = RestRule(dead_zone=0.1, damping=0.4, sidestep=1.0)
    problem = presets.resolve(
        "C",
        {"objective": "C2", "policy": {"use": "local"}, "sensing": {"use": sensing, "rotation": True, "walls": True}},
        {"shield": {"use": "clearance"}},
    )
    problem = replace(problem, world=config, start=UniformStart(), scheduler=scheduler, rest=rest)
    env = build_environment(problem, build_world(problem))
    starts = crowds(robots, np.random.default_rng(robots))
    reach = np.abs(starts).max(axis=1, keepdims=True)
    starts += np.sign(starts.mean(axis=1, keepdims=True)) * (SIDE - reach).astype(np.float32)
    starts = np.clip(starts, -SIDE, SIDE)

    @eqx.filter_jit
    def execute(env, positions):
        def step(state, _):
            after, _ = env.step(state, jnp.zeros_like(positions))
            return after, after.positions

        state = env.state(positions, jnp.asarray(3, jnp.uint32))
        return jnp.concatenate([positions[None], jax.lax.scan(step, state, None, length=60)[1]])

    visited = np.asarray(execute(env, jnp.asarray(np.moveaxis(starts, 0, -1)))).astype(float)
    assert least_distances(visited).min() > 2 * RADIUS
    assert (np.abs(visited) <= SIDE).all()
    assert np.abs(np.diff(visited, axis=0)).max() > 0.01


def test_opaque_robots_know_their_clearance():
    """The nearest robot is never hidden: what robots see for themselves shortens as much as all positions do.

    That is but for the room that they leave to robots that they approach and do not see.
    """
    config = world_of(24)
    world = with_array_leaves(World.create(config, UniformStart(), "C2"))
    env = LocalObservation(world, VisibleSensing(rotation=True, unit_ratio=3.0), config)
    positions = jnp.moveaxis(jnp.asarray(crowds(24, np.random.default_rng(0))), 0, -1)
    shield, velocities = ClearanceShield(0.4), jnp.full_like(positions, 3.0)

    @jax.jit
    def lengths(positions):
        state = env.state(positions)
        local = jnp.stack(state.frames.to_local(velocities[:, 0], velocities[:, 1]), axis=1)
        seen = shield(local, env.observe(state), config)
        known = shield(velocities, positions, config)
        return [jnp.hypot(each[:, 0], each[:, 1]) for each in (seen, known)]

    # No robot is near a wall, so all velocities keep their directions.
    seen, known = lengths(positions)
    assert (seen >= known - 1e-5).all()
    assert (seen <= known + 0.4 * ROOM * RADIUS + 1e-5).all()
    assert known.min() < 0.1 < known.max()


@given(
    gap=st.floats(1e-4, 5.0),
    angle=st.floats(0, 2 * np.pi),
    share=st.floats(0.01, 0.49),
    speeds=st.tuples(st.floats(0, 10), st.floats(0, 10)),
)
def test_two_robots_that_rush_at_each_other_keep_the_rest_of_the_gap(gap, angle, share, speeds):
    direction = np.array([np.cos(angle), np.sin(angle)])
    positions = np.stack([np.zeros(2), (2 * RADIUS + gap) * direction]).astype(np.float32)
    velocities = (np.array(speeds)[:, None] * np.stack([direction, -direction])).astype(np.float32)
    shortened = np.asarray(shorten(share, jnp.asarray(velocities), jnp.asarray(positions))).astype(float)
    limit = share * max(gap - ROOM * RADIUS, 0)
    np.testing.assert_allclose(np.hypot(*shortened.T), np.minimum(speeds, limit), rtol=1e-3, atol=3e-5)
    assert oracle.closest_approach(positions, shortened)[0, 1] >= 2 * RADIUS + (1 - 2 * share) * gap - 1e-5


@jax.jit
def shorten(share, velocities, positions):
    shield = eqx.tree_at(lambda shield: shield.share, with_array_leaves(ClearanceShield(0.25)), share)
    return shield(velocities, positions, world_of(2))


def test_robots_that_approach_each_other_for_long_can_still_part():
    """They stop at some clearance: without that, it would be less than what rounded positions can tell."""
    positions = np.array([[0.0, 0.0], [2.5 * RADIUS, 0.0]])
    closer = jnp.asarray([[9.0, 0.0], [-9.0, 0.0]], jnp.float32)
    for step, wanted in enumerate([closer] * 300 + [-closer] * 7):
        if step == 300:
            assert positions[1, 0] - positions[0, 0] == pytest.approx((2 + ROOM) * RADIUS, abs=1e-4)
        positions = positions + np.asarray(shorten(0.49, wanted, jnp.asarray(positions, jnp.float32)))
    assert positions[1, 0] - positions[0, 0] > 4 * RADIUS


def test_touching_robots_get_free_and_twice_as_far_each_time():
    positions = np.array([[0.0, 0.0], [2 * RADIUS + 1e-3, 0.0]])
    gaps = []
    for _ in range(9):
        gaps.append(positions[1, 0] - positions[0, 0] - 2 * RADIUS)
        wanted = jnp.asarray([[-9.0, 0.0], [9.0, 0.0]], jnp.float32)
        positions = positions + np.asarray(shorten(0.49, wanted, jnp.asarray(positions, jnp.float32)))
    np.testing.assert_allclose(np.array(gaps[1:]) / gaps[:-1], 1.98, rtol=0.03)


def test_coincident_robots_stay_and_nothing_is_not_a_number():
    positions = jnp.zeros((2, 2))
    np.testing.assert_array_equal(shorten(0.49, jnp.ones((2, 2)), positions), jnp.zeros((2, 2)))
    gradient = jax.grad(lambda v: shorten(0.49, v, positions + jnp.array([[0.0], [5.0]])).sum())(jnp.zeros((2, 2)))
    assert np.isfinite(gradient).all()


@pytest.mark.parametrize(
    ("scheduler", "cycle", "steps"),
    [
        (FsyncScheduler(), 0.5, 1),
        (SsyncScheduler(), 0.5, 1),
        (AsyncScheduler(max_delay=0, max_move_steps=1), 0.5, 1),
        (AsyncScheduler(max_delay=1, max_move_steps=1), 0.2, 1),  # c = (1 - c) / 4
        (AsyncScheduler(), 0.126866, 4),  # c = (1 - c)^5 / 4
    ],
)
def test_the_share_follows_from_the_schedulers_numbers(scheduler, cycle, steps):
    assert safe_share(scheduler) == pytest.approx(0.98 * cycle / steps, rel=1e-4)
    assert ClearanceShield().prepare(scheduler).share == safe_share(scheduler)


class Endless(Scheduler):
    """States neither its delays nor how long moves take."""

    def activate(self, key, clock):
        zero = jnp.zeros_like(clock.idle)
        return Activation(zero == 0, zero, zero, zero + 1, zero + 1.0)

    @property
    def period(self):
        return 1


def test_what_cannot_be_served_is_refused():
    with pytest.raises(
        InputError, match=r"scheduler .*Endless states no max_delay and max_move_steps, and no share is safe"
    ):
        ClearanceShield().prepare(Endless())
    with pytest.raises(InputError, match=r"^shield.use = 'walls': .*Endless states no max_move_steps, and no share"):
        WallShield().prepare(Endless())
    with pytest.raises(InputError, match=r"^shield.share = 0.3: must be at most 0.03108, which is safe under .* async"):
        presets.resolve("C", {"shield": {"use": "clearance", "share": 0.3}, "scheduler": {"use": "async"}})
    with pytest.raises(InputError, match=r"^shield.share = 0.0: must be a finite number > 0 and <= 1"):
        presets.resolve("C", {"shield": {"use": "clearance", "share": 0}})
    assert presets.resolve("C", {"shield": {"use": "clearance"}}).prepared_shield.share == pytest.approx(0.49)
