"""Wrong types at the public functions: an exception of this package, in one line that names the argument."""

from __future__ import annotations

import typing
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

import murmurate
from murmurate import analysis, discovery, plots, world
from murmurate.errors import InputError
from murmurate.interop import waypoints
from murmurate.runs import catalogues, comparison, evaluate, folder, sweep, table, train
from murmurate.runs.grid import Grid

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


@pytest.mark.parametrize("value", ["no", "false", "", 0, 1, None, np.True_])
def test_only_true_is_trust(value, finished):
    """Any other value could be true by chance, as the word "no" is: foreign code would be imported."""
    refused("trust", murmurate.load, finished, trust=value)
    refused("trust", murmurate.Run.open, finished, value)
    refused("trust", plots.Recording.open, finished, value)
    refused("trust", waypoints.Waypoints.from_run, finished, waypoints.Scale(), trust=value)
    refused("trust", catalogues.read_findings, finished, value)
    refused("trust", evaluate.evaluated, folder.RunFolder(finished), value)
    refused("trust", table.side_by_side, [finished], value)
    refused("trust", table.results, [finished], value)
    refused("resume", murmurate.discover, "C", out=finished, resume=value)


@pytest.mark.parametrize("value", WRONG)
def test_folders_and_files(value, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    experiment = murmurate.experiment("C")
    refused("folder", folder.RunFolder, value)
    refused("folder", plots.Recording.open, value)
    refused("folder", waypoints.Waypoints.from_run, value, 1.0)
    refused("folder", comparison.load, value)
    refused("folder", comparison.compare, comparison.Comparison(experiment), [], {}, value)
    refused("folder", catalogues.read_findings, value)
    refused("folder", catalogues.check_target, value)
    refused("folder", train.discover, experiment, value)
    refused("out", sweep.sweep, Grid({"a": experiment}), value)
    refused("path", Grid.from_toml, value)
    refused("path", plots.save, Figure(), value)
    refused("path", world.read_starts, value, 3)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("value", [*WRONG, np.zeros(3)])
def test_what_is_drawn_and_measured(value, run):
    config, starts = run.experiment.world, np.zeros((1, 3, 2))
    for figure in (plots.discovery_figure, plots.formation_figure, plots.training_figure, plots.reward_figure):
        refused("recording", figure, value)
    refused("recording", plots.animate, value, "x.gif")
    refused("figure", plots.save, value, "x.png")
    refused("experiment", plots.Recording, value, value)
    refused("trajectories", plots.Recording, run.experiment, value)
    refused("recordings", plots.patterns_figure, [value], ["a"])
    refused("rows", plots.comparison_figure, [3, value])
    refused("patterns", plots.plate_figure, [value], "")
    refused("positions", plots.PlatePattern, value, 1.0, 9.0, "")
    refused("trajectories", murmurate.check_validity, value, config)
    refused("findings", analysis.Catalogue.from_findings, [value])
    refused("positions", world.Configuration, value, config)
    refused("positions", murmurate.Configuration, np.zeros((1, 3, 2)), config)
    refused("world", world.Configuration, np.zeros((3, 2)), value)
    refused("config", murmurate.World.create, value, world.UniformStart())
    refused("start", murmurate.World.create, config, value)
    refused("start", world.draw_starts, value, 0, 1, config)
    refused("start", world.check_start, value, config)
    refused("world", world.scaled_to, value, 3)
    refused("objective", world.objective_signals, value)
    refused("problem", discovery.build_cascade, value, ())
    refused("problem", discovery.Search, value)
    refused("cascade", discovery.rollout, value, starts)
    refused("starts", discovery.rollout, run.cascade, value)
    refused("start", discovery.bound_steps, value, starts[0], 1.0)
    refused("starts", run.cascade.rollout, value)


@pytest.mark.parametrize("value", ["x", 3, [1]])
def test_functions(value, run):
    refused("on_chunk", run.rollout, 2, 0, value)
    refused("on_chunk", run.cascade.rollout, np.zeros((1, 3, 2)), 0, value)
    refused("on_progress", murmurate.evaluate, run, on_progress=value)


@pytest.mark.parametrize("value", ["4", None, [1], True, 1j, object(), {}])
def test_worlds(value):
    for name in murmurate.WorldConfig.__dataclass_fields__:
        if name == "bounded" and value is True:
            continue
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


@pytest.mark.parametrize("path", ["a" * 5000, "a" * 300, "b/" * 3000, "a\0b"])
def test_names_that_no_file_can_have(path, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused("folder", murmurate.load, path)
    refused("folder", murmurate.load, tmp_path / path)
    refused("folder", run.save, path)
    refused("out", murmurate.discover, "C", out=path)
    refused("path", world.read_starts, path, 3)
    refused("path", plots.save, Figure(), path)
    assert not any(tmp_path.iterdir())


def test_what_validity_is_judged_by():
    config, rest, steps = murmurate.WorldConfig(robots=3), np.ones(1, bool), np.zeros(1, int)
    points = np.zeros((1, 1, 3, 2), np.float32)
    good = murmurate.Trajectories(points, steps, np.zeros((1, 0), int), rest, ~rest, {}, steps)
    for positions in (points.tolist(), points.astype(object), points.astype(str), points.astype(complex)):
        refused("trajectories.positions", murmurate.check_validity, replace(good, positions=positions), config)
        refused("trajectories.after_rest", murmurate.check_validity, replace(good, after_rest=positions), config)
    for value in ([True], np.array([0.5]), np.array([1]), None):
        refused("trajectories.at_rest", murmurate.check_validity, replace(good, at_rest=value), config)
    for thresholds in (3, ["a"], 0):
        refused("thresholds", murmurate.check_validity, good, config, thresholds)
    signal = world.objective_signals("C2")["visible"]
    for pair in (3, (signal, "x"), (0.5, signal), (signal,), (signal, True)):
        refused("thresholds['a']", murmurate.check_validity, good, config, {"a": pair})


@pytest.mark.parametrize(("dtype", "value"), [(np.float32, 1e20), (np.float64, 1e160), (np.float64, np.inf)])
def test_a_configuration_whose_squares_overflow(dtype, value):
    points = np.full((3, 2), value, dtype)
    refused("positions", murmurate.Configuration, points, murmurate.WorldConfig(robots=3))
