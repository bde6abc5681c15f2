"""What a sweep asks for: a TOML file of experiments, learners, seeds and fields, and the runs that it stands for.

A file is one block, or several under `[[runs]]`, each of which says only what it has of its own. A block stands for
every combination of its experiments, learners, grid and seeds.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from murmurate.discovery import Search
from murmurate.errors import InputError, RunError, check_choice, suggestion
from murmurate.runs import config_io, presets, storage
from murmurate.runs.experiment import ExperimentConfig, check_same, check_seed, save
from murmurate.runs.paper import EXPERIMENTS

__all__ = ["MOST", "Sweep", "check", "lay_out", "read_sweep"]

MOST = 10_000
"""Runs of a sweep, at most."""

_KEYS = ("experiments", "learners", "seeds", "fields", "grid")
_RUNS = "runs"
_LONGEST = 160
"""Letters of a run's name, at most: file systems allow 255 bytes."""


@dataclass(frozen=True)
class Sweep:
    """The runs that a file stands for.

    Attributes:
        runs: Experiments, by the names of their run folders.
        swept: Dotted paths of the fields in which runs were told to differ.
    """

    runs: Mapping[str, ExperimentConfig]
    swept: tuple[str, ...]


@dataclass(frozen=True)
class _Block:
    """One block of a file, checked.

    Attributes:
        experiments: A to F, or TOML files.
        learners: Whose numbers; None for those of the experiment's policy.
        seeds: Seeds; None for that of the experiment.
        common: Fields that the whole file replaces, by dotted path.
        own: Fields that this block alone replaces.
        grid: Fields and the values that they take in turn.
    """

    experiments: tuple[str, ...]
    learners: tuple[str | None, ...]
    seeds: tuple[int | None, ...]
    common: Mapping[str, Any]
    own: Mapping[str, Any]
    grid: Mapping[str, Sequence[Any]]

    @property
    def size(self) -> int:
        """How many runs it stands for."""
        parts = (self.experiments, self.learners, self.seeds, *self.grid.values())
        return math.prod(map(len, parts))

    def runs(self) -> Iterator[tuple[str, ExperimentConfig]]:
        """Yields its runs by name; seeds of the same experiment follow each other."""
        combinations = itertools.product(*self.grid.values())
        for experiment, learner, values in itertools.product(self.experiments, self.learners, list(combinations)):
            told = {**self.own, **dict(zip(self.grid, values, strict=True))}
            config = _made(experiment, learner, {**self.common, **told})
            for seed in self.seeds:
                seeded = config if seed is None else replace(config, seed=seed)
                yield _name(seeded, learner, told), seeded


def read_sweep(path: str | Path) -> Sweep:
    """Reads a file of runs, and makes sure that every one of them is possible; nothing is written.

    Files that it names are relative to it.

    Raises:
        InputError: A key, field or value is unknown or not allowed, a run comes twice, or there are none.
        OSError: A file cannot be read.
    """
    path = Path(path)
    blocks = _blocks(config_io.load_toml(path), path.parent)
    if not 1 <= (count := sum(block.size for block in blocks)) <= MOST:
        raise InputError(_RUNS, count, f"1 to {MOST}")
    runs: dict[str, ExperimentConfig] = {}
    for name, config in itertools.chain.from_iterable(block.runs() for block in blocks):
        if name in runs:
            other = "told apart by a name: two that differ would have this folder"
            raise InputError(_RUNS, name, "there once, not twice" if runs[name] == config else other)
        runs[name] = config
    _check_different(runs)
    return Sweep(runs, tuple(dict.fromkeys(field for block in blocks for field in (*block.own, *block.grid))))


def check(sweep: Sweep, out: Path) -> list[str]:
    """Makes sure that a folder is empty, or holds these very runs, of a sweep before, and no others; writes nothing.

    Returns:
        The names of the runs that it does not hold yet.

    Raises:
        RunError: A run folder holds another experiment, or one that the sweep does not name, or cannot be read.
    """
    with storage.os_errors_as_run_errors(f"cannot write to {out}"):
        inside = sorted(out.iterdir()) if out.exists() else []
    if any(path.name in (storage.EXPERIMENT, storage.MANIFEST) for path in inside):
        raise RunError(f"{out} holds a run itself: choose another --out")
    seen = [path.name for path in inside if not path.name.startswith(".")]
    if seen and not any(name in sweep.runs for name in seen):
        raise RunError(f"{out} is not empty, and holds no run of this sweep: choose another --out")
    others = [path.name for path in inside if path.name not in sweep.runs and (path / storage.EXPERIMENT).exists()]
    if others:
        more = f" and {len(others) - 1} more" if len(others) > 1 else ""
        raise RunError(f"{out} holds runs that the sweep does not name: {others[0]}{more}; choose another --out")
    new = [name for name in sweep.runs if storage.look(out / name, resume=True) == "new"]
    for name in sweep.runs.keys() - set(new):
        check_same(sweep.runs[name], out / name)
    return new


def lay_out(sweep: Sweep, out: Path) -> dict[str, Path]:
    """Creates the folder of every run, with its experiment: all that a worker need know.

    Returns:
        The run folders by name.

    Raises:
        RunError: See `check`; or a folder cannot be written to.
    """
    for name in check(sweep, out):
        storage.claim(out / name, resume=True)
        save(sweep.runs[name], out / name)
    return {name: out / name for name in sweep.runs}


def _blocks(data: Mapping[str, Any], folder: Path) -> list[_Block]:
    """Reads the blocks of a file; what stands outside of `[[runs]]` holds for all of them."""
    _check_keys(data, (*_KEYS, _RUNS), "")
    common = {name: value for name, value in data.items() if name != _RUNS}
    if _RUNS not in data:
        return [_block(common, {}, folder, "")]
    entries = data[_RUNS]
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, Mapping) for entry in entries):
        raise InputError(_RUNS, entries, "one or more tables, each under [[runs]]")
    return [_block(common, entry, folder, f"runs[{place}].") for place, entry in enumerate(entries, 1)]


def _block(common: Mapping[str, Any], own: Mapping[str, Any], folder: Path, where: str) -> _Block:
    """Checks one block: its own words win over those that are common to all."""
    _check_keys(own, _KEYS, where)
    where_of = {name: f"{where if name in own else ''}{name}" for name in _KEYS}
    data = {**common, **own}
    shared, told = (_leaves(part.get("fields", {}), folder, at) for part, at in ((common, ""), (own, where)))
    grid = _grid(common.get("grid", {}), folder, "")
    _check_once(grid, shared, "")
    grid |= _grid(own.get("grid", {}), folder, where)
    _check_once(grid, told, where)
    words = _listed(data.get("experiments"), where_of["experiments"], 'such as ["A", "B"]')
    return _Block(
        experiments=tuple(_experiment(word, folder, where_of["experiments"]) for word in words),
        learners=_learners(data["learners"], where_of["learners"]) if "learners" in data else (None,),
        seeds=_seeds(data["seeds"], where_of["seeds"]) if "seeds" in data else (None,),
        common={path: value for path, value in shared.items() if path not in told},
        own=told,
        grid=grid,
    )


def _check_once(grid: Mapping[str, Any], told: Mapping[str, Any], where: str) -> None:
    if both := grid.keys() & told.keys():
        raise InputError(f"{where}fields.{min(both)}", told[min(both)], "left out: the grid says which values it takes")


def _check_keys(data: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    for name, value in data.items():
        if name not in known:
            raise InputError(f"{where}{name}", value, f"one of {', '.join(known)}{_hint(name, known)}")


def _hint(name: str, known: Sequence[str]) -> str:
    """Suggests a key, or says where a field of the experiment belongs."""
    sections = {leaf.path.partition(".")[0] for leaf in config_io.leaves(presets.preset("A"))} - {"seed"}
    return suggestion(name, known) or ("; fields of the experiment go under [fields]" if name in sections else "")


def _listed(value: Any, where: str, example: str) -> list[Any]:
    if not isinstance(value, list) or not value:
        raise InputError(where, value, f"a list with one or more values, {example}")
    return value


def _experiment(word: Any, folder: Path, where: str) -> str:
    """Finds an experiment: one of the paper's, or a file relative to the sweep's."""
    if word in EXPERIMENTS:
        return word
    if isinstance(word, str) and word.endswith(".toml") and (folder / word).is_file():
        return str(folder / word)
    allowed = f"one of {', '.join(EXPERIMENTS)}, or a TOML file, relative to the sweep's"
    raise InputError(where, word, allowed + suggestion(str(word).upper(), EXPERIMENTS))


def _learners(value: Any, where: str) -> tuple[str, ...]:
    names = _listed(value, where, 'such as ["equivariant", "central"]')
    for name in names:
        check_choice(where, name, tuple(presets.TRAINING_PRESETS))
    return tuple(names)


def _seeds(value: Any, where: str) -> tuple[int, ...]:
    if type(value) is int and 1 <= value <= MOST:
        return tuple(range(value))
    if not isinstance(value, list) or not value:
        raise InputError(where, value, f"how many (1 to {MOST}), or a list of seeds, such as [0, 1, 5]")
    for seed in value:
        check_seed(seed)
    return tuple(value)


def _grid(data: Any, folder: Path, where: str) -> dict[str, list[Any]]:
    values = _leaves(data, folder, where, "grid")
    return {path: _listed(one, f"{where}grid.{path}", "that the field takes in turn") for path, one in values.items()}


def _leaves(data: Any, folder: Path, where: str, table: str = "fields") -> dict[str, Any]:
    """Returns fields by their dotted paths, which may be written as nested tables as well; files become findable."""
    if not isinstance(data, Mapping):
        raise InputError(f"{where}{table}", data, "a table of fields of the experiment")
    known = [leaf.path for leaf in config_io.leaves(presets.preset("A"))]
    found = dict(_flat(data))
    for path, value in found.items():
        if path == "seed":
            raise InputError(f"{where}{table}.seed", value, "left out: seeds says which")
        if path not in known:
            raise InputError(f"{where}{table}.{path}", value, f"a field of the experiment{suggestion(path, known)}")
        if path == "start.file":
            found[path] = [_found(one, folder) for one in value] if isinstance(value, list) else _found(value, folder)
    return found


def _flat(data: Mapping[str, Any], where: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in data.items():
        path = f"{where}.{name}" if where else name
        if isinstance(value, Mapping):
            yield from _flat(value, path)
        else:
            yield path, value


def _found(file: Any, folder: Path) -> Any:
    return str(folder / file) if file and isinstance(file, str) else file


def _made(experiment: str, learner: str | None, told: Mapping[str, Any]) -> ExperimentConfig:
    """Puts an experiment together, and makes sure that its world is possible."""
    try:
        config = presets.resolve(experiment, config_io.nested(told), learner=learner)
        Search(config)
    except InputError as error:
        raise InputError(error.field, error.value, f"{error.allowed} (in experiment {experiment})") from None
    return config


def _name(config: ExperimentConfig, learner: str | None, told: Mapping[str, Any]) -> str:
    """Names a run's folder by all in which it was told to be different."""
    values = {leaf.path: leaf.value for leaf in config_io.leaves(config)}
    parts = [config.name, learner or config.policy.name, f"seed{config.seed}"]
    parts += [f"{path}={config_io.spelled(values[path])}" for path in told]
    name = re.sub(r"[^\w.,+=-]+", "_", "-".join(parts))
    if len(name) <= _LONGEST:
        return name
    return f"{name[:_LONGEST]}-{hashlib.sha256('-'.join(parts).encode()).hexdigest()[:8]}"


def _check_different(runs: Mapping[str, ExperimentConfig]) -> None:
    """Refuses to train the same twice, under whatever names."""
    first: dict[ExperimentConfig, str] = {}
    for name, config in runs.items():
        if (other := first.setdefault(config, name)) != name:
            raise InputError(_RUNS, name, f"different from {other}: they are the same experiment")
