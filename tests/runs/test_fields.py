from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from murmurate.errors import InputError, check_choice, check_number
from murmurate.runs import config_io


@dataclass(frozen=True)
class Sizes:
    """Sizes of a world.

    Attributes:
        radius: The radius R,
            world units.
        robots: Number of robots.
        safety: Reading of safety.
    """

    radius: float = 1.0
    robots: int = 10
    safety: Literal["penalty", "shell"] = "penalty"

    def __post_init__(self) -> None:
        check_number("radius", self.radius, 0, exclusive_low=True)
        check_number("robots", self.robots, 2, integer=True)
        check_choice("safety", self.safety, ("penalty", "shell"))


@dataclass(frozen=True)
class Stage:
    name: str
    hidden: tuple[int, ...] = (400, 300)
    rates: tuple[float, float] = (1e-3, 1e-4)
    clip: float | None = 0.2
    deterministic: bool = False
    sizes: Sizes = field(default_factory=Sizes)


@dataclass(frozen=True)
class Experiment:
    name: str = "C"
    world: Sizes = field(default_factory=Sizes)
    base: Stage = field(default_factory=lambda: Stage("base"))

    def __post_init__(self) -> None:
        if self.base.name == self.name:
            raise InputError("base.name", self.base.name, "another name")


finite = st.floats(allow_nan=False)
stages = st.builds(
    Stage,
    name=st.text(st.characters(exclude_categories=["Cs"])),
    hidden=st.lists(st.integers(-(2**63), 2**63 - 1)).map(tuple),
    rates=st.tuples(finite, finite),
    clip=st.none() | finite,
    deterministic=st.booleans(),
)


# The check of types in tests draws random items, which hypothesis would rather draw.
@pytest.mark.filterwarnings("ignore::hypothesis.errors.HypothesisDeprecationWarning")
@given(stages)
def test_round_trips_are_exact(stage):
    config = Experiment(name=f"not {stage.name}", base=stage)
    assert config_io.from_dict(Experiment, config_io.to_dict(config)) == config
    text = config_io.dump_toml(config)
    again = config_io.from_dict(Experiment, config_io.tomllib.loads(text))
    assert again == config
    assert config_io.dump_toml(again) == text
    assert math.copysign(1, again.base.rates[0]) == math.copysign(1, stage.rates[0])


def test_none_survives_a_default_that_is_not_none():
    stage = Stage("base", clip=None)
    assert 'clip = "none"' in config_io.dump_toml(stage)
    assert config_io.from_dict(Stage, {"name": "base", "clip": "none"}) == stage
    assert config_io.from_dict(Stage, config_io.to_dict(stage)) == stage


def test_types_become_those_of_the_fields():
    stage = config_io.from_dict(Stage, {"name": "x", "rates": [1, 2], "hidden": [3], "clip": 1})
    assert stage.rates == (1.0, 2.0)
    assert [type(item) for item in (*stage.rates, *stage.hidden, stage.clip)] == [float, float, int, float]


def test_replaced_keeps_everything_else():
    config = Experiment(world=Sizes(radius=3.0), base=Stage("base", hidden=(7,)))
    changed = config_io.replaced(config, {"world": {"robots": 4}, "base": {"sizes": {"radius": 2}}})
    assert changed.world == Sizes(radius=3.0, robots=4)
    assert changed.base == Stage("base", hidden=(7,), sizes=Sizes(radius=2.0))
    assert config_io.replaced(config, {}) == config


@pytest.mark.parametrize(
    ("data", "line"),
    [
        (
            {"world": {"radus": 1}},
            "world.radus = 1: must be a field of [world] (radius, robots, safety); did you mean radius?",
        ),
        ({"wrld": {}}, "wrld = {}: must be a field of the configuration (name, world, base); did you mean world?"),
        ({"world": {"zzz": 1}}, "world.zzz = 1: must be a field of [world] (radius, robots, safety)"),
        ({"world": 3}, "world = 3: must be a table with fields of [world] (radius, robots, safety)"),
        ({"world": {"radius": "big"}}, "world.radius = 'big': must be a number"),
        ({"world": {"radius": True}}, "world.radius = True: must be a number"),
        ({"world": {"radius": None}}, "world.radius = None: must be a number"),
        ({"world": {"robots": True}}, "world.robots = True: must be an integer"),
        ({"world": {"robots": 2.0}}, "world.robots = 2.0: must be an integer"),
        ({"world": {"safety": "shel"}}, "world.safety = 'shel': must be one of penalty, shell"),
        ({"world": {"safety": ["shell"]}}, "world.safety = ['shell']: must be one of penalty, shell"),
        ({"name": 3}, "name = 3: must be text"),
        ({"base": {"deterministic": 1}}, "base.deterministic = 1: must be true or false"),
        ({"base": {"hidden": 3}}, "base.hidden = 3: must be a list [an integer, ...]"),
        ({"base": {"hidden": [3, 1.5]}}, "base.hidden = 1.5: must be an integer"),
        ({"base": {"rates": [1]}}, "base.rates = [1]: must be a list [a number, a number]"),
        ({"base": {"clip": "x"}}, "base.clip = 'x': must be a number or none"),
        # What the dataclasses say themselves, with their place in front:
        ({"world": {"radius": -1.0}}, "world.radius = -1.0: must be a finite number > 0"),
        ({"world": {"radius": math.nan}}, "world.radius = nan: must be a finite number > 0"),
        ({"world": {"robots": 1}}, "world.robots = 1: must be an integer >= 2"),
        ({"base": {"sizes": {"radius": 0}}}, "base.sizes.radius = 0.0: must be a finite number > 0"),
        ({"base": {"name": "C"}}, "base.name = 'C': must be another name"),
    ],
)
def test_refusals_name_the_field(data, line):
    with pytest.raises(InputError) as caught:
        config_io.replaced(Experiment(), data)
    assert str(caught.value) == line


def test_a_field_without_default_must_be_given():
    with pytest.raises(InputError, match=r"^base\.name = None: must be given \(text\)$"):
        config_io.from_dict(Experiment, {"base": {"clip": 1}})


def test_huge_integers_are_no_floats():
    with pytest.raises(InputError, match="must be a number"):
        config_io.from_dict(Sizes, {"radius": 10**400})


def test_unsupported_types_are_defects():
    @dataclass(frozen=True)
    class Wrong:
        x: dict[str, int] = field(default_factory=dict)

    with pytest.raises(InputError, match="a type that a configuration can hold"):
        config_io.from_dict(Wrong, {})


def test_toml_files(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("[world]\nradius = 2\n")
    assert config_io.load_toml(path) == {"world": {"radius": 2}}
    path.write_text(path.read_text(), "utf-8-sig")
    assert path.read_bytes().startswith(b"\xef\xbb\xbf")
    assert config_io.load_toml(path) == {"world": {"radius": 2}}
    path.write_text("[world]\nradius = \n")
    with pytest.raises(InputError, match=r"mine\.toml.*line 2") as caught:
        config_io.load_toml(path)
    assert "\n" not in str(caught.value)
    path.write_bytes(b"name = '\xff'")
    with pytest.raises(InputError, match="valid TOML"):
        config_io.load_toml(path)
    with pytest.raises(FileNotFoundError):
        config_io.load_toml(tmp_path / "none.toml")


def test_leaves_have_paths_values_and_help():
    result = {leaf.path: leaf for leaf in config_io.leaves(Experiment())}
    assert list(result)[:4] == ["name", "world.radius", "world.robots", "world.safety"]
    assert result["world.radius"].help == "The radius R, world units."
    assert result["base.sizes.robots"].value == 10
    assert result["base.clip"].help == ""


@pytest.mark.parametrize("value", [(), (3,), (400, 300)])
def test_flags_read_tuples(value):
    assert config_io.parse(tuple[int, ...], ",".join(map(str, value)), "x") == value


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [(float, "-1e-3", -1e-3), (int, "12", 12), (bool, "true", True), (float | None, "none", None), (str, "12", "12")],
)
def test_flags_read_leaves(kind, text, value):
    assert config_io.parse(kind, text, "x") == value


@pytest.mark.parametrize(
    ("kind", "text", "line"),
    [
        (int, "1.5", "x = '1.5': must be an integer"),
        (float, "", "x = '': must be a number"),
        (bool, "yes", "x = 'yes': must be true or false"),
        (tuple[float, float], "1,2,3", "x = '1,2,3': must be 2 values, separated by commas, such as 0.5,1.5"),
        (tuple[int, ...], "1,a", "x = '1,a': must be integers, separated by commas, such as 32,16"),
        (Literal["a", "b"], "c", "x = 'c': must be one of a, b"),
    ],
)
def test_flags_refuse_text(kind, text, line):
    with pytest.raises(InputError) as caught:
        config_io.parse(kind, text, "x")
    assert str(caught.value) == line


def test_merged_and_nested():
    first = {"world": {"radius": 1, "robots": 2}, "name": "C"}
    flags = config_io.nested({"world.radius": 5, "base.sizes.robots": 3})
    assert config_io.merged(first, flags) == {
        "world": {"radius": 5, "robots": 2},
        "name": "C",
        "base": {"sizes": {"robots": 3}},
    }
    assert first["world"]["radius"] == 1


@pytest.mark.parametrize(
    ("value", "bounds", "allowed"),
    [
        ("x", {}, "a finite number"),
        (True, {"low": 0}, "a finite number >= 0"),
        (math.inf, {"low": 0, "exclusive_low": True}, "a finite number > 0"),
        (1.5, {"low": 0, "high": 1}, "a finite number >= 0 and <= 1"),
        (2.0, {"low": 2, "integer": True}, "an integer >= 2"),
        (None, {}, "a finite number"),
        (10**400, {"integer": True}, "an integer"),
    ],
)
def test_checked_numbers(value, bounds, allowed):
    with pytest.raises(InputError) as caught:
        check_number("x", value, **bounds)
    assert caught.value.allowed == allowed
    check_number("x", 1, 0, 1)
    check_number("x", 0.0, 0)
