"""ONNX models beside what they were made of, and beside the cascade in its world."""

from __future__ import annotations

import functools
import importlib.util
import warnings
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest

from murmurate.discovery import build_cascade, build_networks
from murmurate.discovery.stage import draw_key
from murmurate.errors import InputError
from murmurate.geometry import visible
from murmurate.policies import ClearanceShield
from murmurate.runs import presets
from murmurate.runs.run import Run
from murmurate.world import SlowMoves, SsyncScheduler, WorldConfig, apply_dead_zone

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of what the converter imports
    from onnx import ModelProto

    from murmurate.interop import onnx
    from murmurate.interop.onnx import programs

ROBOTS = 5
STATES = 1000
CHECKED = 100
"""Configurations on which models are compared with their runs: the same number everywhere is compiled once."""
REST = {
    "max_steps": 15,
    "window": 3,
    "switch_tolerance": 0.004,
    "stillness": 0.1,
    "dead_zone": 0.02,
    "damping": 0.0,
    "sidestep": 0.0,
}
"""So that some policies come to rest and others are cut off."""

pytestmark = [
    pytest.mark.filterwarnings("ignore:::(jax2onnx|onnx|onnx_ir|flax|orbax|google).*"),
    pytest.mark.usefixtures("quick_conversion"),
]


def untrained(kind, policies=2, objective="C2", seed=0, factor=1, walls=False):
    """A run whose policies nobody trained, but which do move, faster by a factor."""
    world = {"robots": ROBOTS, "half_width": 30.0, "half_height": 25.0, "scan_radius": 100.0}
    local = {"walls": walls, "gaps": walls} if kind == "local" else {}
    hidden = {
        "policy": {"use": kind, "hidden": [12, 8], **local},
        "rest": REST,
        "shield": {"use": "none"},
        "seed": seed,
    }
    eyes = {"sensing": {"use": "visible", "rotation": True, "walls": walls}} if kind == "local" else {}
    config = presets.resolve("F", {"objective": objective, "world": world, "start": {"use": "random"}}, hidden, eyes)
    chosen = [build_networks(config, draw_key(config, index, "networks"))[0] for index in range(policies)]
    return Run(Path("untrained"), config, build_cascade(config, [_louder(policy, factor) for policy in chosen]), {})


def _louder(policy, factor):
    names = [name for name in ("head", "to_point") if hasattr(policy, name)]
    weights = [factor * getattr(policy, name).weight for name in names]
    return eqx.tree_at(lambda p: [getattr(p, name).weight for name in names], policy, weights)


def configurations(robots, count, seed=0):
    return np.random.default_rng(seed).uniform(-12, 12, (count, robots, 2)).astype(np.float32)


@pytest.fixture(scope="module")
def equivariant():
    run = untrained("equivariant")
    return run, onnx.export(run)


@pytest.fixture(scope="module", params=["C1", pytest.param("C2", marks=pytest.mark.nightly)])
def one_policy(request):
    """A policy and its model; without a point to gather at, cascades and one robot's models are tried too."""
    run = untrained("equivariant", objective=request.param, factor=10)
    return run.cascade.policies[1], onnx.export(run, 1)


LEAST_SPEED = REST["dead_zone"]  # the speed limit is 1


@eqx.filter_jit
def act(policy, positions):
    return apply_dead_zone(policy(positions), positions, SlowMoves(LEAST_SPEED), WorldConfig())


@pytest.mark.parametrize("robots", [1, 2, ROBOTS, 11])
def test_one_policy_serves_any_swarm_and_is_ours_to_1e_5(one_policy, robots):
    policy, model = one_policy
    positions = configurations(robots, STATES)
    (result,) = model.session().run(None, {"positions": positions})
    expected = np.moveaxis(act(policy, np.moveaxis(positions, 0, -1)), -1, 0)
    assert np.abs(expected).max() > 0.1 or robots == 1  # alone, and without a point to gather at, a robot stays
    np.testing.assert_allclose(result, expected, atol=1e-5)
    stands = (expected == 0).all(axis=2)
    assert (np.linalg.norm(expected, axis=2)[~stands] >= LEAST_SPEED - 1e-6).all()
    assert stands.any() or robots == 11, "many robots see much, and all want to move"


def loop(session, starts, most=60):
    """Runs a cascade's model as its receiver would; returns positions, lengths and who was in charge."""
    positions, charges = [np.asarray(starts, np.float32)], []
    memory = np.zeros((len(starts), session.get_inputs()[1].shape[1]), np.float32)
    for _ in range(most):
        velocities, memory = session.run(None, {"positions": positions[-1], "memory": memory})
        charges.append(memory[:, 0].astype(int))
        positions.append(positions[-1] + velocities)
    return np.stack(positions, axis=1), np.stack(charges, axis=1)


@pytest.mark.parametrize("robots", [ROBOTS, ROBOTS + 2])
def test_a_cascade_changes_over_and_rests_as_ours_does_in_swarms_of_any_size(equivariant, robots):
    run, model = equivariant
    run = run.of_size(robots)
    starts = run.starts(24, 3)
    trajectories = run.rollout(starts)
    positions, charges = loop(model.session(), starts)
    # A model knows nothing of collisions: it is compared until then.
    for episode, length in enumerate(trajectories.lengths):
        expected = trajectories.positions[episode, : length + 1]
        np.testing.assert_allclose(positions[episode, : length + 1], expected, atol=1e-3)
    whole = ~trajectories.terminated
    np.testing.assert_array_equal((charges == 0).sum(axis=1)[whole], trajectories.switch[whole, 0])
    np.testing.assert_array_equal((charges < 2).sum(axis=1)[whole], trajectories.lengths[whole])
    assert len(set(trajectories.switch[whole, 0])) > 2
    assert trajectories.at_rest[whole].any()


@pytest.mark.parametrize("robots", [ROBOTS, ROBOTS + 2])
def test_a_cascade_steps_aside_and_is_shielded_as_ours_is(robots):
    run = untrained("equivariant", policies=1, factor=10)
    rest = replace(run.experiment.rest, damping=0.2, sidestep=0.9)
    run = run.under(replace(run.experiment, rest=rest, shield=ClearanceShield()))
    model = onnx.export(run)
    run = run.of_size(robots)
    starts = run.starts(24, 3)
    # In line, nobody sees past a neighbour, and robots that hardly want to move step aside.
    starts[:8] = np.linspace(2.5, 5.0, 8)[:, None, None] * np.stack([np.arange(robots), np.zeros(robots)], axis=1)
    trajectories = run.rollout(starts)
    positions, _ = loop(model.session(), starts, most=20)
    moved = np.linalg.norm(np.diff(positions[:8], axis=1), axis=-1)
    assert np.isclose(moved, 0.9, atol=1e-4).any()
    assert trajectories.interventions.sum() > 0
    for episode, length in enumerate(np.minimum(trajectories.lengths, 20)):
        expected = trajectories.positions[episode, : length + 1]
        np.testing.assert_allclose(positions[episode, : length + 1], expected, atol=1e-3)


def test_a_central_cascade_has_a_dynamic_batch_and_its_own_number_of_robots():
    run = untrained("central", policies=1, factor=10)
    model = onnx.export(run)
    assert model.difference(run, CHECKED) < 1e-5
    session = model.session()
    assert session.get_inputs()[0].shape[1:] == [ROBOTS, 2]
    with pytest.raises(Exception, match="invalid dimensions"):
        loop(session, configurations(ROBOTS + 1, 2))
    for batch in (1, 7):
        assert loop(session, configurations(ROBOTS, batch), 2)[0].shape == (batch, 3, ROBOTS, 2)


@eqx.filter_jit
def velocities_in_world(env, policy, positions, slow, shield):
    state = env.state(positions, 0)
    observation = env.observe(state)
    wanted = apply_dead_zone(policy(observation), observation, slow, env.config)
    observed = state if hasattr(state, "frames") else state.inner  # within the state of the shield
    return observed.frames, shield(wanted, observation, env.config)


@functools.cache
def local(objective, walls):
    """A run and its model: with walls in the newest operators, without in the oldest."""
    run = untrained("local", policies=1, objective=objective, factor=10, walls=walls)
    if walls:
        rest = replace(run.experiment.rest, dead_zone=0.3, damping=0.4, sidestep=0.5)
        run = run.under(replace(run.experiment, rest=rest, shield=ClearanceShield()))
    return run, onnx.export(run) if walls else onnx.export(run, opset=17)


@pytest.mark.parametrize(("objective", "walls"), [pytest.param("C1", False, marks=pytest.mark.nightly), ("C2", True)])
def test_a_robot_with_its_own_eyes_moves_by_its_model_as_in_the_world(objective, walls):
    run, model = local(objective, walls)
    assert model.difference(run, CHECKED) < onnx.TOLERANCE
    starts = run.starts(40, 1)
    env = run.cascade.env
    slow = run.experiment.slow_moves
    policy, shield = run.cascade.policies[0], run.experiment.prepared_shield
    frames, expected = velocities_in_world(env, policy, np.moveaxis(starts, 0, -1), slow, shield)
    expected = np.moveaxis(expected, -1, 0)
    aside = np.linalg.norm(expected, axis=-1) == 0.5
    assert aside.any() == walls
    seen = visible(starts.astype(float), 1.0, 100.0)
    assert not seen[:, ~np.eye(ROBOTS, dtype=bool)].all()
    cos, sin = (np.asarray(a).T for a in (frames.cos, frames.sin))
    for robot in range(ROBOTS):
        offsets = starts - starts[:, robot, None]
        turn = np.stack([cos[:, robot], sin[:, robot], -sin[:, robot], cos[:, robot]], axis=-1).reshape(-1, 2, 2)
        into = lambda vectors, turn=turn: np.einsum("bij,b...j->b...i", turn, vectors)  # noqa: E731
        views = np.where(seen[:, robot, :, None], into(offsets), 0.0)
        inputs = {"others": views}
        if objective == "C1":
            inputs["point"] = into(-starts[:, robot])
        if walls:
            x, y = starts[:, robot].T
            feet = [(30 - x, 0 * x), (0 * x, 25 - y), (-30 - x, 0 * x), (0 * x, -25 - y)]
            inputs["walls"] = into(np.moveaxis(np.array(feet), -1, 0))
        (result,) = model.session().run(None, {name: a.astype(np.float32) for name, a in inputs.items()})
        np.testing.assert_allclose(result, expected[:, robot], atol=1e-5)


def symmetric(robots):
    """Returns rings, a ring around a robot, grids, lines and coincident robots, turned by some angles."""
    number = np.arange(robots)
    shapes = [
        robots * np.exp(2j * np.pi * number / robots),
        robots * np.append(np.exp(2j * np.pi * number[1:] / max(robots - 1, 1)), 0),
        4 * (number % 4 + 1j * (number // 4)),
        4 * number + 0j,
        np.where(number < 2, 0j, 4.0 * number),
    ]
    turned = np.concatenate([np.array(shapes) * np.exp(1j * angle) for angle in (0, 0.3, 0.7, np.pi / 4, 2.0)])
    return np.stack([np.real(turned), np.imag(turned)], axis=-1).astype(np.float32)


@pytest.mark.parametrize("robots", [2, 10, 16])
def test_symmetric_swarms_are_ours_to_1e_5(one_policy, robots):
    policy, model = one_policy
    positions = symmetric(robots)
    (result,) = model.session().run(None, {"positions": positions})
    expected = np.moveaxis(act(policy, np.moveaxis(positions, 0, -1)), -1, 0)
    np.testing.assert_allclose(result, expected, atol=1e-5)


@pytest.mark.parametrize("robots", [2, 3, 10, 16])
def test_the_check_looks_at_symmetric_swarms(equivariant, robots):
    """Some robots tie in distance, some stand in line, some are at one place; whole and as one robot's view."""
    run, model = equivariant
    for name, program in (("positions", model.program), ("others", local("C1", False)[1].program)):
        inputs = onnx._random_inputs(run, program, robots, 200, np.random.default_rng(0))[name].astype(float)
        x, y = np.moveaxis(inputs if name == "positions" else np.pad(inputs, ((0, 0), (1, 0), (0, 0))), 2, 0)
        apart = np.hypot(x[:, 1:] - x[:, :1], y[:, 1:] - y[:, :1])
        assert (apart[:, :1] == 0).sum() >= 6
        if robots > 2:
            cross = (x[:, 1] - x[:, 0]) * (y[:, -1] - y[:, 0]) - (y[:, 1] - y[:, 0]) * (x[:, -1] - x[:, 0])
            in_line = (np.abs(cross) < 1e-3 * apart[:, 0] * apart[:, -1]) & (apart.min(axis=1) > 0)
            ties = (np.abs(np.diff(np.sort(apart, axis=1), axis=1)) < 1e-5).any(axis=1) & (apart.min(axis=1) > 0)
            assert in_line.sum() >= 6
            assert ties.sum() >= 6


def test_a_view_may_leave_out_or_fill_up_whom_it_does_not_hold():
    session, point = local("C1", False)[1].session(), np.array([[2.0, -5.0]], np.float32)
    alone = np.array([[[4.0, 3.0], [-6.0, 1.0]]], np.float32)
    filled = np.concatenate([np.zeros((1, 3, 2), np.float32), alone], axis=1)
    (few,), (many,) = (session.run(None, {"others": view, "point": point}) for view in (alone, filled))
    np.testing.assert_allclose(few, many, atol=1e-6)


EMPTY = np.zeros((3, 0, 2), np.float32)


@pytest.mark.parametrize(("objective", "walls"), [("C1", False), ("C2", True)])
def test_a_robot_that_sees_nobody_moves_as_one_whose_view_is_blank(objective, walls):
    session = local(objective, walls)[1].session()
    rng = np.random.default_rng(0)
    inputs = {
        each.name: rng.standard_normal((3, *each.shape[1:])).astype(np.float32) for each in session.get_inputs()[1:]
    }
    (alone,) = session.run(None, {"others": EMPTY, **inputs})
    (blank,) = session.run(None, {"others": np.zeros((3, 4, 2), np.float32), **inputs})
    assert alone.shape == (3, 2)
    np.testing.assert_allclose(alone, blank, atol=1e-6)
    assert np.isfinite(alone).all()


def test_a_batch_may_be_empty(equivariant):
    session = equivariant[1].session()
    width = session.get_inputs()[1].shape[1]
    positions, memory = np.zeros((0, ROBOTS, 2), np.float32), np.zeros((0, width), np.float32)
    velocities, after = session.run(None, {"positions": positions, "memory": memory})
    assert (velocities.shape, after.shape) == ((0, ROBOTS, 2), (0, width))
    views, point = local("C1", False)[1].session(), np.zeros((0, 2), np.float32)
    for others in (4, 0):
        inputs = {"others": np.zeros((0, others, 2), np.float32), "point": point}
        assert views.run(None, inputs)[0].shape == (0, 2)


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("robots", [1, programs.MAX_ROBOTS + 1])
def test_a_swarm_that_is_too_small_or_too_large_is_refused_by_the_name_of_the_bounds(equivariant, robots):
    session = equivariant[1].session()
    memory = np.zeros((1, session.get_inputs()[1].shape[1]), np.float32)
    with pytest.raises(Exception, match="Name:'2_to_256_robots'"):
        session.run(None, {"positions": configurations(robots, 1), "memory": memory})
    about = session.get_modelmeta().custom_metadata_map
    assert (about["smallest_swarm"], about["largest_swarm"]) == ("2", "256")
    assert "largest_swarm" not in local("C1", False)[1].session().get_modelmeta().custom_metadata_map


def operators(model):
    """Returns the versions of the operators that a model consists of, by their domains, and of its file's format."""
    proto = ModelProto.FromString(model.data)
    return {each.domain: each.version for each in proto.opset_import}, proto.ir_version


def test_a_model_is_in_the_format_that_the_oldest_runtimes_with_its_operators_have(equivariant):
    assert operators(equivariant[1]) == ({"": 23}, 10)
    assert operators(local("C2", True)[1]) == ({"": 23}, 10)
    assert operators(local("C1", False)[1]) == ({"": 17}, 8)


@pytest.mark.nightly
def test_a_cascade_in_older_operators_is_the_same(equivariant):
    run, newest = equivariant
    model = onnx.export(run, opset=17)
    assert operators(model) == ({"": 17}, 8)
    assert model.difference(run, CHECKED) < onnx.TOLERANCE
    positions = configurations(ROBOTS, 20)
    memory = np.zeros((20, model.session().get_inputs()[1].shape[1]), np.float32)
    outputs, newest_outputs = (
        each.session().run(None, {"positions": positions, "memory": memory}) for each in (model, newest)
    )
    for result, expected in zip(outputs, newest_outputs, strict=True):
        np.testing.assert_allclose(result, expected, atol=1e-5)


@pytest.mark.parametrize("opset", [16, 24, 17.5])
def test_operators_of_other_versions_are_refused(equivariant, opset):
    with pytest.raises(InputError, match=r"--opset = .*: must be an integer >= 17 and <= 23"):
        onnx.export(equivariant[0], opset=opset)


def test_the_check_finds_a_model_of_something_else(equivariant):
    run, model = equivariant
    assert model.difference(run, CHECKED) < onnx.TOLERANCE
    other = untrained("equivariant", seed=1)
    assert replace(model, program=programs.cascade_program(other)).difference(run, CHECKED) > 100 * onnx.TOLERANCE


def test_a_model_says_what_it_is(equivariant):
    run, model = equivariant
    about = model.session().get_modelmeta().custom_metadata_map
    assert about["experiment"] == run.experiment.name
    assert (about["robots"], about["radius"], about["max_speed"], about["policies"]) == ("5", "1", "1", "0, 1")
    assert "zeros at first" in about["memory"]
    assert about["scan_radius"] == f"{run.experiment.world.scan_radius:g}"


def test_a_model_says_what_its_shield_counts_on():
    run = untrained("local")
    shielded = run.under(replace(run.experiment, shield=ClearanceShield(), scheduler=SsyncScheduler()))
    about = programs.policy_program(shielded, 0).metadata
    assert about["shield"] == "clearance"
    assert float(about["shield.share"]) == pytest.approx(0.49)


@pytest.mark.parametrize("index", [-1, 2])
def test_a_policy_that_is_not_there_is_refused(equivariant, index):
    with pytest.raises(InputError, match=rf"--policy = {index}: must be 0 to 1"):
        onnx.export(equivariant[0], index)


def test_several_local_policies_do_not_make_a_cascade_of_robots_on_their_own():
    single = local("C2", True)[0]
    run = replace(single, cascade=eqx.tree_at(lambda c: c.policies, single.cascade, 2 * single.cascade.policies))
    with pytest.raises(InputError, match="no robot alone can tell"):
        onnx.export(run)


def test_the_example_runs_a_cascade_to_rest(equivariant, tmp_path, capsys):
    path = Path(__file__).parents[2] / "examples" / "onnx_robots.py"
    spec = importlib.util.spec_from_file_location("example_onnx_robots", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    (tmp_path / "swarm.onnx").write_bytes(equivariant[1].data)
    assert module.main(str(tmp_path / "swarm.onnx"), 7).shape == (7, 2)
    assert "7 robots at rest" in capsys.readouterr().out
    for robots in (1, 257):
        with pytest.raises(SystemExit) as stop:
            module.main(str(tmp_path / "swarm.onnx"), robots)
        line = f"onnx_robots.py: {tmp_path / 'swarm.onnx'} is for swarms of 2 to 256 robots\n"
        assert (stop.value.code, capsys.readouterr()) == (2, ("", line))
    assert "jax" not in path.read_text().split('"""')[2]
