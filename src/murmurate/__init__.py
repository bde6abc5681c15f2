"""Discovers collisionless patterns in swarms of fat, opaque robots by deep reinforcement learning.

Names and submodules are imported when they are first used: `import murmurate` loads neither JAX nor NumPy.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import murmurate  # annotations name its lazy classes, so that they can be resolved

if TYPE_CHECKING:
    from murmurate import (
        analysis,
        cli,
        discovery,
        errors,
        geometry,
        interop,
        learning,
        plots,
        policies,
        registry,
        report,
        runs,
        types,
        world,
    )
    from murmurate.discovery import Cascade, Validity, check_validity
    from murmurate.errors import InputError, RunError, UsageError
    from murmurate.policies import Policy, PolicyNetwork, Shield
    from murmurate.policies.baselines import Baseline
    from murmurate.runs.evaluate import Evaluation, evaluate
    from murmurate.runs.experiment import ExperimentConfig
    from murmurate.runs.run import Run
    from murmurate.types import Trajectories
    from murmurate.world import Configuration, Scheduler, Sensing, Signal, Start, World, WorldConfig, start_set

__version__ = "0.1.0"

_NAMES = {
    "Baseline": "policies.baselines",
    "Cascade": "discovery",
    "Configuration": "world",
    "Evaluation": "runs.evaluate",
    "ExperimentConfig": "runs.experiment",
    "InputError": "errors",
    "Policy": "policies",
    "PolicyNetwork": "policies",
    "Run": "runs.run",
    "RunError": "errors",
    "Scheduler": "world",
    "Sensing": "world",
    "Shield": "policies",
    "Signal": "world",
    "Start": "world",
    "Trajectories": "types",
    "UsageError": "errors",
    "Validity": "discovery",
    "World": "world",
    "WorldConfig": "world",
    "check_validity": "discovery",
    "evaluate": "runs.evaluate",
    "start_set": "world",
}
"""The module of each public name."""

_MODULES = (
    "analysis",
    "cli",
    "discovery",
    "errors",
    "geometry",
    "interop",
    "learning",
    "plots",
    "policies",
    "registry",
    "report",
    "runs",
    "types",
    "world",
)

__all__ = [
    "Baseline",
    "Cascade",
    "Configuration",
    "Evaluation",
    "ExperimentConfig",
    "InputError",
    "Policy",
    "PolicyNetwork",
    "Run",
    "RunError",
    "Scheduler",
    "Sensing",
    "Shield",
    "Signal",
    "Start",
    "Trajectories",
    "UsageError",
    "Validity",
    "World",
    "WorldConfig",
    "__version__",
    "analysis",
    "check_validity",
    "cli",
    "discover",
    "discovery",
    "errors",
    "evaluate",
    "experiment",
    "geometry",
    "interop",
    "learning",
    "load",
    "plots",
    "policies",
    "pretrained",
    "registry",
    "report",
    "runs",
    "start_set",
    "types",
    "world",
]


def discover(
    experiment: str | Path | murmurate.ExperimentConfig,
    *,
    out: str | Path | None = None,
    resume: bool = False,
    on_progress: Callable[..., None] | None = None,
    **fields: Any,
) -> murmurate.Run:
    """Trains the policies of an experiment, evaluates them and leaves a run folder.

    Args:
        experiment: A to F (the paper's experiments), a problem of the package ("circle"), a TOML file, or a
            configuration.
        out: The run folder, to be created; by default runs/NAME-POLICY-seedSEED.
        resume: Continue what the folder holds; a finished run is only opened.
        on_progress: Called as `on_progress(work, done, total, **values)` before and after every chunk of updates.
        **fields: Fields of the experiment to replace: numbers, nested dictionaries, or strategies, such as `seed=1`,
            `world={"robots": 6}`, `start="random"`, `start=MyStart()`, `signals={"calm": Calm(weight=0.5)}`.

    Returns:
        The finished run; `manifest["valid_pattern"]` says whether there was a valid pattern.

    Raises:
        InputError: The experiment is impossible; nothing has been written.
        RunError: The folder holds another run, is damaged, in use or cannot be written to, or the training diverged.

    Example:
        >>> run = murmurate.discover("F", seed=1, base={"gradients": {"updates": 100}})  # doctest: +SKIP
    """
    from murmurate.errors import check_function, check_path, check_type

    check_type("resume", resume, bool, "True or False")
    if out is not None:
        check_path("out", out)
    check_function("on_progress", on_progress, "on_progress(work, done, total, **values)")
    from murmurate.runs.train import discover as train  # only now, because it loads JAX

    config = _resolve(experiment, fields)
    folder = Path(out) if out is not None else Path("runs") / f"{config.name}-{_file_name(config)}-seed{config.seed}"
    return train(config, folder, resume, on_progress)


def experiment(name: str | Path | murmurate.ExperimentConfig, **fields: Any) -> murmurate.ExperimentConfig:
    """Returns the configuration of an experiment with some fields replaced; see `discover`.

    Raises:
        InputError: The experiment or a field is unknown, or a value is not allowed.
    """
    return _resolve(name, fields)


def load(folder: str | Path, trust: bool = False) -> murmurate.Run:
    """Opens the folder of a finished run.

    Args:
        folder: The folder that `discover` or the command `murmurate discover` wrote.
        trust: Whether modules from outside the package that the run names ("module:Class") may be imported, which
            executes them. Nothing else in a run folder is ever executed.

    Returns:
        The run: its experiment, world and cascade, and `rollout(starts, key)`.

    Raises:
        InputError: `folder` is no path, or `trust` neither true nor false.
        RunError: The folder is missing, unfinished, damaged or of an unknown version, or names modules and is not
            trusted.
    """
    from murmurate.runs.run import Run  # only now, because it loads JAX

    return Run.open(folder, trust)


def pretrained(objective: str = "C2", sensing: str = "visible", scheduler: str = "fsync") -> murmurate.Run:
    """Opens weights that come with the package, ready to use: one policy for swarms of many sizes.

    Args:
        objective: C2 (gathering anywhere) or C1 (gathering at the origin, which a landmark marks for all).
        sensing: What robots perceive, in frames of their own: visible (fully visible robots), global (all robots),
            chiral (visible, with a common handedness) or noisy (visible, with noise); or shared: all positions, in one
            frame. These weights remember formations of 4, 6, 8, 10, 12 and 16 robots, and form any other one of up to
            16 (`Run.forming`).
        scheduler: When they move: fsync, ssync, adversarial, async or async-nonrigid.

    Returns:
        The run; `of_size(robots)` puts it into a swarm of another size.

    Raises:
        InputError: There are no such weights; the message lists those that there are.
    """
    from murmurate.runs import pretrained as weights  # only now, because it loads JAX

    return weights.pretrained(objective, sensing, scheduler)


def _resolve(experiment: str | Path | murmurate.ExperimentConfig, fields: dict[str, Any]) -> murmurate.ExperimentConfig:
    from murmurate.runs import config_io, presets

    dotted = {name: value for name, value in fields.items() if "." in name}
    plain = {name: value for name, value in fields.items() if "." not in name}
    overlay = config_io.merged(plain, config_io.nested(dotted))
    return presets.resolve(experiment, overlay, folders=[Path.cwd()])


def _file_name(config: murmurate.ExperimentConfig) -> str:
    """Returns the policy's name as part of a folder's name."""
    return config.policy.name.replace(":", ".")


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(f"murmurate.{name}")
    if name in _NAMES:
        return getattr(importlib.import_module(f"murmurate.{_NAMES[name]}"), name)
    raise AttributeError(f"module 'murmurate' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
