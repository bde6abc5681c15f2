"""The folder of one run: what it holds, how it is read, and how it is written.

`RunFolder` is the only reader and writer of a run folder:

    experiment.toml      the configuration, every field of it (beside it starts.csv, ..., where its start names files)
    manifest.json        versions, machine, results in short, checksums; written last: it marks a finished run
    policies/            0-base.safetensors, 1-auxiliary.safetensors, ...
    metrics.jsonl        a row for each update
    evaluation.json      how often a valid pattern formed, in how many steps, ...
    trajectories.npz     the episodes of the evaluation
    record.json          a pattern better than the best known, if there is one
    figures/             what has been drawn
    checkpoint/          while the run is being trained

Every file is replaced whole, and no file is ever executed: a run from a stranger is safe to open. Links are not
followed, and the manifest has the checksums of all files, whose names are those above.
"""

from __future__ import annotations

import contextlib
import math
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from murmurate import untrusted
from murmurate.discovery import STATIONARY_STEPS, Search, Snapshot, policy_name, policy_templates
from murmurate.discovery.validity import replaced_conditions
from murmurate.errors import MAX_INTEGER, RunError, check_path, check_type, one_line, shown
from murmurate.representation import short_repr
from murmurate.runs import experiment as configuration
from murmurate.runs import files
from murmurate.runs.experiment import EXPERIMENT, ExperimentConfig, is_start_file
from murmurate.types import Trajectories

__all__ = [
    "MAX_EPISODES",
    "Checkpoint",
    "FolderState",
    "RunFolder",
    "describe_starts",
    "is_fresh",
    "policy_checksums",
    "trained_checksums",
]

FORMAT, OLD_FORMAT = 2, 1
"""The format of manifests, and that of version 0.1.0, whose checksums are of the training's files alone."""

MAX_EPISODES = 10_000
"""Episodes of one evaluation, at most: all of their positions are held in memory."""

MAX_POLICIES = 1000
"""Policies in a list, at most."""

MANIFEST = "manifest.json"
METRICS = "metrics.jsonl"
EVALUATION = "evaluation.json"
TRAJECTORIES = "trajectories.npz"
RECORD = "record.json"
CHECKPOINT = "checkpoint"
POLICIES = "policies"
FIGURES = "figures"
SNAPSHOT, INITIAL = "snapshot.safetensors", "initial.safetensors"
LOCK = ".training.lock"

MAX_NAME = 60
"""Characters of the name of starts that are shown, at most."""

TAIL_BYTES = 1 << 14
"""Bytes at the end of metrics.jsonl that `last_metrics` reads."""

_EVALUATED = (EVALUATION, TRAJECTORIES, RECORD)

FolderState = Literal["new", "unfinished", "finished"]
"""What a folder holds: nothing yet, a run whose training can be continued, or a finished run."""

_FRACTIONS = ("valid", "contact_free", "inside", "mutually_visible", "gathered", "safe", "at_rest", "stationary")
_STEPS = ("base_steps", "auxiliary_steps", "total_steps", "bound_steps")
_RENAMED = {
    "world": "inner",
    "standing": "potential",
    "mirror": "chirality",
    "held": "committed_velocity",
    "left": "remaining_distance",
    "moving": "steps_to_go",
    "epochs": "completed_epochs",
}
"""New names of the fields of an environment's state in checkpoints that version 0.1.0 wrote."""

_OUTCOME = "valid patterns discovered"  # what version 0.1.0 wrote instead of `valid_pattern = true`


@dataclass(frozen=True)
class Checkpoint:
    """The progress of a run that is not finished.

    Attributes:
        snapshot: The search: finished policies, and the training of the current one.
        rows: Number of rows of metrics so far.
        seconds: Time that training took so far.
    """

    snapshot: Snapshot
    rows: int = 0
    seconds: float = 0.0

    __repr__ = short_repr


class RunFolder:
    """The folder of one run: the only reader and writer of its files.

    Everything that is read is checked: a missing or damaged file, or one of an unknown version, is a `RunError`.
    Folders of version 0.1.0 are read as if this version had written them.

    Args:
        path: The folder; it need not exist.

    Attributes:
        path: The folder.

    Raises:
        InputError: `path` is no path.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        check_path("folder", path)
        self.path = Path(path)

    def __fspath__(self) -> str:
        return str(self.path)

    def __repr__(self) -> str:
        return f"RunFolder({self.path})"

    @property
    def figures(self) -> Path:
        """The folder of the run's figures; it need not exist.

        Raises:
            RunError: It is a link.
        """
        return self._inside(FIGURES)

    def _inside(self, name: str) -> Path:
        """Returns the path of one of the run's files or folders, which is no link."""
        return files.inside(self.path, name)

    def _names(self) -> list[str]:
        """Returns the names of what the folder holds."""
        with files.os_errors_as_run_errors(f"cannot read {self.path}"):
            return os.listdir(self.path)

    @property
    def experiment_file(self) -> Path:
        """The file of the configuration, to be named in a message."""
        return self.path / EXPERIMENT

    @property
    def evaluation_files(self) -> tuple[Path, Path]:
        """The files of the evaluation, to be named in a message: its summary and its trajectories."""
        return self.path / EVALUATION, self.path / TRAJECTORIES

    @property
    def record_file(self) -> Path:
        """The file of a pattern that is better than the best known one, to be named in a message."""
        return self.path / RECORD

    # What the folder holds

    def holds_run(self) -> bool:
        """Returns whether the folder holds a run, however far it is."""
        return self._has(EXPERIMENT) or self.is_finished()

    def is_finished(self) -> bool:
        """Returns whether the folder holds a finished run; its files may be damaged, see `is_whole`."""
        return self._has(MANIFEST)

    def is_trained(self) -> bool:
        """Returns whether the policies are written: the training is over, the evaluation may not be."""
        return self._has(POLICIES)

    def is_evaluated(self) -> bool:
        """Returns whether the folder holds an evaluation."""
        return self._has(TRAJECTORIES)

    def _has(self, name: str) -> bool:
        """Returns whether there is something of this name in the folder, a link included."""
        return os.path.lexists(self.path / name)

    def inspect(self, resume: bool = False) -> FolderState:
        """Returns what the folder holds, after checking that nothing in it would be overwritten; writes nothing.

        Args:
            resume: Whether a run that the folder holds is to be continued. Without it, only "new" is returned.

        Raises:
            RunError: The folder holds a run that is not to be continued, or other files.
        """
        # A process that was killed before it wrote the configuration leaves a checkpoint folder alone.
        names = files.entries(self.path) - {CHECKPOINT}
        is_run = bool(names & {EXPERIMENT, MANIFEST})
        if names and not is_run:
            raise RunError(f"{self.path} holds other files: choose another --out")
        if is_run and not resume:
            raise RunError(f"{self.path} holds another run: continue it with --resume, or choose another --out")
        if MANIFEST in names:
            return "finished"
        return "unfinished" if is_run else "new"

    def create(self, resume: bool = False) -> FolderState:
        """Creates the folder and checks that it can be written to; a finished run stays untouched.

        Returns:
            What the folder holds; see `inspect`.

        Raises:
            RunError: As `inspect`, or the folder cannot be written to.
        """
        state = self.inspect(resume)
        if state != "finished":
            files.make_writable(self.path)
        return state

    @contextlib.contextmanager
    def lock(self) -> Iterator[None]:
        """Keeps other processes from training in this folder, until the block or the process ends.

        Raises:
            RunError: Another process trains in it.
        """
        path = self._inside(LOCK)
        with contextlib.ExitStack() as stack:
            with files.os_errors_as_run_errors(f"cannot write {path}"):
                try:
                    stack.enter_context(untrusted.locked(path))
                except BlockingIOError:
                    raise RunError(f"{self.path} is in use: another process trains this run") from None
            for name in (".", POLICIES, CHECKPOINT):  # of a process that was killed here
                files.remove_partial(self._inside(name))
            yield

    # Configuration and manifest

    def experiment(self, trust: bool = False) -> ExperimentConfig:
        """Reads the configuration.

        Args:
            trust: Whether modules that it names ("module:Class") may be imported, which executes them.

        Raises:
            InputError: `trust` is neither true nor false.
            RunError: It is missing, not one that this version understands, or names modules and is not trusted.
        """
        # Whatever opens a run passes `trust` on to here; any text, "no" among them, would count as true.
        check_type("trust", trust, bool, "True or False")
        return configuration.load(self.path, trusted=trust)

    def write_experiment(self, config: ExperimentConfig) -> None:
        """Writes the configuration, every field of it, and a copy of the file of starts that it names, if any."""
        configuration.save(config, self.path)

    def check_same(self, config: ExperimentConfig) -> None:
        """Checks that the folder holds a run of this very experiment.

        Raises:
            RunError: It holds another; the message names the first field that differs.
        """
        configuration.check_same(config, self.path)

    def manifest(self) -> dict[str, Any]:
        """Reads the manifest of a finished run.

        Returns:
            Its contents, with `valid_pattern`: whether a valid pattern was discovered.

        Raises:
            RunError: The folder holds no finished run, or one of a format that this version does not know.
        """
        path = self._inside(MANIFEST)
        if not path.exists():
            if self._inside(EXPERIMENT).is_file():
                raise RunError(f"{self.path} holds an unfinished run: finish it with murmurate discover --resume")
            raise RunError(f"{self.path} holds no run: it has no {MANIFEST}")
        manifest = files.read_json(path)
        version = manifest.get("format") if isinstance(manifest, dict) else None
        if version not in (FORMAT, OLD_FORMAT) or isinstance(version, bool):
            known = f"this version of murmurate reads formats {OLD_FORMAT} and {FORMAT}"
            raise RunError(f"{path} has format {shown(version)}; {known}")
        manifest.setdefault("valid_pattern", manifest.get("outcome") == _OUTCOME)
        names, sums = manifest.get("policies"), manifest.get("checksums")
        if not isinstance(names, list) or not 1 <= len(names) <= MAX_POLICIES:
            raise RunError(f"{path} does not list the policies")
        if names != [policy_name(index) for index in range(len(names))]:
            raise RunError(f"{path} has policies = {shown(names)}, which are not those of a run")
        if not isinstance(sums, dict) or not all(isinstance(value, str) for value in sums.values()):
            raise RunError(f"{path} has no checksums")
        if not {EXPERIMENT, *_policy_files(len(names))} <= sums.keys():
            raise RunError(f"{path} does not list every policy with its checksum")
        for name, (check, what) in _MANIFEST_FIELDS.items():
            if name in manifest and not check(manifest[name]):
                raise RunError(f"{path} has {name} = {shown(manifest[name])}, which {what}")
        for name in sums.keys() - {*_trained_files(len(names), sums), METRICS, *_EVALUATED}:
            raise RunError(f"{path} has a checksum of {shown(name)}, which is no file of a run")
        return manifest

    def write_manifest(self, manifest: Mapping[str, Any], policies: int) -> dict[str, Any]:
        """Writes the manifest, which marks the run as finished.

        Args:
            manifest: Its contents, without format, policies and checksums.
            policies: Number of policies.

        Returns:
            Its contents, as `manifest` returns them.
        """
        trained = _trained_files(policies, self._names())
        names = [name for name in (*trained, METRICS, *_EVALUATED) if self._inside(name).exists()]
        contents = {
            **manifest,
            "format": FORMAT,
            "policies": [policy_name(index) for index in range(policies)],
            "checksums": {name: files.checksum(self.path / name) for name in names},
        }
        files.write_json(self._inside(MANIFEST), contents)
        return self.manifest()

    def verify(self, needed: Iterable[str] = ()) -> dict[str, Any]:
        """Checks the configuration and the policies of a finished run by their checksums.

        The files of its evaluation are checked when they are read: an evaluation that was interrupted can be made
        again.

        Args:
            needed: Fields that the manifest must have.

        Returns:
            The manifest.

        Raises:
            RunError: The run is not finished, a file is missing or changed, or the manifest is damaged or lacks a
                field.
        """
        manifest = self.manifest()
        missing = sorted(set(needed) - manifest.keys())
        if missing:
            raise RunError(f"{self.path / MANIFEST} lacks {missing[0]}")
        for name in trained_checksums(manifest):
            self._check(name, manifest)
        for name in self._names():
            if is_start_file(name) and name not in manifest["checksums"]:
                raise RunError(f"{self.path / name} has no checksum in {MANIFEST}")
        return manifest

    def is_whole(self) -> bool:
        """Returns whether every file of a finished run is there and as it was written."""
        try:
            manifest = self.verify()
            for name in manifest["checksums"]:
                self._check(name, manifest)
            self.evaluation()
        except RunError:
            return False
        return True

    def unfinish(self) -> None:
        """Removes the manifest, which marks the run as finished: its training begins anew.

        Raises:
            RunError: It cannot be removed.
        """
        with files.os_errors_as_run_errors(f"cannot write to {self.path}"):
            (self.path / MANIFEST).unlink(missing_ok=True)

    def _check(self, name: str, manifest: Mapping[str, Any], remedy: str = "") -> None:
        """Checks a file by its checksum; version 0.1.0 wrote none of evaluations and metrics."""
        recorded = manifest["checksums"].get(name)
        if recorded is None and manifest["format"] == OLD_FORMAT:
            return
        if files.checksum(self._inside(name)) != recorded:
            raise RunError(f"{self.path / name} does not match its checksum in {MANIFEST}{remedy}")

    def _check_evaluated(self, name: str) -> None:
        """Checks a file of the evaluation of a run that is finished; before that it has no checksum."""
        if self.is_finished():
            self._check(name, self.manifest(), f": {self._remedy}")

    @property
    def _remedy(self) -> str:
        return f"make it again with murmurate evaluate {self.path}"

    # Policies and training

    def policies(self, templates: Sequence[Any]) -> tuple[Any, ...]:
        """Reads the first policies of the list.

        Args:
            templates: Networks of the same structure, one for each policy to read; see `discovery.policy_templates`.

        Raises:
            RunError: A file is missing or damaged, or holds other arrays than its template.
        """
        names = _policy_files(len(templates))
        return tuple(files.read_tree(self._inside(name), like) for name, like in zip(names, templates, strict=True))

    def write_policies(self, policies: Sequence[Any]) -> None:
        """Writes the policies of the list."""
        files.make_folder(self._inside(POLICIES))
        for name, policy in zip(_policy_files(len(policies)), policies, strict=True):
            files.write_tree(self._inside(name), policy)

    def checkpoint(self, search: Search) -> Checkpoint:
        """Reads the checkpoint; without one, returns the beginning of the search.

        Raises:
            RunError: It is damaged, or not of this experiment.
        """
        path = self._inside(f"{CHECKPOINT}/{SNAPSHOT}")
        if not path.exists():
            return Checkpoint(search.begin())
        notes = _Notes(path)
        count = notes.integer("policies", MAX_POLICIES)
        valid, seconds = notes.number("valid", 1), notes.number("seconds", math.inf)
        finished, training = notes.flag("finished"), notes.flag("training")
        # Older versions had no refinement.
        refining = "refining" in notes.values and notes.flag("refining")
        if refining and len(search.problem.stage(count).learners) == 1:
            notes.refuse("refining")
        shape = (notes.integer("sigma", MAX_INTEGER), search.problem.world.robots, 2)
        policies = policy_templates(search.problem, count)
        sigma = jax.ShapeDtypeStruct(shape, jnp.float32)
        unrefined = policy_templates(search.problem, 1)[0] if refining else None
        template = {"policies": policies, "sigma": sigma, "train": None, "unrefined": unrefined}
        if training:
            template["train"] = eqx.filter_eval_shape(_training_state, search, policies, sigma, unrefined)
        tree = files.read_tree(path, template, _RENAMED)
        snapshot = Snapshot(tree["policies"], tree["sigma"], valid, tree["train"], finished, tree["unrefined"])
        return Checkpoint(snapshot, notes.integer("rows", MAX_INTEGER), seconds)

    def checkpoint_rows(self) -> int:
        """Returns how many rows of metrics the checkpoint was saved after; 0 without a checkpoint.

        Raises:
            RunError: It is damaged.
        """
        path = self._inside(f"{CHECKPOINT}/{SNAPSHOT}")
        return _Notes(path).integer("rows", MAX_INTEGER) if path.exists() else 0

    def write_checkpoint(self, checkpoint: Checkpoint) -> None:
        """Writes a checkpoint in place of the one before."""
        snapshot = checkpoint.snapshot
        notes = {
            "policies": len(snapshot.policies),
            "sigma": len(snapshot.sigma),
            "training": snapshot.train is not None,
            "refining": snapshot.unrefined is not None,
            "valid": snapshot.valid,
            "finished": snapshot.finished,
            "rows": checkpoint.rows,
            "seconds": checkpoint.seconds,
        }
        tree = {name: getattr(snapshot, name) for name in ("policies", "sigma", "train", "unrefined")}
        files.make_folder(self._inside(CHECKPOINT))
        files.write_tree(self._inside(f"{CHECKPOINT}/{SNAPSHOT}"), tree, notes)

    def initial(self, config: ExperimentConfig) -> tuple[tuple[Any, ...], dict[str, Any] | None]:
        """Reads the policies that the training began with, from its beginning to its end.

        Args:
            config: The run's configuration.

        Returns:
            The policies, and the run that they are from; `()` and None where the training began with new ones.

        Raises:
            RunError: They are damaged.
        """
        path = self._inside(f"{CHECKPOINT}/{INITIAL}")
        if not path.exists():
            return (), None
        notes = _Notes(path)
        count, origin = notes.integer("policies", MAX_POLICIES), notes.values.get("origin")
        if origin is not None and not isinstance(origin, dict):
            raise RunError(f"{path} has origin = {shown(origin)}, which is no run")
        return files.read_tree(path, policy_templates(config, count)), origin

    def write_initial(self, policies: Sequence[Any], origin: Mapping[str, Any] | None) -> None:
        """Writes the policies that the training begins with, so that it can be resumed without their run."""
        files.make_folder(self._inside(CHECKPOINT))
        notes = {"policies": len(policies), "origin": origin}
        files.write_tree(self._inside(f"{CHECKPOINT}/{INITIAL}"), tuple(policies), notes)

    def remove_checkpoint(self) -> None:
        """Removes what only an unfinished run needs."""
        shutil.rmtree(self.path / CHECKPOINT, ignore_errors=True)

    def metrics(self) -> list[dict[str, Any]]:
        """Reads the rows of metrics, one for each update; none where nothing was recorded.

        Raises:
            RunError: The file is damaged.
        """
        if self.is_finished() and self._has(METRICS):
            self._check(METRICS, self.manifest())
        return self.new_metrics(0)[0]

    def new_metrics(self, offset: int) -> tuple[list[dict[str, Any]], int]:
        """Reads the rows of metrics behind an offset in the file, as `files.read_rows` does.

        Returns:
            The rows, and the offset behind them.

        Raises:
            RunError: The file is damaged.
        """
        path = self._inside(METRICS)
        rows, end = files.read_rows(path, offset)
        for number, row in enumerate(rows, 1):
            if not _is_metrics(row) or row["signals"].keys() != rows[0]["signals"].keys():
                raise RunError(f"{path} is damaged: line {number} is not a row of metrics")
        return rows, end

    def last_metrics(self) -> list[dict[str, Any]]:
        """Returns the last rows of metrics that are whole, some tens; none where they cannot be read at this moment."""
        with contextlib.suppress(RunError):
            rows = files.read_last_rows(self._inside(METRICS), TAIL_BYTES)
            return [row for row in rows if _is_metrics(row) and row.keys() >= {"reward", "steps_per_second"}]
        return []

    def append_metrics(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Appends rows of metrics, all of them or none."""
        files.append_rows(self._inside(METRICS), rows)

    def truncate_metrics(self, rows: int) -> None:
        """Cuts the metrics back to their first rows, those before a checkpoint."""
        files.truncate_rows(self._inside(METRICS), rows)

    # Evaluation

    def evaluation(self) -> dict[str, Any]:
        """Reads the evaluation's summary.

        Returns:
            The contents of evaluation.json. Fractions and mean steps are floats, NaN where they could not be computed;
            `starts` is a dictionary, see `describe_starts`.

        Raises:
            RunError: It is missing or incomplete, or contradicts itself.
        """
        path, remedy = self._inside(EVALUATION), self._remedy
        summary = files.read_json_object(path)
        if "collision_free" in summary:  # version 0.1.0 counted contact and leaving the world together
            summary |= {"contact_free": summary["collision_free"], "inside": summary["collision_free"]}
        summary.setdefault("stationary", None)  # what version 0.1.0 did not measure
        if isinstance(summary.get("starts"), str):
            kind = summary["starts"] if summary["starts"] in ("fresh", "given") else "file"
            summary["starts"] = {"kind": kind} | ({"name": summary["starts"]} if kind == "file" else {})
        needed = ("starts", "episodes", "valid_interval", "signal", "failures", *_FRACTIONS, *_STEPS)
        missing = [name for name in needed if name not in summary]
        if missing:
            raise RunError(f"{path} lacks {missing[0]}: {remedy}")
        for name, (check, what) in _EVALUATION_FIELDS.items():
            if name in summary and not check(summary[name]):
                raise RunError(f"{path} has {name} = {shown(summary[name])}, which {what}: {remedy}")
        failures, episodes = summary["failures"], summary["episodes"]
        if any(not 0 <= index < episodes for index in failures) or len(set(failures)) < len(failures):
            raise RunError(
                f"{path} has failures = {shown(failures)}, which are not of its {episodes} episodes: {remedy}"
            )
        contradiction = _contradiction(summary)
        if contradiction:
            raise RunError(f"{path} contradicts itself: {contradiction}: {remedy}")
        self._check_evaluated(EVALUATION)
        for name in (*_FRACTIONS, *_STEPS):
            summary[name] = float("nan") if summary[name] is None else float(summary[name])
        return summary

    def trajectories(self, config: ExperimentConfig, finite: bool = True) -> Trajectories:
        """Reads the episodes of the evaluation.

        Args:
            config: The run's configuration, which they must be of. It says how many steps they can have, and what rest
                is.
            finite: Refuse episodes in which a position or signal is not finite.

        Returns:
            The episodes. Version 0.1.0 did not record `terminated` and `epochs`: there they are false, and the lengths;
            nor `after_rest`, without which no pattern counts as stationary.

        Raises:
            RunError: They are missing, damaged, impossible, not of this experiment, or not finite.
        """
        path = self._inside(TRAJECTORIES)
        robots, episodes, policies, version = None, None, None, FORMAT
        if self._inside(EVALUATION).exists():
            summary = self.evaluation()
            robots, episodes = summary.get("robots"), summary["episodes"]
        if self._inside(MANIFEST).exists():
            manifest = self.manifest()
            policies, version = len(manifest["policies"]), manifest["format"]

        def check(headers: dict[str, files.ArrayHeader]) -> None:
            _check_headers(path, headers, episodes, robots, policies)
            _check_sizes(path, headers, config)

        arrays = files.read_npz(path, (*_REQUIRED, "terminated", "epochs", "interventions", "after_rest"), check)
        self._check_evaluated(TRAJECTORIES)
        positions, names = arrays["positions"], [str(name) for name in arrays["signal_names"]]
        if names != list(config.signal_names):
            raise RunError(f"{path} is not of this experiment: it has the signals {', '.join(names)}")
        lengths, signals, after_rest = arrays["lengths"].astype(int), arrays["signals"], arrays.get("after_rest")
        recorded = (positions, signals, *([] if after_rest is None else [after_rest]))
        if finite and not all(np.isfinite(array).all() for array in recorded):
            raise RunError(f"{path} has positions or signals that are not finite: the training diverged")
        trajectories = Trajectories(
            positions=positions,
            lengths=lengths,
            switch=arrays["switch"].astype(int),
            at_rest=arrays["at_rest"],
            terminated=arrays.get("terminated", np.zeros(len(lengths), bool)),
            epochs=arrays.get("epochs", lengths).astype(int),
            interventions=arrays.get("interventions"),
            after_rest=after_rest,
            signals={name: signals[..., index] for index, name in enumerate(names)},
        )
        # In version 0.1.0, which recorded nothing after rest, rest was another thing, and moves that were begun before
        # the end of an episode went on after it.
        is_old = version == OLD_FORMAT and after_rest is None
        impossible = _impossibility(trajectories) or ("" if is_old else _restlessness(trajectories, config))
        if impossible:
            raise RunError(f"{path} has {impossible}")
        return trajectories

    def record(self) -> dict[str, Any] | None:
        """Reads the pattern that is better than the best known one, as an entry of that table; None without one."""
        path = self._inside(RECORD)
        if not path.exists():
            return None
        record = files.read_json_object(path)
        self._check_evaluated(RECORD)
        return record

    def write_evaluation(
        self, summary: Mapping[str, Any], arrays: Mapping[str, Any], record: Mapping[str, Any] | None = None
    ) -> None:
        """Writes an evaluation in place of the one before.

        Args:
            summary: The contents of evaluation.json.
            arrays: The contents of trajectories.npz.
            record: A pattern better than the best known one, if there is one.
        """
        if record is not None:
            files.write_json(self._inside(RECORD), record)
        else:
            with files.os_errors_as_run_errors(f"cannot write to {self.path}"):
                (self.path / RECORD).unlink(missing_ok=True)
        files.write_npz(self._inside(TRAJECTORIES), arrays)
        files.write_json(self._inside(EVALUATION), summary)
        if self._inside(MANIFEST).exists():
            # Until here the new files do not match the manifest, and a reader is told to evaluate again.
            manifest = self.manifest()
            self.write_manifest(manifest, len(manifest["policies"]))

    def copy_to(
        self, folder: str | os.PathLike[str], *, metrics_every: int = 1, changes: Mapping[str, Any] | None = None
    ) -> RunFolder:
        """Copies a finished run without its evaluation and figures.

        Args:
            folder: The folder of the copy.
            metrics_every: Of the rows of metrics, one in so many is copied.
            changes: Fields of the manifest to replace.

        Raises:
            RunError: The folder holds something, or cannot be written to; or this run is damaged.
        """
        manifest, rows, copy = self.verify(), self.metrics(), RunFolder(folder)
        copy.create()
        for name in trained_checksums(manifest):
            target = copy._inside(name)
            files.make_folder(target.parent)
            files.write_bytes(target, files.read_bytes(self._inside(name)))
        copy.append_metrics(rows[metrics_every - 1 :: metrics_every])
        # The manifest last: it marks the copy as complete.
        copy.write_manifest({**manifest, **(changes or {})}, len(manifest["policies"]))
        return copy


_REQUIRED = ("positions", "lengths", "switch", "signals", "signal_names", "at_rest")


def _check_headers(
    path: Path, headers: dict[str, files.ArrayHeader], episodes: int | None, robots: Any, policies: int | None
) -> None:
    """Checks that the arrays of an evaluation fit together, before any of them takes memory.

    Args:
        path: The file, for messages.
        headers: What they say of themselves.
        episodes: The number of episodes of the evaluation beside them; None without one.
        robots: Its swarm size, where it has one.
        policies: The length of the run's list of policies; None while it is being trained.
    """
    for name in _REQUIRED:
        if name not in headers:
            raise RunError(f"{path} lacks {name}")
    shape, kind = headers["positions"].shape, headers["positions"].dtype.kind
    if len(shape) != 4 or shape[3] != 2 or 0 in shape or kind != "f" or shape[0] > MAX_EPISODES:
        have = headers["positions"]
        raise RunError(f"{path} has positions as {have}, not as float32[episodes, steps + 1, robots, 2]")
    names, switch = headers["signal_names"].shape, headers["switch"].shape
    after = headers["after_rest"].shape if "after_rest" in headers else ()
    expected = {
        "lengths": ("iu", shape[:1]),
        "switch": ("iu", (shape[0], (switch[-1] if switch else 0) if policies is None else policies - 1)),
        "at_rest": ("b", shape[:1]),
        "signal_names": ("U", names[:1] or (0,)),
        "signals": ("f", (*shape[:2], names[0] if names else 0)),
        "terminated": ("b", shape[:1]),
        "epochs": ("iu", shape[:1]),
        "interventions": ("iu", shape[:1]),
        "after_rest": ("f", (shape[0], after[1] if len(after) > 1 else 0, *shape[2:])),
    }
    for name, (kinds, wanted) in expected.items():
        if name in headers and (headers[name].shape != wanted or headers[name].dtype.kind not in kinds):
            raise RunError(f"{path} has {name} as {headers[name]}, which does not fit positions of {list(shape)}")
    if shape[0] != (episodes or shape[0]) or shape[2] != (robots or shape[2]):
        raise RunError(f"{path} is not of the evaluation beside it: its positions are {list(shape)}")


def _check_sizes(path: Path, headers: dict[str, files.ArrayHeader], config: ExperimentConfig) -> None:
    """Checks that the arrays of an evaluation are no larger than its experiment lets them be, before they take memory.

    Args:
        path: The file, for messages.
        headers: What they say of themselves; see `_check_headers`.
        config: The run's configuration.
    """
    policies, robots = headers["switch"].shape[1] + 1, headers["positions"].shape[2]
    if robots != config.world.robots:
        raise RunError(f"{path} is not of this experiment: it has {robots} robots")
    if policies > MAX_POLICIES:
        raise RunError(f"{path} has switch as {headers['switch']}: no run has so many policies")
    most = {
        "positions": config.rest_in_steps.max_steps * policies + 1,
        "after_rest": STATIONARY_STEPS * config.scheduler.period,
    }
    for name, steps in most.items():
        if name in headers and headers[name].shape[1] > steps:
            raise RunError(f"{path} has {name} as {headers[name]}, but its experiment ends after {steps} of them")
    for name in ("positions", "signals", "after_rest"):
        if name in headers and headers[name].dtype.itemsize > 4:
            raise RunError(f"{path} has {name} as {headers[name]}, not as float32")
    longest = max(map(len, config.signal_names))
    if (
        headers["signal_names"].shape[0] != len(config.signal_names)
        or headers["signal_names"].dtype.itemsize > 4 * longest
    ):
        raise RunError(f"{path} is not of this experiment: it has signal_names as {headers['signal_names']}")


def _impossibility(trajectories: Trajectories) -> str:
    """Returns in words what no rollout could have recorded; nothing where all is possible."""
    lengths, (_, configurations, robots, _) = trajectories.lengths, trajectories.positions.shape
    if lengths.min() < 0 or lengths.max() >= configurations:
        return f"lengths that are not from 0 to {configurations - 1}"
    turns = np.column_stack([np.zeros_like(lengths), trajectories.switch, lengths])
    if (turns[:, 1:] < turns[:, :-1]).any():
        return "switch that is not from 0 to the length of each episode, one policy after another"
    for name, most in (("epochs", lengths), ("interventions", lengths * robots)):
        counts = getattr(trajectories, name)
        if counts is not None and ((counts < 0) | (counts > most)).any():
            return f"{name} that {'no' if name == 'interventions' else 'so few'} steps can have"
    return ""


def _restlessness(trajectories: Trajectories, config: ExperimentConfig) -> str:
    """Returns in words where robots move that have come to rest, or whose episode is over; nothing where none does."""
    rest = config.rest_in_steps
    most = rest.stillness * config.world.radius * (1 + STILLNESS_ROUNDING)
    switch, lengths, at_rest = trajectories.switch, trajectories.lengths, trajectories.at_rest
    begins = switch[:, -1] if switch.shape[1] else np.zeros_like(lengths)
    for positions, begin, length, rested in zip(trajectories.positions, begins, lengths, at_rest, strict=True):
        after, end = positions[length + 1 :], positions[length]
        if ((after != end) & ~(np.isnan(after) & np.isnan(end))).any():
            return "positions that change after the end of an episode"
        if not rested:
            continue
        if length - begin < rest.window:
            return f"at_rest in an episode whose last policy acted for fewer than the {rest.window} steps of rest"
        last = positions[length - rest.window : length + 1].astype(float)
        with np.errstate(invalid="ignore"):  # a training may have diverged
            moves = np.linalg.norm(np.diff(last, axis=0), axis=-1)
            # The recorded positions are rounded, each by half of the spacing of the numbers about it.
            if (moves > most + 2 * np.spacing(np.abs(last).max().astype(np.float32))).any():
                return f"at_rest in an episode whose robots moved in its last {rest.window} steps"
    return ""


def _contradiction(summary: Mapping[str, Any]) -> str:
    """Returns in words where a summary of an evaluation contradicts itself; nothing where it does not."""
    episodes, valid = summary["episodes"], summary["valid"]
    formed = 1 - len(summary["failures"]) / episodes
    if valid is None or abs(valid - formed) > ROUNDING:
        return f"valid = {shown(valid)} with {len(summary['failures'])} failures of {episodes}"
    low, high = (valid if bound is None else bound for bound in summary["valid_interval"])
    if not low - ROUNDING <= valid <= high + ROUNDING:
        return f"valid = {shown(valid)} outside valid_interval = {shown(summary['valid_interval'])}"
    replaced = replaced_conditions(summary.get("thresholds", ()))
    for name in _FRACTIONS:
        if name not in replaced and summary[name] is not None and summary[name] < valid - ROUNDING:
            return f"{name} = {shown(summary[name])} below valid = {shown(valid)}"
    base, auxiliary, total, bound = (summary[name] for name in _STEPS)
    slack = STEPS_ROUNDING * (1 + (total or 0))
    if None not in (base, auxiliary, total) and abs(base + auxiliary - total) > slack:
        return f"total_steps = {shown(total)} with base_steps = {shown(base)} and auxiliary_steps = {shown(auxiliary)}"
    if None not in (bound, total) and bound > total + slack:
        return f"bound_steps = {shown(bound)} above total_steps = {shown(total)}"
    return ""


ROUNDING, STEPS_ROUNDING, STILLNESS_ROUNDING = 1e-9, 1e-3, 1e-5
"""By how much shares may differ that should be equal; and steps and the moves of robots at rest, as a share of them:
positions are float32."""


def is_fresh(summary: Mapping[str, Any]) -> bool:
    """Returns whether an evaluation began at fresh starts of its experiment, not at given ones."""
    return summary["starts"]["kind"] == "fresh"


def describe_starts(summary: Mapping[str, Any]) -> str:
    """Returns in words where the episodes of an evaluation began.

    Args:
        summary: What `RunFolder.evaluation` returns. Its `starts` has the field `kind`: fresh (of the experiment, drawn
            by the seed), drawn (of the start `name`), set or file (with its `name`) or given (in Python).
    """
    starts = summary["starts"]
    # A stranger may have named them: pictures and pages show this.
    name = one_line(starts.get("name", starts["kind"]), MAX_NAME)
    return f"starts of {name}" if starts["kind"] in ("set", "file") else f"{name} starts"


def _policy_files(count: int) -> list[str]:
    return [f"{POLICIES}/{index}-{policy_name(index)}.safetensors" for index in range(count)]


def _trained_files(count: int, names: Iterable[str]) -> list[str]:
    """Returns the files that the training of `count` policies ends in; of the given names, those of files of starts."""
    return [EXPERIMENT, *sorted(filter(is_start_file, names)), *_policy_files(count)]


def trained_checksums(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Returns the checksums of the configuration and the policies, whatever these were evaluated on."""
    sums = manifest["checksums"]
    return {name: sums[name] for name in _trained_files(len(manifest["policies"]), sums) if name in sums}


def policy_checksums(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Returns the checksums of the policies alone."""
    return {name: value for name, value in manifest["checksums"].items() if name.startswith(f"{POLICIES}/")}


def _is_metrics(row: Mapping[str, Any]) -> bool:
    """Returns whether a row is one of metrics.jsonl; what was not finite is None there."""
    counts, signals = [row.get("policy"), row.get("update"), row.get("environment_steps")], row.get("signals")
    if None in counts or not all(map(_is_length, counts)) or not isinstance(signals, dict):
        return False
    values = [*signals.values(), *(row.get(name) for name in ("reward", "steps_per_second", "seconds"))]
    return all(value is None or files.is_number(value) for value in values) and isinstance(row.get("name"), str)


MAX_COUNT = 1e18
"""Steps of a training, at most: a float counts them one by one."""


class _Notes:
    """The notes of a checkpoint.

    Args:
        path: The file.

    Raises:
        RunError: It has none, or, when one is asked for, that one is missing or out of bounds.
    """

    def __init__(self, path: Path) -> None:
        notes = files.read_notes(path)
        self._path, self.values = path, notes if isinstance(notes, dict) else {}

    def integer(self, name: str, high: int) -> int:
        """Returns a whole number from 0 to `high`."""
        value = self.values.get(name)
        return value if isinstance(value, int) and self.number(name, high) >= 0 else self.refuse(name)

    def number(self, name: str, high: float) -> float:
        """Returns a number from 0 to `high`."""
        value: Any = self.values.get(name)
        return value if files.is_number(value) and 0 <= value <= high else self.refuse(name)

    def flag(self, name: str) -> bool:
        """Returns true or false."""
        value = self.values.get(name)
        return value if isinstance(value, bool) else self.refuse(name)

    def refuse(self, name: str) -> Any:
        """Raises the error about a note."""
        has = f"{name} = {shown(self.values.get(name))}"
        raise RunError(f"{self._path} is not a checkpoint of this version of murmurate: it has {has}")


# What evaluation.json and manifest.json hold: what each field must be, and what to say of one that is not


def _is_share(value: Any) -> bool:
    return value is None or (files.is_number(value) and 0 <= value <= 1)


def _is_length(value: Any) -> bool:
    return value is None or (files.is_number(value) and 0 <= value <= MAX_COUNT)


def _is_interval(value: Any) -> bool:
    if not isinstance(value, list) or len(value) != 2 or not all(map(_is_share, value)):
        return False
    return None in value or value[0] <= value[1]


def _is_count(value: Any, high: int, low: int = 1) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high


def _are_numbers(value: Any) -> bool:
    numbers = value.values() if isinstance(value, dict) else [value]
    return isinstance(value, dict) and all(number is None or files.is_number(number) for number in numbers)


def _are_starts(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and value.get("kind") in ("fresh", "given", *_NAMED_STARTS)
        and isinstance(value.get("name", ""), str)
        and ("name" in value) == (value["kind"] in _NAMED_STARTS)
    )


_NAMED_STARTS = ("drawn", "set", "file")


_EVALUATION_FIELDS: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    **dict.fromkeys(_FRACTIONS, (_is_share, "is not a share from 0 to 1")),
    **dict.fromkeys((*_STEPS, "epochs"), (_is_length, "is not a number of steps")),
    "interventions": (_is_length, "is not a number of interventions"),
    "episodes": (lambda value: _is_count(value, MAX_EPISODES), f"is not a number of episodes from 1 to {MAX_EPISODES}"),
    "robots": (lambda value: _is_count(value, MAX_INTEGER), "is not a number of robots"),
    "seed": (lambda value: _is_count(value, 2**32 - 1, 0), "is not a seed"),
    "failures": (
        lambda value: isinstance(value, list) and all(_is_count(index, MAX_INTEGER, 0) for index in value),
        "are not episodes",
    ),
    "starts": (_are_starts, "is unknown"),
    "valid_interval": (_is_interval, "is not an interval inside 0 to 1"),
    "signal": (_are_numbers, "are not numbers by name"),
    "thresholds": (lambda value: _are_numbers(value) and all(map(_is_share, value.values())), "are not shares by name"),
    **dict.fromkeys(
        ("efficiency", "best_known", "best_found", "gap"),
        (lambda value: value is None or files.is_number(value), "is not a number"),
    ),
}


_MANIFEST_FIELDS: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    **dict.fromkeys(
        ("environment_steps", "train_seconds"),
        (lambda value: value is not None and _is_length(value), "is not a number"),
    ),
    **dict.fromkeys(
        ("murmurate", "platform", "cpu", "device", "experiment"), (lambda value: isinstance(value, str), "is not text")
    ),
    "seed": (lambda value: _is_count(value, 2**32 - 1, 0), "is not a seed"),
    "robots": (lambda value: _is_count(value, MAX_INTEGER), "is not a number of robots"),
    "valid_pattern": (lambda value: isinstance(value, bool), "is neither true nor false"),
    "versions": (
        lambda value: isinstance(value, dict) and all(isinstance(version, str) for version in value.values()),
        "are not versions by name",
    ),
    "initial": (lambda value: isinstance(value, dict), "is not a run"),
}


def _training_state(search: Search, policies: tuple[Any, ...], sigma: jax.Array, unrefined: Any | None) -> Any:
    return search.training(Snapshot(policies, sigma, 0.0, None, unrefined=unrefined))
