"""Strategies of a user's own in the environments and in exported models."""

from __future__ import annotations

import warnings
from pathlib import Path

import equinox as eqx
import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_hand import CONFIG, SWARM, TRIANGLE, close, signals_of, world

from murmurate import Policy, PolicyNetwork, Signal
from murmurate.discovery import build_cascade, build_networks
from murmurate.discovery.stage import draw_key
from murmurate.errors import InputError
from murmurate.interop.gymnasium import ENV_ID, GatheringEnv, GatheringVectorEnv
from murmurate.interop.pettingzoo import parallel_env
from murmurate.policies import EquivariantPolicy, WallShield
from murmurate.runs import presets
from murmurate.runs.run import Run
from own.mine import Calm, Half, Linear, Nearest, Rings, RoundRobin

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of what the converter imports
    from murmurate.interop import onnx

pytestmark = [
    pytest.mark.filterwarnings("ignore:::(jax2onnx|onnx|onnx_ir|flax|orbax|google).*"),
    pytest.mark.usefixtures("quick_conversion"),
]

ROBOTS = 3
SMALL = EquivariantPolicy(hidden=(8, 4))


def test_a_start_is_given_by_module_and_class_with_its_fields_or_as_an_object():
    starts = ("own.mine:Rings", {"use": "own.mine:Rings", "gap": 5.0}, Rings(gap=5.0))
    plain, mapping, instance = (GatheringEnv(**SWARM, start=start).reset(seed=0)[0] for start in starts)
    np.testing.assert_array_equal(mapping, instance)
    np.testing.assert_allclose(np.linalg.norm(plain[1]), 4.0, atol=1.5)
    np.testing.assert_allclose(np.linalg.norm(mapping[1]), 5.0, atol=1.5)


@pytest.mark.parametrize("calm", ["own.mine:Calm", Calm(weight=0.5), {"use": "own.mine:Calm", "weight": 0.5}])
def test_a_signal_is_part_of_infos_and_reward(calm):
    weight = {"calm": 2.0} if isinstance(calm, str) else None
    env = GatheringEnv(**SWARM, signals={"calm": calm}, weights=weight)
    _, before = env.reset(options={"positions": TRIANGLE})
    observation, reward, _, _, after = env.step(np.ones((3, 2)))
    assert set(after) == {*signals_of(world(), jnp.asarray(TRIANGLE)), "calm"}
    by_hand = np.tanh(np.linalg.norm(observation, axis=1) / CONFIG.half_width).mean()
    close(after["calm"], by_hand)
    weights = dict.fromkeys(after, 1.0) | {"calm": 2.0 if isinstance(calm, str) else 0.5}
    close(reward, sum(weights[name] * (after[name] - before[name]) for name in after))


def test_vectors_and_agents_have_own_signals_too():
    envs = gymnasium.make_vec(ENV_ID, num_envs=2, signals={"calm": Calm()}, start=Rings(), **SWARM)
    assert isinstance(envs, GatheringVectorEnv)
    _, infos = envs.reset(seed=0)
    assert (infos["calm"] > 0).all()
    env = parallel_env(**SWARM, objective="custom", signals={"calm": Calm()}, sensing="own.mine:Nearest")
    observations, infos = env.reset(options={"positions": TRIANGLE})
    assert list(infos["robot_0"]) == ["calm"]
    # Each robot perceives its nearest neighbour alone.
    assert [rows[:, 2].sum() for rows in observations.values()] == [1, 1, 1]
    close(observations["robot_1"][0], [*(TRIANGLE[2] - TRIANGLE[1]), 1])


@pytest.mark.parametrize("shield", ["own.mine:Half", Half()])
def test_a_shield_shortens_the_moves(shield):
    env = GatheringEnv(**SWARM, shield=shield)
    env.reset(options={"positions": TRIANGLE})
    close(env.step(np.ones((3, 2)))[0], TRIANGLE + 0.25)


def test_agents_have_a_scheduler_and_a_shield():
    env = parallel_env(**SWARM, sensing="global", scheduler=RoundRobin(), shield=Half())
    env.reset(options={"positions": TRIANGLE})
    for _ in range(2):
        before = env.state()
        env.step({agent: np.ones(2, np.float32) for agent in env.agents})
        moved = np.abs(env.state() - before).max(axis=1)
        assert sorted(moved.round(5).tolist())[:2] == [0, 0]
        assert moved.max() > 0.1


def test_each_world_of_many_has_the_scheduler_of_its_seed():
    envs = GatheringVectorEnv(num_envs=2, scheduler="ssync", **SWARM)
    begun, _ = envs.reset(seed=[3, 4])
    after = [envs.step(np.ones((2, 3, 2)))[0] for _ in range(3)]
    for index, seed in enumerate((3, 4)):
        env = GatheringEnv(scheduler="ssync", **SWARM)
        np.testing.assert_array_equal(env.reset(seed=seed)[0], begun[index])
        for positions in after:
            close(env.step(np.ones((3, 2)))[0], positions[index])
    moved = np.abs(np.diff(np.stack([begun, *after]), axis=0)).max(axis=3) > 0
    assert 0 < moved.mean() < 1


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"scheduler": "sometimes"}, "scheduler"),
        ({"scheduler": 3}, "scheduler"),
        ({"shield": "own.mine:RoundRobin"}, "shield"),
        ({"start": "nowhere:Start"}, "start"),
        ({"start": "own.mine:not_a_class"}, "start"),
        ({"start": "own.mine:Calm"}, "start"),
        ({"start": "own.mine:Crowd"}, "world.robots"),
        ({"start": {"use": "own.mine:Rings", "gasp": 3.0}}, "start.gasp"),
        ({"start": 3}, "start"),
        ({"signals": {"calm": "own.mine:Flat"}}, "signals.calm"),
        ({"signals": {"calm": "own.mine:Undefined"}}, "signals.calm"),
        ({"signals": {"calm": "own.mine:Broken"}}, "signals.calm"),
        ({"signals": {"calm": "own.mine:Abstract"}}, "signals.calm"),
        ({"signals": "own.mine:Calm"}, "signals"),
        ({"weights": {"calm": 1.0}}, "weights.calm"),
        ({"objective": "custom"}, "signals"),
        ({"sensing": "visible"}, "sensing"),
    ],
)
def test_wrong_strategies_are_refused_in_one_line(options, field):
    with pytest.raises(InputError) as error:
        GatheringEnv(**SWARM | options)
    assert error.value.field == field
    assert "\n" not in str(error.value)


class ViewNetwork(PolicyNetwork):
    """Moves each robot towards the mean of the robots that it perceives."""

    log_std: jax.Array
    gain: jax.Array
    world: object = eqx.field(static=True)
    trick: str = eqx.field(static=True)

    def __call__(self, observation):
        view = observation.view
        count = jnp.maximum(view.seen.sum(axis=1), 1)
        velocities = self.gain * jnp.stack([view.x.sum(axis=1) / count, view.y.sum(axis=1) / count], axis=1)
        if self.trick == "positions":
            velocities = velocities + 0.01 * observation.positions
        if self.trick == "callback":
            shape = jax.ShapeDtypeStruct(velocities.shape, velocities.dtype)
            velocities = jax.pure_callback(lambda value: value, shape, velocities)
        return velocities


class ViewPolicy(Policy):
    """A policy that acts on each robot's own view; some act on more, or in a way that ONNX does not have."""

    perceives = True
    trick: str = eqx.field(default="none", static=True)

    def networks(self, world, landmark, key):
        zero = jnp.zeros((), jnp.float32)
        network = ViewNetwork(log_std=zero, gain=zero + 0.2, world=world, trick=self.trick)
        return network, lambda observation: observation.walls


class Opaque(Signal):
    """Is computed outside of JAX."""

    def __call__(self, configuration):
        x = configuration.positions[:, 0]
        return jax.pure_callback(lambda value: 0 * value, jax.ShapeDtypeStruct(x.shape, x.dtype), x)


def run_of(policies=1, **fields):
    sizes = {"robots": ROBOTS, "half_width": 12.0, "half_height": 10.0, "scan_radius": 100.0}
    rest = {
        "max_steps": 15,
        "window": 3,
        "switch_tolerance": 0.02,
        "stillness": 0.1,
        "dead_zone": 0.0,
        "damping": 0.0,
        "sidestep": 0.0,
    }
    config = presets.resolve("F", {"objective": "C2", "world": sizes, "rest": rest, "start": "random"}, fields)
    networks = [build_networks(config, draw_key(config, index, "networks"))[0] for index in range(policies)]
    return Run(Path("untrained"), config, build_cascade(config, networks), {})


def test_a_cascade_of_own_parts_under_its_scheduler_is_the_run():
    parts = {"policy": Linear(gain=0.5), "signals": {"calm": Calm()}, "shield": Half(), "scheduler": RoundRobin()}
    run = run_of(2, **parts)
    model = onnx.export(run)
    assert model.difference(run, 100) < onnx.TOLERANCE
    session = model.session()
    metadata = session.get_modelmeta().custom_metadata_map
    assert (metadata["policy"], metadata["shield"]) == ("own.mine:Linear", "own.mine:Half")
    # Own parts know the run's number of robots alone.
    assert session.get_inputs()[0].shape[1:] == [ROBOTS, 2]
    starts = run.starts(20, 1)
    expected = run.rollout(starts)
    positions, memory = starts.astype(np.float32), np.zeros((20, session.get_inputs()[1].shape[1]), np.float32)
    for step in range(40):
        alive = step <= expected.lengths
        reference = expected.positions[alive, min(step, expected.positions.shape[1] - 1)]
        np.testing.assert_allclose(positions[alive], reference, atol=1e-3)
        velocities, memory = session.run(None, {"positions": positions, "memory": memory})
        turn = (np.arange(ROBOTS) == step % ROBOTS)[:, None]
        positions = positions + turn * velocities
    assert len(set(expected.lengths)) > 1


def test_an_own_policy_on_own_views_is_exported_alone():
    run = run_of(policy=ViewPolicy(), sensing=Nearest(rotation=True, walls=True))
    model = onnx.export(run)
    assert model.difference(run, 100) < onnx.TOLERANCE
    (velocity,) = model.session().run(
        None, {"others": np.array([[[3, 4], [0, 0]]], np.float32), "walls": np.ones((1, 4, 2), np.float32)}
    )
    np.testing.assert_allclose(velocity, [[0.6, 0.8]], rtol=1e-5)
    with pytest.raises(InputError, match="no robot alone can tell"):
        onnx.export(run_of(2, policy=ViewPolicy()))


@pytest.mark.parametrize(
    ("fields", "field", "reason"),
    [
        ({"policy": ViewPolicy(trick="positions")}, "policy", "nothing but its own view"),
        ({"policy": ViewPolicy(trick="callback")}, "policy", "exported to ONNX"),
        ({"signals": {"opaque": Opaque()}, "policy": SMALL}, "signals.opaque", "exported to ONNX"),
    ],
)
def test_parts_that_cannot_be_exported_are_named(fields, field, reason):
    run = run_of(**fields)
    with pytest.raises(InputError, match=reason) as error:
        onnx.export(run)
    assert error.value.field == field
    assert "\n" not in str(error.value)
    if field != "policy":  # a single policy does not measure the objective
        assert onnx.export(run, 0).difference(run, 20) < onnx.TOLERANCE


def test_a_shield_is_part_of_the_model():
    shielded, plain = (run_of(policy=SMALL, shield=shield) for shield in (WallShield(share=0.01), "none"))
    model = onnx.export(shielded, 0)
    assert model.difference(shielded, 50) < onnx.TOLERANCE
    assert model.difference(plain, 50) > 10 * onnx.TOLERANCE
