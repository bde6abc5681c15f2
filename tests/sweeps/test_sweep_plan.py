"""What a file of runs stands for, and what is refused before anything is written."""

from __future__ import annotations

import pytest

from murmurate.errors import InputError, RunError
from murmurate.sweeps import plan
from tiny import tiny


def test_experiments_times_seeds(written):
    sweep = plan.read_sweep(written('experiments = ["one.toml", "two.toml", "three.toml"]\nseeds = 2\n'))
    assert len(sweep.runs) == 6
    assert {(run.name, run.seed) for run in sweep.runs.values()} == {
        (name, seed) for name in ("one", "two", "three") for seed in (0, 1)
    }
    assert sweep.runs["two-central-seed1"] == tiny(name="two", seed=1)
    assert sweep.swept == ()


def test_a_grid_takes_every_combination_and_names_what_differs(written):
    text = (
        'experiments = ["one.toml"]\nseeds = [5]\n[grid]\n"base.ppo.clip" = [0.1, 0.2]\nworld.max_speed = [0.5, 0.25]\n'
    )
    sweep = plan.read_sweep(written(text))
    assert set(sweep.swept) == {"base.ppo.clip", "world.max_speed"}
    assert {(run.base.ppo.clip, run.world.max_speed) for run in sweep.runs.values()} == {
        (clip, speed) for clip in (0.1, 0.2) for speed in (0.5, 0.25)
    }
    assert all(run.seed == 5 for run in sweep.runs.values())
    assert "one-central-seed5-base.ppo.clip=0.1-world.max_speed=0.5" in sweep.runs


def test_blocks_have_what_is_common_and_what_is_their_own(written):
    text = """
seeds = 1
fields.world.max_speed = 0.25
[[runs]]
experiments = ["A", "B"]
learners = ["central", "equivariant"]
[[runs]]
experiments = ["one.toml"]
fields.world.max_speed = 0.125
"""
    sweep = plan.read_sweep(written(text))
    assert len(sweep.runs) == 5
    speeds = {name: run.world.max_speed for name, run in sweep.runs.items()}
    assert speeds.pop("one-central-seed0-world.max_speed=0.125") == 0.125
    assert set(speeds.values()) == {0.25}
    assert {run.policy.kind for run in sweep.runs.values() if run.name == "A"} == {"central", "equivariant"}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "experiments = None: must be a list"),
        ("experiments = []", "experiments = []"),
        ('experiments = ["A"]\nseeds = 0', "seeds = 0: must be how many (1 to 10000)"),
        ('experiments = ["A"]\nseeds = []', "seeds = []"),
        ('experiments = ["A"]\nseeds = [-1]', "-1"),
        ('experiments = ["a"]', "did you mean A"),
        ('experiments = ["none.toml"]', "a TOML file, relative to the sweep's"),
        ('experiments = ["A"]\nlearners = ["centrale"]', "must be one of equivariant, central"),
        ('experiment = ["A"]', "did you mean experiments"),
        ('experiments = ["A"]\n[world]\nrobots = 3', "fields of the experiment go under [fields]"),
        ('experiments = ["A"]\n[fields.world]\nrobot = 3', "did you mean world.robots"),
        ('experiments = ["A"]\n[grid]\n"base.ppo.clipp" = [0.1]', "did you mean base.ppo.clip"),
        ('experiments = ["A"]\n[grid]\n"base.ppo.clip" = []', "grid.base.ppo.clip = []"),
        ('experiments = ["A"]\n[grid]\n"base.ppo.clip" = [0.1, -1.0]', "(in experiment A)"),
        ('experiments = ["A"]\n[fields]\nseed = 1', "seeds says which"),
        ('experiments = ["A"]\n[fields]\nbase.ppo.clip = 0.1\n[grid]\n"base.ppo.clip" = [0.1]', "the grid says which"),
        ('experiments = ["A", "A"]', "there once, not twice"),
        ('experiments = ["A"]\nseeds = 10000\n[grid]\n"base.ppo.clip" = [0.1, 0.2]', "1 to 10000"),
        ('experiments = ["A"]\n[fields.world]\nrobots = 5000', "(in experiment A)"),
        ("runs = []", "each under [[runs]]"),
    ],
)
def test_refused(written, text, words):
    with pytest.raises(InputError) as caught:
        plan.read_sweep(written(text))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_of_something_else_stays_as_it_is(written, tmp_path):
    sweep = plan.read_sweep(written('experiments = ["one.toml"]'))
    out = tmp_path / "out"
    out.mkdir()
    (out / "results.csv").write_text("mine")
    with pytest.raises(RunError, match="holds no run of this sweep"):
        plan.lay_out(sweep, out)
    assert [path.name for path in out.iterdir()] == ["results.csv"]


def test_a_run_of_another_experiment_is_not_gone_on_with(written, tmp_path):
    out = tmp_path / "out"
    sweep = plan.read_sweep(written('experiments = ["one.toml"]'))
    folders = plan.lay_out(sweep, out)
    assert plan.check(sweep, out) == []
    (folder,) = folders.values()
    config.save(tiny(name="one", seed=3), folder)
    with pytest.raises(RunError):
        plan.check(sweep, out)


def test_runs_that_the_sweep_no_longer_names_are_not_mixed_in(written, tmp_path):
    plan.lay_out(plan.read_sweep(written('experiments = ["one.toml", "two.toml"]')), tmp_path / "out")
    with pytest.raises(RunError, match="two-central-seed0"):
        plan.check(plan.read_sweep(written('experiments = ["one.toml"]')), tmp_path / "out")
