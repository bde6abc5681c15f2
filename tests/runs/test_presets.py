from __future__ import annotations

import math
import re
import shlex
from dataclasses import replace
from pathlib import Path

import pytest

from murmurate.errors import InputError
from murmurate.runs import config_io, presets
from murmurate.runs.experiment import ExperimentConfig
from murmurate.runs.paper import EXPERIMENTS
from murmurate.world import WorldConfig

DOCS = Path(__file__).parents[2] / "docs"


def test_table_iii():
    settings = {name: (row.world.robots, row.objective, row.start) for name, row in EXPERIMENTS.items()}
    assert settings == {
        "A": (6, "C1", "packed"),
        "B": (8, "C1", "scattered"),
        "C": (10, "C1", "distributed"),
        "D": (6, "C2", "packed"),
        "E": (8, "C2", "scattered"),
        "F": (10, "C2", "distributed"),
    }


def test_table_iv_adds_up_except_in_row_e():
    totals = {name: (row.total_steps, row.summed_steps) for name, row in EXPERIMENTS.items()}
    assert totals.pop("E") == (1168.83, 745.27)
    assert all(printed == summed for printed, summed in totals.values())


@pytest.mark.parametrize("learner", presets.TRAINING_PRESETS)
@pytest.mark.parametrize("name", EXPERIMENTS)
def test_presets_are_the_papers_experiments(name, learner):
    config, row = presets.preset(name, learner), EXPERIMENTS[name]
    world = config.world
    assert (config.name, config.objective, config.start.name, world) == (name, row.objective, row.start, row.world)
    assert config.start.noise == 2
    assert config.policy.name == ("central" if learner == "paper" else learner)
    assert all(type(value) is float for value in (world.half_width, world.radius, world.scan_radius, world.max_speed))
    if row.objective == "C2":
        assert world.scan_radius >= 2 * math.hypot(world.half_width, world.half_height)
    assert config_io.from_dict(ExperimentConfig, config_io.to_dict(config)) == config
    assert presets.paper_row(config) is row


@pytest.mark.parametrize(
    ("learner", "budget"), [("formation", 4_000_000), ("equivariant", 4_000_000), ("central", 8_000_000)]
)
def test_the_longest_list_of_policies_stays_within_the_budget(learner, budget):
    numbers = presets.TRAINING_PRESETS[learner]
    stages = [numbers.base] + [numbers.auxiliary] * (numbers.discovery.max_policies - 1)
    phases = [(stage, phase) for stage in stages for phase in range(len(stage.learners))]
    assert sum(stage.learning(phase).updates * stage.steps_per_update(phase) for stage, phase in phases) <= budget


@pytest.mark.parametrize("learner", presets.TRAINING_PRESETS)
def test_all_experiments_have_the_same_numbers(learner):
    numbers = presets.TRAINING_PRESETS[learner]
    for name in EXPERIMENTS:
        config = presets.preset(name, learner)
        for part in ("policy", "base", "auxiliary", "discovery", "rest", "shield"):
            assert getattr(config, part) == getattr(numbers, part)


def test_the_page_says_whose_discount_falls():
    page = " ".join((DOCS / "paper.md").read_text(encoding="utf-8").split())
    discounts = {
        name: (learner.base.ppo.discount, learner.auxiliary.ppo.discount)
        for name, learner in presets.TRAINING_PRESETS.items()
    }
    assert discounts.pop("paper") == (0.95, 0.85)
    assert discounts.pop("central") == (0.95, 0.90)
    assert {*discounts.values()} == {(0.95, 0.95)}
    assert "`equivariant` does not reduce the discount: it is 0.95 for the base policy and for every later one" in page
    assert "trained by gradients with a discount of 0.97" in page
    assert presets.TRAINING_PRESETS["formation"].base.gradients.discount == 0.97
    assert "Only `paper` (0.95, then 0.85) and `central` (0.95, then 0.90) do." in page


def test_the_papers_learner_goes_the_papers_way():
    learner = presets.TRAINING_PRESETS["paper"]
    assert learner.policy.hidden == (400, 300, 300)
    for stage in (learner.base, learner.auxiliary):
        assert stage.ppo.clip_end > stage.ppo.clip
        assert stage.ppo.value_target == "rewards-to-go"
    assert learner.auxiliary.ppo.discount < learner.base.ppo.discount


def test_another_world_is_not_the_papers():
    config = presets.preset("C")
    assert presets.paper_row(replace(config, name="mine", seed=3)) is EXPERIMENTS["C"]
    assert presets.paper_row(replace(config, world=replace(config.world, radius=0.9))) is None


def test_later_overlays_win():
    config = presets.resolve("C", {"seed": 1, "world": {"robots": 7}}, {"seed": 2})
    assert (config.seed, config.world.robots, config.world.radius) == (2, 7, 1.0)


def test_the_policy_brings_its_learner():
    assert presets.resolve("B", {"policy": {"kind": "central"}}) == presets.preset("B", "central")
    paper = presets.resolve("B", {"base": {"horizon": 50}}, learner="paper")
    assert (paper.policy.hidden, paper.base.horizon) == ((400, 300, 300), 50)


def test_sizes_that_belong_together_are_replaced_together():
    config = presets.resolve("C", {"world": {"safe_distance": 20.0, "radius": 6.0}, "start": {"kind": "random"}})
    assert (config.world.radius, config.world.safe_distance) == (6.0, 20.0)


def test_a_toml_file_says_what_differs(tmp_path):
    path = tmp_path / "seven robots.toml"
    path.write_text('objective = "C2"\n[world]\nrobots = 7\n[policy]\nkind = "central"\n')
    config = presets.resolve(str(path), {"seed": 4})
    assert (config.name, config.objective, config.seed) == ("seven robots", "C2", 4)
    assert config.world == replace(WorldConfig(), robots=7)
    assert config.base == presets.TRAINING_PRESETS["central"].base
    path.write_text(config_io.dump_toml(presets.preset("F")))
    assert presets.resolve(str(path)) == presets.preset("F")


@pytest.mark.parametrize(
    ("data", "learner", "line"),
    [
        ({"world": {"radus": 1.0}}, None, "world.radus = 1.0: must be a field of [world]"),
        ({"wrld": {}}, None, "wrld = {}: must be a field of the configuration"),
        ({"policy": {"use": "paper"}}, None, "policy.use = 'paper': must be one of"),
        ({"policy": {"kind": []}}, None, "policy.use = []: must be one of"),
        ({"policy": 3}, None, "policy = 3: must be a table"),
        ({}, "best", "learner = 'best': must be one of formation, equivariant, central, local, paper"),
        ({"base": {"weights": {"visible": -1.0}}}, None, "base.weights.visible = -1.0: must be"),
    ],
)
def test_what_is_unknown_is_refused(data, learner, line):
    with pytest.raises(InputError) as caught:
        presets.resolve("C", data, learner=learner)
    assert str(caught.value).startswith(line)


def test_whose_numbers_a_problem_has_where_nobody_says(tmp_path):
    """Experiments of the package are searched for formations; the policy of all other problems serves any of them."""
    signals = {"signals": {"near": {"use": "compact"}}}
    several = {"sizes": [4, 6], "start": {"use": "random"}, "discovery": {"max_policies": 1}}
    (tmp_path / "my.toml").write_text("")
    for word, data, policy in (
        ("C", {}, "formation"),
        ("C", {"world": {"robots": 12, "half_width": 50.0, "half_height": 50.0}}, "formation"),
        ("C", signals, "equivariant"),
        ("C", several, "equivariant"),
        (tmp_path / "my.toml", {}, "equivariant"),
        ("circle", {}, "formation"),
    ):
        assert presets.resolve(word, data).policy.name == policy
    assert presets.resolve("C", learner="equivariant") == presets.preset("C", "equivariant")


def test_numbers_of_a_learner_that_does_not_train_are_refused(tmp_path):
    for policy, learners, path, value in (
        ("formation", "goals and gradients", "base.ppo.updates", 10),
        ("formation", "goals and gradients", "base.repeat", 4),
        ("formation", "goals and gradients", "base.weights", {"visible": 9.0}),
        ("formation", "gradients", "auxiliary.ppo.updates", 10),
        ("equivariant", "ppo and gradients", "base.goals.updates", 10),
        ("equivariant", "gradients", "auxiliary.motion_cost", 0.5),
        ("central", "ppo", "base.gradients.updates", 10),
    ):
        section = path.partition(".")[0]
        given = {"policy": policy}, config_io.nested({path: value})
        line = re.escape(f": must be left out: {section} is trained by {learners} here, without it")
        with pytest.raises(InputError, match=rf"^{path}.* = .*{line}$"):
            presets.resolve("A", *given)
        with pytest.raises(InputError, match=line):
            presets.resolve(presets.preset("A", policy), config_io.nested({path: value}))
        path_of_file = tmp_path / "my.toml"
        path_of_file.write_text(config_io.dump_toml(presets.resolve("A", learner="paper")))
        assert presets.resolve(path_of_file, *given).policy.name == policy, "a file has the numbers of all learners"
        chosen = {section: {"learner": "gradients" if learners[0] != "g" or section == "base" else "ppo"}}
        assert presets.resolve("A", *given, chosen).policy.name == policy


@pytest.mark.parametrize("policy", ["equivariant", "central", "local"])
@pytest.mark.parametrize("from_file", [False, True])
def test_an_objective_of_one_s_own_signals_alone(tmp_path, policy, from_file):
    """It has the preset's weights of the signals that it has, and no others."""
    (tmp_path / "my.toml").write_text("")
    word = tmp_path / "my.toml" if from_file else "A"
    data = {
        "objective": "custom",
        "policy": policy,
        "signals": {"near": {"use": "compact", "weight": 0.5}, "visible": {"use": "visible"}},
    }
    config, usual = presets.resolve(word, data), presets.resolve(word, {"policy": policy})
    for index in range(2):
        assert config.reward(index)[1] == {"near": 0.5, "visible": usual.reward(index)[1]["visible"]}
    assert config.objective_signals.keys() == {"near", "visible"}
    assert replace(config.base, weights=usual.base.weights, refine=usual.base.refine) == usual.base
    # The refinement would know nothing of the signals of one's own.
    assert [config.stage(index).learners for index in range(2)] == [("ppo",), ("ppo",)]
    assert config.discovery.min_policies == 2
    own = presets.resolve(word, data, {"auxiliary": {"weights": {"near": 3.0}}})
    assert own.reward(1)[1]["near"] == 3.0
    gathered = presets.resolve(word, data, {"signals": {"close": {}}})
    assert gathered.reward(1)[1]["close"] == usual.auxiliary.weights["gathering"]
    for name in ("gathering", "safety"):
        line = (
            f"^base.weights.{name} = 1.0: must be for a signal of the objective \\(near, visible\\), or a smooth one$"
        )
        with pytest.raises(InputError, match=line):
            presets.resolve(word, data, {"base": {"weights": {name: 1.0}}})


@pytest.mark.parametrize("word", ["G", "c", "", "experiment.toml", "."])
def test_unknown_experiments(word):
    with pytest.raises(InputError, match=r"(one of A, .*, F, arrow, .*, visibility, or a|an existing) TOML file"):
        presets.resolve(word)


def test_the_command_of_an_experiment_makes_it_again():
    for flags in (
        {},
        {"seed": 7, "policy": {"kind": "central"}, "base": {"ppo": {"worlds": 64}}},
        {"policy": {"hidden": [8, 4]}, "auxiliary": {"warm_start": False}, "start": {"noise": 0.5}},
    ):
        config = presets.resolve("F", flags)
        assert parsed(presets.command(config)) == config
    assert presets.command(presets.preset("F")) == "murmurate discover F --seed 0"
    assert presets.command(replace(presets.preset("F"), name="my own")) == "murmurate discover 'my own.toml' --seed 0"


def parsed(command):
    """Reads a command as `murmurate discover` does."""
    from murmurate.cli.discover import _parser

    _, _, *arguments = shlex.split(command)
    options, flags = _parser("F", arguments).parse(arguments)
    return presets.resolve(options.experiment, flags)
