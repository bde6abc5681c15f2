"""Runs with sensing, a scheduler, a start and signals of a user's own are compared like those of the package."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from murmurate.cli.main import main
from murmurate.errors import InputError
from murmurate.runs import comparison
from murmurate.runs.comparison import Comparison, Condition, compare, conditions
from murmurate.runs.run import Run
from own.mine import Calm, Nearest, Rings, RoundRobin

SENSING, SCHEDULER, START = "own.mine:Nearest", "own.mine:RoundRobin", "own.mine:Rings"


@pytest.fixture(scope="module")
def run(tiny_run, tmp_path_factory):
    """A run whose robots perceive the nearest robot, in turns, from two rings, with a signal besides."""
    opened = Run.open(tiny_run("local"))
    parts = {"sensing": Nearest(rotation=True), "scheduler": RoundRobin(), "start": Rings(gap=3.5)}
    experiment = replace(opened.experiment, **parts, signals={"calm": Calm(weight=3.0)})
    return opened.under(experiment).save(tmp_path_factory.mktemp("compared") / "mine")


def test_a_run_with_parts_of_ones_own_is_compared(run, tmp_path, monkeypatch, capsys):
    batches, measure = [], comparison._measure
    monkeypatch.setattr(comparison, "_measure", lambda *args: batches.append(args) or measure(*args))
    out = tmp_path / "out"
    words = ["--methods", "mine", "--robots", "3", "--episodes", "4", "--sensing", SENSING, "--schedulers", SCHEDULER]
    assert main(["compare", str(run), "--trust", *words, "--starts", f"random,{START}", "--out", str(out)]) == 0
    assert f"mine, {SENSING}, {SCHEDULER}, {START}, N = 3: " in capsys.readouterr().out
    rows, settings = comparison.sorted_rows(out), comparison.load(out)
    assert [(row["start"], row["episodes"], row["gap"], row["best_known"]) for row in rows] == [
        ("random", 4, None, None),
        (START, 4, None, None),
    ]
    # The run's own fields, and not the defaults of the classes.
    assert settings["sensings"][SENSING]["rotation"] is True
    assert {name: start["gap"] for name, start in settings["starts"].items()} == {"random": 3.5, START: 3.5}
    for problem, batch in batches:
        assert (problem.sensing, problem.scheduler) == (Nearest(rotation=True), RoundRobin())
        inner = np.linalg.norm(batch.positions[:, 0, 1], axis=1)
        assert (np.abs(inner - 3.5) <= 2**0.5).all()
        moved = (np.diff(batch.positions[:, :10], axis=1) != 0).any(axis=3)
        assert (moved.sum(axis=2) <= 1).all()
    page = (out / "comparison.md").read_text()
    assert "mine:Rings" in page


def test_parts_that_no_run_has_are_those_of_their_defaults(tiny_run):
    setting = Comparison(Run.open(tiny_run("local")).experiment)
    (condition,) = conditions(["circle"], [SENSING], [SCHEDULER], [3], [START], ["circle"])
    problem = setting.problem(condition)
    assert (problem.sensing, problem.scheduler) == (Nearest(), RoundRobin())
    assert setting.start(START) == Rings()


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        (Condition("circle", "visible", "fsync", 3, "own.mine:Crowd"), "few enough to fit the own.mine:Crowd start"),
        (Condition("circle", "visible", "fsync", 3, "rings"), "robots = 3: must be at least 4 for the start rings"),
        (Condition("circle", "own.mine:Calm", "fsync", 3), "sensing = 'own.mine:Calm': must be a class murmurate.Sens"),
    ],
)
def test_an_impossible_part_is_refused_before_anything_runs(condition, message, tiny_run, tmp_path):
    setting = Comparison(Run.open(tiny_run("local")).experiment, episodes=2)
    with pytest.raises(InputError, match=message):
        compare(setting, [condition], {}, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_policy_of_one_size_is_compared_at_that_size(run, tmp_path, monkeypatch):
    opened = Run.open(run, trust=True)
    monkeypatch.setattr(type(opened.experiment.policy), "any_size", False)
    condition = Condition("mine", "visible", "fsync", 4)
    with pytest.raises(InputError, match="robots = 4: must be 3: the policy local is of one size"):
        compare(Comparison(opened.experiment, 2), [condition], {"mine": {"visible": opened}}, tmp_path / "out")
    assert not (tmp_path / "out").exists()
