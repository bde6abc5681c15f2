"""A search from start to finish: trains, keeps checkpoints, evaluates, and leaves a run folder."""

from __future__ import annotations

import contextlib
import functools
import json
import math
import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import jax

from murmurate import __version__, prng
from murmurate.discovery import Search, advance_together, build_cascade, check_parts, policy_name, policy_templates
from murmurate.errors import RunError, check_function, check_path, check_type
from murmurate.interrupts import raise_if_interrupted
from murmurate.learning import sharding
from murmurate.policies import PolicyNetwork
from murmurate.runs import config_io, files
from murmurate.runs.evaluate import EPISODES, Evaluation, evaluate
from murmurate.runs.experiment import ExperimentConfig
from murmurate.runs.folder import Checkpoint, FolderState, RunFolder, policy_checksums
from murmurate.runs.run import Run

__all__ = ["begin_with", "check_initial", "discover", "discover_together"]

_QUANTITIES = {"reward": "the reward", "policy_loss": "the policy's loss", "value_loss": "the value network's loss"}
"""What is said to have diverged, by its name in a row of metrics; where all are finite, it is a parameter."""

_PACKAGES = ("jax", "jaxlib", "equinox", "optax", "numpy")
_FLAGS = ("jax_enable_x64", "jax_default_prng_impl", "jax_threefry_partitionable", "jax_default_matmul_precision")
_VARIABLES = ("XLA_FLAGS", "OMP_NUM_THREADS")


def discover(
    config: ExperimentConfig,
    folder: str | Path,
    resume: bool = False,
    on_progress: Callable[..., None] | None = None,
    on_metrics: Callable[[Path], None] | None = None,
    initial: Run | None = None,
) -> Run:
    """Runs Algorithm 2 and leaves everything it produced in a folder.

    The folder always holds a run that can be continued: killed at any moment, it loses the updates since the last chunk
    and ends, resumed, in the same weights.

    Args:
        config: What to discover, and how.
        folder: The run folder, to be created.
        resume: Continue what the folder holds; a finished run is only opened.
        on_progress: Called as `on_progress(work, done, total, **values)` before and after every chunk of updates.
        on_metrics: Called with the folder at the beginning, and whenever its metrics.jsonl has grown.
        initial: A run whose policies the policies of this one begin with, as far as it has any.

    Returns:
        The finished run; `manifest["valid_pattern"]` says whether there was a valid pattern.

    Raises:
        InputError: The experiment is impossible; nothing has been written.
        RunError: The folder holds another run, is damaged, in use, or cannot be written to; the policies of `initial`
            do not fit; or the training diverged.
    """
    check_type("config", config, ExperimentConfig, "an experiment, such as murmurate.experiment('C')")
    check_path("folder", folder)
    check_function("on_progress", on_progress, "on_progress(work, done, total, **values)")
    runs = {} if initial is None else {Path(folder): initial}
    return discover_together({Path(folder): config}, resume, on_progress, on_metrics, runs)[0]


@prng.reproducible()
def discover_together(
    configs: Mapping[Path, ExperimentConfig],
    resume: bool = False,
    on_progress: Callable[..., None] | None = None,
    on_metrics: Callable[[Path], None] | None = None,
    initial: Mapping[Path, Run] | None = None,
) -> list[Run]:
    """Runs many searches side by side, those of the same shapes in one compiled program, each to its own folder.

    Meant for an accelerator, which one search does not keep busy; on a CPU it takes longer than one after the other.

    With several hosts (`murmurate.learning.sharding`) every process calls it with the same arguments. Process 0 alone
    writes; to resume, the others read the folder too, so it must be on a file system that all of them share.

    Args:
        configs: What to discover, and how, by the run folder.
        resume: Continue what the folders hold.
        on_progress: See `discover`; it is given the search that is furthest behind, with means over all.
        on_metrics: See `discover`; called for every folder.
        initial: See `discover`; by the run folder of the search that begins with it.

    Returns:
        The finished runs, in the order of the folders.

    Raises:
        InputError: An experiment is impossible; nothing has been written.
        RunError: See `discover`; or the hosts differ in what they were given.
    """
    on_progress, on_metrics = on_progress or (lambda *_, **__: None), on_metrics or (lambda _: None)
    initial = initial or {}
    folders = {RunFolder(path): config for path, config in configs.items()}
    command = repr([(str(path), config_io.to_dict(c), _origin(initial.get(path))) for path, c in configs.items()])
    sharding.check_agreement("the experiment: give all of them the same command", command.encode())
    # Everything that can be wrong is checked before anything is written.
    states = _inspect(folders, resume, initial)
    searches = {}
    for folder, config in folders.items():
        if states[folder] != "finished":
            is_new = states[folder] == "new"
            policies = _fit_initial(config, initial.get(folder.path)) if is_new else folder.initial(config)[0]
            searches[folder] = Search(config, policies)
    for search in searches.values():
        check_parts(search.problem)
        search.check_devices()
    with contextlib.ExitStack() as locks:
        trainings = []
        for folder, search in searches.items():
            begun_with = initial.get(folder.path)
            prepare = functools.partial(_prepare, folder, states[folder], search, folders[folder], begun_with)
            locks.enter_context(sharding.run_on_first(prepare) or contextlib.nullcontext())
            # From here on every process reads the folder, which process 0 has prepared.
            checkpoint = folder.checkpoint(search)
            sharding.check_agreement(
                f"the checkpoint in {folder.path}: to resume, put it on a file system that all of them share",
                repr((checkpoint.rows, checkpoint.seconds)).encode(),
            )
            trainings.append(_Training(folders[folder], folder, search, checkpoint))
        for folder in folders:
            on_metrics(folder.path)
        trained = _train(trainings, on_progress, on_metrics)
        finished = {training.folder: _finish(training, on_progress) for training in trained}
    return [finished.get(folder) or _open(folder, config) for folder, config in folders.items()]


@dataclass(frozen=True, eq=False)
class _Training:
    """A search under way.

    Attributes:
        config: What is to be discovered, and how.
        folder: Its run folder.
        search: The search.
        checkpoint: Its progress.
    """

    config: ExperimentConfig
    folder: RunFolder
    search: Search
    checkpoint: Checkpoint

    @property
    def progress(self) -> tuple[int, int, int]:
        """Its progress, to compare: finished policies, and phase and updates of the one in training."""
        snapshot = self.checkpoint.snapshot
        return len(snapshot.policies), snapshot.phase, 0 if snapshot.train is None else int(snapshot.train.update)

    def environment_steps(self, policies: int) -> int:
        """Returns the steps that training the first policies of the list took; evaluations are not training."""
        return sum(map(self.search.curriculum.policy_steps, range(policies)))


# Before the training: what the folders hold, and what the training begins with


def check_initial(configs: Mapping[Path, ExperimentConfig], resume: bool, initial: Mapping[Path, Run]) -> None:
    """Checks that runs can begin with the policies of others, and that those that have begun did.

    Args:
        configs: What each is to discover, and how, by the run folder.
        resume: Continue what the folders hold.
        initial: The runs that they begin with, by the same folders.

    Raises:
        RunError: They cannot, or did not.
    """
    states = _inspect({RunFolder(path): config for path, config in configs.items()}, resume, initial)
    for folder, state in states.items():
        if state == "new":
            _fit_initial(configs[folder.path], initial.get(folder.path))


def begin_with(folder: RunFolder, config: ExperimentConfig, initial: Run) -> None:
    """Writes the policies that a training is to begin with, so that any process can do it without their run.

    Raises:
        RunError: They do not fit, or cannot be written.
    """
    folder.write_initial(_fit_initial(config, initial), _origin(initial))


def _inspect(
    folders: Mapping[RunFolder, ExperimentConfig], resume: bool, initial: Mapping[Path, Run]
) -> dict[RunFolder, FolderState]:
    """Returns what the folders hold on process 0, after checking that they are of these experiments."""

    def inspect() -> list[FolderState]:
        states = []
        for folder, config in folders.items():
            state = folder.inspect(resume)
            if state != "new":
                folder.check_same(config)
                origin = folder.manifest().get("initial") if state == "finished" else folder.initial(config)[1]
                # To resume, the run that the training began with need not be there any more.
                given = initial.get(folder.path)
                if given is not None and origin != _origin(given):
                    raise RunError(f"{folder.path} did not begin with the policies of {given.folder}")
            states.append(state)
        return states

    states = sharding.run_on_first(inspect)
    return dict(zip(folders, json.loads(sharding.broadcast_bytes(json.dumps(states).encode())), strict=True))


def _origin(initial: Run | None) -> dict[str, Any] | None:
    """Returns what a run records about the run that its training began with."""
    if initial is None:
        return None
    sums = policy_checksums(initial.manifest)
    return {"experiment": initial.experiment.name, "seed": initial.experiment.seed, "checksums": sums}


def _fit_initial(config: ExperimentConfig, initial: Run | None) -> tuple[Any, ...]:
    """Returns the policies to begin with, for the world of this experiment, with its units and inputs.

    Raises:
        RunError: They are of other shapes than this experiment's.
    """
    policies = () if initial is None else initial.cascade.policies[: config.discovery.max_policies]
    templates = policy_templates(config, len(policies))
    fitted = []
    for index, (policy, template) in enumerate(zip(policies, templates, strict=True)):
        # A network need not be a PolicyNetwork, which can be widened.
        policy = policy.widened_to(template) if isinstance(policy, PolicyNetwork) else policy
        fitted.append(files.fit_tree(policy, template, f"the {policy_name(index)} policy to begin with"))
    return tuple(fitted)


def _prepare(
    folder: RunFolder, state: FolderState, search: Search, config: ExperimentConfig, initial: Run | None
) -> contextlib.AbstractContextManager[Any]:
    """Creates a run folder, or brings an interrupted one back to its last checkpoint.

    Returns:
        The lock that keeps other processes from training in it.
    """
    with contextlib.ExitStack() as stack:
        folder.create(resume=state != "new")
        stack.enter_context(folder.lock())
        if folder.inspect(resume=True) != state:
            raise RunError(f"{folder.path} has been changed by another process: give the command again")
        if state == "new":
            folder.remove_checkpoint()
            if initial is not None:
                folder.write_initial(search.initial, _origin(initial))
        folder.write_experiment(config)
        folder.truncate_metrics(folder.checkpoint_rows())
        return stack.pop_all()


def _open(folder: RunFolder, config: ExperimentConfig) -> Run:
    """Opens a run that was finished before; its modules are those of the configuration, imported already."""
    manifest = folder.verify()
    folder.remove_checkpoint()
    policies = folder.policies(policy_templates(config, len(manifest["policies"])))
    return Run(folder.path, config, build_cascade(config, policies), manifest)


# The training


def _train(
    trainings: Sequence[_Training], on_progress: Callable[..., None], on_metrics: Callable[[Path], None]
) -> list[_Training]:
    """Trains from checkpoints until every list of policies is complete."""
    trainings = list(trainings)
    running = [index for index, training in enumerate(trainings) if not training.checkpoint.snapshot.finished]
    if running:
        _report([trainings[index] for index in running], on_progress, note="compiling")
    while running:
        raise_if_interrupted()
        before = [trainings[index] for index in running]
        after, rows = _advance(before)
        for index, training in zip(running, after, strict=True):
            trainings[index] = training
            on_metrics(training.folder.path)
        _report(before, on_progress, rows, after)
        running = [index for index in running if not trainings[index].checkpoint.snapshot.finished]
    return trainings


def _advance(trainings: Sequence[_Training]) -> tuple[list[_Training], list[dict[str, Any]]]:
    """Runs one chunk of updates of each and writes what came of it.

    Returns:
        The trainings after it, and the last row of metrics of each.

    Raises:
        RunError: One diverged. Nothing of this chunk is written: the checkpoint before it stays.
    """
    begun = time.perf_counter()
    advanced = advance_together([t.search for t in trainings], [t.checkpoint.snapshot for t in trainings])
    took = time.perf_counter() - begun
    for training, (_, rows) in zip(trainings, advanced, strict=True):
        _check_finite(training, rows)
    after, last_rows = [], []
    for training, (snapshot, rows) in zip(trainings, advanced, strict=True):
        checkpoint = training.checkpoint
        index, phase, _ = training.progress
        curriculum = training.search.curriculum
        before = curriculum.policy_steps(index, phase) + curriculum.steps(index, phase, rows[0]["update"] - 1)
        steps = rows[-1]["policy_steps"] - before
        # Of the time that all took together, each is charged an equal part.
        share = took / len(trainings)
        # What a policy is rewarded for beside the objective is its own: all rows of a run have the same signals.
        signals = training.search.problem.objective_signals
        recorded = [
            {
                "environment_steps": training.environment_steps(index) + row.pop("policy_steps"),
                **row,
                "signals": {name: row["signals"][name] for name in signals},
                "objective": sum(signal.weight * row["signals"][name] for name, signal in signals.items()),
                "steps_per_second": steps / share,
                "seconds": checkpoint.seconds + share * number / len(rows),
            }
            for number, row in enumerate(rows, 1)
        ]
        seconds = checkpoint.seconds + share
        checkpoint = Checkpoint(snapshot, rows=checkpoint.rows + len(rows), seconds=seconds)
        sharding.run_on_first(functools.partial(_write_chunk, training.folder, recorded, checkpoint))
        after.append(replace(training, checkpoint=checkpoint))
        last_rows.append(recorded[-1])
    return after, last_rows


def _check_finite(training: _Training, rows: Sequence[dict[str, Any]]) -> None:
    """Removes the flag `finite` from rows of metrics, and checks it."""
    for row in rows:
        # A signal may be NaN in a step whose losses are finite; the reward is not, then.
        if not row.pop("finite") or not math.isfinite(row["reward"]):
            named = (text for name, text in _QUANTITIES.items() if not math.isfinite(row.get(name, 0.0)))
            quantity = next(named, "a parameter")
            raise RunError(
                f"{training.folder.path}: the training of the {_policy_title(row['policy'])} diverged at update "
                f"{row['update']}: {quantity} is NaN or infinite; the checkpoint before it is kept; try smaller "
                "learning rates"
            )


def _write_chunk(folder: RunFolder, rows: Sequence[Mapping[str, Any]], checkpoint: Checkpoint) -> None:
    # Rows first: those beyond the checkpoint are cut off on resuming, but missing ones could not be made up.
    folder.append_metrics(rows)
    folder.write_checkpoint(checkpoint)


def _report(
    before: Sequence[_Training],
    on_progress: Callable[..., None],
    rows: Sequence[Mapping[str, Any]] = (),
    after: Sequence[_Training] = (),
    **values: Any,
) -> None:
    """Reports the training that is furthest behind, as it was before a chunk, with means over all of them."""
    behind = min(range(len(before)), key=lambda index: before[index].progress)
    policy, phase, done = before[behind].progress
    if rows:
        done = rows[behind]["update"]
        speed = statistics.fmean(row["steps_per_second"] for row in rows)
        values |= {"steps_per_second": speed} if speed else {}  # a search for goals takes no steps
        values["reward"] = statistics.fmean(row["reward"] for row in rows)
        visible = [row["signals"]["visible"] for row in rows if "visible" in row["signals"]]
        values |= {"visible": statistics.fmean(visible)} if visible else {}
    if after and len(after[behind].checkpoint.snapshot.policies) > policy:
        values["valid"] = statistics.fmean(training.checkpoint.snapshot.valid for training in after)
    stage = before[behind].search.problem.stage(policy)
    title = _policy_title(policy) + (", refined" if phase else "")
    work = f"{title} of {len(before)} runs" if len(before) > 1 else title
    on_progress(work, done, stage.learning(phase).updates, **values)


def _policy_title(index: int) -> str:
    return f"{policy_name(index)} policy{f' {index}' if index > 1 else ''}"


# After the training


def _finish(training: _Training, on_progress: Callable[..., None]) -> Run:
    """Evaluates on every process, and writes on process 0."""
    on_progress("evaluation", 0, EPISODES, note=f"{EPISODES} fresh starts")
    cascade = build_cascade(training.config, training.checkpoint.snapshot.policies)
    run = Run(training.folder.path, training.config, cascade, {})
    evaluation = evaluate(run)
    manifest = sharding.run_on_first(functools.partial(_write_results, training, evaluation))
    on_progress("evaluation", EPISODES, EPISODES, valid=float(evaluation.validity.valid.mean()))
    return replace(run, manifest=manifest or {})


def _write_results(training: _Training, evaluation: Evaluation) -> dict[str, Any]:
    """Writes policies, evaluation and, last of all, the manifest: from then on the run is finished."""
    config, folder, snapshot = training.config, training.folder, training.checkpoint.snapshot
    folder.write_policies(snapshot.policies)
    evaluation.save(folder)
    origin = folder.initial(config)[1]
    manifest = folder.write_manifest(
        {
            **_describe_machine(),
            "seed": config.seed,
            "experiment": config.name,
            "robots": config.world.robots,
            **({} if origin is None else {"initial": origin}),
            # Without sigma no later policy could be trained: every episode ended in contact or outside the world.
            "valid_pattern": len(snapshot.sigma) > 0 and bool(evaluation.validity.valid.any()),
            # Those of a last policy that was left out again, too.
            "environment_steps": int(folder.metrics()[-1]["environment_steps"]),
            "train_seconds": round(training.checkpoint.seconds, 3),
        },
        policies=len(snapshot.policies),
    )
    folder.remove_checkpoint()
    return manifest


def _describe_machine() -> dict[str, Any]:
    """Returns what a run's numbers depend on besides its configuration: versions, machine, threads and flags."""
    devices = jax.devices()
    return {
        "murmurate": __version__,
        "versions": {"python": platform.python_version()} | {name: metadata.version(name) for name in _PACKAGES},
        "platform": platform.platform(),
        "cpu": _cpu_name(),
        # XLA sums in as many parts as it has threads, which it takes from the CPUs that this process may use.
        "threads": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "device": devices[0].device_kind,
        "devices": len(devices),
        "flags": {name: getattr(jax.config, name, None) for name in _FLAGS}
        | {name: os.environ[name] for name in _VARIABLES if name in os.environ},
    }


def _cpu_name() -> str:
    with contextlib.suppress(OSError), open("/proc/cpuinfo", encoding="utf-8") as file:
        for line in file:
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()
