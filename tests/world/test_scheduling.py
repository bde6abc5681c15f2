"""Who looks and moves when, read back from displacements alone: velocities say at which step they were computed."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from murmurate.errors import InputError
from murmurate.world import (
    Activation,
    Scheduler,
    SchedulerWrapper,
    UniformStart,
    World,
    WorldConfig,
    with_array_leaves,
)

ROBOTS, STEPS, BATCH = 4, 60, 8
# So far apart that nobody ever meets, in a world that nobody ever leaves.
WORLD = WorldConfig(robots=ROBOTS, half_width=1e5, half_height=1e5, scan_radius=1e6)
PLACES = np.array([[0, 0], [1000, 0], [0, 1000], [1000, 1000]], np.float32)


def world(config=WORLD):
    return World.create(config, UniformStart(), "C2")


def scheduler_of(use="fsync", **fields):
    return Scheduler.registered()[use](**fields)


def answer(step):
    """The velocity that is computed at a step: its direction tells which."""
    angle = 0.1 * step
    return 0.8 * np.array([np.cos(angle), np.sin(angle)], np.float32)


def ran(steps=STEPS, seed=0, **scheduler):
    """Runs a scheduler; returns displacements (steps, robots, 2, batch) and epochs after every step."""
    env = with_array_leaves(SchedulerWrapper(world(), scheduler_of(**scheduler)))
    places = jnp.asarray(np.broadcast_to(PLACES[..., None], (ROBOTS, 2, BATCH)))
    answers = jnp.asarray(np.array([answer(t) for t in range(steps)]))
    moved, epochs, ended = step_through(env, places, jnp.asarray(seed, jnp.uint32), answers)
    assert not ended.any()
    return np.asarray(moved, float), np.asarray(epochs)


@eqx.filter_jit
def step_through(env, places, seed, answers):
    def step(state, velocity):
        after, transition = env.step(state, jnp.broadcast_to(velocity[None, :, None], (ROBOTS, 2, BATCH)))
        return after, (after.positions - state.positions, after.epochs, transition.terminated)

    return jax.lax.scan(step, env.state(places, seed), answers)[1]


def looks(moved):
    """Reads back at which step each velocity was computed: (steps, robots, batch), -1 where nobody moves."""
    speed = np.hypot(moved[:, :, 0], moved[:, :, 1])
    angle = np.arctan2(moved[:, :, 1], moved[:, :, 0]) % (2 * np.pi)
    now = 0.1 * np.arange(len(moved))[:, None, None]
    # Of all steps with that direction, the last one so far.
    step = np.rint((now - (now - angle + 0.05) % (2 * np.pi) + 0.05) / 0.1).astype(int)
    return np.where(speed > 1e-3, step, -1)


def recounted(looked):
    """Counts epochs from the moves alone: one ends when everybody has ended a cycle since the last did."""
    steps, robots, batch = looked.shape
    later = np.concatenate([looked[1:], np.full((1, robots, batch), -2)])
    epochs = np.zeros((steps, batch), int)
    for episode in range(batch):
        done, count = set(), 0
        for step in range(steps):
            ends = (looked[step, :, episode] >= 0) & (looked[step, :, episode] != later[step, :, episode])
            done |= set(np.flatnonzero(ends))
            if len(done) == robots:
                done, count = set(), count + 1
            epochs[step, episode] = count
    return epochs


def test_all_at_every_step_is_what_the_world_itself_does():
    plain, env = world(), SchedulerWrapper(world(), scheduler_of())
    advance = jax.jit(lambda state, same, velocities: (env.step(state, velocities), plain.step(same, velocities)))
    state, same = jax.jit(lambda: (env.state(jnp.asarray(PLACES)), plain.state(jnp.asarray(PLACES))))()
    for step in range(5):
        velocities = jnp.asarray(3 * np.random.default_rng(step).normal(size=(ROBOTS, 2)), jnp.float32)
        (state, a), (same, b) = advance(state, same, velocities)
        assert (np.asarray(state.positions) == np.asarray(same.positions)).all()
        assert float(a.reward) == float(b.reward)
    assert int(state.epochs) == int(same.epochs) == 5
    assert scheduler_of().is_trivial
    assert not scheduler_of(rigid=False).is_trivial


@settings(max_examples=8)
@given(
    seed=st.integers(0, 1000),
    activation_probability=st.sampled_from([0.0, 0.4, 1.0]),
    fairness_bound=st.sampled_from([1, 4]),
)
def test_some_at_every_step_never_nobody_and_everybody_within_the_bound(seed, activation_probability, fairness_bound):
    moved, epochs = ran(
        seed=seed, use="ssync", activation_probability=activation_probability, fairness_bound=fairness_bound
    )
    looked = looks(moved)
    active = looked >= 0
    assert active.any(axis=1).all()
    now = np.broadcast_to(np.arange(STEPS)[:, None, None], looked.shape)
    assert (looked[active] == now[active]).all()
    for first in range(STEPS - fairness_bound + 1):
        assert active[first : first + fairness_bound].any(axis=0).all()
    # Every active robot completes its cycle within the step.
    count = np.zeros(BATCH, int)
    for episode in range(BATCH):
        done = set()
        for step in range(STEPS):
            done |= set(np.flatnonzero(active[step, :, episode]))
            if len(done) == ROBOTS:
                done, count[episode] = set(), count[episode] + 1
        assert epochs[-1, episode] == count[episode]
    assert (epochs[-1] >= STEPS // fairness_bound).all()


def test_the_share_of_the_active_is_as_asked():
    active = looks(ran(steps=400, use="ssync", activation_probability=0.3, fairness_bound=50)[0]) >= 0
    # One is drawn where all would rest: 0.3 + 0.7^4 / 4.
    assert active.mean() == pytest.approx(0.3 + 0.7**4 / 4, abs=0.02)


@settings(max_examples=8)
@given(seed=st.integers(0, 1000), max_delay=st.sampled_from([0, 1, 4]), max_move_steps=st.sampled_from([1, 5]))
def test_each_in_its_own_time_moves_by_what_it_saw_some_steps_ago(seed, max_delay, max_move_steps):
    moved, epochs = ran(seed=seed, use="async", max_delay=max_delay, max_move_steps=max_move_steps)
    looked = looks(moved)
    period = scheduler_of(use="async", max_delay=max_delay, max_move_steps=max_move_steps).period
    steps = np.arange(STEPS)
    for robot in range(ROBOTS):
        for episode in range(BATCH):
            look_steps = looked[:, robot, episode]
            cycles = sorted(set(look_steps[look_steps >= 0]))
            for cycle, following in zip(cycles, [*cycles[1:], None], strict=True):
                at = steps[look_steps == cycle]
                assert (np.diff(at) == 1).all(), "a move is in one piece"
                assert len(at) <= max_move_steps
                assert 0 <= at[0] - cycle <= max_delay
                assert following is None or 1 <= following - at[-1] <= max_delay + 1
            assert len(cycles) >= STEPS // period - 1
    assert (epochs[:-1] == recounted(looked)[:-1]).all()
    if max_delay:
        stale = looked[looked >= 0] < np.broadcast_to(steps[:, None, None], looked.shape)[looked >= 0]
        assert stale.any()
        assert len({tuple(looked[:, r, 0] >= 0) for r in range(ROBOTS)}) > 1


@settings(max_examples=8)
@given(
    seed=st.integers(0, 1000),
    use=st.sampled_from(["fsync", "ssync", "async"]),
    min_move=st.sampled_from([0.05, 0.5, 2.0]),
)
def test_a_move_may_be_stopped_but_not_before_the_least_distance(seed, use, min_move):
    moved, _ = ran(seed=seed, use=use, rigid=False, min_move=min_move)
    whole, _ = ran(seed=seed, use=use, rigid=True)
    looked, meant = looks(moved), looks(whole)
    shorter = 0
    for robot in range(ROBOTS):
        for episode in range(BATCH):
            # The last cycle may not be over.
            for cycle in sorted(set(meant[:, robot, episode]) - {-1})[:-1]:
                go = moved[looked[:, robot, episode] == cycle, robot, :, episode].sum(axis=0)
                want = whole[meant[:, robot, episode] == cycle, robot, :, episode].sum(axis=0)
                way, full = np.hypot(*go), np.hypot(*want)
                assert min(min_move, full) - 1e-3 <= way <= full + 1e-3
                assert np.abs(go[0] * want[1] - go[1] * want[0]) < 1e-3
                shorter += way < full - 1e-3
    assert shorter or min_move > 0.8


def test_an_adversary_does_worse_than_chance_and_is_as_fair():
    config = WorldConfig(robots=6, half_width=45, half_height=45)
    results = {}
    for adversarial in (False, True):
        env = SchedulerWrapper(
            world(config), scheduler_of(use="ssync", adversarial=adversarial, fairness_bound=6, rigid=False)
        )

        def advance(state, _, env=env):
            towards = -state.positions / jnp.linalg.norm(state.positions, axis=1, keepdims=True)
            after, transition = env.step(state, 0.5 * towards)
            active = jnp.any(after.positions != state.positions, axis=1)
            return after, (transition.reward, active)

        @jax.jit
        def run(env=env, advance=advance):
            return jax.lax.scan(advance, env.reset_batch(jax.random.key(0), 64), None, length=20)[1]

        reward, active = run()
        active = np.asarray(active)
        assert active.any(axis=1).all()
        assert all(active[first : first + 6].any(axis=0).all() for first in range(15))
        results[adversarial] = float(reward.sum(axis=0).mean())
    assert results[True] < results[False]


def test_those_who_stand_still_collide_too():
    config = WorldConfig(robots=2, half_width=20, half_height=20)
    env = SchedulerWrapper(world(config), scheduler_of(use="ssync", activation_probability=0.0, fairness_bound=100))
    places, velocities = jnp.asarray([[-1.3, 0.0], [1.3, 0.0]]), jnp.asarray([[1.0, 0.0], [-1.0, 0.0]])
    _, transition = jax.jit(lambda: env.step(env.state(places), velocities))()
    assert bool(transition.terminated)


def test_not_a_number_ends_the_episode():
    env = SchedulerWrapper(world(), scheduler_of(rigid=False))
    _, transition = jax.jit(lambda: env.step(env.state(jnp.asarray(PLACES)), jnp.full((ROBOTS, 2), jnp.nan)))()
    assert bool(transition.terminated)


@pytest.mark.parametrize(
    ("use", "field", "value", "allowed"),
    [
        ("ssync", "activation_probability", 1.5, "a finite number >= 0 and <= 1"),
        ("ssync", "fairness_bound", 0, "an integer >= 1"),
        ("async", "max_delay", -1, "an integer >= 0"),
        ("async", "max_move_steps", 0, "an integer >= 1"),
        ("fsync", "min_move", 0.0, "a finite number > 0"),
    ],
)
def test_bad_numbers_are_refused(use, field, value, allowed):
    with pytest.raises(InputError, match=f"{field} = .*: must be {allowed}"):
        scheduler_of(use, **{field: value})


class RoundRobin(Scheduler):
    """One robot after another: a scheduler of a user's own, which knows the step."""

    def activate(self, key, clock):
        robots = clock.idle.shape[0]
        zero = jnp.zeros(robots, jnp.int32)
        return Activation(clock.step % robots == jnp.arange(robots), zero, zero, zero + 1, jnp.ones(robots))

    @property
    def period(self):
        return MAX_ROBOTS


MAX_ROBOTS = ROBOTS


def test_a_scheduler_of_ones_own_is_told_the_step():
    env = SchedulerWrapper(world(), RoundRobin())
    state = env.state(jnp.asarray(PLACES))
    for step in range(2 * ROBOTS):
        after, _ = env.step(state, jnp.full((ROBOTS, 2), 0.5))
        moved = np.asarray((after.positions != state.positions).any(axis=1))
        np.testing.assert_array_equal(np.flatnonzero(moved), [step % ROBOTS])
        state = after
    assert int(state.epochs) == 2
