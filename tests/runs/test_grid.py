"""Grids: which runs a file, flags or Python describe, and what is refused before anything is write_sweep."""

from __future__ import annotations

import pytest

from murmurate.errors import InputError, RunError
from murmurate.runs import experiment as configuration
from murmurate.runs.grid import Grid, run_name
from murmurate.runs.jobs import training_jobs
from tiny import tiny


def test_experiments_times_seeds(write_sweep):
    grid = Grid.from_toml(write_sweep('experiments = ["one.toml", "two.toml", "three.toml"]\nseeds = 2\n'))
    assert len(grid.runs) == 6
    assert {(run.name, run.seed) for run in grid.runs.values()} == {
        (name, seed) for name in ("one", "two", "three") for seed in (0, 1)
    }
    assert grid.runs["two-central-seed1"] == tiny(name="two", seed=1)
    assert grid.varied == ()


def test_a_grid_takes_every_combination_and_names_what_differs(write_sweep):
    text = (
        'experiments = ["one.toml"]\nseeds = [5]\n[grid]\n"base.ppo.clip" = [0.1, 0.2]\nworld.max_speed = [0.5, 0.25]\n'
    )
    grid = Grid.from_toml(write_sweep(text))
    assert set(grid.varied) == {"base.ppo.clip", "world.max_speed"}
    assert {(run.base.ppo.clip, run.world.max_speed) for run in grid.runs.values()} == {
        (clip, speed) for clip in (0.1, 0.2) for speed in (0.5, 0.25)
    }
    assert all(run.seed == 5 for run in grid.runs.values())
    assert "one-central-seed5-base.ppo.clip=0.1-world.max_speed=0.5" in grid.runs


def test_files_of_starts_are_relative_to_the_sweep(write_sweep):
    path = write_sweep(
        'experiments = ["one.toml"]\nseeds = 1\n[grid]\n'
        'start = [{ use = "file", file = "more/a.csv" }, { use = "file", file = "more/a.csv", noise = 0.0 }]\n'
    )
    (path.parent / "more").mkdir()
    (path.parent / "more" / "a.csv").write_text("start,x,y\n0,-5,0\n0,0,0\n0,5,1\n")
    found = [(run.start.file, run.start.noise) for run in Grid.from_toml(path).runs.values()]
    assert found == [(str(path.parent / "more" / "a.csv"), noise) for noise in (2.0, 0.0)]


def test_blocks_have_what_is_common_and_what_is_their_own(write_sweep):
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
    grid = Grid.from_toml(write_sweep(text))
    assert len(grid.runs) == 5
    speeds = {name: run.world.max_speed for name, run in grid.runs.items()}
    assert speeds.pop("one-central-seed0-world.max_speed=0.125") == 0.125
    assert set(speeds.values()) == {0.25}
    assert {run.policy.name for run in grid.runs.values() if run.name == "A"} == {"central", "equivariant"}


@pytest.mark.parametrize(
    ("text", "arguments"),
    [
        ("", "experiments = None: must be a list"),
        ("experiments = []", "experiments = []"),
        ('experiments = ["A"]\nseeds = 0', "seeds = 0: must be how many (1 to 10000)"),
        ('experiments = ["A"]\nseeds = []', "seeds = []"),
        ('experiments = ["A"]\nseeds = [-1]', "-1"),
        ('experiments = ["a"]', "did you mean A"),
        ('experiments = ["none.toml"]', "a TOML file, relative to the sweep's"),
        ('experiments = ["A"]\nlearners = ["centrale"]', "must be one of formation, equivariant, central"),
        ('experiment = ["A"]', "did you mean experiments"),
        ('experiments = ["A"]\n[world]\nrobots = 3', "fields of the experiment go under [fields]"),
        ('experiments = ["A"]\n[fields.world]\nrobot = 3', "did you mean robots"),
        ('experiments = ["A"]\n[grid]\n"base.ppo.clipp" = [0.1]', "did you mean clip"),
        ('experiments = ["A"]\n[grid]\n"base.ppo.clip" = []', "grid.base.ppo.clip = []"),
        ('experiments = ["A"]\n[grid]\n"base.gradients.discount" = [0.9, -1.0]', "(in experiment A)"),
        ('experiments = ["A"]\n[fields]\nseed = 1', "seeds says which"),
        ('experiments = ["A"]\n[fields]\nbase.ppo.clip = 0.1\n[grid]\n"base.ppo.clip" = [0.1]', "the grid says which"),
        ('experiments = ["A", "A"]', "there once, not twice"),
        ('experiments = ["A"]\nseeds = 10000\n[grid]\n"base.ppo.clip" = [0.1, 0.2]', "1 to 10000"),
        ('experiments = ["A"]\n[fields.world]\nrobots = 5000', "(in experiment A)"),
        ("runs = []", "each under [[runs]]"),
    ],
)
def test_refused(write_sweep, text, arguments):
    with pytest.raises(InputError) as caught:
        Grid.from_toml(write_sweep(text))
    assert arguments in str(caught.value)
    assert "\n" not in str(caught.value)


def test_python_grids_are_products_and_sums():
    config = tiny(name="own")
    grid = Grid.product(["A", config], seeds=[3, 4], fields={"base.horizon": 9}, axes={"world.max_speed": [0.5, 0.25]})
    assert len(grid) == 8
    assert {run.base.horizon for run in grid.runs.values()} == {9}
    assert grid.runs["own-central-seed3-world.max_speed=0.25"].world.max_speed == 0.25
    assert repr(grid) == "Grid(8 runs, varied: world.max_speed)"
    both = grid + Grid.product(["B"], seeds=1)
    assert list(both.runs) == [*grid.runs, "B-formation-seed0"]
    with pytest.raises(InputError, match="there once, not twice"):
        grid + Grid.product([config], seeds=[3], fields={"base.horizon": 9}, axes={"world.max_speed": [0.5]})


def test_flags_are_a_grid_of_one_experiment():
    grid = Grid.from_flags(tiny(seed=3), "tiny", 2, ["base.horizon=7,9", "auxiliary.ppo.discount=0.80"])
    assert list(grid.runs) == [f"tiny-seed{s}-horizon{h}-discount0.80" for s in (3, 4) for h in (7, 9)]
    assert grid.runs["tiny-seed4-horizon9-discount0.80"].auxiliary.ppo.discount == 0.8
    assert grid.varied == ("base.horizon", "auxiliary.ppo.discount")


def test_names_of_runs_are_names_of_folders(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a").mkdir()
    for name in ("a/one.csv", "a_one.csv"):
        (tmp_path / name).write_text("start,x,y\n0,-5,0\n0,0,0\n0,5,1\n")
    config, prefix = tiny(start={"use": "file", "file": "a/one.csv"}), run_name("my own", "mine:Linear")
    grid = Grid.from_flags(config, prefix, 1, ["start.file=a/one.csv"])
    assert list(grid.runs) == ["my_own-mine_Linear-seed0-filea_one.csv"]
    with pytest.raises(InputError, match=r"different runs, not my-seed0-filea_one\.csv twice"):
        Grid.from_flags(config, "my", 1, ["start.file=a/one.csv,a_one.csv"])


def test_the_same_experiment_under_two_names_is_refused():
    with pytest.raises(InputError, match="different from first: they are the same experiment"):
        Grid({"first": tiny(), "second": tiny()})


@pytest.fixture
def grid(write_sweep):
    return Grid.from_toml(write_sweep('experiments = ["one.toml"]'))


def hold(grid, out):
    """Begins the runs of a grid, as workers do."""
    for job in training_jobs(grid, out):
        job.prepare()


def test_a_folder_of_something_else_stays_as_it_is(grid, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "results.csv").write_text("mine")
    with pytest.raises(RunError, match="holds no run of this sweep"):
        grid.check(out, exclusive=True)
    assert [path.name for path in out.iterdir()] == ["results.csv"]


def test_a_run_of_another_experiment_is_not_continued(grid, tmp_path):
    out = tmp_path / "out"
    assert grid.check(out) == {"one-central-seed0": "new"}
    hold(grid, out)
    assert grid.check(out, exclusive=True) == {"one-central-seed0": "unfinished"}
    with pytest.raises(RunError, match="holds another run"):
        grid.check(out, resume=False)
    configuration.save(tiny(name="one", seed=3), out / "one-central-seed0")
    with pytest.raises(RunError, match="seed is 3 there, 0 here"):
        grid.check(out)


def test_runs_that_the_grid_does_not_name_are_not_mixed_in(write_sweep, tmp_path):
    out = tmp_path / "out"
    hold(Grid.from_toml(write_sweep('experiments = ["one.toml", "two.toml"]')), out)
    grid = Grid.from_toml(write_sweep('experiments = ["one.toml"]'))
    with pytest.raises(RunError, match="two-central-seed0"):
        grid.check(out, exclusive=True)
    assert grid.check(out) == {"one-central-seed0": "unfinished"}
