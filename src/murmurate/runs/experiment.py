"""An experiment as configuration: what is to be discovered and how, with a name; its TOML file."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from murmurate import prng, untrusted
from murmurate.discovery import MAX_REST_STEPS, Problem
from murmurate.discovery.problem import GATHERING, GATHERING_SIGNALS
from murmurate.discovery.validity import REPLACED
from murmurate.errors import InputError, RunError, check_choice, check_number, check_path, check_type, shown
from murmurate.registry import Importer, source_folder
from murmurate.runs import config_io, files
from murmurate.world import OBJECTIVES, SMOOTH_SIGNALS, Start, scaled_to
from murmurate.world.start_files import MAX_STARTS_BYTES

__all__ = [
    "EXPERIMENT",
    "STARTS",
    "ExperimentConfig",
    "check_same",
    "check_seed",
    "is_start_file",
    "load",
    "make_importer",
    "read_toml",
    "save",
]

EXPERIMENT = "experiment.toml"

_NOT_WRITTEN = {"rest": {"dead_zone": 0.0}}
"""What a run was discovered with whose experiment.toml does not say it: that of version 0.1.0 knew no dead zone."""

STARTS = "starts.csv"
"""A run keeps its own copy of the file that its start names under this name, and further ones as starts-2.csv, ..."""

_START_FILE = re.compile(r"starts(-\d{1,3})?(\.\w{1,16})?")


@dataclass(frozen=True)
class ExperimentConfig(Problem):
    """An experiment.

    Attributes:
        objective: C1 (gathering at the origin), C2 (at no predefined point) or custom (the signals of [signals] alone).
        seed: Seed of everything random.
        sizes: Swarm sizes among which training alternates, each in a world scaled to it; none: the world's own alone.
        name: What the experiment is called.
        modules: Folders of the modules that "module:Class" names, by module; filled in where a run is written.
    """

    objective: Literal["C1", "C2", "custom"]
    name: str
    modules: Mapping[str, str] = field(default_factory=dict, kw_only=True)

    def __post_init__(self) -> None:
        check_choice("objective", self.objective, tuple(OBJECTIVES))
        check_seed(self.seed)
        check_number("rest.max_steps", self.rest.max_steps, 1, MAX_REST_STEPS, integer=True)
        if not re.fullmatch(r"\w[\w .+-]{0,63}", self.name):
            raise InputError("name", self.name, "up to 64 letters, digits, spaces and . + - _")
        config_io.file_fields(self.start)  # refuses a start whose file_fields are none
        self._check_signals()
        self._check_sensing()
        self._check_dead_zone()
        self._check_goals()
        self.shield.prepare(self.scheduler)  # refuses a scheduler that it cannot serve
        if self.sizes:
            self._check_sizes()

    @property
    def has_paper_objective(self) -> bool:
        """Whether the objective is the paper's C1 or C2 with its own weights, so that best-known patterns compare."""
        return self.objective != "custom" and not self.signals

    def _check_signals(self) -> None:
        """Refuses weights and thresholds of signals that the objective does not have."""
        for name in self.signals:
            if not re.fullmatch(r"[A-Za-z_]\w{0,31}", name) or name in (GATHERING, "total"):
                allowed = f"a name of letters, digits and _, neither {GATHERING} nor total"
                raise InputError("signals", name, allowed)
        names = self.signal_names
        gathering = [GATHERING] if set(GATHERING_SIGNALS) & set(names) else []
        names_or_smooth = f"for a signal of the objective ({', '.join(names)}), or a smooth one"
        measurable = dict.fromkeys((*names, *REPLACED))
        for section, table, extra, allowed in (
            ("base.weights", self.base.weights, [*gathering, *SMOOTH_SIGNALS], names_or_smooth),
            ("auxiliary.weights", self.auxiliary.weights, [*gathering, *SMOOTH_SIGNALS], names_or_smooth),
            ("valid", self.valid, REPLACED, f"for a signal of the objective or the paper ({', '.join(measurable)})"),
        ):
            for name, value in table.items():
                if name not in (*names, *extra):
                    raise InputError(f"{section}.{name}", value, allowed)
        for index in range(2):
            self.refinement(index)  # refuses weights of signals that there are not
        for name, least in self.valid.items():
            check_number(f"valid.{name}", least)

    def _check_dead_zone(self) -> None:
        """Refuses a dead zone in which a pattern cannot be corrected.

        Two robots that nearly touch have to move apart by up to the safe distance less two radii; where the dead zone
        is as wide, robots that want to do just that stand still.
        """
        world, room = self.world, self.world.safe_distance - 2 * self.world.radius
        if self.slow_moves.least_speed >= room:
            allowed = f"less than {room / world.max_speed:.4g}: a robot could not correct its way to the safe distance"
            raise InputError("rest.dead_zone", self.rest.dead_zone, allowed)

    def _check_sensing(self) -> None:
        """Refuses sensing that the policy does not use, or that cannot serve the objective."""
        usual = type(self).__dataclass_fields__["sensing"].default_factory()  # type: ignore[misc]
        if not self.policy.perceives and self.sensing != usual:
            given = config_io.to_dict(self.sensing)
            standard = config_io.to_dict(usual)
            name = next(name for name, value in given.items() if value != standard.get(name))
            allowed = (
                f"{standard.get(name, 'left out')}: with the policy {self.policy.name} robots act on all positions"
            )
            raise InputError(f"sensing.{name}", given[name], f"{allowed}; to act on their own view choose policy local")
        if self.policy.needs_walls and not self.sensing.walls:
            reason = f"true: with this policy ({self.policy.name}) robots act on the walls that they perceive"
            raise InputError("sensing.walls", False, reason)
        if self.landmark and not self.sensing.landmark:
            signal = next(name for name, signal in self.objective_signals.items() if signal.needs_landmark)
            reason = f"true with the signal {signal}: in frames of their own, robots find a point only by a landmark"
            raise InputError("sensing.landmark", False, reason)

    def _check_goals(self) -> None:
        """Refuses the search for goals of a policy that has none."""
        for section in ("base", "auxiliary")[: min(self.discovery.max_policies, 2)]:
            if getattr(self, section).learner == "goals" and not self.policy.has_goals:
                allowed = f"ppo or gradients: the policy {self.policy.name} has no goals (formation has)"
                raise InputError(f"{section}.learner", "goals", allowed)

    def _check_sizes(self) -> None:
        """Refuses swarm sizes that one policy cannot be trained among."""
        for robots in self.sizes:
            scaled_to(self.world, robots)
        if len(set(self.sizes)) < len(self.sizes):
            raise InputError("sizes", self.sizes, "different from each other")
        if not (self.policy.any_size or self.policy.has_goals):
            allowed = f"equivariant, local or formation with sizes: {self.policy.name} knows one size only"
            raise InputError("policy.use", self.policy.name, allowed)
        if self.policy.has_goals and self.world.robots not in self.sizes:
            sizes = ", ".join(map(str, self.sizes))
            allowed = f"one of sizes ({sizes}): the policy {self.policy.name} has formations for these alone"
            raise InputError("world.robots", self.world.robots, allowed)
        if self.start.name in ("scattered", "distributed", "packed") or not self.start.fits_any_size():
            raise InputError("start.use", self.start.name, "random with sizes: other starts are of one size")
        if self.discovery.max_policies > 1:
            allowed = "1 with sizes: a swarm of any size runs one policy, and nobody tells it when to change"
            raise InputError("discovery.max_policies", self.discovery.max_policies, allowed)

    def __repr__(self) -> str:
        robots = f"{self.world.robots} robots" if not self.sizes else f"{min(self.sizes)} to {max(self.sizes)} robots"
        return (
            f"ExperimentConfig({self.name}: {robots}, {self.objective}, start {self.start.name}, "
            f"policy {self.policy.name}, seed {self.seed})"
        )


def check_seed(seed: object) -> None:
    """Checks a seed.

    Raises:
        InputError: It is no integer, or out of bounds.
    """
    if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed <= prng.MAX_SEED:
        raise InputError("seed", seed, f"an integer from 0 to {prng.MAX_SEED}")


def read_toml(path: str | Path) -> dict[str, Any]:
    """Reads a TOML file of an experiment, or of some of its fields; paths in it are relative to the TOML file.

    Raises:
        InputError: The file is not valid TOML.
        OSError: The file cannot be read.
    """
    folder = Path(path).parent
    return config_io.located(_with_module_folders(config_io.load_toml(path), folder), folder)


def _with_module_folders(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    modules = data.get("modules")
    if isinstance(modules, Mapping):
        absolute = {
            name: os.path.realpath(folder / value)
            for name, value in modules.items()
            if isinstance(value, str) and "\0" not in value
        }
        data = config_io.merged(data, {"modules": absolute})
    return data


def make_importer(data: Mapping[str, Any], folder: str | Path | None = None, trusted: bool = True) -> Importer:
    """Returns what finds the classes that a configuration names.

    Args:
        data: The configuration as nested dictionaries: its `modules` name folders.
        folder: The folder of the configuration file, where modules are looked for first.
        trusted: Whether modules from outside the package may be imported.
    """
    modules = data.get("modules")
    named = modules.values() if isinstance(modules, Mapping) else ()
    folders = [folder, *(value for value in named if isinstance(value, str))]
    return Importer(tuple(Path(value) for value in folders if value is not None), trusted)


def save(config: ExperimentConfig, folder: str | Path) -> None:
    """Writes a configuration, every field of it, and copies of the files that its start names.

    Raises:
        RunError: A file cannot be written.
    """
    check_type("config", config, ExperimentConfig, "an experiment")
    check_path("folder", folder)
    folder = Path(folder)
    modules = dict(config.modules)
    for _, strategy in config_io.strategies(config):
        source = source_folder(type(strategy)) if strategy.is_foreign() else None
        if source is not None:
            modules.setdefault(strategy.name.partition(":")[0].partition(".")[0], source)
    named, copies = config_io.file_fields(config.start), {}
    for file in named.values():
        copies.setdefault(file, _copy_name(len(copies) + 1, file))
    # The starts first: they may be this very folder's, and a run without them cannot be read.
    contents = {copies[file]: _read_starts(file) for file in copies}
    for name, content in contents.items():
        files.write_bytes(files.inside(folder, name), content)
    config = replace(_with_files(config, {path: copies[file] for path, file in named.items()}), modules=modules)
    files.write_text(files.inside(folder, EXPERIMENT), config_io.dump_toml(config))


def is_start_file(name: str) -> bool:
    """Returns whether a run may have its own copy of a file that its start names under this name."""
    return _START_FILE.fullmatch(name) is not None


def _copy_name(number: int, file: str) -> str:
    """Returns what a run calls its own copy of a file that its start names."""
    name = f"{'starts' if number == 1 else f'starts-{number}'}{Path(file).suffix}"
    return name if is_start_file(name) else Path(name).stem


def _with_files(config: ExperimentConfig, named: Mapping[str, str]) -> ExperimentConfig:
    """Returns an experiment whose start names other files, by the dotted paths of its fields."""
    return config_io.replaced(config, config_io.nested(named)) if named else config


def _read_starts(path: str) -> bytes:
    with files.os_errors_as_run_errors(f"cannot read {path}"):
        return untrusted.read(path, MAX_STARTS_BYTES, follow=True)


def load(folder: str | Path, trusted: bool = False) -> ExperimentConfig:
    """Reads the configuration of a run.

    Args:
        folder: The run folder.
        trusted: Whether the modules that it names may be imported, which executes them.

    Raises:
        RunError: It is missing or not one that this version understands.
    """
    check_path("folder", folder)
    path = Path(folder) / EXPERIMENT
    try:
        data = config_io.load_toml(files.inside(folder, EXPERIMENT), follow=False)
        data = config_io.merged(_NOT_WRITTEN, _with_module_folders(data, Path(folder)))
        config = config_io.from_dict(ExperimentConfig, data, importer=make_importer(data, trusted=trusted))
        return _with_files(config, _own_files(config.start, Path(folder)))
    except InputError as error:
        raise RunError(f"{path}: {error}") from None
    except OSError as error:
        raise RunError(f"cannot read {path}: {error.strerror or error}") from None


def _own_files(start: Start, folder: Path) -> dict[str, str]:
    """Returns the files of a run's start, which are the run's own: any other may be anywhere."""
    named = config_io.file_fields(start)
    for path, file in named.items():
        if not is_start_file(file):
            raise InputError(path, file, f"{STARTS}, the run's own file of starts")
    return {path: str(files.inside(folder, file)) for path, file in named.items()}


def check_same(config: ExperimentConfig, folder: str | Path) -> None:
    """Checks that a run folder holds this very experiment.

    Raises:
        RunError: It holds another; the message names the first field that differs.
    """
    # Nothing that only the folder names is imported: it is not trusted.
    there = load(folder)
    recorded = {leaf.path: leaf.value for leaf in config_io.leaves(there)}
    given = {leaf.path: leaf.value for leaf in config_io.leaves(config)}
    old_files, new_files = config_io.file_fields(there.start), config_io.file_fields(config.start)
    for path in dict.fromkeys((*given, *recorded)):
        if path.startswith("modules."):
            continue
        old, new = recorded.get(path), given.get(path)
        same = old == new
        if path in old_files and path in new_files:
            old_file, new_file = old_files[path], new_files[path]
            same = not Path(old_file).exists() or _read_starts(old_file) == _read_starts(new_file)
        if not same:
            what = f"{path} is {shown(old)} there, {shown(new)} here"
            raise RunError(f"{folder} holds another experiment: {what}; choose another folder")
