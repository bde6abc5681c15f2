"""The whole plane, `bounded = false`: nobody leaves it, there are no walls, and everything else stays."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from murmurate.discovery import Cascade, RestRule, check_validity
from murmurate.errors import InputError
from murmurate.plots.swarm import draw_world, world_half_side
from murmurate.policies import ClearanceShield, LocalPolicy
from murmurate.runs import config_io, presets
from murmurate.world import JitteredStart, LocalObservation, VisibleSensing, World, WorldConfig
from tiny import tiny

ROOM = WorldConfig(robots=3, half_width=10.0, half_height=10.0, scan_radius=40.0, max_speed=1.0)
PLANE = replace(ROOM, bounded=False)
START = np.array([[[-9.0, 0.0], [0.0, 9.0], [9.0, 0.0]]])
APART = jnp.asarray(np.moveaxis(START, 0, -1), jnp.float32)


def world(config):
    return World.create(config, JitteredStart(jnp.asarray(START, jnp.float32)), "C2")


def outwards(positions):
    """Robots go away from the origin until they are 30 away."""
    distance = jnp.sqrt(jnp.sum(positions**2, axis=1, keepdims=True))
    return jnp.where(distance < 30, 0.9 * positions / distance, 0.0)


@pytest.mark.parametrize(("config", "ends"), [(ROOM, True), (PLANE, False)])
def test_only_a_world_with_walls_is_left(config, ends):
    cascade = Cascade((outwards,), world(config), RestRule(window=2, dead_zone=0.0, max_steps=60))
    trajectories = cascade.rollout(START)
    validity = check_validity(trajectories, config)
    assert trajectories.terminated.tolist() == [ends]
    assert validity.inside.tolist() == [not ends]
    assert validity.at_rest.tolist() == [not ends]
    if not ends:
        distance = np.linalg.norm(trajectories.final[0], axis=-1)
        assert ((distance >= 30) & (distance < 31)).all()
        assert not validity.valid.any()  # they are no neighbours any more


def test_contact_ends_an_episode_there_too():
    together = jnp.asarray([[-1.5, 0.0], [1.5, 0.0], [0.0, 9.0]])[:, :, None]
    velocities = jnp.asarray([[0.9, 0.0], [-0.9, 0.0], [0.0, 0.0]])[:, :, None]
    plane = world(PLANE)
    _, transition = jax.jit(lambda: plane.step(plane.state(together), velocities))()
    assert transition.terminated.tolist() == [True]


def test_signals_are_those_of_the_rectangle():
    inside, plane = (world(config).signals(APART) for config in (ROOM, PLANE))
    assert {name: value.tolist() for name, value in inside.items()} == {
        name: value.tolist() for name, value in plane.items()
    }


def test_there_are_no_walls_to_perceive_and_none_that_limit():
    sensing = VisibleSensing(walls=True)
    views = {}
    for config in (ROOM, PLANE):
        env = LocalObservation(world(config), sensing, config)
        state = env.state(APART)
        views[config.bounded] = env.observe(state)
    assert views[True].view.walls.shape == (3, 4, 2, 1)
    assert views[False].view.walls is None
    assert views[False].walls.tolist() == [[40.0]] * 3
    fast = outwards(APART)
    for observation in (views[False], APART):
        assert (ClearanceShield()(fast, observation, PLANE) == fast).all()
    assert (jnp.abs(ClearanceShield()(fast, APART, ROOM)) < jnp.abs(fast)).any()


def test_a_policy_that_acts_on_walls_takes_none_for_far_ones():
    policy, _ = eqx.filter_jit(LocalPolicy(hidden=(8, 4), walls=True).networks)(ROOM, False, jax.random.key(0))
    act = eqx.filter_jit(lambda env: policy(env.observe(env.state(APART))))
    wide = replace(ROOM, half_width=1e6, half_height=1e6, scan_radius=1e4)
    sensing = VisibleSensing(walls=True)
    moves = []
    for config in (wide, replace(wide, bounded=False)):
        env = LocalObservation(world(config), sensing, config)
        moves.append(act(env))
    np.testing.assert_array_equal(*moves)
    near = LocalObservation(world(ROOM), sensing, ROOM)
    assert (act(near) != moves[0]).any()


def test_the_plane_has_no_edge_to_draw():
    from matplotlib.figure import Figure

    ax = Figure().add_subplot()
    assert draw_world(ax, ROOM).get_visible()
    assert not draw_world(ax, PLANE).get_visible()
    assert world_half_side(ROOM, 3 * START) == 10
    assert world_half_side(PLANE, 3 * START) == 28


def test_experiments_choose_it():
    config = tiny(world={"bounded": False})
    assert presets.resolve(config) == config
    assert config_io.from_dict(WorldConfig, config_io.to_dict(config.world)) == config.world
    with pytest.raises(InputError, match=r"bounded = 'no'.*true or false"):
        WorldConfig(bounded="no")  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"sensing\.walls = False: must be true"):
        tiny(policy={"use": "local", "hidden": [4, 4], "walls": True}, sensing={"use": "visible"})
