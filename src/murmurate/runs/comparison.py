"""Method against method, with the same eyes, schedulers, starts and step budget: how often each forms a pattern."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, cast, get_args

import jax
import numpy as np
from jaxtyping import Float

from murmurate.policies.baselines import BASELINES
from murmurate.discovery import Trajectories, bound_steps, build_cascade, check_validity
from murmurate.errors import RunError, check_choice, check_number
from murmurate.runs import config_io, storage
from murmurate.runs.experiment import ExperimentConfig, check_seed
from murmurate.runs.evaluate import wilson
from murmurate.runs.run import MAX_EPISODES, Run
from murmurate.geometry import neighbors_and_visible
from murmurate.analysis.optimum.best_known import best_known
from murmurate.analysis.optimum.formation import Target
from murmurate.policies import LocalPolicy
from murmurate.world import (
    AsyncScheduler,
    Family,
    FsyncScheduler,
    GlobalSensing,
    Scheduler,
    Sensing,
    SsyncScheduler,
    SymmetricStart,
    VisibleSensing,
    WorldConfig,
    draw_starts,
)

__all__ = ["COMPARISON", "SCHEDULERS", "SENSINGS", "Cell", "Comparison", "cells", "compare", "load", "sorted_rows"]

COMPARISON = "comparison.json"

SENSINGS: dict[str, Sensing] = {
    "global": GlobalSensing(rotation=True, reflection=True, walls=True),
    "visible": VisibleSensing(rotation=True, reflection=True),
    "chiral": VisibleSensing(rotation=True),
    "noisy": VisibleSensing(rotation=True, reflection=True, range_noise=0.02, bearing_noise=0.01),
}
"""What robots perceive, by name. None agrees with another on directions, nor, but for `chiral`, on handedness."""

SCHEDULERS: dict[str, Scheduler] = {
    "fsync": FsyncScheduler(),
    "ssync": SsyncScheduler(),
    "adversarial": SsyncScheduler(adversarial=True, rigid=False),
    "async": AsyncScheduler(),
    "async-nonrigid": AsyncScheduler(rigid=False),
}
"""When robots move, by name."""

RANDOM = "random"

WORST = 3
"""Failures kept of each cell, to be drawn."""

ROOM = 2**18
"""Pairs of robots in one batch of episodes, at most."""

_HELD_OUT = 2**31 + 1


@dataclass(frozen=True)
class Cell:
    """One comparison.

    Attributes:
        method: Name of a run, or of a baseline.
        sensing: A name of `SENSINGS`.
        scheduler: A name of `SCHEDULERS`.
        robots: Swarm size.
        start: random, or a family of exactly symmetric starts.
    """

    method: str
    sensing: str
    scheduler: str
    robots: int
    start: str = "random"


@dataclass(frozen=True)
class Comparison:
    """What is compared, and from which starts.

    Attributes:
        base: The world, scaled_to to each swarm size, the objective and the rule of rest.
        episodes: Random starts for each cell; the same for every method.
        seed: Their seed; no training ever began at them.
    """

    base: ExperimentConfig
    episodes: int = 1000
    seed: int = 0

    def __post_init__(self) -> None:
        check_number("episodes", self.episodes, 1, MAX_EPISODES, integer=True)
        check_seed(self.seed)

    def problem(self, cell: Cell) -> ExperimentConfig:
        """Returns the experiment of one cell: its world, eyes and scheduler."""
        frames = SENSINGS[cell.sensing]
        if cell.method in BASELINES and BASELINES[cell.method].centralised:
            # A central mind has one frame; with it come all positions.
            frames = GlobalSensing()
        policy = LocalPolicy()
        problem = replace(self.base, policy=policy, sensing=frames, scheduler=SCHEDULERS[cell.scheduler], sizes=())
        return problem.of_size(cell.robots)


def cells(
    methods: Sequence[str],
    sensings: Sequence[str],
    schedulers: Sequence[str],
    sizes: Sequence[int],
    starts: Sequence[str] = (RANDOM,),
    known: Sequence[str] = (),
) -> list[Cell]:
    """Returns all cells of a comparison, in the order of its table.

    Args:
        methods: Names of methods.
        sensings: Names of `SENSINGS`.
        schedulers: Names of `SCHEDULERS`.
        sizes: Swarm sizes.
        starts: random, and families of symmetric starts; swarms too small for one are left out there.
        known: The methods that there are.

    Raises:
        InputError: A name is unknown; the message lists the known ones.
    """
    choices = (
        ("method", methods, known),
        ("sensing", sensings, SENSINGS),
        ("scheduler", schedulers, SCHEDULERS),
        ("start", starts, (RANDOM, *get_args(Family))),
    )
    for field, names, there in choices:
        for name in names:
            check_choice(field, name, tuple(there))
    for robots in sizes:
        check_number("robots", robots, 2, 1000, integer=True)
    return [
        Cell(method, eyes, scheduler, robots, start)
        for start in starts
        for eyes in sensings
        for scheduler in schedulers
        for robots in sizes
        for method in methods
        if start != "rings" or robots >= 4
    ]


def compare(
    comparison: Comparison,
    wanted: Sequence[Cell],
    runs: Mapping[str, Mapping[str, Run]],
    folder: str | Path,
    on_progress: Callable[..., None] | None = None,
    command: str | None = None,
) -> list[dict[str, Any]]:
    """Runs every cell that the folder does not hold already, and keeps each there as soon as it is done.

    Cells may differ in how many starts they have; one with more than are asked for is not run again.

    Args:
        comparison: What is compared.
        wanted: The cells.
        runs: Learned methods by name, the run for each sensing; the other names are baselines'.
        folder: Where comparison.json is, or will be.
        on_progress: Called as `on_progress(work, done, total, **values)` after each cell.
        command: What to note as having made the cells.

    Returns:
        The rows of the table, one a cell.

    Raises:
        RunError: The folder holds another comparison, or cannot be written to.
    """
    path = Path(folder) / COMPARISON
    settings = _settings(comparison, runs)
    done = _there(path, settings) if path.exists() else {}
    before = load(folder) if path.exists() else {}
    settings["weights"] = {**before.get("weights", {}), **settings["weights"]}
    settings["commands"] = list(dict.fromkeys([*before.get("commands", []), *([command] if command else [])]))
    storage.make_folder(Path(folder))
    for place, cell in enumerate(wanted):
        if cell not in done or done[cell]["episodes"] < comparison.episodes:
            done[cell] = _row(comparison, cell, _policy(comparison, cell, runs))
            storage.write_json(path, {**settings, "rows": list(done.values())})
        if on_progress is not None:
            name = f"{cell.method}, {cell.sensing}, {cell.scheduler}, {cell.start}, N = {cell.robots}"
            share = done[cell]["valid"] / done[cell]["episodes"]
            on_progress("comparison", place + 1, len(wanted), valid=share, note=name)
    storage.write_json(path, {**settings, "rows": list(done.values())})
    return [done[cell] for cell in wanted]


def load(folder: str | Path) -> dict[str, Any]:
    """Reads a comparison.

    Raises:
        RunError: It is missing or damaged.
    """
    found = storage.read_json(Path(folder) / COMPARISON)
    if not isinstance(found, dict) or not isinstance(found.get("rows"), list):
        raise RunError(f"{Path(folder) / COMPARISON} is not a comparison")
    return found


def sorted_rows(folder: str | Path) -> list[dict[str, Any]]:
    """Returns all cells that a folder holds, in the order of its table: learned methods before baselines.

    Raises:
        RunError: It is missing or damaged.
    """
    places = {name: place for place, name in enumerate(("random", *get_args(Family), *SENSINGS, *SCHEDULERS))}
    methods = {name: place for place, name in enumerate(BASELINES, start=1)}

    def place(row: dict[str, Any]) -> tuple[Any, ...]:
        names = (row["start"], row["sensing"], row["scheduler"])
        return (*(places[name] for name in names), row["robots"], methods.get(row["method"], 0), row["method"])

    return sorted(load(folder)["rows"], key=place)


def _settings(comparison: Comparison, runs: Mapping[str, Mapping[str, Run]]) -> dict[str, Any]:
    world = {name: value for name, value in asdict(comparison.base.world).items() if name != "collision_penalty"}
    return {
        "objective": comparison.base.objective,
        "world": world,
        "rest": asdict(comparison.base.rest),
        "seed": comparison.seed,
        "sensings": {name: config_io.to_dict(config) for name, config in SENSINGS.items()},
        "schedulers": {name: config_io.to_dict(config) for name, config in SCHEDULERS.items()},
        "weights": {f"{name}, {eyes}": _identity(run) for name, own in runs.items() for eyes, run in own.items()},
    }


def _identity(run: Run) -> str:
    return hashlib.sha256(storage.to_json(run.manifest.get("checksums", {})).encode()).hexdigest()[:16]


def _there(path: Path, settings: Mapping[str, Any]) -> dict[Cell, dict[str, Any]]:
    """Reads the cells that are done, if they are of the same comparison."""
    found = load(path.parent)
    for name, value in settings.items():
        # Names that only one of the two has do no harm: their cells are told apart.
        there = found.get(name)
        same = there == value
        if name == "weights" and isinstance(there, dict):
            same = all(there.get(key, one) == one for key, one in value.items())
        if not same:
            what = f"{name} is {there!r} there, {value!r} here"
            raise RunError(f"{path} holds another comparison: {what}; choose another folder")
    try:
        cells = {Cell(*(row[name] for name in Cell.__dataclass_fields__)): row for row in found["rows"]}
        return {cell: {**row, "episodes": int(row["episodes"])} for cell, row in cells.items()}
    except (KeyError, TypeError) as error:
        raise RunError(f"{path} is damaged: a row lacks {error}") from None


def _policy(comparison: Comparison, cell: Cell, runs: Mapping[str, Mapping[str, Run]]) -> Any:
    if cell.method in runs:
        run = runs[cell.method][cell.sensing]
        run.warn_of_size(cell.robots)
        return run.cascade.policies
    world = comparison.problem(cell).world
    return (BASELINES[cell.method](world, comparison.base.landmark),)


def _row(comparison: Comparison, cell: Cell, policies: Any) -> dict[str, Any]:
    """Runs one cell."""
    problem = comparison.problem(cell)
    parts = [_judged(problem, ran) for ran in _rollouts(comparison, problem, policies, cell.start)]
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    valid, count = joined["valid"], len(joined["valid"])
    known = best_known(Target(problem.world, problem.objective))
    bad = np.flatnonzero(~valid)
    worst = bad[np.argsort(joined["visible"][bad] + 2.0 * joined["free"][bad], kind="stable")][:WORST]

    def mean(name: str) -> float | None:
        return float(joined[name][valid].mean()) if valid.any() else None

    value = mean("objective")
    return {
        **asdict(cell),
        "episodes": count,
        "valid": int(valid.sum()),
        "interval": list(wilson(int(valid.sum()), count)),
        "collisions": int((~joined["free"] & ~joined["left"]).sum()),
        "left": int(joined["left"].sum()),
        "hidden": int((joined["free"] & ~joined["seen"]).sum()),
        "unsafe": int((joined["free"] & ~joined["safe"]).sum()),
        "restless": int((joined["free"] & ~joined["rest"]).sum()),
        "steps": mean("steps"),
        "epochs": mean("epochs"),
        "efficiency": mean("efficiency"),
        "gap": None if known is None or value is None else known - value,
        "worst": [{"positions": joined["final"][i].round(3).tolist(), "free": bool(joined["free"][i])} for i in worst],
    }


def _rollouts(
    comparison: Comparison, problem: ExperimentConfig, policies: Any, start: str = RANDOM
) -> Iterator[Trajectories]:
    """Executes a method from all starts, so many at a time as memory holds; every method from the same."""
    cascade = build_cascade(problem, policies)
    size = min(max(ROOM // problem.world.robots**2, 8), comparison.episodes)
    key = jax.random.fold_in(jax.random.fold_in(jax.random.key(comparison.seed), _HELD_OUT), problem.world.robots)
    for first in range(0, comparison.episodes, size):
        if start == RANDOM:
            starts = draw_starts(cascade.world.start, jax.random.fold_in(key, first), size, problem.world)
        else:
            family = SymmetricStart(cast(Any, start))
            starts = draw_starts(family.prepare(problem.world), jax.random.fold_in(key, first), size, problem.world)
        ran = cascade.rollout(starts, seed=first)
        yield _first(ran, comparison.episodes - first)


def _first(ran: Trajectories, count: int) -> Trajectories:
    """Returns the first episodes."""
    return Trajectories(
        **{name: value[:count] for name, value in vars(ran).items() if name != "signals"},
        signals={name: value[:count] for name, value in ran.signals.items()},
    )


def _judged(problem: ExperimentConfig, ran: Trajectories) -> dict[str, np.ndarray]:
    """Measures every episode."""
    validity, world = check_validity(ran, problem.world, problem.thresholds), problem.world
    bound = np.array([bound_steps(a, b, world.max_speed) for a, b in zip(ran.positions[:, 0], ran.final, strict=True)])
    return {
        "valid": validity.valid,
        "free": validity.contact_free & validity.inside,
        "left": _left(ran.final, world),
        "seen": validity.mutually_visible,
        "safe": validity.safe,
        "rest": validity.at_rest,
        "visible": _share_visible(ran.final, world),
        "steps": ran.lengths,
        "epochs": ran.epochs,
        "efficiency": bound / np.maximum(ran.lengths, 1),
        "objective": np.sum([values[:, -1] for values in ran.signals.values()], axis=0),
        "final": ran.final,
    }


def _left(final: Float[np.ndarray, "episodes robots 2"], world: WorldConfig) -> np.ndarray:
    bounds = np.array([world.half_width, world.half_height], np.float32)
    return np.asarray((np.abs(final) > bounds).any(axis=(1, 2)))


def _share_visible(final: Float[np.ndarray, "episodes robots 2"], world: WorldConfig) -> np.ndarray:
    _, seen = neighbors_and_visible(final, world.radius, world.scan_radius)
    return seen.sum(axis=(1, 2)) / (world.robots * (world.robots - 1))
