"""Compares methods with the same sensing, schedulers, starts and step budget: how often each forms a valid pattern.

A comparison is a grid of conditions. Each is a job (see `execute`), whose result is one row of comparison.json.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import itertools
import math
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from murmurate import prng
from murmurate.analysis.optimum.best_known import best_known
from murmurate.analysis.optimum.formation import Target
from murmurate.discovery import Trajectories, bound_steps, build_cascade, check_parts, check_validity, rollout
from murmurate.errors import (
    MAX_MAGNITUDE,
    InputError,
    RunError,
    check_number,
    check_path,
    check_type,
    one_line,
    printable,
    shown,
)
from murmurate.geometry import neighbors_and_visible
from murmurate.policies import LocalPolicy
from murmurate.policies.baselines import Baseline
from murmurate.registry import Importer, Strategy
from murmurate.runs import config_io, files, progress
from murmurate.runs.evaluate import wilson
from murmurate.runs.execute import Executor, InProcess, locked, run_jobs
from murmurate.runs.experiment import ExperimentConfig, check_seed, make_importer
from murmurate.runs.folder import trained_checksums
from murmurate.runs.given_starts import find_start, start_names
from murmurate.runs.jobs import Job, Progress
from murmurate.runs.run import MAX_EPISODES, Run
from murmurate.world import (
    MAX_ROBOTS,
    AsyncScheduler,
    FsyncScheduler,
    GlobalSensing,
    Scheduler,
    Sensing,
    SsyncScheduler,
    Start,
    VisibleSensing,
    WorldConfig,
    check_start,
    draw_starts,
    scaled_to,
)
from murmurate.world.start_sets import draw_set

__all__ = [
    "COMPARISON",
    "SCHEDULERS",
    "SENSINGS",
    "Comparison",
    "Condition",
    "ConditionJob",
    "compare",
    "conditions",
    "deviations",
    "find_baseline",
    "is_baseline",
    "load",
    "shared_experiment",
    "sorted_rows",
]

COMPARISON = "comparison.json"

SENSINGS: dict[str, Sensing] = {
    "global": GlobalSensing(rotation=True, reflection=True, walls=True),
    "visible": VisibleSensing(rotation=True, reflection=True, walls=True),
    "chiral": VisibleSensing(rotation=True, walls=True),
    "noisy": VisibleSensing(rotation=True, reflection=True, range_noise=0.02, bearing_noise=0.01, walls=True),
}
"""What robots perceive, by name. None agrees with another on directions, nor, but for `chiral`, on handedness. All
perceive walls, as they do robots."""

SCHEDULERS: dict[str, Scheduler] = {
    "fsync": FsyncScheduler(),
    "ssync": SsyncScheduler(),
    "adversarial": SsyncScheduler(adversarial=True, rigid=False),
    "async": AsyncScheduler(),
    "async-nonrigid": AsyncScheduler(rigid=False),
}
"""When robots move, by name."""

S = TypeVar("S", bound=Strategy)

RANDOM = "random"
"""Where the comparison's own experiment begins."""

SETS = ("cluster", "corner", "wall", "walls", "tight-grid")
"""Families of starts that are those of a named set; see `start_sets`. The others are drawn by the comparison's seed."""

MAX_WORST = 3
"""Failures of each condition that are kept, to be drawn."""

MAX_ROWS = 10_000
"""Rows of a comparison, at most."""

MAX_PAIRS = 2**18
"""Pairs of robots in one batch of episodes, at most."""

JOBS = ".conditions"
"""Where jobs work, in the folder of the comparison; removed when they are done."""

ROW, PROGRESS = "row.json", "progress.json"
_HELD_OUT = 2**31 + 1


@dataclass(frozen=True)
class Condition:
    """What one row of the table compares.

    Attributes:
        method: Name of a run, or of a baseline, or a baseline of one's own as "module:Class".
        sensing: A name of `SENSINGS`, or "module:Class".
        scheduler: A name of `SCHEDULERS`, or "module:Class".
        robots: Swarm size.
        start: `RANDOM`, another name of `given_starts.start_names`, or "module:Class".
    """

    method: str
    sensing: str
    scheduler: str
    robots: int
    start: str = RANDOM

    def __str__(self) -> str:
        return f"{self.method}, {self.sensing}, {self.scheduler}, {self.start}, N = {self.robots}"


@dataclass(frozen=True)
class Comparison:
    """What is compared, and from which starts.

    Attributes:
        base: The world, scaled to each swarm size, the start, the objective, the rest rule and the shield. What becomes
            of slow moves is each method's own: a learned one has the dead zone, damping and sidestep that it was
            trained with, a baseline those that its class states, with the sidestep of the base.
        episodes: Starts of each condition; the same for every method.
        seed: Seed of the starts, but for those of sets, and of frames, noise and scheduler; no training ever began at
            these starts.
    """

    base: ExperimentConfig
    episodes: int = 1000
    seed: int = 0

    def __post_init__(self) -> None:
        check_number("episodes", self.episodes, 1, MAX_EPISODES, integer=True)
        check_seed(self.seed)

    def problem(self, condition: Condition, learned: ExperimentConfig | None = None) -> ExperimentConfig:
        """Returns the experiment of one condition: its world, sensing and scheduler.

        Args:
            condition: The condition.
            learned: The experiment of a learned method.
        """
        sensing, scheduler, rest = self.sensing(condition.sensing), self.scheduler(condition.scheduler), self.base.rest
        if learned is not None:
            rest = replace(rest, **{name: getattr(learned.rest, name) for name in _SLOW_MOVES})
        elif is_baseline(condition.method):
            baseline = find_baseline(condition.method)
            rest = replace(rest, **_slow_moves(baseline))
            if baseline.centralised:
                # A centralised method has one frame, and all positions in it.
                sensing = GlobalSensing()
        problem = replace(self.base, policy=LocalPolicy(), sensing=sensing, scheduler=scheduler, rest=rest, sizes=())
        return problem.of_size(condition.robots)

    def sensing(self, name: str) -> Sensing:
        """Returns what robots perceive, by its name in a condition."""
        return SENSINGS[name] if name in SENSINGS else _own(Sensing, name, SENSINGS, self.base.sensing)

    def scheduler(self, name: str) -> Scheduler:
        """Returns when robots move, by its name in a condition."""
        return SCHEDULERS[name] if name in SCHEDULERS else _own(Scheduler, name, SCHEDULERS, self.base.scheduler)

    def start(self, name: str) -> Start:
        """Returns where robots begin, by its name in a condition."""
        if name == RANDOM:
            return self.base.start
        return find_start(name, "start") if name in start_names() else _own(Start, name, (), self.base.start)


def _own(kind: type[S], name: str, names: Sequence[str] | Mapping[str, S], base: S) -> S:
    """Returns a strategy named "module:Class": the experiment's, or else one with the defaults of its fields."""
    return base if base.name == name else config_io.named(kind, name, tuple(names), kind.section)


def shared_experiment(runs: Mapping[str, ExperimentConfig]) -> ExperimentConfig:
    """Returns the experiment whose world, objective, rest rule and shield all of several have: the first.

    Their worlds are compared at the first one's swarm size; their starts, sensing and schedulers are conditions.

    Args:
        runs: The experiments of learned methods, by the names of these.

    Raises:
        InputError: They differ, so that no condition is the same for all; the message names the field.
    """
    (first, base), *others = runs.items()
    expected = _task(base, base)
    for name, experiment in others:
        given = _task(experiment, base)
        for path in dict.fromkeys((*expected, *given)):
            old, new = expected.get(path), given.get(path)
            if old == new or (isinstance(old, float) and isinstance(new, float) and math.isclose(old, new)):
                continue
            allowed = f"{shown(old)} in {name} as in {first}: methods are compared at one task"
            raise InputError(path, new, allowed)
    return base


_TASK = ("objective", "signals", "valid", "world", "rest", "shield")
"""The sections of an experiment that all methods of a comparison share, but for `_SLOW_MOVES`."""

_SLOW_MOVES = ("dead_zone", "damping", "sidestep")
"""The fields of a rest rule that say what robots make of slow moves, and not what counts as rest."""


def _slow_moves(baseline: type[Baseline]) -> dict[str, float]:
    """Returns the fields of a rest rule that a baseline states."""
    return {"dead_zone": baseline.dead_zone, "damping": baseline.damping}


def _task(experiment: ExperimentConfig, base: ExperimentConfig) -> dict[str, Any]:
    """Returns the leaves of what methods share, by path, in a world of the base's swarm size."""
    scaled = replace(experiment, world=scaled_to(experiment.world, base.world.robots), sizes=())
    leaves = {leaf.path: leaf.value for leaf in config_io.leaves(scaled) if leaf.path.partition(".")[0] in _TASK}
    own = {"world.collision_penalty", *(f"rest.{name}" for name in _SLOW_MOVES)}
    return {path: value for path, value in leaves.items() if path not in own}


def is_baseline(method: str) -> bool:
    """Returns whether a method is a baseline, of this package or of one's own, rather than a run."""
    return method in Baseline.registered() or ":" in method


def find_baseline(method: str, trusted: bool = True) -> type[Baseline]:
    """Returns the class of a baseline.

    Args:
        method: Its registered name, or "module:Class", importable from the working folder or the Python path.
        trusted: Whether its module may be imported, which executes it: where the user names it, and not a file.

    Raises:
        InputError: There is no such class, it is no `Baseline`, or it cannot be imported.
    """
    return Importer((Path.cwd(),), trusted).find(Baseline, method, "method")


def deviations(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Returns how the baselines of a table deviate from what was published, by name; of those that are known here."""
    notes = {}
    for method in dict.fromkeys(row["method"] for row in rows if is_baseline(row["method"])):
        with contextlib.suppress(InputError):  # a stranger's table may name any module: it is not imported
            notes[method] = find_baseline(method, trusted=False).deviations
    return {method: text for method, text in notes.items() if text}


def conditions(
    methods: Sequence[str],
    sensings: Sequence[str],
    schedulers: Sequence[str],
    sizes: Sequence[int],
    starts: Sequence[str] = (RANDOM,),
    known: Sequence[str] = (),
) -> list[Condition]:
    """Returns every combination, in the order of the table.

    Args:
        methods: Names of methods; baselines of one's own as "module:Class".
        sensings: Names of `SENSINGS`, or "module:Class".
        schedulers: Names of `SCHEDULERS`, or "module:Class".
        sizes: Swarm sizes.
        starts: Names of `given_starts.start_names`, or "module:Class"; swarms too small for a family are left out of
            it.
        known: The methods that there are.

    Raises:
        InputError: A name is unknown; the message lists the known ones.
    """
    choices: tuple[tuple[Any, Sequence[str], Any], ...] = (
        (Baseline, methods, known),
        (Sensing, sensings, SENSINGS),
        (Scheduler, schedulers, SCHEDULERS),
        (Start, starts, start_names()),
    )
    for kind, words, names in choices:
        for word in words:
            config_io.find_named(kind, word, tuple(names), kind.section)
    for robots in sizes:
        check_number("robots", robots, 2, 1000, integer=True)
    fitting = [(start, robots) for start in starts for robots in sizes if start != "rings" or robots >= 4]
    if not fitting:
        raise InputError("robots", sizes[0], "at least 4 for the start rings")
    return [
        Condition(method, sensing, scheduler, robots, start)
        for start, sensing, scheduler, robots, method in itertools.product(starts, sensings, schedulers, sizes, methods)
        if (start, robots) in fitting
    ]


def compare(
    comparison: Comparison,
    wanted: Sequence[Condition],
    runs: Mapping[str, Mapping[str, Run]],
    folder: str | Path,
    executor: Executor | None = None,
    *,
    command: str | None = None,
    quiet: bool = True,
) -> list[dict[str, Any]]:
    """Evaluates every condition that the folder does not hold yet; each is kept there as soon as it is done.

    Conditions may differ in their number of starts: one with more than are asked for is not evaluated again.

    Args:
        comparison: What is compared.
        wanted: The conditions.
        runs: Learned methods by name, the run for each sensing; the other methods are baselines.
        folder: Where comparison.json is, or will be.
        executor: Where conditions are evaluated; by default in this process, one after the other.
        command: The command line that evaluates them, to be kept in comparison.json.
        quiet: Show nothing.

    Returns:
        The rows of the table, one for each condition.

    Raises:
        RunError: The folder holds another comparison, or cannot be written to, or a condition failed.
    """
    check_type("comparison", comparison, Comparison, "a comparison")
    check_path("folder", folder)
    folder = Path(folder)
    path, settings = folder / COMPARISON, _settings(comparison, wanted, runs)
    rows = _read_rows(path, settings) if path.exists() else {}
    before = load(folder) if path.exists() else {}
    for name in _BY_NAME:
        settings[name] = {**before.get(name, {}), **settings[name]}
    settings["commands"] = list(
        dict.fromkeys([*before.get("commands", []), *([printable(command)] if command else [])])
    )
    jobs = {}
    for condition in wanted:
        run = runs[condition.method][condition.sensing] if condition.method in runs else None
        if run is not None:
            run.check_size(condition.robots)
        if condition not in rows or rows[condition]["episodes"] < comparison.episodes:
            job = ConditionJob(folder / JOBS / _file_name(str(condition)), comparison, condition, run)
            jobs[job.name] = job
    _check_jobs(list(jobs.values()))
    is_new = not folder.exists()
    files.make_folder(folder)
    with locked(files.inside(folder, JOBS)):
        for old in (folder / JOBS).iterdir():
            # Left over from a comparison that was interrupted, perhaps with other weights. A link is refused: the row
            # of its condition would be written where it leads.
            if files.inside(folder, f"{JOBS}/{old.name}").is_dir():
                shutil.rmtree(old, ignore_errors=True)

        def keep(name: str) -> None:
            job = jobs[name]
            if job.is_finished():
                rows[job.condition] = files.read_json(job.folder / ROW)
                files.write_json(path, {**settings, "rows": list(rows.values())})

        try:
            statuses = run_jobs(list(jobs.values()), executor or InProcess(), on_end=keep, quiet=quiet)
        finally:
            shutil.rmtree(folder / JOBS, ignore_errors=True)
            if is_new and not path.exists():
                with contextlib.suppress(OSError):
                    folder.rmdir()
        if rows:
            files.write_json(path, {**settings, "rows": list(rows.values())})
    failed = [f"{name}: {status.error}" for name, status in statuses.items() if status.state == "failed"]
    if failed:
        raise RunError(failed[0] + (f" (and {len(failed) - 1} more conditions)" if len(failed) > 1 else ""))
    return [rows[condition] for condition in wanted]


@dataclass(frozen=True, eq=False)
class ConditionJob(Job):
    """The evaluation of one condition.

    Attributes:
        folder: Where the row is written.
        comparison: The comparison.
        condition: The condition.
        learned: The run of the method; None for a baseline.
    """

    folder: Path
    comparison: Comparison
    condition: Condition
    learned: Run | None = None

    @property
    def name(self) -> str:
        """See `Job`."""
        return str(self.condition)

    def is_finished(self) -> bool:
        """See `Job`."""
        return (self.folder / ROW).is_file()

    def run(self, on_progress: Any = None) -> None:
        """See `Job`."""
        self.prepare()
        # In a worker process nobody listens: the driver reads how far it is from the folder.
        problem = self.comparison.problem(self.condition, self.learned.experiment if self.learned else None)
        report = on_progress or self._write_progress
        row = _evaluate(self.comparison, problem, self.condition, self._policies(), report)
        files.write_json(self.folder / ROW, row)

    def _write_progress(self, work: str, done: int, total: int, **_: Any) -> None:
        files.write_json(self.folder / PROGRESS, {"work": work, "done": done, "total": total})

    def progress(self) -> Progress | None:
        """See `Job`."""
        path = self.folder / PROGRESS
        if not path.is_file():
            return None
        known = files.read_json(path)
        return Progress(known["work"], known["done"], known["total"], None, None, None)

    def _policies(self) -> tuple[Any, ...]:
        if self.learned is not None:
            return self.learned.cascade.policies
        return (_build_baseline(self.condition.method, self.comparison.problem(self.condition)),)

    def fields(self) -> dict[str, Any]:
        """See `Job`."""
        return {
            "base": config_io.to_dict(self.comparison.base),
            "episodes": self.comparison.episodes,
            "seed": self.comparison.seed,
            "condition": asdict(self.condition),
            "learned": None if self.learned is None else str(self.learned.folder.resolve()),
        }

    @classmethod
    def from_spec(cls, fields: Mapping[str, Any]) -> ConditionJob:
        """See `Job`."""
        base = config_io.from_dict(ExperimentConfig, fields["base"], importer=make_importer(fields["base"]))
        comparison = Comparison(base, fields["episodes"], fields["seed"])
        learned = None if fields["learned"] is None else Run.open(fields["learned"], trust=True)
        return cls(Path(fields["folder"]), comparison, Condition(**fields["condition"]), learned)

    def result(self) -> str:
        """See `Job`."""
        row = files.read_json(self.folder / ROW)
        return f"{row['valid'] / row['episodes']:.1%} valid"


def load(folder: str | Path) -> dict[str, Any]:
    """Reads a comparison.

    Raises:
        RunError: It is missing or damaged.
    """
    check_path("folder", folder)
    path = files.inside(folder, COMPARISON)
    comparison = files.read_json_object(path)
    rows, commands = comparison.get("rows"), comparison.setdefault("commands", [])
    if not isinstance(rows, list) or len(rows) > MAX_ROWS:
        raise RunError(f"{path} is not a comparison")
    if not isinstance(commands, list) or not all(_is_command(command) for command in commands):
        raise RunError(f"{path} is damaged: its commands are not those of murmurate compare")
    if not isinstance(comparison.setdefault("weights", {}), dict):
        raise RunError(f"{path} is damaged: its weights are not named")
    known = functools.cache(functools.partial(_best_known, comparison))
    for number, row in enumerate(rows, 1):
        wrong = _wrong_field(row)
        if wrong is not None:
            value = row.get(wrong) if isinstance(row, dict) else row
            raise RunError(f"{path} is damaged: row {number} has {wrong} = {shown(value)}")
        if "best_known" not in row:  # version 0.1.0 wrote the gap alone
            row["best_known"] = known(row["robots"])
    return comparison


def _best_known(comparison: Mapping[str, Any], robots: int) -> float | None:
    """Returns the objective of the best-known pattern of a comparison that was read; None where none is known."""
    try:
        return best_known(Target(scaled_to(WorldConfig(**comparison["world"]), robots), comparison["objective"]))
    except (InputError, KeyError, TypeError):
        return None


def _is_command(value: Any) -> bool:
    return isinstance(value, str) and value.isprintable() and len(value) <= 10_000


def _wrong_field(row: Any) -> str | None:
    """Returns the first field of a row of comparison.json that is missing or not what it should be; None if all are."""
    if not isinstance(row, dict):
        return "a value"
    names = ("valid", "collisions", "left", "hidden", "restless")
    if "unsteady" in row:  # version 0.1.0 did not watch patterns after rest
        names += ("unsteady",)
    counts = dict.fromkeys(names, row.get("episodes"))
    for name, high in {"robots": MAX_ROBOTS, "episodes": MAX_EPISODES, **counts}.items():
        value, low = row.get(name), 0 if name in counts else {"robots": 2}.get(name, 1)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            return name
    for name, allowed in {"sensing": SENSINGS, "scheduler": SCHEDULERS, "start": start_names()}.items():
        value = row.get(name)
        if not isinstance(value, str) or len(value) > 255 or not (value in allowed or config_io.is_class_name(value)):
            return name
    if not isinstance(row.get("method"), str) or not 0 < len(row["method"]) <= 255:
        return "method"
    for name in ("steps", "epochs", "efficiency", "gap", "best_known", "interventions"):
        value = row.get(name, None if name in ("best_known", "interventions") else "")
        if value is not None and not files.is_number(value):
            return name
    interval, worst = row.get("interval"), row.get("worst")
    if not isinstance(interval, list) or len(interval) != 2 or not all(map(_is_share, interval)):
        return "interval"
    if not isinstance(worst, list) or not all(_is_failure(failure, row["robots"]) for failure in worst):
        return "worst"
    return None


def _is_share(value: Any) -> bool:
    return files.is_number(value) and 0 <= value <= 1


def _is_failure(failure: Any, robots: int) -> bool:
    if not isinstance(failure, dict) or not isinstance(failure.get("free"), bool):
        return False
    points = failure.get("positions")
    return isinstance(points, list) and len(points) == robots and all(map(_is_point, points))


def _is_point(point: Any) -> bool:
    if not isinstance(point, list) or len(point) != 2:
        return False
    return all(files.is_number(value) and abs(value) <= MAX_MAGNITUDE for value in point)


def sorted_rows(folder: str | Path) -> list[dict[str, Any]]:
    """Returns all rows that a folder holds, in the order of the table: learned methods before baselines.

    Raises:
        RunError: They are missing or damaged.
    """
    orders = {"start": start_names(), "sensing": tuple(SENSINGS), "scheduler": tuple(SCHEDULERS)}
    baselines = {name: index for index, name in enumerate(Baseline.registered(), start=1)}

    def key(row: dict[str, Any]) -> tuple[Any, ...]:
        method = baselines.get(row["method"], len(baselines) + 1 if is_baseline(row["method"]) else 0)
        levels = ((*names, row[name]).index(row[name]) for name, names in orders.items())
        classes = (row[name] for name in orders)
        return (*levels, *classes, row["robots"], method, row["method"])

    return sorted(load(folder)["rows"], key=key)


_BY_NAME: dict[str, Any] = {
    "sensings": Sensing, "schedulers": Scheduler, "starts": Start, "weights": None, "baselines": None,
}  # fmt: skip
"""The settings that are tables by name, with the kinds of their strategies. Rows are told apart by these names, so
entries that only one of two comparisons has do no harm."""


def _settings(
    comparison: Comparison, wanted: Sequence[Condition], runs: Mapping[str, Mapping[str, Run]]
) -> dict[str, Any]:
    """Returns what the rows of a folder depend on besides their conditions, as comparison.json has it."""
    base = comparison.base
    world = {name: value for name, value in asdict(base.world).items() if name != "collision_penalty"}
    sensings = dict.fromkeys((*SENSINGS, *(condition.sensing for condition in wanted)))
    schedulers = dict.fromkeys((*SCHEDULERS, *(condition.scheduler for condition in wanted)))
    starts = dict.fromkeys(condition.start for condition in wanted)
    return {
        "objective": base.objective,
        "signals": {name: config_io.to_dict(signal) for name, signal in base.signals.items()},
        "valid": dict(base.valid),
        "world": world,
        "rest": {name: value for name, value in asdict(base.rest).items() if name not in ("dead_zone", "damping")},
        "shield": config_io.to_dict(base.shield),
        "seed": comparison.seed,
        "sensings": {name: config_io.to_dict(comparison.sensing(name)) for name in sensings},
        "schedulers": {name: config_io.to_dict(comparison.scheduler(name)) for name in schedulers},
        "starts": {name: config_io.to_dict(comparison.start(name)) for name in starts},
        "weights": {
            f"{name}, {sensing}": _fingerprint(run)
            for name, by_sensing in runs.items()
            for sensing, run in by_sensing.items()
        },
        "baselines": {
            condition.method: _slow_moves(find_baseline(condition.method))
            for condition in wanted
            if condition.method not in runs
        },
    }


def _fingerprint(run: Run) -> str:
    return hashlib.sha256(files.to_json(trained_checksums(run.manifest)).encode()).hexdigest()[:16]


def _file_name(text: str) -> str:
    return f"{re.sub(r'[^A-Za-z0-9]+', '-', text)[:80]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def _read_rows(path: Path, settings: Mapping[str, Any]) -> dict[Condition, dict[str, Any]]:
    """Reads the rows of a comparison.json by their conditions.

    Raises:
        RunError: It is of another comparison, or damaged.
    """
    recorded = load(path.parent)
    for name, value in settings.items():
        old = recorded.get(name)
        same = old == value
        if name in _BY_NAME and isinstance(old, dict):
            kind = _BY_NAME[name]
            same = all(key not in old or _is_same(kind, old[key], new) for key, new in value.items())
        if not same:
            if isinstance(old, dict) and isinstance(value, dict):
                field = next(key for key in {**value, **old} if old.get(key) != value.get(key))
                name, old, value = f"{name}.{field}", old.get(field), value.get(field)
            what = f"{name} is {shown(old)} there, {shown(value)} here"
            raise RunError(f"{path} holds another comparison: {what}; choose another folder")
    names = Condition.__dataclass_fields__
    return {Condition(*(row[name] for name in names)): row for row in recorded["rows"]}


def _is_same(kind: Any, old: Any, new: Any) -> bool:
    """Returns whether an entry of a table of settings is the recorded one, whatever version wrote that."""
    if old == new or kind is None:
        return old == new
    # Nothing that only the folder names is imported: it is not trusted.
    importer = Importer(trusted=False)
    with contextlib.suppress(InputError):
        old, new = (config_io.from_dict(kind, fields, importer=importer) for fields in (old, new))
        return config_io.to_dict(old) == config_io.to_dict(new)
    return False


@prng.reproducible()
def _check_jobs(jobs: Sequence[ConditionJob]) -> None:
    """Checks the starts, and evaluates what is not of this package once, so that nothing is begun with a faulty part.

    Raises:
        InputError: A start is impossible, or a class returns another shape or type, or numbers that are not finite.
    """
    checked = set()
    for job in jobs:
        comparison, condition = job.comparison, job.condition
        names = (condition.start, condition.sensing, condition.scheduler)
        if (*names, condition.robots) not in checked:
            checked.add((*names, condition.robots))
            problem, start = comparison.problem(condition), comparison.start(condition.start)
            if start.is_foreign():
                check_start(start, problem.world)
            else:
                start.prepare(problem.world)
            if any(map(config_io.is_class_name, names[1:])):
                check_parts(problem)
        if job.learned is None and (condition.method, condition.robots) not in checked:
            checked.add((condition.method, condition.robots))
            _check_baseline(condition.method, comparison.problem(condition))


def _build_baseline(method: str, problem: ExperimentConfig) -> Baseline:
    """Builds a baseline for a problem.

    Raises:
        InputError: A further field of it has no default, or it cannot be built.
    """
    baseline = find_baseline(method)
    for field in baseline.__dataclass_fields__.values():
        if field.name not in ("world", "landmark") and field.default is field.default_factory is MISSING:
            raise InputError("method", method, f"a class whose field {field.name} has a default")
    try:
        return baseline(problem.world, problem.landmark)
    except InputError:
        raise
    except Exception as error:  # a user's class may raise anything
        raise _broken(method, error) from None


def _check_baseline(method: str, problem: ExperimentConfig) -> None:
    """Evaluates a baseline that is not of this package from two starts.

    Raises:
        InputError: It cannot be evaluated, or returns another shape or type, or velocities that are not finite.
    """
    baseline = _build_baseline(method, problem)
    if not baseline.is_foreign():
        return
    cascade, world = build_cascade(problem, (baseline,)), problem.world
    starts = draw_starts(cascade.world.start, prng.key(0), 2, world)
    positions = jnp.moveaxis(jnp.asarray(starts), 0, -1)
    try:
        # As in a rollout, it is compiled: a class may work on numbers and not under a jit.
        velocities = eqx.filter_jit(lambda: baseline(cascade.env.observe(cascade.env.state(positions))))()
    except InputError:
        raise
    except Exception as error:  # a user's class may raise anything
        raise _broken(method, error) from None
    shape, dtype = getattr(velocities, "shape", None), getattr(velocities, "dtype", type(velocities).__name__)
    if shape != positions.shape or dtype != positions.dtype:
        have = f"{dtype}{list(shape)}" if shape is not None else dtype
        wanted = f"{positions.dtype}{list(positions.shape)} for 2 configurations, not {have}"
        raise InputError("method", method, f"a class whose __call__ returns {wanted}")
    _check_finite(method, velocities)


def _broken(method: str, error: Exception) -> InputError:
    reason = one_line(f"{type(error).__name__}: {error}", 300)
    return InputError("method", method, f"a class that can be evaluated ({reason})")


def _check_finite(method: str, numbers: Any) -> None:
    if not np.isfinite(np.asarray(numbers)).all():
        raise InputError("method", method, "one whose velocities are finite numbers")


@prng.reproducible()
def _evaluate(
    comparison: Comparison,
    problem: ExperimentConfig,
    condition: Condition,
    policies: tuple[Any, ...],
    report: Callable[..., None],
) -> dict[str, Any]:
    """Runs a method under one condition, and returns its row of the table."""
    parts, done = [], 0
    for batch in _rollouts(comparison, problem, policies, condition.start, report):
        _check_finite(condition.method, batch.final)
        parts.append(_measure(problem, batch))
        done += len(batch.lengths)
        report("episodes", done, comparison.episodes)
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    valid, count = joined["valid"], len(joined["valid"])
    known = best_known(Target(problem.world, problem.objective)) if problem.has_paper_objective else None
    # Contacts before hidden robots; of each, those with the fewest visible pairs.
    failures = np.flatnonzero(~valid)
    badness = joined["visible"][failures] + 2.0 * joined["free"][failures]
    worst = failures[np.argsort(badness, kind="stable")][:MAX_WORST]

    def mean(name: str) -> float | None:
        return float(joined[name][valid].mean()) if valid.any() else None

    value = mean("objective")
    return {
        **asdict(condition),
        "episodes": count,
        "valid": int(valid.sum()),
        "interval": list(wilson(int(valid.sum()), count)),
        "collisions": int(joined["collided"].sum()),
        "left": int(joined["left"].sum()),
        "hidden": int((joined["free"] & ~joined["seen"]).sum()),
        "unsafe": int((joined["free"] & ~joined["safe"]).sum()),
        "restless": int((joined["free"] & ~joined["rest"]).sum()),
        "unsteady": int((joined["formed"] & ~valid).sum()),
        "steps": mean("steps"),
        "epochs": mean("epochs"),
        "efficiency": mean("efficiency"),
        "interventions": float(joined["interventions"].mean()),
        "best_known": known,
        "gap": None if known is None or value is None else known - value,
        "worst": [{"positions": joined["final"][i].round(3).tolist(), "free": bool(joined["free"][i])} for i in worst],
    }


def _rollouts(
    comparison: Comparison,
    problem: ExperimentConfig,
    policies: tuple[Any, ...],
    start: str = RANDOM,
    report: Callable[..., None] = lambda *_, **__: None,
) -> Iterator[Trajectories]:
    """Executes a method from all starts, as many at a time as memory holds; every method from the same."""
    cascade = build_cascade(problem, policies)
    size = min(max(MAX_PAIRS // problem.world.robots**2, 8), comparison.episodes)
    key = jax.random.fold_in(jax.random.fold_in(prng.key(comparison.seed), _HELD_OUT), problem.world.robots)
    usual_steps = problem.usual_steps(len(policies), size)
    batches = range(0, comparison.episodes, size)
    draw = _draws(problem.world, comparison.start(start), start, key, len(batches) * size)
    for first in batches:
        starts = draw(first, size)
        # Each batch of each seed has frames, noise and a scheduler of its own.
        seed = (comparison.seed * MAX_EPISODES + first) % 2**32
        on_chunk = progress.on_chunk(report, "episodes", comparison.episodes, usual_steps, first)
        batch = rollout(cascade, starts, seed, on_chunk)
        yield _first_episodes(batch, comparison.episodes - first)


def _draws(
    world: WorldConfig, start: Start, name: str, key: PRNGKeyArray, count: int
) -> Callable[[int, int], Float[np.ndarray, "episodes robots 2"]]:
    """Returns what gives the starts from a number on, of so many in all."""
    if name in SETS:
        points = draw_set(name, world, count)
        return lambda first, size: points[first : first + size]
    prepared = start.prepare(world)
    return lambda first, size: draw_starts(prepared, jax.random.fold_in(key, first), size, world)


def _first_episodes(batch: Trajectories, count: int) -> Trajectories:
    return Trajectories(
        **{name: value[:count] for name, value in vars(batch).items() if name != "signals"},
        signals={name: value[:count] for name, value in batch.signals.items()},
    )


def _measure(problem: ExperimentConfig, batch: Trajectories) -> dict[str, np.ndarray]:
    """Measures every episode."""
    validity, world = check_validity(batch, problem.world, problem.thresholds), problem.world
    ends = zip(batch.positions[:, 0], batch.final, strict=True)
    bound = np.array([bound_steps(first, last, world.max_speed) for first, last in ends])
    return {
        "valid": validity.valid,
        "free": validity.contact_free & validity.inside,
        "collided": ~validity.contact_free,
        "left": ~validity.inside,
        "seen": validity.mutually_visible,
        "safe": validity.safe,
        "rest": validity.at_rest,
        "formed": validity.formed,
        "visible": _visible_fraction(batch.final, world),
        "steps": batch.lengths,
        "epochs": batch.epochs,
        "efficiency": bound / np.maximum(batch.lengths, 1),
        "interventions": np.asarray(batch.interventions, np.int32),
        "objective": np.sum([values[:, -1] for values in batch.signals.values()], axis=0),
        "final": batch.final,
    }


def _visible_fraction(final: Float[np.ndarray, "episodes robots 2"], world: WorldConfig) -> np.ndarray:
    _, seen = neighbors_and_visible(final, world.radius, world.scan_radius)
    return seen.sum(axis=(1, 2)) / (world.robots * (world.robots - 1))
