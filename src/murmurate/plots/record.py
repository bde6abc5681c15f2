"""What a finished run recorded, as plain arrays: no JAX, no policies, and nothing that a file could execute."""

from __future__ import annotations

import functools
import json
import os
import tomllib
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int

from murmurate import geometry
from murmurate.errors import InputError, RunError

__all__ = ["Episode", "Record", "Sizes", "Training"]

Parsed = TypeVar("Parsed")


@dataclass(frozen=True)
class Sizes:
    """The sizes of a world, world units: what a drawing to scale needs.

    Attributes:
        robots: The number N of robots.
        half_width: X; the world is |x| <= X.
        half_height: Y; the world is |y| <= Y.
        radius: The paper's R_bot.
        scan_radius: The paper's R_scan.
        safe_distance: The paper's delta_s, between centres.
    """

    robots: int
    half_width: float
    half_height: float
    radius: float
    scan_radius: float
    safe_distance: float


@dataclass(frozen=True)
class Training:
    """One policy's training, a value for each update.

    Attributes:
        name: The policy's name.
        environment_steps: Steps of the environment so far, over the whole run.
        signals: Mean of each signal over the states of the update's rollout, by name.
    """

    name: str
    environment_steps: Float[np.ndarray, " updates"]
    signals: Mapping[str, Float[np.ndarray, " updates"]]

    @property
    def objective(self) -> Float[np.ndarray, " updates"]:
        """The paper's C1 or C2, signals of equal weight: so the policies, each with its own weights, compare."""
        return np.sum(list(self.signals.values()), axis=0)


@dataclass(frozen=True)
class Episode:
    """One execution of the cascade, from its start to its end.

    Attributes:
        index: Its place in the run's evaluation.
        positions: Centres before the first step and after each step, world units.
        switches: The step at which each auxiliary policy took over, ascending.
        signals: Each signal by name, for every configuration.
        at_rest: Whether it came to rest, and did not end in a collision or at a time limit.
    """

    index: int
    positions: Float[np.ndarray, "configurations robots 2"]
    switches: tuple[int, ...]
    signals: Mapping[str, Float[np.ndarray, " configurations"]]
    at_rest: bool

    @property
    def outcome(self) -> str:
        """How it ended, in words."""
        return "at rest" if self.at_rest else "not at rest"

    @property
    def steps(self) -> int:
        """Formation steps, all policies together."""
        return len(self.positions) - 1

    @property
    def objective(self) -> Float[np.ndarray, " configurations"]:
        """The paper's C1 or C2 of every configuration, signals of equal weight."""
        return np.sum(list(self.signals.values()), axis=0)

    def policy_at(self, step: int) -> int:
        """Returns the place in the list of the policy that decides at `step`."""
        return int(np.searchsorted(self.switches, step, side="right"))


@dataclass(frozen=True, eq=False)
class Record:
    """A finished run folder, read for drawing.

    Attributes:
        path: The run folder.
        name: The experiment's name.
        objective: "C1" (gathering at the origin) or "C2" (no predefined point).
        sizes: The world's sizes.
        experiment: The whole of experiment.toml.
        evaluation: The whole of evaluation.json.
        manifest: The whole of manifest.json; empty where there is none.
        policies: The policies' names, in the order of the list.
        training: One curve for each policy that metrics.jsonl tells of.
        positions: Centres, held still after rest, world units.
        lengths: Formation steps of each episode.
        switch: The step at which each auxiliary policy took over.
        signals: Signals of every configuration, in the order of `signal_names`.
        signal_names: The signals' names.
        at_rest: Whether the episode came to rest.
    """

    path: Path
    name: str
    objective: str
    sizes: Sizes
    experiment: Mapping[str, Any]
    evaluation: Mapping[str, Any]
    manifest: Mapping[str, Any]
    policies: tuple[str, ...]
    training: tuple[Training, ...]
    positions: Float[np.ndarray, "episodes configurations robots 2"]
    lengths: Int[np.ndarray, " episodes"]
    switch: Int[np.ndarray, "episodes switches"]
    signals: Float[np.ndarray, "episodes configurations signals"]
    signal_names: tuple[str, ...]
    at_rest: Bool[np.ndarray, " episodes"]

    @classmethod
    def open(cls, run: str | os.PathLike[str]) -> Record:
        """Reads a finished run folder.

        Args:
            run: The folder that `murmurate discover` wrote.

        Returns:
            The record.

        Raises:
            RunError: The folder or one of its files is missing or malformed.
        """
        path = Path(run)
        if not path.is_dir():
            raise RunError(f"{path} is not a run folder: no such folder")
        experiment = _read(path, "experiment.toml", lambda file: tomllib.loads(file.read_text("utf-8")))
        evaluation = _read(path, "evaluation.json", _evaluation)
        manifest = _read(path, "manifest.json", _json_object) if (path / "manifest.json").exists() else {}
        sizes = _read(path, "experiment.toml", lambda _: _sizes(experiment))
        arrays = _read(path, "trajectories.npz", lambda file: _trajectories(file, sizes.robots))
        training = _read(path, "metrics.jsonl", lambda file: _training(file, arrays["signal_names"]))
        objective = experiment.get("objective")
        if objective not in ("C1", "C2"):
            raise RunError(f'{path / "experiment.toml"} is malformed: objective = {objective!r}, not "C1" or "C2"')
        names = [curve.name for curve in training]
        names += [f"policy {place}" for place in range(len(names), arrays["switch"].shape[1] + 1)]
        return cls(
            path=path,
            name=str(experiment.get("name", path.name)),
            objective=objective,
            sizes=sizes,
            experiment=experiment,
            evaluation=evaluation,
            manifest=manifest,
            policies=tuple(names),
            training=training,
            **arrays,
        )

    @functools.cached_property
    def valid(self) -> Bool[np.ndarray, " episodes"]:
        """Whether each episode ended in a valid pattern: at rest, collision-free, gathered, mutually visible, safe."""
        return np.array([bool(rest) and self._forms_pattern(index) for index, rest in enumerate(self.at_rest)])

    def _forms_pattern(self, index: int) -> bool:
        path = self.positions[index, : self.lengths[index] + 1]
        final, sizes = path[-1], self.sizes
        other = ~np.eye(sizes.robots, dtype=bool)
        seen = geometry.visible(final, sizes.radius, sizes.scan_radius)  # a robot seen is a neighbour as well
        safe = geometry.distances(final) >= sizes.safe_distance
        hit = geometry.any_contact(path[:-1], np.diff(path, axis=0), sizes.radius)
        return bool((seen & safe)[other].all() and not hit.any())

    def typical(self) -> int:
        """Returns the episode of median formation steps among the valid ones, or among all where none is valid."""
        candidates = np.flatnonzero(self.valid if self.valid.any() else np.ones_like(self.valid))
        order = candidates[np.argsort(self.lengths[candidates], kind="stable")]
        return int(order[(len(order) - 1) // 2])

    def episode(self, index: int | None = None) -> Episode:
        """Returns one episode, cut where it ended.

        Args:
            index: Its place in the evaluation; the typical one where None.

        Raises:
            InputError: There is no such episode.
        """
        index = self.typical() if index is None else index
        if not 0 <= index < len(self.lengths):
            raise InputError("episode", index, f"an integer from 0 to {len(self.lengths) - 1}")
        length = int(self.lengths[index])
        # A policy that never took over has no step of its own: its switch falls on the end.
        switches = np.maximum.accumulate(np.clip(self.switch[index], 0, length)).tolist()
        signals = {name: self.signals[index, : length + 1, place] for place, name in enumerate(self.signal_names)}
        return Episode(
            index=index,
            positions=self.positions[index, : length + 1],
            switches=tuple(switches),
            signals=signals,
            at_rest=bool(self.at_rest[index]),
        )


def _read(run: Path, name: str, parse: Callable[[Path], Parsed]) -> Parsed:
    """Parses one file of a run, turning whatever may be wrong with it into one line that names it."""
    file = run / name
    try:
        return parse(file)
    except FileNotFoundError as error:
        raise RunError(f"{run} is not a finished run: {name} is missing") from error
    except OSError as error:
        raise RunError(f"cannot read {file}: {error.strerror or error}") from error
    except KeyError as error:
        raise RunError(f"{file} is malformed: {error.args[0]} is missing") from error
    except (ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise RunError(f"{file} is malformed: {error}") from error


def _json_object(file: Path) -> dict[str, Any]:
    content = json.loads(file.read_text("utf-8"))
    if not isinstance(content, dict):
        raise ValueError("not a JSON object")
    return content


def _evaluation(file: Path) -> dict[str, Any]:
    content = _json_object(file)
    for name in ("episodes", "valid"):
        if type(content[name]) not in (int, float):
            raise ValueError(f"{name} = {content[name]!r} is not a number")
    return content


def _sizes(experiment: Mapping[str, Any]) -> Sizes:
    world = experiment["world"]
    if not isinstance(world, dict):
        raise ValueError("world is not a table")
    values = {name: _positive(world, name) for name in Sizes.__dataclass_fields__ if name != "robots"}
    robots = world["robots"]
    if type(robots) is not int or robots < 1:
        raise ValueError(f"world.robots = {robots!r} is not a number of robots")
    return Sizes(robots=robots, **values)


def _positive(world: Mapping[str, Any], name: str) -> float:
    value = world[name]
    if type(value) not in (int, float) or not value > 0:
        raise ValueError(f"world.{name} = {value!r} is not a positive number")
    return float(value)


def _training(file: Path, signal_names: tuple[str, ...]) -> tuple[Training, ...]:
    rows: dict[int, list[dict[str, Any]]] = {}
    for number, line in enumerate(file.read_text("utf-8").splitlines(), start=1):
        try:
            row = json.loads(line)
            rows.setdefault(row["policy"], []).append(row)
        except (json.JSONDecodeError, TypeError) as error:
            raise ValueError(f"line {number} is not a row of metrics") from error
    return tuple(_curve(rows[policy], signal_names) for policy in sorted(rows))


def _curve(rows: list[dict[str, Any]], signal_names: tuple[str, ...]) -> Training:
    return Training(
        name=str(rows[0]["name"]),
        environment_steps=np.array([row["environment_steps"] for row in rows], dtype=float),
        signals={name: np.array([row["signals"][name] for row in rows], dtype=float) for name in signal_names},
    )


def _trajectories(file: Path, robots: int) -> dict[str, Any]:
    names = ("positions", "lengths", "switch", "signals", "signal_names", "at_rest")
    # NumPy leaves a file open that turns out to be no archive: so this opens and closes it.
    with file.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in names}
    positions, lengths, signals = arrays["positions"], arrays["lengths"], arrays["signals"]
    if positions.ndim != 4 or positions.shape[2:] != (robots, 2) or 0 in positions.shape:
        raise ValueError(f"positions are {positions.shape}, not (episodes, steps + 1, {robots}, 2)")
    episodes, configurations = positions.shape[:2]
    shapes = {
        "lengths": (episodes,),
        "switch": (episodes, arrays["switch"].shape[-1] if arrays["switch"].ndim else 0),
        "signals": (episodes, configurations, len(np.atleast_1d(arrays["signal_names"]))),
        "at_rest": (episodes,),
    }
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise ValueError(f"{name} is {arrays[name].shape}, not {shape}")
    if not (np.isfinite(positions).all() and np.isfinite(signals).all()):
        raise ValueError("positions or signals are not finite")
    if lengths.min() < 0 or lengths.max() >= configurations:
        raise ValueError(f"lengths are not all from 0 to {configurations - 1}")
    return arrays | {
        "lengths": lengths.astype(int),
        "switch": arrays["switch"].astype(int),
        "at_rest": arrays["at_rest"].astype(bool),
        "signal_names": tuple(str(name) for name in np.atleast_1d(arrays["signal_names"])),
    }
