"""One policy trained among swarms of several sizes, and executed in others."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from test_training import StoppedError, stop_after

from murmurate.discovery import Search, build_cascade, build_networks, search
from murmurate.discovery.build import check_parts
from murmurate.discovery.stage import draw_key
from murmurate.errors import BeyondTrainingWarning, InputError
from murmurate.runs import presets, train
from murmurate.runs.formations import reached
from murmurate.runs.run import Run
from murmurate.world import LocalObservation, WorldConfig, scaled_to
from tiny import TINY, tiny

ANY = {
    "policy": {"use": "equivariant", "hidden": [8, 4]},
    "start": {"use": "random"},
    "sizes": [3, 6],
    "discovery": {"min_policies": 1, "max_policies": 1},
    "base": {"ppo": {"updates": 5}},
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return train.discover(tiny(**ANY), tmp_path_factory.mktemp("sizes") / "run")


def metrics(run):
    return [json.loads(line) for line in (run.folder / "metrics.jsonl").read_text().splitlines()]


def test_worlds_grow_as_the_papers_do_and_then_as_rings_do():
    half = {6: 35, 8: 40, 10: 45}
    for robots, side in half.items():
        world = scaled_to(WorldConfig(), robots)
        assert (world.half_width, world.robots) == (pytest.approx(side), robots)
        assert world.scan_radius / world.half_width == pytest.approx(20 / 45)
        assert (world.radius, world.safe_distance, world.max_speed) == (1.0, 5.0, 1.0)
    assert scaled_to(WorldConfig(), 20).half_width == pytest.approx(70)
    assert scaled_to(WorldConfig(), 64).half_width == pytest.approx(0.175 * 64**2)
    back = scaled_to(scaled_to(WorldConfig(), 64), 10)
    assert back.half_width == pytest.approx(45)


@pytest.mark.parametrize("robots", [1, 0, -3, 2.5, 10_001])
def test_a_world_has_two_robots_or_more(robots):
    with pytest.raises(InputError, match=r"robots = .*: must be an integer >= 2"):
        scaled_to(WorldConfig(), robots)


def test_every_size_has_its_turn_in_every_round(run):
    rows = [row["robots"] for row in metrics(run)]
    assert len(rows) == 5
    assert sorted(rows[:2]) == sorted(rows[2:4]) == [3, 6]
    assert rows[4] in (3, 6)


def test_steps_are_counted_size_by_size(run):
    rows = metrics(run)
    # Eight worlds of three robots: as many robots in all, in whole minibatches of two.
    worlds = {3: 8, 6: 4}
    steps = np.cumsum([worlds[row["robots"]] * 4 for row in rows])
    assert [row["environment_steps"] for row in rows] == steps.tolist()
    assert run.manifest["environment_steps"] == steps[-1]


def test_resuming_ends_in_the_same_bytes(run, tmp_path):
    with pytest.raises(StoppedError):
        train.discover(tiny(**ANY), tmp_path / "run", on_progress=stop_after(4))
    train.discover(tiny(**ANY), tmp_path / "run", resume=True)
    name = "policies/0-base.safetensors"
    assert (tmp_path / "run" / name).read_bytes() == (run.folder / name).read_bytes()


def test_a_run_is_executed_in_a_swarm_of_any_size(run):
    with pytest.warns(BeyondTrainingWarning, match="robots = 9: trained were swarms of 3 to 6"):
        large = run.of_size(9)
    assert large.experiment.world == scaled_to(run.experiment.world, 9)
    assert large.rollout(3).positions.shape[2:] == (9, 2)
    assert run.of_size(3) is run
    far = run.experiment.of_size(64)
    factor = far.world.half_width / run.experiment.world.half_width
    assert far.rest.max_steps == pytest.approx(run.experiment.rest.max_steps * factor, abs=1)
    assert far.rest.window == pytest.approx(run.experiment.rest.window * factor, abs=1)
    assert far.rest.switch_tolerance == pytest.approx(run.experiment.rest.switch_tolerance / factor)
    # In a smaller world there is as much time as ever.
    assert run.experiment.of_size(2).rest == run.experiment.rest


def test_the_policy_central_is_of_one_size(finished):
    run = Run.open(finished)
    with pytest.raises(InputError, match="robots = 5: must be 3: the policy central is of one size"):
        run.of_size(5)


def test_patterns_are_evaluated_in_every_size(monkeypatch):
    sizes = []

    def build(problem, policies, world):
        sizes.append(problem.world.robots)
        return build_cascade(problem, policies, world)

    config = tiny(**ANY)
    monkeypatch.setattr(search, "build_cascade", build)
    Search(config).validity((build_networks(config, draw_key(config, 0, "networks"))[0],), 0)
    assert sizes == [3, 6]


@pytest.mark.parametrize(
    ("overlay", "line"),
    [
        ({"sizes": [3, 1]}, "robots = 1: must be an integer >= 2"),
        ({"sizes": [3, 3]}, "sizes = (3, 3): must be different from each other"),
        ({"policy": {"use": "central"}}, "policy.use = 'central': must be equivariant, local or formation with sizes"),
        ({"start": {"use": "packed"}}, "start.use = 'packed': must be random with sizes"),
        ({"discovery": {"max_policies": 2}}, "discovery.max_policies = 2: must be 1 with sizes"),
    ],
)
def test_sizes_that_one_policy_cannot_serve_are_refused(overlay, line):
    with pytest.raises(InputError) as caught:
        presets.resolve("F", ANY, overlay)
    assert str(caught.value).startswith(line)


def seeing(env):
    """The wrapper in which robots perceive."""
    return env if isinstance(env, LocalObservation) else seeing(env.env)


def test_a_margin_makes_robots_larger_while_they_learn_and_nowhere_else():
    own_eyes = {"policy": {"use": "local", "hidden": [8, 4]}, "sizes": [], "base": {"margin": 0.25}}
    config = tiny(**ANY | own_eyes)
    search = Search(config)
    env = search.stage(search.begin()).environment(0, None)
    trained, world = env.config, config.world
    assert (float(trained.radius), float(trained.safe_distance)) == (1.25 * world.radius, 1.25 * world.safe_distance)
    eyes, executed = seeing(env), seeing(build_cascade(config, ()).env)
    for perceived in (eyes.world, search.world.config, executed.world):
        assert (float(perceived.radius), float(perceived.safe_distance)) == (world.radius, world.safe_distance)


SEVERAL = {
    "world": TINY["world"],
    "policy": {"use": "formation", "formations": 6, "hidden": [8, 4]},
    "start": {"use": "random"},
    "sizes": [3, 5],
    "discovery": {"min_policies": 1, "max_policies": 1, "chunk": 150, "episodes": 8, "sigma": 8},
    "base": {"refine": False, "goals": {"updates": 600}},
}


def formation(*overlays):
    """A search for formations of three and of five robots, by default without a way to them that is learned."""
    return presets.resolve("E", SEVERAL, *overlays)


@pytest.fixture(scope="module")
def several(tmp_path_factory):
    """A policy with formations of three and of five robots."""
    return train.discover(formation(), tmp_path_factory.mktemp("several") / "run")


def test_one_policy_remembers_formations_of_several_sizes(several):
    rows = metrics(several)
    assert [row["learner"] for row in rows] == ["goals"] * 600
    assert all("robots" not in row for row in rows), "all sizes are searched at once"
    assert rows[-1]["objective"] > rows[0]["objective"]
    for robots in (3, 5):
        run = several.of_size(robots)
        assert run.cascade.policies[0].sizes == ((3, 5) if robots == 3 else (5,))
        trajectories = run.rollout(20, key=1)
        assert reached(run, trajectories).all()
        assert run.remembered().classes[0].representative.positions.shape == (robots, 2)


def test_a_search_of_several_sizes_resumes_in_the_same_bytes(several, tmp_path):
    with pytest.raises(StoppedError):
        train.discover(formation(), tmp_path / "run", on_progress=stop_after(3))
    train.discover(formation(), tmp_path / "run", resume=True)
    name = "policies/0-base.safetensors"
    assert (tmp_path / "run" / name).read_bytes() == (several.folder / name).read_bytes()


@pytest.mark.nightly
def test_the_way_to_formations_of_several_sizes_is_learned_by_turns(several, tmp_path):
    numbers = {"updates": 3, "worlds": 8, "steps": 4, "minibatches": 2}
    run = train.discover(formation({"base": {"refine": True, "gradients": numbers}}), tmp_path / "run")
    rows = metrics(run)[600:]
    assert {row["learner"] for row in rows} == {"gradients"}
    assert {row["robots"] for row in rows[:2]} == {3, 5}
    before, after = (each.cascade.policies[0] for each in (several, run))
    assert (np.asarray(before.places) == np.asarray(after.places)).all()
    assert (np.asarray(before.pair.weight) != np.asarray(after.pair.weight)).any()


def test_sizes_without_formations_have_to_be_told_one(several, tmp_path):
    with pytest.raises(InputError, match="robots = 4: must be 3, 5: the policy formation remembers"):
        several.of_size(4)
    square = 6.0 * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
    told = several.forming(square)
    assert told.experiment.world == scaled_to(several.experiment.world, 4)
    assert reached(told, told.rollout(20, key=1)).all()
    with pytest.warns(BeyondTrainingWarning, match="a formation of 2 robots: trained were swarms of 3 to 5"):
        pair = several.forming(square[:2])
    assert reached(pair, pair.rollout(20, key=1)).all()
    # A folder keeps what was told, of a size that was trained and of one that was not.
    triangle = square[:3] * [1.0, 0.9]
    for number, other in enumerate((told, several.forming(triangle))):
        again = Run.open(other.save(tmp_path / str(number)))
        assert (np.asarray(again.cascade.policies[0].goals()) == np.asarray(other.cascade.policies[0].goals())).all()
        assert again.experiment == other.experiment
    # What is told is of the size that it is; the others are as they were.
    assert told.cascade.policies[0].sizes == (4,)
    assert several.cascade.policies[0].sizes == (3, 5)


def test_formations_that_are_fixed_stay_where_they_are(several):
    """They are neither moved nor turned, and robots go to the places nearest in all."""
    experiment = replace(several.experiment, policy=replace(several.experiment.policy, fixed=True))
    network, _ = build_networks(experiment, draw_key(experiment, 0, "networks"))
    places = np.array([[5.0, 5.0], [5.0, -3.0], [-7.0, 0.0]])
    run = replace(several, experiment=experiment, cascade=build_cascade(experiment, [network])).forming(places)
    for final in run.rollout(20, key=1).final:
        apart = np.linalg.norm(final[:, None] - places[None], axis=-1)
        assert apart.min(axis=0).max() < 0.1
    side = experiment.world.half_width
    with pytest.raises(InputError, match=r"so that it is inside the world$"):
        run.forming(places + np.array([side - 5.5, 0.0]))
    assert run.forming(places + np.array([side - 6.5, 0.0])).rollout(2, key=1).at_rest.all()


@pytest.mark.parametrize(
    ("overlay", "line"),
    [
        ({"sizes": [4, 5]}, "world.robots = 3: must be one of sizes (4, 5): the policy formation has formations for"),
        ({"policy": {"fixed": 1}}, "policy.fixed = 1: must be true or false"),
        ({"start": {"use": "packed"}}, "start.use = 'packed': must be random with sizes"),
    ],
)
def test_formations_of_several_sizes_that_cannot_be_are_refused(overlay, line):
    with pytest.raises(InputError) as caught:
        formation(overlay)
    assert str(caught.value).startswith(line)


def test_a_search_needs_something_to_look_for():
    """Signals of one's own come with no weight: nobody knows which of them formations are searched by."""
    experiment = presets.resolve(
        "F", {"policy": "formation", "objective": "custom", "signals": {"straight": {}, "safety": {}}}
    )
    with pytest.raises(InputError, match=r"base\.goals\.weights = .*must be weights of signals with gradients"):
        check_parts(experiment)
