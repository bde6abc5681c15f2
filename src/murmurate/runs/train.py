"""A search from start to finish: trains, keeps checkpoints, evaluates, and leaves a run folder."""

from __future__ import annotations

import platform
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax

from murmurate import __version__
from murmurate.discovery import Search, advance_together, build_cascade, check_parts, policy_name
from murmurate.runs import checkpoint, copies, storage, serialization
from murmurate.runs import experiment as configuration
from murmurate.runs.checkpoint import Checkpoint
from murmurate.runs.experiment import ExperimentConfig
from murmurate.runs.evaluate import EPISODES, evaluate
from murmurate.runs.run import METRICS, Run, policy_files
from murmurate.learning import hosts
from murmurate.world import FileStart

__all__ = ["NOTHING_VALID", "VALID", "discover", "discover_together"]

VALID = "valid patterns discovered"
NOTHING_VALID = "no valid pattern was discovered"


def discover(
    config: ExperimentConfig,
    folder: str | Path,
    resume: bool = False,
    on_progress: Callable[..., None] | None = None,
    on_metrics: Callable[[Path], None] | None = None,
) -> Run:
    """Runs Algorithm 2 and leaves everything it produced in a folder.

    The folder always holds a run that can be continued: killed at any moment, it loses the updates since the last chunk
    and ends, resumed, in the same weights.

    Args:
        config: What to discover, and how.
        folder: The run folder, to be created.
        resume: Continue what the folder holds; a finished run is only opened.
        on_progress: Called as `on_progress(work, done, total, **values)` whenever there is something new to tell.
        on_metrics: Called with the folder at the beginning, and whenever its metrics.jsonl has grown.

    Returns:
        The finished run; `manifest["outcome"]` says whether there was a valid pattern.

    Raises:
        InputError: The experiment is impossible; nothing has been written.
        RunError: The folder holds another run, is damaged, or cannot be written to.
    """
    return discover_together({Path(folder): config}, resume, on_progress, on_metrics)[0]


def discover_together(
    configs: Mapping[Path, ExperimentConfig],
    resume: bool = False,
    on_progress: Callable[..., None] | None = None,
    on_metrics: Callable[[Path], None] | None = None,
) -> list[Run]:
    """Runs many searches side by side, those of the same shapes in one compiled program, each to its own folder.

    Meant for an accelerator, which one search does not keep busy; on a CPU it takes longer than one after the other.

    On several hosts (`jax.distributed`) all call it alike and the first one's folder is the run's; see `copies`.

    Args:
        configs: What to discover, and how, by the run folder.
        resume: Continue what the folders hold.
        on_progress: See `discover`; told of is the search that is furthest behind, with means over all.
        on_metrics: See `discover`; called for every folder.

    Returns:
        The finished runs, in the order of the folders.

    Raises:
        InputError: An experiment is impossible; nothing has been written.
        RunError: A folder holds another run, is damaged, or cannot be written to; or another host is gone.
    """
    with hosts.guarded():
        places = {copies.place(folder, resume): config for folder, config in configs.items()}
        return _discover(places, resume, on_progress or (lambda *_, **__: None), on_metrics or (lambda folder: None))


def _discover(
    configs: Mapping[Path, ExperimentConfig],
    resume: bool,
    tell: Callable[..., None],
    watch: Callable[[Path], None],
) -> list[Run]:
    for folder, config in configs.items():
        if storage.look(folder, resume) != "new":
            configuration.check_same(config, folder)
    searches = {folder: Search(config) for folder, config in configs.items()}
    for search in searches.values():
        check_parts(search.problem)
        search.check_devices()
    works = []
    for folder, search in searches.items():
        if storage.claim(folder, resume) == "finished":
            checkpoint.remove(folder)
            watch(folder)
            continue
        configuration.save(configs[folder], folder)
        point = checkpoint.load(folder, search)
        storage.truncate_lines(folder / METRICS, point.rows)
        works.append(_Work(configs[folder], folder, search, point))
        watch(folder)
    ran = {work.folder: _finish(work, tell) for work in _train(works, tell, watch)}
    return [ran.get(folder) or Run.open(folder) for folder in configs]


@dataclass(frozen=True, eq=False)
class _Work:
    """A search under way.

    Attributes:
        config: What is to be discovered, and how.
        folder: Its run folder.
        search: The search.
        point: How far it has come.
    """

    config: ExperimentConfig
    folder: Path
    search: Search
    point: Checkpoint

    @property
    def place(self) -> tuple[int, int]:
        """How far it has come, to compare: policies, and updates of the one in training."""
        snapshot = self.point.snapshot
        return len(snapshot.policies), 0 if snapshot.train is None else int(snapshot.train.update)


def _train(works: Sequence[_Work], tell: Callable[..., None], watch: Callable[[Path], None]) -> list[_Work]:
    """Goes on from checkpoints until every list of policies is complete."""
    works = list(works)
    running = [place for place, work in enumerate(works) if not work.point.snapshot.finished]
    if running:
        _tell([works[place] for place in running], tell, note="compiling")
    while running:
        before = [works[place] for place in running]
        after, rows = _advance(before)
        for place, work in zip(running, after, strict=True):
            works[place] = work
            watch(work.folder)
        _tell(before, tell, rows, after)
        running = [place for place in running if not works[place].point.snapshot.finished]
    return works


def _advance(works: Sequence[_Work]) -> tuple[list[_Work], list[dict[str, Any]]]:
    """Runs one chunk of updates of each and keeps what came of it; returns the last row of metrics of each as well."""
    begun = time.perf_counter()
    advanced = advance_together([work.search for work in works], [work.point.snapshot for work in works])
    took = time.perf_counter() - begun
    after, last = [], []
    for work, (snapshot, rows) in zip(works, advanced, strict=True):
        point, index = work.point, len(work.point.snapshot.policies)
        trained = _environment_steps(work.search, index)
        steps = rows[-1]["policy_steps"] - work.search.curriculum.steps(index, rows[0]["update"] - 1)
        # Of the time that all took together, each is charged an equal part.
        share = took / len(works)
        done = [
            {
                "environment_steps": trained + row.pop("policy_steps"),
                **row,
                "objective": sum(row["signals"].values()),
                "steps_per_second": steps / share,
                "seconds": point.seconds + share * (place + 1) / len(rows),
            }
            for place, row in enumerate(rows)
        ]
        point = replace(point, snapshot=snapshot, rows=point.rows + len(rows), seconds=point.seconds + share)
        # Rows first: those beyond the checkpoint are cut off on resuming, but missing ones could not be made up.
        storage.append_lines(work.folder / METRICS, done)
        checkpoint.save(work.folder, point)
        after.append(replace(work, point=point))
        last.append(done[-1])
    return after, last


def _environment_steps(search: Search, policies: int) -> int:
    """Counts the steps that training the first policies of the list took; evaluations are not training."""
    return sum(search.curriculum.steps(index, search.problem.stage(index).ppo.updates) for index in range(policies))


def _tell(
    works: Sequence[_Work],
    tell: Callable[..., None],
    rows: Sequence[Mapping[str, Any]] = (),
    after: Sequence[_Work] = (),
    **values: Any,
) -> None:
    """Tells of the work that is furthest behind, by what it was before a chunk, and of the means over all of them."""
    behind = min(range(len(works)), key=lambda place: works[place].place)
    index, done = works[behind].place
    if rows:
        done = rows[behind]["update"]
        values["steps_per_second"] = statistics.fmean(row["steps_per_second"] for row in rows)
        values["reward"] = statistics.fmean(row["reward"] for row in rows)
        values["visible"] = statistics.fmean(row["signals"]["visible"] for row in rows)
    if after and after[behind].point.snapshot.train is None:
        values["valid"] = statistics.fmean(work.point.snapshot.valid for work in after)
    name = f"{policy_name(index)} policy{f' {index}' if index > 1 else ''}"
    work = f"{name} of {len(works)} runs" if len(works) > 1 else name
    tell(work, done, works[behind].search.problem.stage(index).ppo.updates, **values)


def _finish(work: _Work, tell: Callable[..., None]) -> Run:
    """Writes policies, evaluation and, last of all, the manifest: from then on the run is finished."""
    search, config, folder, point = work.search, work.config, work.folder, work.point
    snapshot = point.snapshot
    tell("evaluation", 0, EPISODES, note=f"{EPISODES} fresh starts")
    files = policy_files(len(snapshot.policies))
    storage.make_folder(folder / "policies")
    for file, policy in zip(files, snapshot.policies, strict=True):
        serialization.save(folder / file, policy)
    run = Run(folder, config, build_cascade(config, snapshot.policies), {})
    evaluation = evaluate(run)
    evaluation.save(folder)
    tell("evaluation", EPISODES, EPISODES, valid=float(evaluation.validity.valid.mean()))
    kept = [storage.EXPERIMENT, *([configuration.STARTS] if isinstance(config.start, FileStart) else []), *files]
    discovered = len(snapshot.sigma) > 0 and bool(evaluation.validity.valid.any())
    manifest = {
        "format": storage.FORMAT,
        "murmurate": __version__,
        "versions": storage.versions(),
        "platform": platform.platform(),
        "device": jax.devices()[0].device_kind,
        "devices": jax.device_count(),
        "seed": config.seed,
        "experiment": config.name,
        "robots": config.world.robots,
        "outcome": VALID if discovered else NOTHING_VALID,
        "policies": [policy_name(index) for index in range(len(files))],
        "environment_steps": _environment_steps(search, len(files)),
        "train_seconds": round(point.seconds, 3),
        "checksums": storage.checksums(folder, kept),
    }
    storage.write_json(folder / storage.MANIFEST, manifest)
    checkpoint.remove(folder)
    return replace(run, manifest=manifest)
