from __future__ import annotations

import pytest

from murmurate.errors import InputError
from murmurate.report.plan import make_plan
from murmurate.runs import config_io
from murmurate.runs.paper import EXPERIMENTS
from murmurate.runs.presets import preset
from murmurate.world import check_start


def names(plan):
    return {run.name for run in plan.runs}


def test_a_full_report_has_every_experiment_with_both_policies():
    plan = make_plan(seed=3)
    assert len(plan.runs) == 24
    for name in EXPERIMENTS:
        for learner in ("central", "formation"):
            run = plan.experiments[name][learner]
            assert run.name == f"{name}-{learner}-seed3"
            assert config_io.to_dict(run.config) == config_io.to_dict(preset(name, learner)) | {"seed": 3}


def test_swarm_sizes_that_are_an_experiment_are_trained_once():
    plan = make_plan()
    assert [list(runs) for runs in plan.sizes.values()] == [list(range(4, 11))] * 2
    assert plan.sizes["distributed"][10] is plan.experiments["C"]["formation"]
    assert plan.sizes["scattered"][8] is plan.experiments["B"]["formation"]
    others = names(plan) - {run.name for runs in plan.experiments.values() for run in runs.values()}
    assert len(others) == 12
    assert {"size4-distributed-formation-seed0", "size10-scattered-formation-seed0"} <= others


def test_swarm_sizes_differ_in_the_world_and_the_start_only():
    like = {leaf.path: leaf.value for leaf in config_io.leaves(preset("C"))}
    for start, runs in make_plan().sizes.items():
        for robots, run in runs.items():
            other = {leaf.path: leaf.value for leaf in config_io.leaves(run.config)}
            changed = {path: value for path, value in other.items() if like.get(path) != value} | {"name": None}
            side = 20 + 2.5 * robots
            assert changed.keys() <= {"name", "world.robots", "world.half_width", "world.half_height", "start.use"}
            assert (other["world.robots"], other["world.half_width"], other["start.use"]) == (robots, side, start)


def test_swarms_of_every_size_fit_their_worlds():
    for runs in make_plan().sizes.values():
        for run in runs.values():
            check_start(run.config.start, run.config.world)


def test_a_quick_report_has_the_same_problems_and_smaller_budgets():
    full, quick = make_plan(), make_plan(quick=True)
    assert all(name.startswith("quick-") for name in names(quick))
    assert {name.removeprefix("quick-") for name in names(quick)} < names(full)
    by_name = {run.name: run for run in full.runs}
    for run in quick.runs:
        before = {leaf.path: leaf.value for leaf in config_io.leaves(by_name[run.name.removeprefix("quick-")].config)}
        for leaf in config_io.leaves(run.config):
            if before[leaf.path] != leaf.value:
                assert leaf.path.endswith(
                    ("ppo.updates", "worlds", "gradients.updates", "max_policies", "sigma", "episodes")
                )
                assert leaf.value < before[leaf.path]


def test_a_seed_is_checked():
    with pytest.raises(InputError, match="seed = -1"):
        make_plan(seed=-1)
