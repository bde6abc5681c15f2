"""A search from start to finish: trains, keeps checkpoints, evaluates, and leaves a run folder."""

from __future__ import annotations

import functools
import platform
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax

from murmurate import __version__, prng
from murmurate.discovery import Search, advance_together, build_cascade, check_parts, policy_name
from murmurate.errors import RunError
from murmurate.learning import sharding
from murmurate.runs import checkpoint, serialization, storage
from murmurate.runs import experiment as configuration
from murmurate.runs.checkpoint import Checkpoint
from murmurate.runs.evaluate import EPISODES, Evaluation, evaluate
from murmurate.runs.experiment import ExperimentConfig
from murmurate.runs.run import METRICS, Run, policy_files
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


@prng.reproducible()
def discover_together(
    configs: Mapping[Path, ExperimentConfig],
    resume: bool = False,
    on_progress: Callable[..., None] | None = None,
    on_metrics: Callable[[Path], None] | None = None,
) -> list[Run]:
    """Runs many searches side by side, those of the same shapes in one compiled program, each to its own folder.

    Meant for an accelerator, which one search does not keep busy; on a CPU it takes longer than one after the other.

    With several hosts (`murmurate.learning.sharding`) every process calls it with the same arguments. Process 0 alone
    writes; to resume, the others read the folder too, so it must be on a file system that all of them share.

    Args:
        configs: What to discover, and how, by the run folder.
        resume: Continue what the folders hold.
        on_progress: See `discover`; told of is the search that is furthest behind, with means over all.
        on_metrics: See `discover`; called for every folder.

    Returns:
        The finished runs, in the order of the folders.

    Raises:
        InputError: An experiment is impossible; nothing has been written.
        RunError: A folder holds another run, is damaged, cannot be written to, or is not the same on all hosts.
    """
    return _discover(configs, resume, on_progress or (lambda *_, **__: None), on_metrics or (lambda folder: None))


def _discover(
    configs: Mapping[Path, ExperimentConfig],
    resume: bool,
    tell: Callable[..., None],
    watch: Callable[[Path], None],
) -> list[Run]:
    sharding.check_agreement("the experiment: give all of them the same command", repr(list(configs.items())).encode())

    def check_folders() -> None:
        for folder, config in configs.items():
            if storage.look(folder, resume) != "new":
                configuration.check_same(config, folder)

    sharding.run_on_first(check_folders)
    searches = {folder: Search(config) for folder, config in configs.items()}
    for search in searches.values():
        check_parts(search.problem)
        search.check_devices()
    works = []
    for folder, search in searches.items():
        sharding.run_on_first(functools.partial(_prepare, configs[folder], folder, resume))
        # From here on every process reads the folder, which process 0 has prepared.
        if storage.look(folder, resume=True) == "finished":
            watch(folder)
            continue
        point = checkpoint.load(folder, search)
        sharding.check_agreement(
            f"the checkpoint in {folder}: to resume, put it on a file system that all of them share",
            repr((point.rows, point.seconds)).encode(),
        )
        works.append(_Work(configs[folder], folder, search, point))
        watch(folder)
    ran = {work.folder: _finish(work, tell) for work in _train(works, tell, watch)}
    return [ran.get(folder) or Run.open(folder) for folder in configs]


def _prepare(config: ExperimentConfig, folder: Path, resume: bool) -> None:
    """Creates a run folder, or brings an interrupted one back to its last checkpoint."""
    if storage.claim(folder, resume) == "finished":
        checkpoint.remove(folder)
        return
    configuration.save(config, folder)
    storage.truncate_lines(folder / METRICS, checkpoint.rows(folder))


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
    for row in (row for _, rows in advanced for row in rows):
        if not row.pop("finite"):
            # The checkpoint before this chunk stays, so other numbers can be tried from there.
            raise RunError(
                f"training of the {row['name']} policy failed at update {row['update']}: a loss or a parameter is NaN "
                "or infinite; try smaller learning rates"
            )
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
        sharding.run_on_first(functools.partial(_write, work.folder, done, point))
        after.append(replace(work, point=point))
        last.append(done[-1])
    return after, last


def _write(folder: Path, rows: Sequence[Mapping[str, Any]], point: Checkpoint) -> None:
    # Rows first: those beyond the checkpoint are cut off on resuming, but missing ones could not be made up.
    storage.append_lines(folder / METRICS, rows)
    checkpoint.save(folder, point)


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
    """Evaluates on every process, and writes on process 0."""
    tell("evaluation", 0, EPISODES, note=f"{EPISODES} fresh starts")
    run = Run(work.folder, work.config, build_cascade(work.config, work.point.snapshot.policies), {})
    evaluation = evaluate(run)
    manifest = sharding.run_on_first(functools.partial(_write_results, work, evaluation, tell))
    return replace(run, manifest=manifest or {})


def _write_results(work: _Work, evaluation: Evaluation, tell: Callable[..., None]) -> dict[str, Any]:
    """Writes policies, evaluation and, last of all, the manifest: from then on the run is finished."""
    search, config, folder, point = work.search, work.config, work.folder, work.point
    snapshot = point.snapshot
    files = policy_files(len(snapshot.policies))
    storage.make_folder(folder / "policies")
    for file, policy in zip(files, snapshot.policies, strict=True):
        serialization.save(folder / file, policy)
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
    return manifest
