"""Methods side by side: the same starts for all, every condition kept as soon as it is done, failures by kind."""

from __future__ import annotations

import json
import types
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from murmurate.discovery import Cascade, Trajectories
from murmurate.errors import InputError, RunError
from murmurate.runs import comparison, comparison_page, config_io, live_table
from murmurate.runs.comparison import Comparison, Condition, ConditionJob, compare, conditions, shared_experiment
from murmurate.runs.execute import LocalProcesses
from murmurate.runs.jobs import JobStatus
from murmurate.runs.run import Run
from murmurate.world import check_configurations, scaled_to
from murmurate.world.start_sets import draw_set
from tiny import tiny

ROOT = Path(__file__).parents[2]
NAMES = ["learned", "circle", "random", "circle-central"]


@pytest.fixture(scope="module")
def runs(tiny_run):
    return {"learned": {"visible": Run.open(tiny_run("local"))}}


@pytest.fixture(scope="module")
def setting():
    base = tiny(policy={"use": "local", "hidden": [8, 4]}, start={"use": "random"})
    return Comparison(replace(base, rest=replace(base.rest, max_steps=60)), episodes=20)


@pytest.fixture(scope="module")
def done(runs, setting, tmp_path_factory):
    folder = tmp_path_factory.mktemp("cells")
    wanted = conditions(NAMES, ["visible"], ["fsync"], [3, 5], known=NAMES)
    return folder, wanted, compare(setting, wanted, runs, folder)


def test_a_row_adds_up(done):
    _, wanted, rows = done
    assert [Condition(*(r[n] for n in Condition.__dataclass_fields__)) for r in rows] == wanted
    for row in rows:
        failures = [row[name] for name in ("collisions", "left", "hidden", "unsafe", "restless", "unsteady")]
        assert max(failures) <= row["episodes"] - row["valid"] <= sum(failures)
        low, high = row["interval"]
        assert low - 1e-9 <= row["valid"] / row["episodes"] <= high + 1e-9
        assert len(row["worst"]) == min(comparison.MAX_WORST, row["episodes"] - row["valid"])
        assert all(np.shape(case["positions"]) == (row["robots"], 2) for case in row["worst"])
        if row["valid"]:
            assert row["steps"] == row["epochs"]
            assert (row["efficiency"] > 0) == (row["method"] != "learned"), "it hardly learned, and stands still"
        else:
            assert row["steps"] is None


def test_a_good_method_is_told_from_a_bad_one(done):
    _, _, rows = done
    valid = {(row["method"], row["robots"]): row["valid"] for row in rows}
    assert valid["circle-central", 5] >= 18
    assert valid["random", 5] <= 2


def test_every_method_begins_at_the_same_starts(setting, monkeypatch):
    seen = []
    monkeypatch.setattr(
        comparison,
        "_measure",
        lambda problem, trajectories: seen.append(trajectories.positions[:, 0]) or {"a": np.ones(1)},
    )
    monkeypatch.setattr(comparison, "MAX_PAIRS", 8 * 3**2)
    for method in ("random", "centroid"):
        condition = Condition(method, "visible", "fsync", 3)
        problem = setting.problem(condition)
        for trajectories in comparison._rollouts(
            setting, problem, ConditionJob(Path(), setting, condition)._policies()
        ):
            comparison._measure(problem, trajectories)
    batches = len(seen) // 2
    assert batches == 3
    for first, second in zip(seen[:batches], seen[batches:], strict=True):
        np.testing.assert_array_equal(first, second)
    assert sum(map(len, seen[:batches])) == setting.episodes
    assert len(np.unique(np.concatenate(seen[:batches]), axis=0)) == setting.episodes


def test_what_is_done_is_not_run_again_and_more_may_be_asked_for(done, setting, runs, monkeypatch):
    folder, wanted, rows = done
    monkeypatch.setattr(comparison, "_evaluate", lambda *_: pytest.fail("run again"))
    assert compare(setting, wanted, runs, folder) == json.loads(json.dumps(rows))
    assert compare(replace(setting, episodes=10), wanted, runs, folder) == json.loads(json.dumps(rows))


BASELINE = """
import jax.numpy as jnp

from murmurate import Baseline


class StandStill(Baseline):
    deviations = "It does not move."

    def __call__(self, observation):
        return jnp.zeros((self.world.robots, 2, observation.view.x.shape[-1]))
"""


def test_a_baseline_of_ones_own_is_compared_here_and_in_a_process(setting, runs, tmp_path, monkeypatch, capsys):
    (tmp_path / "still.py").write_text(BASELINE)
    monkeypatch.syspath_prepend(tmp_path)
    wanted = conditions(["still:StandStill"], ["visible"], ["fsync"], [3], known=NAMES)
    setting = replace(setting, episodes=4)
    local_rows = compare(setting, wanted, runs, tmp_path / "here")
    assert capsys.readouterr() == ("", "")
    worker_rows = compare(setting, wanted, runs, tmp_path / "there", LocalProcesses(1), quiet=False)
    assert local_rows == worker_rows
    line = f"1 of 1: still:StandStill, visible, fsync, random, N = 3: {local_rows[0]['valid'] / 4:.1%} valid\n"
    assert capsys.readouterr().out == line
    assert [(row["method"], row["collisions"], row["left"]) for row in local_rows] == [("still:StandStill", 0, 0)]
    assert comparison.sorted_rows(tmp_path / "there") == worker_rows
    assert [path.name for path in (tmp_path / "there").iterdir()] == [comparison.COMPARISON]


FAULTY = """
import jax.numpy as jnp

from murmurate import Baseline


class Faulty(Baseline):
    dtype = jnp.float32
    number = 0.0

    def __call__(self, observation):
        return jnp.full((self.world.robots, 2, observation.view.x.shape[-1]), self.number, self.dtype)


class Flat(Faulty):
    def __call__(self, observation):
        return super().__call__(observation)[0]


class Half(Faulty):
    dtype = jnp.float16


class Whole(Faulty):
    dtype = jnp.int32


class Undefined(Faulty):
    number = jnp.nan


class Broken(Faulty):
    def __call__(self, observation):
        return observation.colours


class Gain(Faulty):
    gain: float
"""


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Flat", "a class whose __call__ returns float32[3, 2, 2] for 2 configurations, not float32[2, 2]"),
        ("Half", "a class whose __call__ returns float32[3, 2, 2] for 2 configurations, not float16[3, 2, 2]"),
        ("Whole", "a class whose __call__ returns float32[3, 2, 2] for 2 configurations, not int32[3, 2, 2]"),
        ("Undefined", "one whose velocities are finite numbers"),
        ("Broken", "a class that can be evaluated (AttributeError: 'Observation' object has no attribute 'colours')"),
        ("Gain", "a class whose field gain has a default"),
    ],
)
def test_a_faulty_baseline_is_refused_before_anything_runs(name, message, setting, tmp_path, monkeypatch):
    (tmp_path / "faulty.py").write_text(FAULTY)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(comparison, "_evaluate", lambda *_: pytest.fail("evaluated"))
    method = f"faulty:{name}"
    wanted = conditions(["random", method], ["visible"], ["fsync"], [3], known=NAMES)
    with pytest.raises(InputError) as error:
        compare(setting, wanted, {}, tmp_path / "out")
    assert str(error.value) == f"method = {method!r}: must be {message}"
    assert not (tmp_path / "out").exists()


def test_a_comparison_that_fails_leaves_nothing(setting, tmp_path, monkeypatch):
    monkeypatch.setattr(comparison, "_measure", lambda *_: pytest.fail("measured"))
    diverged = [types.SimpleNamespace(final=np.full((4, 3, 2), np.nan))]
    monkeypatch.setattr(comparison, "_rollouts", lambda *_: diverged)
    wanted = conditions(["random"], ["visible"], ["fsync"], [3], known=NAMES)
    with pytest.raises(InputError, match=r"^method = 'random': must be one whose velocities are finite numbers"):
        compare(setting, wanted, {}, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_driver_of_workers_reads_how_far_each_condition_is(setting, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(live_table, "DRAW_SECONDS", 0.0)
    monkeypatch.setattr(comparison, "_evaluate", lambda *args: args[-1]("episodes", 512, 1000, steps="step 9") or {})
    job = ConditionJob(tmp_path, setting, Condition("random", "visible", "fsync", 3))
    assert job.progress() is None
    table = live_table.LiveTable([job], {job.name: JobStatus("running", 1)})
    table.draw()
    job.run()
    table.draw()
    table.draw()
    assert capsys.readouterr() == ("", "random, visible, fsync, random, N = 3: episodes: 512/1000\n")


def test_gaps_are_in_percent_of_the_best_known(tmp_path):
    data = json.loads((ROOT / "docs" / "comparison" / "comparison.json").read_text())
    row = next(row for row in data["rows"] if (row["method"], row["robots"]) == ("circle", 8))
    data["rows"] = [{**row, "gap": 0.0391}, {**row, "robots": 10, "gap": 0.0391, "best_known": 3.91}, row | UNKNOWN]
    (tmp_path / comparison.COMPARISON).write_text(json.dumps(data))
    rows = comparison.load(tmp_path)["rows"]
    assert rows[0]["best_known"] == pytest.approx(3.9, abs=0.05)  # as an older version wrote it
    assert [cells[-1] for cells in comparison_page.table_rows(rows)] == ["0.997%", "1.000%", "-"]


UNKNOWN = {"robots": 64, "best_known": None, "gap": None}


def test_whether_patterns_stay_is_shown_where_it_is_known(done, tmp_path):
    """Comparisons of version 0.1.0 did not watch them."""
    _, _, rows = done
    assert "| not at rest | not stationary | steps |" in comparison_page.tables(rows)
    assert "| efficiency | shortened | gap |" in comparison_page.tables(rows)
    old = [{name: value for name, value in row.items() if name not in ("unsteady", "interventions")} for row in rows]
    (tmp_path / comparison.COMPARISON).write_text(json.dumps({"rows": old}))
    page = comparison_page.page(comparison.load(tmp_path)["rows"], []).lower()
    assert "stationary" not in page
    assert "shortened" not in page
    bad = [rows[0] | {"unsteady": rows[0]["episodes"] + 1}]
    (tmp_path / comparison.COMPARISON).write_text(json.dumps({"rows": bad}))
    with pytest.raises(RunError, match="row 1 has unsteady = 21"):
        comparison.load(tmp_path)


def test_a_shield_s_interventions_are_counted(setting, tmp_path):
    wanted = [Condition("random", "visible", "fsync", 3)]
    for shield, counted in (("none", False), ("clearance", True)):
        comparing = replace(setting, base=config_io.replaced(setting.base, {"shield": {"use": shield}}))
        (row,) = compare(comparing, wanted, {}, tmp_path / shield)
        assert (row["interventions"] > 0) == counted
        assert (row["collisions"] == 0) >= counted


@pytest.mark.parametrize(
    ("name", "reason"), [("none:Such", "No module named 'none'"), ("json:JSONDecoder", "no subclass of it")]
)
def test_a_baseline_that_is_none_is_refused(name, reason):
    with pytest.raises(InputError, match=reason):
        conditions([name], ["visible"], ["fsync"], [3])


def test_the_seed_reaches_the_scheduler_and_the_frames(setting, monkeypatch):
    seeds = []
    rollout = Cascade.rollout
    monkeypatch.setattr(Cascade, "rollout", lambda *args: seeds.append(args[2]) or rollout(*args))
    monkeypatch.setattr(comparison, "MAX_PAIRS", 8 * 3**2)
    for seed in (0, 1):
        condition = Condition("centroid", "visible", "ssync", 3)
        comparing = replace(setting, episodes=10, seed=seed)
        policies = ConditionJob(Path(), comparing, condition)._policies()
        list(comparison._rollouts(comparing, comparing.problem(condition), policies))
    assert seeds == [0, 8, 10_000, 10_008]


def test_more_starts_are_another_run_of_the_same_cell(runs, setting, tmp_path):
    condition = conditions(["random"], ["visible"], ["fsync"], [3], known=NAMES)
    first = compare(replace(setting, episodes=4), condition, runs, tmp_path)
    assert [row["episodes"] for row in first] == [4]
    assert [row["episodes"] for row in compare(replace(setting, episodes=6), condition, runs, tmp_path)] == [6]
    assert len(comparison.load(tmp_path)["rows"]) == 1


def test_another_comparison_is_not_mixed_in(done, setting, runs):
    folder, wanted, _ = done
    with pytest.raises(RunError, match="holds another comparison: seed is 0 there, 1 here; choose another folder"):
        compare(replace(setting, seed=1), wanted, runs, folder)


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("shield", {"shield": {"use": "walls"}}),
        ("rest", {"rest": {"stillness": 0.01}}),
        ("valid", {"valid": {"safety": 0.9}}),
        ("signals", {"signals": {"calm": {"use": "own.mine:Calm"}}}),
        ("starts", {"start": {"use": "scattered"}}),
    ],
)
def test_rows_of_other_settings_are_not_reused(name, changed, done, setting, runs):
    folder, wanted, _ = done
    base = config_io.replaced(setting.base, changed)
    with pytest.raises(RunError, match=rf"holds another comparison: {name}[.\w]* is .* there, .* here; choose"):
        compare(replace(setting, base=base), wanted, runs, folder)


def test_rows_of_other_starts_are_kept_beside_each_other(done, setting, runs, monkeypatch):
    """Where the experiment begins matters to rows of random starts alone."""
    folder, _, _ = done
    monkeypatch.setattr(comparison, "_evaluate", lambda *_: pytest.fail("evaluated"))
    before = comparison.load(folder)["rows"]
    assert (
        compare(replace(setting, base=config_io.replaced(setting.base, {"start": "scattered"})), [], {}, folder) == []
    )
    assert comparison.load(folder)["rows"] == before
    assert comparison.load(folder)["starts"]["random"]["use"] == "random"


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"rest": {"max_steps": 21}}, "rest.max_steps = 21: must be 20 in other as in first"),
        ({"shield": {"use": "walls"}}, "shield.use = 'walls': must be 'none' in other as in first"),
        ({"objective": "C1"}, "objective = 'C1': must be 'C2' in other as in first"),
        ({"valid": {"safety": 0.9}}, "valid.safety = 0.9: must be None in other as in first"),
        ({"world": {"safe_distance": 4.5}}, "world.safe_distance = 4.5: must be 4.0 in other as in first"),
        ({"signals": {"calm": {"use": "own.mine:Calm"}}}, "signals.calm.use = 'own.mine:Calm': must be None in other"),
    ],
)
def test_runs_at_other_tasks_are_not_compared(changed, message, setting):
    base = tiny(policy={"use": "local", "hidden": [8, 4]})
    with pytest.raises(InputError) as error:
        shared_experiment({"first": base, "other": config_io.replaced(base, changed)})
    assert str(error.value).startswith(message)


def test_runs_of_other_sizes_starts_and_sensing_are_compared():
    base = tiny(policy={"use": "local", "hidden": [8, 4]})
    changed = {"sensing": {"use": "global"}, "scheduler": {"use": "ssync"}, "start": {"use": "random"}, "seed": 3}
    other = replace(config_io.replaced(base, changed), world=scaled_to(base.world, 7))
    assert shared_experiment({"first": base, "other": other}) is base


def test_a_learned_method_makes_of_slow_moves_what_it_was_trained_to(setting):
    """Baselines do as they state; what counts as rest is the same for all."""
    slow = {"dead_zone": 0.05, "damping": 0.7, "sidestep": 0.5}
    other = config_io.replaced(tiny(policy={"use": "local", "hidden": [8, 4]}), {"rest": slow | {"window": 9}})
    shared_experiment({"first": setting.base, "other": config_io.replaced(setting.base, {"rest": slow})})
    condition = Condition("other", "visible", "fsync", 4, "random")
    rest = setting.problem(condition, other).rest
    assert {name: getattr(rest, name) for name in slow} == slow
    for name, stated in (("circle", (0.05, 0.0)), ("gradient", (0.12, 0.4))):
        own = setting.problem(replace(condition, method=name)).rest
        assert (own.dead_zone, own.damping, own.sidestep) == (*stated, setting.base.rest.sidestep)
        assert (rest.window, rest.max_steps) == (own.window, own.max_steps)


def test_contact_and_leaving_are_counted_apart(setting):
    """Two robots touch, one leaves, and both happen in the same step; another episode is a valid pattern."""
    world = setting.base.world
    still = np.array([[0, 0], [5, 0], [0, 5]], np.float32)
    ends = np.stack([still] * 4)
    ends[[0, 2], 0] = [4.5, 0]
    ends[[1, 2], 2] = [0, 13]
    positions = np.stack([np.stack([still] * 4), ends], axis=1)
    flags = np.ones(4, bool)
    episodes = Trajectories(
        positions=positions,
        lengths=np.ones(4, np.int32),
        switch=np.zeros((4, 0), np.int32),
        at_rest=flags,
        terminated=~flags,
        epochs=np.ones(4, np.int32),
        signals={"close": np.ones((4, 2))},
        interventions=np.arange(4, dtype=np.int32),
        after_rest=ends[:, None],
    )
    assert world.half_width == 12
    measured = comparison._measure(setting.base, episodes)
    assert measured["collided"].tolist() == [True, False, True, False]
    assert measured["left"].tolist() == [False, True, True, False]
    assert measured["valid"].tolist() == [False, False, False, True]
    assert measured["interventions"].tolist() == [0, 1, 2, 3]


def test_symmetric_starts_are_cells_of_their_own(setting):
    wanted = conditions(["circle"], ["visible"], ["fsync"], [3, 5], ["rings", "line"], ["circle"])
    assert [(condition.start, condition.robots) for condition in wanted] == [("rings", 5), ("line", 3), ("line", 5)]
    condition = wanted[1]
    problem = setting.problem(condition)
    trajectories = next(
        comparison._rollouts(setting, problem, ConditionJob(Path(), setting, condition)._policies(), condition.start)
    )
    first = trajectories.positions[:, 0].astype(float)
    along = first[:, 2] - first[:, 0]
    across = first[:, 1] - (first[:, 0] + first[:, 2]) / 2
    assert np.linalg.norm(along, axis=1).min() > 0.1
    assert np.abs(across).max() < 1e-5


def test_starts_of_sets_are_cells_of_their_own_whatever_the_seed(setting, monkeypatch):
    monkeypatch.setattr(comparison, "MAX_PAIRS", 8 * 3**2)
    for start in (*comparison.SETS, "hard"):
        (condition,) = conditions(["circle"], ["visible"], ["fsync"], [3], [start], ["circle"])
        problem = setting.problem(condition)
        strategy, count = setting.start(start), setting.episodes
        keys = [jax.random.key(seed) for seed in (0, 1)]
        draws = [comparison._draws(problem.world, strategy, start, key, count) for key in keys]
        first, second = (np.concatenate([draw(0, 8), draw(8, 8)]) for draw in draws)
        if start == "hard":
            assert (first != second).any()
            check_configurations(first, problem.world, start)
        else:
            np.testing.assert_array_equal(first, draw_set(start, problem.world, 16))
            np.testing.assert_array_equal(first, second)


def test_a_damaged_file_is_refused(done, setting, runs, tmp_path):
    folder, wanted, _ = done
    data = json.loads((folder / comparison.COMPARISON).read_text())
    for name in ("robots", "episodes"):
        damaged = json.loads(json.dumps(data))
        del damaged["rows"][0][name]
        (tmp_path / comparison.COMPARISON).write_text(json.dumps(damaged))
        with pytest.raises(RunError, match=rf"comparison.json is damaged: row 1 has {name} = None"):
            compare(setting, wanted, runs, tmp_path)


def test_what_made_the_cells_is_noted_once(done, setting, runs):
    folder, wanted, _ = done
    for command in ("first", "second", "first"):
        compare(setting, wanted[:1], runs, folder, command=command)
    assert comparison.load(folder)["commands"] == ["first", "second"]
    assert [row["robots"] for row in comparison.sorted_rows(folder)] == [3] * 4 + [5] * 4
    assert comparison.sorted_rows(folder)[0]["method"] == "learned"


def test_a_central_mind_has_one_frame_and_others_have_their_own(setting):
    sensing = setting.problem(Condition("circle-central", "visible", "fsync", 5)).sensing
    assert (sensing.name, sensing.rotation, sensing.reflection) == ("global", False, False)
    sensing = setting.problem(Condition("circle", "visible", "fsync", 5)).sensing
    assert (sensing.name, sensing.rotation, sensing.reflection) == ("visible", True, True)


@pytest.mark.parametrize(
    ("field", "names"),
    [
        ("method", (["lerned"], ["visible"], ["fsync"])),
        ("sensing", (["circle"], ["radar"], ["fsync"])),
        ("scheduler", (["circle"], ["visible"], ["psync"])),
    ],
)
def test_unknown_names_list_the_known_ones(field, names):
    with pytest.raises(InputError, match=f"{field} = .*: must be one of .*,"):
        conditions(*names, [4], known=NAMES)


def test_the_table_goes_into_a_page_once_and_is_kept(done):
    _, _, rows = done
    part = comparison_page.page(rows, ["murmurate compare"], ["a note"])
    headings = part.count("\n### ")
    kinds = {(row["sensing"], row["scheduler"]) if row["start"] == "random" else row["start"] for row in rows}
    assert headings == len(kinds)
    assert part.count("\n| ") == len(rows) + 2 * headings
    page = comparison_page.put_into("# Title\n\ntext\n", part)
    again = comparison_page.put_into(page, part.replace("a note", "another"))
    assert page.startswith("# Title\n\ntext\n")
    assert again.count("## Any swarm") == 1
    assert "another" in again
    assert comparison_page.kept(again) in again
    assert comparison_page.kept("# Title\n") == ""
