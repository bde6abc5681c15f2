from __future__ import annotations

import functools

import jax
import pytest
from matplotlib.figure import Figure

from murmurate import plots
from murmurate.report import report
from murmurate.report import runs as work
from murmurate.report.data import Command, ReportData
from murmurate.report.plan import Plan, PlannedRun
from murmurate.runs.paper import EXPERIMENTS
from tiny import tiny


def make_tiny_plan(quick=False):
    """The tiny experiment in the place of all others: two runs that differ in the seed."""
    # One of them forms patterns that do not stay: its robots creep on.
    rests = {"central": {"dead_zone": 0.001, "stillness": 1.0}, "formation": {}}
    plan_runs = {
        learner: PlannedRun(f"tiny-{learner}-seed{seed}", learner, tiny(seed=seed, rest=rest))
        for seed, (learner, rest) in enumerate(rests.items())
    }
    sizes = {start: dict.fromkeys((3, 4, 5), plan_runs["formation"]) for start in ("distributed", "scattered")}
    return Plan(seed=0, quick=quick, experiments=dict.fromkeys(EXPERIMENTS, plan_runs), sizes=sizes)


@pytest.fixture(scope="session")
def plan():
    return make_tiny_plan()


@pytest.fixture(scope="session")
def runs(plan, tmp_path_factory):
    """The folder of the plan's finished runs; not to be changed."""
    runs = tmp_path_factory.mktemp("runs")
    with jax.numpy_rank_promotion("allow"):  # optax needs the usual rules
        work.train(plan, runs)
    return runs


@pytest.fixture(scope="session")
def results(plan, runs):
    return [work.read(planned, runs / planned.name) for planned in plan.runs]


COMMAND = Command("murmurate reproduce --quick", "murmurate reproduce", seconds=12.3, reused=1)


def blank(patch):
    """Draws nothing, fast."""
    for name in ("robot", "visibility", "training", "reward", "formation", "patterns", "growth"):
        patch.setattr(plots, f"{name}_figure", lambda *_: Figure(figsize=(0.2, 0.1)))


@pytest.fixture(scope="session")
def written(results, tmp_path_factory):
    """Folders of a full and of a quick report, the quick one with real, if small, pictures; not to be changed."""
    folders = {}
    for quick in (True, False):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(plots, "png", functools.partial(plots.png, dpi=25))
            if not quick:
                blank(patch)
            folders[quick] = tmp_path_factory.mktemp("report")
            data = ReportData(make_tiny_plan(quick), results, COMMAND)
            report.write(report.make(data), folders[quick])
    return folders


@pytest.fixture
def blank_pictures(monkeypatch):
    blank(monkeypatch)
