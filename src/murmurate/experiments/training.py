"""A discovery from start to finish: trains, keeps checkpoints, evaluates, and leaves a run folder."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax

from murmurate import __version__
from murmurate.discovery import Discovery, policy_name
from murmurate.experiments import checkpoint, storage, trees
from murmurate.experiments import config as configuration
from murmurate.experiments.checkpoint import Checkpoint
from murmurate.experiments.config import ExperimentConfig
from murmurate.experiments.evaluation import EPISODES, evaluate
from murmurate.experiments.run import METRICS, Run, policy_files

__all__ = ["NOTHING_VALID", "VALID", "discover"]

VALID = "valid patterns discovered"
NOTHING_VALID = "no valid pattern was discovered"


def discover(
    config: ExperimentConfig,
    folder: str | Path,
    resume: bool = False,
    on_progress: Callable[..., None] | None = None,
) -> Run:
    """Runs Algorithm 2 and leaves everything it produced in a folder.

    The folder always holds a run that can be continued: killed at any moment, it loses the updates since the last chunk
    and ends, resumed, in the same weights.

    Args:
        config: What to discover, and how.
        folder: The run folder, to be created.
        resume: Continue what the folder holds; a finished run is only opened.
        on_progress: Called as `on_progress(work, done, total, **values)` whenever there is something new to tell.

    Returns:
        The finished run; `manifest["outcome"]` says whether there was a valid pattern.

    Raises:
        InputError: The experiment is impossible; nothing has been written.
        RunError: The folder holds another run, is damaged, or cannot be written to.
    """
    folder, tell = Path(folder), on_progress or (lambda *_, **__: None)
    storage.look(folder, resume)
    discovery = Discovery(config)
    found = storage.claim(folder, resume)
    if found != "new":
        configuration.check_same(config, folder)
    if found == "finished":
        checkpoint.remove(folder)
        return Run.open(folder)
    configuration.save(config, folder)
    point = _train(discovery, folder, checkpoint.load(folder, discovery), tell)
    return _finish(discovery, config, folder, point, tell)


def _train(discovery: Discovery, folder: Path, point: Checkpoint, tell: Callable[..., None]) -> Checkpoint:
    """Goes on from a checkpoint until the list of policies is complete."""
    storage.truncate_lines(folder / METRICS, point.rows)
    if not point.snapshot.finished:
        _tell(discovery, point, tell, note="compiling")
    while not point.snapshot.finished:
        before = point
        point, rows = _advance(discovery, before)
        # Rows first: those beyond the checkpoint are cut off on resuming, but missing ones could not be made up.
        storage.append_lines(folder / METRICS, rows)
        checkpoint.save(folder, point)
        last = rows[-1]
        values = {"reward": last["reward"], "visible": last["signals"]["visible"]}
        if point.snapshot.train is None:
            values["valid"] = point.snapshot.valid
        _tell(discovery, before, tell, last["update"], steps_per_second=last["steps_per_second"], **values)
    return point


def _advance(discovery: Discovery, point: Checkpoint) -> tuple[Checkpoint, list[dict[str, Any]]]:
    """Runs one chunk of updates and completes its rows of metrics."""
    begun = time.perf_counter()
    snapshot, rows = discovery.advance(point.snapshot)
    took = time.perf_counter() - begun
    index, problem = len(point.snapshot.policies), discovery.problem
    earlier = _environment_steps(discovery, index)
    done = [
        {
            "environment_steps": earlier + row.pop("policy_steps"),
            **row,
            "objective": sum(row["signals"].values()),
            "steps_per_second": len(rows) * problem.stage(index).steps_per_update / took,
            "seconds": point.seconds + took * (place + 1) / len(rows),
        }
        for place, row in enumerate(rows)
    ]
    return replace(point, snapshot=snapshot, rows=point.rows + len(rows), seconds=point.seconds + took), done


def _environment_steps(discovery: Discovery, policies: int) -> int:
    """Counts the steps that training the first policies of the list took; evaluations are not training."""
    stages = [discovery.problem.stage(index) for index in range(policies)]
    return sum(stage.ppo.updates * stage.steps_per_update for stage in stages)


def _tell(discovery: Discovery, point: Checkpoint, tell: Callable[..., None], done: int = 0, **values: Any) -> None:
    index = len(point.snapshot.policies)
    work = f"{policy_name(index)} policy{f' {index}' if index > 1 else ''}"
    if not done and point.snapshot.train is not None:
        done = int(point.snapshot.train.update)
    tell(work, done, discovery.problem.stage(index).ppo.updates, **values)


def _finish(
    discovery: Discovery, config: ExperimentConfig, folder: Path, point: Checkpoint, tell: Callable[..., None]
) -> Run:
    """Writes policies, evaluation and, last of all, the manifest: from then on the run is finished."""
    snapshot = point.snapshot
    tell("evaluation", 0, EPISODES, note=f"{EPISODES} fresh starts")
    files = policy_files(len(snapshot.policies))
    storage.make_folder(folder / "policies")
    for file, policy in zip(files, snapshot.policies, strict=True):
        trees.save(folder / file, policy)
    run = Run(folder, config, discovery.cascade(snapshot.policies), {})
    evaluation = evaluate(run)
    evaluation.save(folder)
    tell("evaluation", EPISODES, EPISODES, valid=float(evaluation.verdict.valid.mean()))
    kept = [storage.EXPERIMENT, *([configuration.STARTS] if config.start.file else []), *files]
    discovered = len(snapshot.sigma) > 0 and bool(evaluation.verdict.valid.any())
    manifest = {
        "format": storage.FORMAT,
        "murmurate": __version__,
        "versions": storage.versions(),
        "platform": platform.platform(),
        "device": jax.devices()[0].device_kind,
        "seed": config.seed,
        "experiment": config.name,
        "robots": config.world.robots,
        "outcome": VALID if discovered else NOTHING_VALID,
        "policies": [policy_name(index) for index in range(len(files))],
        "environment_steps": _environment_steps(discovery, len(files)),
        "train_seconds": round(point.seconds, 3),
        "checksums": storage.checksums(folder, kept),
    }
    storage.write_json(folder / storage.MANIFEST, manifest)
    checkpoint.remove(folder)
    return replace(run, manifest=manifest)
