"""Wrong types at the public functions: an exception of this package, in one line that names the argument."""

from __future__ import annotations

import typing

import numpy as np
import pytest

import murmurate
from murmurate.errors import InputError

pytestmark = pytest.mark.unchecked

WRONG = [3, None, b"x", object(), ["a"], {}, 1.5]


@pytest.fixture(scope="module")
def run():
    return murmurate.pretrained().of_size(3)


def refused(field, call, *arguments, **named):
    with pytest.raises(InputError) as caught:
        call(*arguments, **named)
    assert "\n" not in str(caught.value)
    assert caught.value.field == field


@pytest.mark.parametrize("name", [name for name in murmurate.__all__ if callable(getattr(murmurate, name))])
def test_type_hints_can_be_resolved(name):
    typing.get_type_hints(getattr(murmurate, name))


def test_type_hints_are_the_classes():
    assert typing.get_type_hints(murmurate.load)["return"] is murmurate.Run
    assert murmurate.ExperimentConfig in typing.get_args(typing.get_type_hints(murmurate.discover)["experiment"])


@pytest.mark.parametrize("value", WRONG)
def test_paths_and_experiments(value, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused("folder", murmurate.load, value)
    refused("folder", murmurate.Run.open, value)
    refused("folder", run.save, value)
    refused("experiment", murmurate.discover, value)
    refused("experiment", murmurate.experiment, value)
    if value is not None:
        refused("out", murmurate.discover, "C", out=value)
        refused("on_progress", murmurate.discover, "C", on_progress=value)
    for name in ("objective", "sensing", "scheduler"):
        refused(name, murmurate.pretrained, **{name: value})
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("value", ["4", None, [1], True, 1j, object(), {}])
def test_worlds(value):
    for name in (field for field in murmurate.WorldConfig.__dataclass_fields__):
        refused(name, murmurate.WorldConfig, **{name: value})
    refused("world.robots", murmurate.experiment, "C", **{"world.robots": value})


@pytest.mark.parametrize("value", ["x", None, 1.5, -1, True, [], object(), np.zeros(3), np.zeros((2, 2), np.uint32)])
def test_keys(value, run):
    refused("seed" if not isinstance(value, np.ndarray) else "key", run.rollout, 2, key=value)
    refused("seed" if not isinstance(value, np.ndarray) else "key", run.starts, 2, value)
    refused("seed" if not isinstance(value, np.ndarray) else "key", murmurate.evaluate, run, 2, value)


@pytest.mark.parametrize("value", ["x", None, 1.5, True, object(), {}, np.zeros((2, 3))])
def test_starts_and_sizes(value, run):
    refused("starts", run.rollout, value)
    refused("robots", run.of_size, value)
    refused("experiment", run.under, value)
    refused("run", murmurate.evaluate, value)


@pytest.mark.parametrize("value", ["x", None, 1.5, object()])
def test_episodes(value, run):
    refused("episodes", run.starts, value)
