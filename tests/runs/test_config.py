from __future__ import annotations

import re
from dataclasses import replace

import pytest

from murmurate.errors import InputError, RunError
from murmurate.runs import config_io, experiment, presets
from murmurate.runs.experiment import ExperimentConfig
from tiny import tiny


def test_toml_round_trip(tmp_path):
    wanted = tiny(seed=7, base={"weights": {"visible": 0.5}})
    experiment.save(wanted, tmp_path)
    assert experiment.load(tmp_path) == wanted
    experiment.check_same(wanted, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["experiment.toml"]


@pytest.mark.parametrize(
    ("field", "value", "line"),
    [
        ("objective", "C3", "objective = 'C3': must be one of C1, C2"),
        ("seed", -1, "seed = -1: must be an integer from 0 to 4294967295"),
        ("seed", 2**32, "seed = 4294967296: must be an integer from 0 to 4294967295"),
        ("name", "", "name = '': must be up to 64 letters"),
        ("name", "../C", "name = '../C': must be up to 64 letters"),
        ("name", ".hidden", "name = '.hidden': must be up to 64 letters"),
    ],
)
def test_values_are_checked(field, value, line):
    with pytest.raises(InputError) as caught:
        replace(tiny(), **{field: value})
    assert str(caught.value).startswith(line)


def test_a_dead_zone_that_leaves_no_way_to_the_safe_distance_is_refused():
    """Two robots that nearly touch are 2 from the safe distance of 4: at a speed limit of 4 that is half of a step."""
    world = replace(tiny().world, max_speed=4.0)
    for dead_zone in (0.0, 0.49):
        replace(tiny(), world=world, rest=replace(tiny().rest, dead_zone=dead_zone))
    with pytest.raises(InputError) as caught:
        replace(tiny(), world=world, rest=replace(tiny().rest, dead_zone=0.5))
    expected = "rest.dead_zone = 0.5: must be less than 0.5: a robot could not correct its way to the safe distance"
    assert str(caught.value) == expected


def test_every_leaf_has_a_help_text():
    assert [leaf.path for leaf in config_io.leaves(tiny()) if not leaf.help] == []


def test_nothing_is_assumed_that_is_not_said():
    with pytest.raises(InputError, match="given"):
        config_io.from_dict(ExperimentConfig, {"name": "x"})


def test_a_file_of_starts_is_relative_to_the_toml_file(tmp_path):
    path = tmp_path / "my.toml"
    path.write_text('[start]\nkind = "file"\nfile = "my.csv"\n')
    assert presets.resolve(path).start.file == str(tmp_path / "my.csv")
    # Fields of a file replace those of another one, and the words of a command line are relative to no file.
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "more.toml").write_text('[start]\nfile = "my.csv"\n')
    overlay = experiment.read_toml(tmp_path / "other" / "more.toml")
    assert presets.resolve(path, overlay).start.file == str(tmp_path / "other" / "my.csv")
    assert presets.resolve(path, overlay, {"start": {"file": "my.csv"}}).start.file == "my.csv"
    path.write_text('[start]\nkind = "file"\nfile = "/my.csv"\n')
    assert presets.resolve(path).start.file == "/my.csv"
    path.write_text('[start]\nuse = "mixture"\nshare = 0.25\n[start.second]\nuse = "file"\nfile = "my.csv"\n')
    start = presets.resolve(path).start
    assert start.second.file == str(tmp_path / "my.csv")
    assert type(start.second.file) is str
    path.write_text("start = 3\n")
    assert experiment.read_toml(path) == {"start": 3}


def test_a_damaged_configuration_is_one_line(tmp_path):
    with pytest.raises(RunError, match="cannot read"):
        experiment.load(tmp_path)
    path = tmp_path / "experiment.toml"
    whole = config_io.dump_toml(presets.preset("C"))
    crowd = whole.replace("robots = 10\n", "robots = 30000\n")
    endless = re.sub(r"max_steps = \d+", "max_steps = 2147483647", whole)
    assert whole not in (crowd, endless)
    for text, line in (
        ("x = ", "valid TOML"),
        ("radius = 1.0", "radius = 1.0: must be a field of"),
        ("", "given"),
        (crowd, "world.robots = 30000: must be an integer >= 2 and <= 10000"),
        (endless, "rest.max_steps = 2147483647: must be an integer >= 1 and <= 10000000"),
    ):
        path.write_text(text)
        with pytest.raises(RunError, match=line) as caught:
            experiment.load(tmp_path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)
