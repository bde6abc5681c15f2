"""A policy with its own eyes: nothing but what a robot perceives moves it, in whatever frame it perceives it."""

from __future__ import annotations

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from murmurate.errors import InputError
from murmurate.policies import LocalPolicy
from murmurate.policies.shield import WALL_SHARE
from murmurate.world import Observation, Sensing, VisibleSensing, WorldConfig

R, SCAN = 1.0, 40.0


@functools.cache
def networks(landmark=True):
    build = eqx.filter_jit(LocalPolicy(hidden=(16, 8), gaps=True, exits=True).networks)
    policy, value = build(WorldConfig(robots=6), landmark, jax.random.key(0))
    return louder(policy), value


def louder(policy):
    """Fresh heads are all but silent: here they speak up."""
    names = [name for name in ("head", "to_point", "to_gap", "to_exit") if getattr(policy, name) is not None]
    heads = lambda p: [getattr(p, name).weight for name in names]  # noqa: E731
    return eqx.tree_at(heads, policy, [20 * weight for weight in heads(policy)])


def configuration(seed=0, robots=6):
    angle = 2 * np.pi * np.arange(robots) / robots
    ring = 2.0 * robots * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return jnp.asarray(ring + np.random.default_rng(seed).uniform(-2, 2, ring.shape), jnp.float32)


def observed(positions, seed=0, use="global", **fields):
    return _observed(Sensing.registered()[use](**fields), positions, jax.random.key(seed))


@eqx.filter_jit
def _observed(sensing, positions, key):
    frames = sensing.draw_frames(key, len(positions))
    view = sensing.view(positions, frames, key, WorldConfig(robots=len(positions), radius=R, scan_radius=SCAN))
    return frames, Observation(view, positions, 45.0 - jnp.abs(positions).max(axis=1))


def velocities(policy, positions, seed=0, **sensing):
    """Returns what the robots do, in the world's frame."""
    frames, observation = observed(positions, seed, **sensing)
    return np.asarray(frames.to_world(act(policy, observation)))


@eqx.filter_jit
def act(network, observation):
    return network(observation)


@pytest.mark.parametrize("use", ["global", "scan", "visible"])
def test_no_frame_changes_where_a_robot_goes(use):
    policy, _ = networks()
    plain = velocities(policy, configuration(), use=use)
    assert np.abs(plain).max() > 0.1
    for seed in range(4):
        turned = velocities(policy, configuration(), seed, use=use, rotation=True, unit_ratio=5.0)
        np.testing.assert_allclose(turned, plain, atol=2e-5)


def test_a_mirrored_frame_changes_where_its_robot_goes_and_nobody_else():
    """A policy may prefer one hand: only robots that do not see a mirror image go where they went."""
    policy, _ = networks()
    plain = velocities(policy, configuration())
    frames, observation = observed(configuration(), 1, rotation=True, reflection=True)
    mirrored = np.asarray(frames.chirality) < 0
    assert 0 < mirrored.sum() < len(mirrored)
    now = np.asarray(frames.to_world(act(policy, observation)))
    np.testing.assert_allclose(now[~mirrored], plain[~mirrored], atol=2e-5)
    assert (np.abs(now - plain)[mirrored].max(axis=1) > 0.01).all()


def test_turning_the_swarm_turns_its_velocities():
    policy, _ = networks()
    turn = jnp.asarray([[np.cos(1.0), -np.sin(1.0)], [np.sin(1.0), np.cos(1.0)]], jnp.float32)
    plain = velocities(policy, configuration(), use="visible", rotation=True)
    turned = velocities(policy, configuration() @ turn.T, 3, use="visible", rotation=True)
    np.testing.assert_allclose(turned, plain @ np.asarray(turn).T, atol=2e-5)


def test_moving_the_swarm_changes_nothing_without_a_landmark():
    policy, _ = networks(landmark=False)
    plain = velocities(policy, configuration(), use="visible")
    np.testing.assert_allclose(velocities(policy, configuration() + 7.0, use="visible"), plain, atol=2e-5)
    aware, _ = networks(landmark=True)
    centered, shifted = (velocities(aware, configuration() + shift) for shift in (0.0, 7.0))
    assert np.abs(centered - shifted).max() > 0.01


def test_robots_have_no_number():
    policy, _ = networks()
    order = np.random.default_rng(1).permutation(6)
    plain = velocities(policy, configuration(), use="visible")
    np.testing.assert_allclose(velocities(policy, configuration()[order], use="visible"), plain[order], atol=2e-5)


def test_what_is_hidden_does_not_move_a_robot():
    """Robot 2 stands behind robot 1: wherever it is there, 0 does the same, unless it sees through 1."""
    policy, _ = networks()
    positions = configuration().at[:3].set(jnp.asarray([[0.0, -20.0], [0.0, -15.0], [0.0, -8.0]]))
    displaced = positions.at[2].set(jnp.asarray([0.3, -6.5]))
    _, observation = observed(positions, use="visible")
    assert not bool(observation.view.seen[0, 2])
    first, second = (velocities(policy, p, use="visible")[0] for p in (positions, displaced))
    np.testing.assert_array_equal(first, second)
    first, second = (velocities(policy, p, use="scan")[0] for p in (positions, displaced))
    assert np.abs(first - second).max() > 1e-4


def test_positions_never_reach_the_acting_policy():
    policy, value = networks()
    _, observation = observed(configuration(), use="visible")
    blind = eqx.tree_at(lambda o: o.positions, observation, observation.positions * jnp.nan)
    np.testing.assert_array_equal(act(policy, blind), act(policy, observation))
    assert not np.isfinite(np.asarray(act(value, blind))).any()


def test_a_robot_knows_no_size_of_the_world():
    """Neither its sides nor the time that it has: without walls to see, the same weights do the same."""
    policy, _ = networks()
    wide = WorldConfig(robots=6, half_width=500.0, half_height=70.0, collision_penalty=9.0)
    build = eqx.filter_jit(LocalPolicy(hidden=(16, 8), gaps=True, exits=True).networks)
    wide_policy = louder(build(wide, True, jax.random.key(0))[0])
    plain = velocities(policy, configuration(), use="visible")
    np.testing.assert_array_equal(velocities(wide_policy, configuration(), use="visible"), plain)


def test_walls_far_away_do_not_matter():
    """A robot that perceives all four walls does the same in a larger world, but near a wall."""
    build = eqx.filter_jit(LocalPolicy(hidden=(16, 8), walls=True, gaps=True).networks)
    policy = louder(build(WorldConfig(robots=6), True, jax.random.key(0))[0])
    policy = eqx.tree_at(lambda p: p.to_walls.weight, policy, replace_fn=lambda weight: 20 * weight)
    sensing = VisibleSensing(walls=True)

    def change(positions, side, larger):
        """Returns how much faster or slower robots go where two of the walls are farther away."""
        moves = []
        for half in (side, larger):
            world = WorldConfig(robots=6, radius=R, half_width=half, half_height=half, scan_radius=1000.0)
            frames = sensing.draw_frames(jax.random.key(0), 6)
            view = sensing.view(positions, frames, jax.random.key(0), world)
            moves.append(act(policy, Observation(view, positions, half - jnp.abs(positions).max(axis=1))))
        return np.abs(np.subtract(*moves)).max()

    assert change(configuration(), 45.0, 90.0) < 1e-3
    assert change(configuration() + 30.0, 45.0, 90.0) > 1e-2


@pytest.mark.parametrize("far", [0.0, 0.3, 40.0])
def test_no_robot_goes_more_than_a_share_of_its_way_to_a_wall_that_it_perceives(far):
    """In a corner, and as fast as it would go anyway where no wall is near."""
    policy, _ = networks()
    positions = configuration() + 45.0 - far - configuration().max(axis=0)
    plain, slowed = (
        velocities(policy, positions, 3, use="global", rotation=True, reflection=True, unit_ratio=3.0, walls=walls)
        for walls in (False, True)
    )
    way = 45.0 - np.asarray(positions)
    np.testing.assert_allclose(slowed, np.minimum(plain, WALL_SHARE * way), atol=2e-5)
    assert (far == 40.0) == np.allclose(slowed, plain, atol=1e-4)
    # Away from a wall, or from the opposite one, nothing holds a robot back.
    back = velocities(policy, -positions, 3, use="global", rotation=True, walls=True)
    free = velocities(policy, -positions, 3, use="global", rotation=True)
    np.testing.assert_allclose(back, np.maximum(free, -WALL_SHARE * way), atol=2e-5)


@pytest.mark.parametrize("robots", [2, 3, 16, 40])
def test_the_same_weights_act_in_every_swarm(robots):
    policy, value = networks()
    _, observation = observed(configuration(robots=robots), use="visible")
    chosen = np.asarray(act(policy, observation))
    assert chosen.shape == (robots, 2)
    assert act(value, observation).shape == (robots,)
    speeds = np.linalg.norm(chosen, axis=1)
    assert np.isfinite(speeds).all()
    assert (speeds <= 1.0).all()


def test_a_robot_alone_and_coincident_robots_are_defined():
    policy, _ = networks()
    for positions in (jnp.asarray([[0.0, 0.0], [100.0, 0.0]]), jnp.zeros((3, 2))):
        total = eqx.filter_grad(lambda p, x: jnp.sum(p(observed(x, use="scan")[1])))
        gradient = eqx.filter_jit(total)(policy, positions)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))


def test_velocities_do_not_grow_with_the_swarm():
    """Four times as many robots far away, on the same circle, pull hardly harder."""
    policy, _ = networks(landmark=False)
    mean = []
    for count in (60, 240):
        angle = np.pi * (np.arange(count) + 0.5) / count
        far = 35.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        positions = jnp.asarray(np.vstack([[[0.0, 0.0]], far]), jnp.float32)
        mean.append(np.arctanh(np.linalg.norm(velocities(policy, positions, use="global")[0])))
    assert mean[1] < 3 * mean[0]


@pytest.mark.parametrize("robots", [8, 24, 100])
def test_an_enclosed_robot_leaves_the_middle_of_a_ring(robots):
    """However wide the ring is: the one at its exact centre stays, those on it do not act on gaps."""
    build = eqx.filter_jit(LocalPolicy(hidden=(16, 8), gaps=True, exits=True).networks)
    policy = build(WorldConfig(robots=robots), False, jax.random.key(0))[0]
    silent = eqx.tree_at(lambda p: p, policy, jax.tree.map(jnp.zeros_like, eqx.filter(policy, eqx.is_array)))
    leaving = eqx.tree_at(lambda p: p.to_exit.bias, silent, jnp.full(1, 3.0))
    angle = 2 * np.pi * np.arange(robots - 1) / (robots - 1)
    ring = 4.0 * robots * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    for share, least in ((0.0, None), (0.01, 0.5), (0.1, 0.9), (0.5, 0.95)):
        inside = share * 4.0 * robots * np.array([np.cos(0.3), np.sin(0.3)])
        moves = velocities(leaving, jnp.asarray(np.vstack([ring, inside]), jnp.float32), 3, rotation=True)
        if least is None:
            np.testing.assert_allclose(moves[-1], 0, atol=2e-3)
        else:
            assert moves[-1] @ np.array([np.cos(0.3), np.sin(0.3)]) >= least
        np.testing.assert_allclose(moves[:-1], 0, atol=1e-6)


def test_exits_need_gaps():
    with pytest.raises(InputError, match=r"^exits = True: must be false without gaps$"):
        LocalPolicy(exits=True)


def test_a_network_is_given_walls_and_gaps_that_have_no_effect_yet():
    def build(**inputs):
        networks = eqx.filter_jit(LocalPolicy(hidden=(16, 8), **inputs).networks)
        return networks(WorldConfig(robots=6), True, jax.random.key(0))[0]

    plain, template = build(), eqx.filter_eval_shape(lambda: build(walls=True, gaps=True, exits=True))
    wider = plain.widened_to(template)
    assert jax.tree.map(jnp.shape, eqx.filter(wider, eqx.is_array)) == jax.tree.map(
        jnp.shape, eqx.filter(build(walls=True, gaps=True, exits=True), eqx.is_array)
    )
    for walls in (False, True):
        _, observation = observed(configuration(), use="visible", walls=walls)
        np.testing.assert_allclose(act(wider, observation), act(plain, observation), atol=1e-6)
    # They are there to be trained.
    _, observation = observed(configuration() + 36.0, use="visible", walls=True)
    slope = eqx.filter_jit(eqx.filter_grad(lambda p: jnp.sum(p(observation) ** 2)))(wider)
    for head in (slope.to_gap, slope.to_walls):
        assert np.abs(head.weight).max() > 0
    _, observation = observed(configuration().at[0].set(jnp.array([1.0, 2.0])), use="visible")
    slope = eqx.filter_jit(eqx.filter_grad(lambda p: jnp.sum(p(observation) ** 2)))(wider)
    assert np.abs(slope.to_exit.weight).max() > 0
    # What has all of them, or could only have walls before gaps, is left as it is.
    for network in (build(walls=True, gaps=True, exits=True), build(gaps=True)):
        assert network.widened_to(template) is network


def test_a_network_is_given_units_that_have_no_effect_yet():
    def build(landmark=True, **fields):
        fields = {"walls": True, "gaps": True, "basis": 4, **fields}
        return eqx.filter_jit(LocalPolicy(**fields).networks)(WorldConfig(robots=6), landmark, jax.random.key(0))[0]

    narrow = louder(build(hidden=(16, 8)))
    wide = narrow.widened_to(eqx.filter_eval_shape(lambda: build(hidden=(24, 20))))
    assert jax.tree.map(jnp.shape, eqx.filter(wide, eqx.is_array)) == jax.tree.map(
        jnp.shape, eqx.filter(build(hidden=(24, 20)), eqx.is_array)
    )
    _, observation = observed(configuration(), use="visible", walls=True)
    np.testing.assert_allclose(act(wide, observation), act(narrow, observation), atol=1e-6)
    slope = eqx.filter_jit(eqx.filter_grad(lambda p: jnp.sum(p(observation) ** 2)))(wide)
    # What comes of the new units is there to be trained; two of them do not do the same.
    assert np.abs(slope.head.weight[:, 8:]).min() > 0
    assert np.abs(slope.to_gap.weight[:, 16:]).min() > 0
    assert np.abs(np.diff(slope.head.weight[:, 8:], axis=1)).min() > 0
    # Narrower ones, others' inputs: left as it is.
    for fields in ({"hidden": (12, 20)}, {"basis": 6}, {"landmark": False}):
        template = eqx.filter_eval_shape(lambda fields=fields: build(**{"hidden": (24, 20), **fields}))
        assert narrow.widened_to(template) is narrow
