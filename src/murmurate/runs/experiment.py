"""An experiment as configuration: what is to be discovered and how, with a name; its TOML file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from murmurate.discovery import Problem
from murmurate.errors import InputError, RunError, check_choice
from murmurate.runs import config_io, storage
from murmurate.world import SensingConfig, scaled_to

__all__ = ["STARTS", "ExperimentConfig", "check_same", "check_seed", "load", "read_toml", "save"]

STARTS = "starts.csv"
"""A run that begins at given positions keeps its own copy of them under this name."""


MAX_SEED = 2**32 - 1


@dataclass(frozen=True)
class ExperimentConfig(Problem):
    """An experiment.

    Attributes:
        objective: C1 (gathering at the origin) or C2 (at no predefined point).
        seed: Seed of everything random.
        sizes: Swarm sizes among which training goes about, each in a world grown to it; none: the world's own alone.
        name: What the experiment is called.
    """

    objective: Literal["C1", "C2"]
    name: str

    def __post_init__(self) -> None:
        check_choice("objective", self.objective, ("C1", "C2"))
        check_seed(self.seed)
        if not re.fullmatch(r"\w[\w .+-]{0,63}", self.name):
            raise InputError("name", self.name, "up to 64 letters, digits, spaces and . + - _")
        self._check_sensing()
        if self.sizes:
            self._check_sizes()

    def _check_sensing(self) -> None:
        """Refuses eyes that the policy does not use, or that cannot serve the objective."""
        usual = SensingConfig()
        for name, value in vars(self.sensing).items():
            if self.policy.kind != "local" and value != getattr(usual, name):
                allowed = f"{getattr(usual, name)}: with the policy {self.policy.kind} robots act on all positions"
                raise InputError(f"sensing.{name}", value, f"{allowed}; for eyes of their own choose the policy local")
        if self.objective == "C1" and not self.sensing.landmark:
            reason = "true with objective C1: in frames of their own, robots find a given point only by a landmark"
            raise InputError("sensing.landmark", False, reason)

    def _check_sizes(self) -> None:
        """Refuses swarm sizes that one policy cannot be trained among."""
        for robots in self.sizes:
            scaled_to(self.world, robots)
        if len(set(self.sizes)) < len(self.sizes):
            raise InputError("sizes", self.sizes, "different from each other")
        if self.policy.kind == "central":
            raise InputError("policy.kind", "central", "equivariant or local with sizes: central knows one size only")
        if self.start.kind != "random":
            raise InputError("start.kind", self.start.kind, "random with sizes: other starts are of one size")
        if self.discovery.max_policies > 1:
            allowed = "1 with sizes: a swarm of any size runs one policy, and nobody tells it when to change"
            raise InputError("discovery.max_policies", self.discovery.max_policies, allowed)


def check_seed(seed: object) -> None:
    """Checks a seed.

    Raises:
        InputError: It is no integer, or out of bounds.
    """
    if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed <= MAX_SEED:
        raise InputError("seed", seed, f"an integer from 0 to {MAX_SEED}")


def read_toml(path: str | Path) -> dict[str, Any]:
    """Reads a TOML file of an experiment, or of some of its fields; its `start.file` is relative to the TOML file.

    Raises:
        InputError: The file is not valid TOML.
        OSError: The file cannot be read.
    """
    data = config_io.load_toml(path)
    start = data.get("start")
    file = start.get("file") if isinstance(start, Mapping) else None
    if file and isinstance(file, str):
        data = config_io.merged(data, {"start": {"file": str(Path(path).parent / file)}})
    return data


def save(config: ExperimentConfig, folder: str | Path) -> None:
    """Writes a configuration, every field of it, and the positions that it begins at, if it names a file of them.

    Raises:
        RunError: A file cannot be written.
    """
    folder, source = Path(folder), config.start.file
    if source:
        config = replace(config, start=replace(config.start, file=STARTS))
    storage.write_text(folder / storage.EXPERIMENT, config_io.dump_toml(config))
    if source:
        storage.write_bytes(folder / STARTS, Path(source).read_bytes())


def load(folder: str | Path) -> ExperimentConfig:
    """Reads the configuration of a run.

    Raises:
        RunError: It is missing or not one that this version understands.
    """
    path = Path(folder) / storage.EXPERIMENT
    try:
        return config_io.from_dict(ExperimentConfig, read_toml(path))
    except InputError as error:
        raise RunError(f"{path}: {error}") from None
    except OSError as error:
        raise RunError(f"cannot read {path}: {error.strerror or error}") from None


def check_same(config: ExperimentConfig, folder: str | Path) -> None:
    """Checks that a run folder holds this very experiment.

    Raises:
        RunError: It holds another; the message names the first field that differs.
    """
    there = {leaf.path: leaf.value for leaf in config_io.leaves(load(folder))}
    for leaf in config_io.leaves(config):
        same = leaf.value == there[leaf.path]
        if leaf.path == "start.file" and leaf.value and there[leaf.path]:
            copy = Path(there[leaf.path])
            same = not copy.exists() or copy.read_bytes() == Path(leaf.value).read_bytes()
        if not same:
            raise RunError(
                f"{folder} holds another experiment: {leaf.path} is {there[leaf.path]!r} there, {leaf.value!r} here; "
                "choose another folder"
            )
