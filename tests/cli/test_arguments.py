from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import pytest

from murmurate.cli.arguments import Parser
from murmurate.errors import InputError, UsageError
from murmurate.runs import config_io


@dataclass(frozen=True)
class Sizes:
    """Sizes of the world.

    Attributes:
        radius: The paper's R; 100% of it.
        safety: Reading of F_safe.
    """

    radius: float = 1.0
    safety: Literal["penalty", "shell"] = "penalty"


@dataclass(frozen=True)
class Network:
    """How velocities are chosen.

    Attributes:
        kind: Which policy.
        hidden: Widths of the layers.
    """

    kind: Literal["central", "equivariant"] = "equivariant"
    hidden: tuple[int, ...] = (400, 300)
    clip: float | None = None
    shared: bool = False


@dataclass(frozen=True)
class Experiment:
    """An experiment.

    Attributes:
        name: Its name.
        seed: Seed of all randomness.
    """

    name: str = "C"
    seed: int = 0
    world: Sizes = field(default_factory=Sizes)
    policy: Network = field(default_factory=Network)


@pytest.fixture
def parser():
    parser = Parser("discover", "EXPERIMENT", "Trains.")
    parser.add_argument("experiment", metavar="EXPERIMENT", help="Its name.")
    parser.add_argument("--out", metavar="DIR", help="Output folder.")
    parser.add_argument("--resume", action="store_true", help="Continue.")
    parser.add_argument("--count", type=int, metavar="INT", default=1)
    parser.add_fields(Experiment(), aliases={"policy.kind": "--policy"}, skip=["name"])
    return parser


def test_fields_and_own_arguments(parser):
    command_line = (
        "--world.radius 2 A --policy central --resume --seed=3 --policy.hidden 8,9 --policy.clip none --out here"
    )
    options, data = parser.parse(command_line.split())
    assert vars(options) == {"experiment": "A", "out": "here", "resume": True, "count": 1}
    assert data == {
        "seed": 3,
        "world": {"radius": 2.0},
        "policy": {"kind": "central", "hidden": (8, 9), "clip": None},
    }
    assert config_io.replaced(Experiment(), data).policy.hidden == (8, 9)


def test_nothing_given_is_nothing_replaced(parser):
    assert parser.parse(["A"])[1] == {}


@pytest.mark.parametrize("value", ["-1", "-1e-3", "-inf", "nan", "-.5"])
def test_negative_numbers_are_values(parser, value):
    radius = parser.parse(["A", "--world.radius", value])[1]["world"]["radius"]
    assert repr(radius) == repr(float(value))


@pytest.mark.parametrize(
    ("command_line", "line"),
    [
        ("A --world.radus 1", "unknown flag --world.radus; did you mean --world.radius? (see murmurate discover"),
        ("A --world.radus=1", "unknown flag --world.radus; did you mean --world.radius? (see murmurate discover"),
        ("A --radius 1", "unknown flag --radius; did you mean --world.radius? (see murmurate discover --help)"),
        ("A --name B", "unknown flag --name"),
        ("A --zzzzzzz", "unknown flag --zzzzzzz (see murmurate discover --help)"),
        ("A -x", "unknown flag -x"),
        ("A --world.rad 1", "unknown flag --world.rad; did you mean --world.radius?"),
        ("", "the following arguments are required: EXPERIMENT (see murmurate discover --help)"),
        ("A B", "unrecognized arguments: B"),
        ("A --world.radius", "--world.radius needs a value, such as --world.radius 1.0 (see murmurate discover"),
        ("A --world.radius --resume", "--world.radius needs a value, such as --world.radius 1.0"),
        ("A --policy.shared", "--policy.shared needs a value, such as --policy.shared true"),
        ("A --policy", "--policy.kind needs a value, such as --policy.kind equivariant"),
        ("A --out", "--out needs a value: --out DIR"),
        ("A --resume=1", "--resume takes no value"),
    ],
)
def test_usage_errors_are_one_line(parser, command_line, line, capsys):
    with pytest.raises(UsageError) as caught:
        parser.parse(command_line.split())
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("command_line", "line"),
    [
        ("A --world.radius big", "world.radius = 'big': must be a number"),
        ("A --policy centrl", "policy.kind = 'centrl': must be one of central, equivariant"),
        ("A --seed 1.5", "seed = '1.5': must be an integer"),
        ("A --policy.shared yes", "policy.shared = 'yes': must be true or false"),
        (
            "A --policy.hidden 32x16",
            "policy.hidden = '32x16': must be integers, separated by commas, such as 32,16",
        ),
        ("A --world.radius 1,2", "world.radius = '1,2': must be a number without commas, such as 1.2"),
        ("A --world.radius 1,2,3", "world.radius = '1,2,3': must be a number without commas, such as 123"),
        ("A --seed 1,000", "seed = '1,000': must be an integer without commas, such as 1000"),
        ("A --count x", "--count = 'x': must be an integer"),
    ],
)
def test_wrong_values_are_those_of_the_fields(parser, command_line, line):
    with pytest.raises(InputError) as caught:
        parser.parse(command_line.split())
    assert str(caught.value) == line


def test_help_is_grouped_with_defaults(parser, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    with pytest.raises(SystemExit) as stop:
        parser.parse(["--help"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    assert text.startswith("usage: murmurate discover EXPERIMENT [options]\n")
    for part in (
        "world:\n  Sizes of the world.\n",
        "--world.radius NUMBER",
        "The paper's R; 100% of it. (default: 1.0)",
        "--world.safety {penalty,shell}",
        "--policy.hidden INT,...",
        "(default: 400,300)",
        "--policy.clip NUMBER|none",
        "--policy.shared {true,false}",
    ):
        assert part in text
    assert "--name" not in text


def test_a_short_help_shows_everyday_flags_and_says_how_to_see_the_rest(capsys):
    parser = Parser("discover", "EXPERIMENT", "Trains.", everyday=("--out", "--policy", "--seed"))
    parser.add_argument("experiment", metavar="EXPERIMENT", help="Its name.")
    parser.add_argument("--out", metavar="DIR", help="Output folder.")
    parser.add_argument("--resume", action="store_true", help="Continue.")
    parser.add_fields(Experiment(), aliases={"policy.kind": "--policy"}, skip=["name"])
    shown = {}
    for flag in ("--help", "--help-all"):
        with pytest.raises(SystemExit) as stop:
            parser.parse([flag])
        assert stop.value.code == 0
        shown[flag] = " ".join(capsys.readouterr().out.split())
    for part in ("EXPERIMENT", "--out", "--policy", "--seed"):
        assert part in shown["--help"]
    for part in ("--resume", "--world.radius", "Sizes of the world.", "--policy.hidden"):
        assert part not in shown["--help"]
        assert part in shown["--help-all"]
    assert "All flags, one for every field of the configuration: murmurate discover --help-all" in shown["--help"]
    assert "All flags" not in shown["--help-all"]
