"""Grids: many experiments, each with a name, to be trained in folders of these names.

A grid is the product of base experiments, training presets, values of fields and seeds, or a list of such products. It
is written in Python, as a TOML file, or as flags of the command line. Every experiment of a grid is checked when the
grid is made: nothing is written until all of them are possible.
"""

from __future__ import annotations

import functools
import hashlib
import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from murmurate import prng
from murmurate.discovery import build_world, check_parts
from murmurate.errors import InputError, RunError, check_choice, check_number, check_path, suggestion
from murmurate.runs import config_io, files, presets
from murmurate.runs.experiment import ExperimentConfig, check_seed
from murmurate.runs.folder import FolderState, RunFolder
from murmurate.runs.paper import EXPERIMENTS
from murmurate.runs.problems import PROBLEMS

__all__ = ["MAX_RUNS", "Grid", "run_name"]

MAX_RUNS = 10_000
MAX_NAME = 160
"""Characters of a run's name, at most: file systems allow 255 bytes."""

KEYS = ("experiments", "learners", "seeds", "fields", "grid")
BLOCKS = "runs"


@dataclass(frozen=True)
class Grid:
    """Named experiments.

        Grid.product(["A", "my.toml"], seeds=3, axes={"world.safe_distance": [5.0, 6.0]})
        Grid.from_toml("many.toml")
        Grid({"first": config, "second": other})

    Attributes:
        runs: The experiments by the names of their run folders.
        varied: Dotted paths of the fields that the grid varies.

    Raises:
        InputError: There is no run, too many, or the same experiment under two names.
    """

    runs: Mapping[str, ExperimentConfig]
    varied: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        _check_size(len(self.runs))
        names: dict[str, str] = {}
        for name, config in self.runs.items():
            other = names.setdefault(repr(config_io.to_dict(config)), name)
            if other != name:
                raise InputError(BLOCKS, name, f"different from {other}: they are the same experiment")

    def __len__(self) -> int:
        return len(self.runs)

    def __repr__(self) -> str:
        varied = f", varied: {', '.join(self.varied)}" if self.varied else ""
        return f"Grid({len(self)} runs{varied})"

    def __add__(self, other: Grid) -> Grid:
        """Returns the grid of both grids' runs.

        Raises:
            InputError: A name or an experiment is in both.
        """
        for name in self.runs.keys() & other.runs.keys():
            same = self.runs[name] == other.runs[name]
            raise InputError(BLOCKS, name, "there once, not twice" if same else "the name of one run, not of two")
        return Grid({**self.runs, **other.runs}, tuple(dict.fromkeys((*self.varied, *other.varied))))

    @classmethod
    def product(
        cls,
        experiments: Sequence[str | Path | ExperimentConfig],
        *,
        learners: Sequence[str | None] = (None,),
        seeds: int | Sequence[int] | None = None,
        fields: Mapping[str, Any] | None = None,
        axes: Mapping[str, Sequence[Any]] | None = None,
        folders: Sequence[Path] = (),
    ) -> Grid:
        """Returns every combination of experiments, training presets, values of fields, and seeds.

        Args:
            experiments: A to F, problems of the package, TOML files, or experiments.
            learners: Training presets by name; None for that of the experiment's policy.
            seeds: How many seeds, from 0 on, or which; None for that of each experiment.
            fields: Fields to replace in all experiments, by dotted path.
            axes: Fields and the values that they take in turn, by dotted path. Names of runs show them.
            folders: Folders in which the modules of strategies "module:Class" are looked for.

        Raises:
            InputError: A name, field or value is unknown or not allowed, or a combination comes twice.
        """
        axes = axes or {}
        chosen: Sequence[int | None] = (None,) if seeds is None else _seeds(seeds, "seeds")
        _check_size(_size(experiments, learners, chosen, axes=axes))
        combinations = [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]
        runs: dict[str, ExperimentConfig] = {}
        varied: dict[str, None] = {}
        checked: set[str] = set()
        for experiment, learner, values in itertools.product(experiments, learners, combinations):
            config = _build(experiment, learner, {**(fields or {}), **values}, folders, checked)
            for seed in chosen:
                run = config if seed is None else replace(config, seed=seed)
                leaves = {leaf.path: leaf.value for leaf in config_io.leaves(run)}
                name = _name(run, learner, {path: leaves.get(path, value) for path, value in values.items()})
                if name in runs:
                    allowed = "there once, not twice" if runs[name] == run else "the name of one run, not of two"
                    raise InputError(BLOCKS, name, allowed)
                runs[name] = run
                # An axis may be a section, such as a start with all its fields.
                varied |= {leaf: None for path in values for leaf in leaves if f"{leaf}.".startswith(f"{path}.")}
        return cls(runs, tuple(varied))

    @classmethod
    def from_toml(cls, path: str | Path) -> Grid:
        """Reads a grid from a TOML file; files that it names are relative to it.

        The file is one product, or several under [[runs]]: what stands above those holds for all of them.

        Raises:
            InputError: A key, field or value is unknown or not allowed, a run comes twice, or there is none.
            OSError: A file cannot be read.
        """
        check_path("path", path)
        path = Path(path)
        blocks = _blocks(config_io.load_toml(path), path.parent)
        _check_size(sum(_size(**block) for block in blocks))
        products = [cls.product(**block, folders=[path.parent]) for block in blocks]
        return sum(products[1:], products[0])

    @classmethod
    def from_flags(
        cls,
        config: ExperimentConfig,
        prefix: str,
        seeds: int,
        vary: Sequence[str],
        build: Callable[[Mapping[str, Any]], ExperimentConfig] | None = None,
    ) -> Grid:
        """Returns seeds of one experiment, with every combination of values of fields.

        Args:
            config: The experiment, with the first of the seeds.
            prefix: What names of runs begin with.
            seeds: How many seeds.
            vary: Fields and their values, each as `FIELD=VALUE,...`.
            build: Returns the experiment with fields replaced; by default `config` has them replaced.

        Raises:
            InputError: A field is unknown, or a value is not allowed.
        """
        build = functools.partial(presets.resolve, config) if build is None else build
        check_number("--seeds", seeds, 1, MAX_RUNS, integer=True)
        if config.seed + seeds - 1 > prng.MAX_SEED:
            limit = prng.MAX_SEED - config.seed + 1
            raise InputError("--seeds", seeds, f"at most {limit}: seeds end at {prng.MAX_SEED}")
        leaves = {leaf.path: leaf for leaf in config_io.leaves(config)}
        axes: dict[str, list[str]] = {}
        for text in vary:
            path, equals, values = text.partition("=")
            if path not in leaves or path == "seed":
                allowed = f"FIELD=VALUE,... with a field of the experiment{suggestion(path, leaves)}"
                raise InputError("--vary", text, allowed)
            axes[path] = [value.strip() for value in values.split(",")]
            if not equals or not all(axes[path]) or len(set(axes[path])) < len(axes[path]):
                raise InputError("--vary", text, "FIELD=VALUE,... with one or more values, none of them twice")
        _check_size(seeds * math.prod(map(len, axes.values())))
        runs: dict[str, ExperimentConfig] = {}
        for seed, texts in itertools.product(
            range(config.seed, config.seed + seeds), itertools.product(*axes.values())
        ):
            chosen = dict(zip(axes, texts, strict=True))
            values = {path: config_io.parse(leaves[path].kind, text, path) for path, text in chosen.items()}
            labels = [f"{path.rpartition('.')[2]}{text}" for path, text in chosen.items()]
            name = run_name(prefix, f"seed{seed}", *labels)
            if name in runs:
                raise InputError("--vary", vary, f"values that name different runs, not {name} twice")
            runs[name] = replace(build(config_io.nested(values)), seed=seed)
        return cls(runs, tuple(axes))

    def check(self, out: str | Path, *, resume: bool = True, exclusive: bool = False) -> dict[str, FolderState]:
        """Checks that the runs can be trained in a folder, or continued there; writes nothing.

        Args:
            out: The folder of the run folders.
            resume: Continue runs that the folder holds.
            exclusive: The folder is for this grid alone: other runs in it are refused.

        Returns:
            What each run folder holds, by name.

        Raises:
            RunError: A run folder holds another experiment, cannot be read, or is not one of this grid.
        """
        out = Path(out)
        if exclusive:
            self._check_alone(out)
        states: dict[str, FolderState] = {
            name: RunFolder(files.inside(out, name)).inspect(resume) for name in self.runs
        }
        for name, config in self.runs.items():
            if states[name] != "new":
                RunFolder(out / name).check_same(config)
        return states

    def _check_alone(self, out: Path) -> None:
        with files.os_errors_as_run_errors(f"cannot write to {out}"):
            inside = sorted(out.iterdir()) if out.exists() else []
        if RunFolder(out).holds_run():
            raise RunError(f"{out} holds a run itself: choose another --out")
        visible = [path.name for path in inside if not path.name.startswith(".")]
        if visible and not any(name in self.runs for name in visible):
            raise RunError(f"{out} is not empty, and holds no run of this sweep: choose another --out")
        others = [path.name for path in inside if path.name not in self.runs and RunFolder(path).holds_run()]
        if others:
            more = f" and {len(others) - 1} more" if len(others) > 1 else ""
            raise RunError(f"{out} holds runs that the sweep does not name: {others[0]}{more}; choose another --out")


def _check_size(count: int) -> None:
    if not 1 <= count <= MAX_RUNS:
        raise InputError(BLOCKS, count, f"1 to {MAX_RUNS}")


def _size(
    experiments: Sequence[Any],
    learners: Sequence[Any],
    seeds: Sequence[Any] | None,
    axes: Mapping[str, Sequence[Any]],
    fields: Any = None,
) -> int:
    return math.prod(map(len, (experiments, learners, seeds or (None,), *axes.values())))


def _build(
    experiment: str | Path | ExperimentConfig,
    learner: str | None,
    values: Mapping[str, Any],
    folders: Sequence[Path],
    checked: set[str],
) -> ExperimentConfig:
    """Builds one experiment, and checks that it is possible.

    Raises:
        InputError: A field or value is unknown or not allowed.
    """
    try:
        if learner is not None and isinstance(experiment, ExperimentConfig):
            raise InputError("learners", learner, "left out: the experiment has its training preset already")
        config = presets.resolve(experiment, config_io.nested(values), learner=learner, folders=folders)
        build_world(config)
        # A user's own strategies are evaluated, once for all runs that have the same.
        foreign = repr([config_io.to_dict(part) for _, part in config_io.strategies(config) if part.is_foreign()])
        if foreign not in ("[]", *checked):
            check_parts(config)
            checked.add(foreign)
    except InputError as error:
        name = experiment.name if isinstance(experiment, ExperimentConfig) else experiment
        raise InputError(error.field, error.value, f"{error.allowed} (in experiment {name})") from None
    return config


def _name(config: ExperimentConfig, learner: str | None, values: Mapping[str, Any]) -> str:
    """Names a run by its experiment, training preset and seed, and by the values of the axes."""
    parts = [config.name, learner or config.policy.name, f"seed{config.seed}"]
    return run_name(*parts, *(f"{path}={_text(value)}" for path, value in values.items()))


def run_name(*parts: str) -> str:
    """Returns the name of a run and its folder: its parts, with _ for what file systems may refuse."""
    text = "-".join(parts)
    name = re.sub(r"[^\w.,+=-]+", "_", text)
    return name if len(name) <= MAX_NAME else f"{name[:MAX_NAME]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def _text(value: Any) -> str:
    """Writes a value of an axis, which may be a table of fields."""
    if isinstance(value, Mapping):
        return "+".join(f"{_text(entry)}" for entry in value.values())
    return config_io.spelled(tuple(value) if isinstance(value, list) else value)


# The TOML file


def _blocks(data: Mapping[str, Any], folder: Path) -> list[dict[str, Any]]:
    """Returns the arguments of `Grid.product` for every block of a file."""
    _check_keys(data, (*KEYS, BLOCKS), "")
    common = {name: value for name, value in data.items() if name != BLOCKS}
    if BLOCKS not in data:
        return [_block(common, {}, folder, "")]
    entries = data[BLOCKS]
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, Mapping) for entry in entries):
        raise InputError(BLOCKS, entries, "one or more tables, each under [[runs]]")
    return [_block(common, entry, folder, f"{BLOCKS}[{number}].") for number, entry in enumerate(entries, 1)]


def _block(common: Mapping[str, Any], block: Mapping[str, Any], folder: Path, where: str) -> dict[str, Any]:
    """Returns the arguments of `Grid.product` for one block: its own keys win over those that are common to all."""
    _check_keys(block, KEYS, where)
    path_of = {name: f"{where if name in block else ''}{name}" for name in KEYS}
    data = {**common, **block}
    shared, fields = _fields(common, "fields", folder, ""), _fields(block, "fields", folder, where)
    axes = _axes(common, shared, folder, "")
    axes |= _axes(block, fields, folder, where)
    experiments = _list(data.get("experiments"), path_of["experiments"], 'such as ["A", "B"]')
    learners: Sequence[str | None] = (None,)
    if "learners" in data:
        learners = _list(data["learners"], path_of["learners"], 'such as ["equivariant", "central"]')
        for name in learners:
            check_choice(path_of["learners"], name, tuple(presets.TRAINING_PRESETS))
    return {
        "experiments": [_experiment(word, folder, path_of["experiments"]) for word in experiments],
        "learners": learners,
        "seeds": _seeds(data["seeds"], path_of["seeds"]) if "seeds" in data else None,
        "fields": {path: value for path, value in shared.items() if path not in fields},
        # A field of the block's own tells its runs from those of other blocks, as an axis of one value does.
        "axes": {path: [value] for path, value in fields.items()} | axes,
    }


def _check_keys(data: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    sections = {leaf.path.partition(".")[0] for leaf in config_io.leaves(presets.preset("A"))} - {"seed"}
    for name, value in data.items():
        if name not in known:
            hint = "; fields of the experiment go under [fields]" if name in sections else ""
            hint = suggestion(name, known) or hint
            raise InputError(f"{where}{name}", value, f"one of {', '.join(known)}{hint}")


def _list(value: Any, where: str, example: str) -> list[Any]:
    if not isinstance(value, list) or not value:
        raise InputError(where, value, f"a list with one or more values, {example}")
    return value


def _experiment(word: Any, folder: Path, where: str) -> str:
    """Returns an experiment of the paper, a problem, or the path of a TOML file relative to the sweep's."""
    if word in EXPERIMENTS or word in PROBLEMS:
        return word
    if isinstance(word, str) and word.endswith(".toml") and (folder / word).is_file():
        return str(folder / word)
    allowed = f"one of {', '.join((*EXPERIMENTS, *PROBLEMS))}, or a TOML file, relative to the sweep's"
    raise InputError(where, word, allowed + suggestion(str(word).upper(), EXPERIMENTS))


def _seeds(value: Any, where: str) -> tuple[int, ...]:
    if type(value) is int and 1 <= value <= MAX_RUNS:
        return tuple(range(value))
    if not isinstance(value, list | tuple | range) or not value:
        raise InputError(where, value, f"how many (1 to {MAX_RUNS}), or a list of seeds, such as [0, 1, 5]")
    for seed in value:
        check_seed(seed)
    return tuple(value)


def _axes(data: Mapping[str, Any], fields: Mapping[str, Any], folder: Path, where: str) -> dict[str, list[Any]]:
    axes = _fields(data, "grid", folder, where)
    for path in axes.keys() & fields.keys():
        allowed = "left out: the grid says which values it takes"
        raise InputError(f"{where}fields.{path}", fields[path], allowed)
    return {path: _list(values, f"{where}grid.{path}", "that the field takes in turn") for path, values in axes.items()}


def _fields(data: Mapping[str, Any], table: str, folder: Path, where: str) -> dict[str, Any]:
    """Returns fields by their dotted paths, which may be written as nested tables as well."""
    fields = data.get(table, {})
    if not isinstance(fields, Mapping):
        raise InputError(f"{where}{table}", fields, "a table of fields of the experiment")
    values = dict(_flat(config_io.located(fields, folder)))
    if "seed" in values:
        raise InputError(f"{where}{table}.seed", values["seed"], "left out: seeds says which")
    return values


def _flat(data: Mapping[str, Any], where: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in data.items():
        path = f"{where}.{name}" if where else name
        if isinstance(value, Mapping):
            yield from _flat(value, path)
        else:
            yield path, value
