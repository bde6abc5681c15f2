"""The folder of one run: what it holds, how it is read, and how it is written.

`RunFolder` is the only reader and writer of a run folder:

    experiment.toml      the configuration, every field of it (starts.csv beside it where it names a file of starts)
    manifest.json        versions, machine, results in short, checksums; written last: it marks a finished run
    policies/            0-base.safetensors, 1-auxiliary.safetensors, ...
    metrics.jsonl        a row for each update
    evaluation.json      how often a valid pattern formed, in how many steps, ...
    trajectories.npz     the episodes of the evaluation
    record.json          a pattern better than the best known, if there is one
    figures/             what has been drawn
    checkpoint/          while the run is being trained

Every file is replaced whole, and no file is ever executed: a run from a stranger is safe to open.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from murmurate.discovery import Search, Snapshot, policy_name, policy_templates
from murmurate.errors import RunError
from murmurate.runs import experiment as configuration
from murmurate.runs import files
from murmurate.runs.experiment import EXPERIMENT, STARTS, ExperimentConfig
from murmurate.types import Trajectories

try:
    import fcntl
except ImportError:  # not a POSIX system: runs are not locked
    fcntl = None

__all__ = ["Checkpoint", "FolderState", "RunFolder", "describe_starts", "is_fresh"]

FORMAT = 1
MANIFEST = "manifest.json"
METRICS = "metrics.jsonl"
EVALUATION = "evaluation.json"
TRAJECTORIES = "trajectories.npz"
RECORD = "record.json"
CHECKPOINT = "checkpoint"
LOCK = ".training.lock"

FolderState = Literal["new", "unfinished", "finished"]
"""What a folder holds: nothing yet, a run whose training can be continued, or a finished run."""

_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)

_FRACTIONS = ("valid", "contact_free", "inside", "mutually_visible", "gathered", "safe", "at_rest")
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


class RunFolder:
    """The folder of one run: the only reader and writer of its files.

    Everything that is read is checked: a missing or damaged file, or one of an unknown version, is a `RunError`.
    Folders of version 0.1.0 are read as if this version had written them.

    Args:
        path: The folder; it need not exist.

    Attributes:
        path: The folder.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)

    def __fspath__(self) -> str:
        return str(self.path)

    def __repr__(self) -> str:
        return f"RunFolder({self.path})"

    @property
    def figures(self) -> Path:
        """The folder of the run's figures; it need not exist."""
        return self.path / "figures"

    @property
    def evaluation_files(self) -> tuple[Path, Path]:
        """The files of the evaluation: its summary and its trajectories."""
        return self.path / EVALUATION, self.path / TRAJECTORIES

    # What the folder holds

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
        path = self.path / LOCK
        with contextlib.ExitStack() as stack:
            while True:
                with files.os_errors_as_run_errors(f"cannot write {path}"):
                    file = stack.enter_context(path.open("ab"))
                if not _acquire(file):
                    raise RunError(f"{self.path} is in use: another process trains this run")
                # The process that held the lock may have removed the file in the meantime: then it locks nothing.
                with contextlib.suppress(OSError):
                    if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                        break
            try:
                yield
            finally:
                with contextlib.suppress(OSError):
                    path.unlink()

    # Configuration and manifest

    def experiment(self, trust: bool = False) -> ExperimentConfig:
        """Reads the configuration.

        Args:
            trust: Whether modules that it names ("module:Class") may be imported, which executes them.

        Raises:
            RunError: It is missing, not one that this version understands, or names modules and is not trusted.
        """
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
        path = self.path / MANIFEST
        if not path.is_file():
            if (self.path / EXPERIMENT).is_file():
                raise RunError(f"{self.path} holds an unfinished run: finish it with murmurate discover --resume")
            raise RunError(f"{self.path} holds no run: it has no {MANIFEST}")
        manifest = files.read_json(path)
        version = manifest.get("format") if isinstance(manifest, dict) else None
        if version != FORMAT:
            raise RunError(f"{path} has format {version!r}; this version of murmurate reads format {FORMAT}")
        manifest.setdefault("valid_pattern", manifest.get("outcome") == _OUTCOME)
        names, sums = manifest.get("policies"), manifest.get("checksums")
        if not isinstance(sums, dict) or not all(isinstance(value, str) for value in sums.values()):
            raise RunError(f"{path} has no checksums")
        if not isinstance(names, list) or not names or not {EXPERIMENT, *_policy_files(len(names))} <= sums.keys():
            raise RunError(f"{path} does not list every policy with its checksum")
        return manifest

    def write_manifest(self, manifest: Mapping[str, Any], policies: int) -> dict[str, Any]:
        """Writes the manifest, which marks the run as finished.

        Args:
            manifest: Its contents, without format, policies and checksums.
            policies: Number of policies.

        Returns:
            Its contents, as `manifest` returns them.
        """
        names = [EXPERIMENT, *_policy_files(policies)]
        if (self.path / STARTS).is_file():
            names.insert(1, STARTS)
        contents = {
            "format": FORMAT,
            **manifest,
            "policies": [policy_name(index) for index in range(policies)],
            "checksums": {name: files.checksum(self.path / name) for name in names},
        }
        files.write_json(self.path / MANIFEST, contents)
        return self.manifest()

    def verify(self) -> dict[str, Any]:
        """Checks the files of a finished run by their checksums.

        Returns:
            The manifest.

        Raises:
            RunError: The run is not finished, a file is missing or changed, or the manifest is damaged.
        """
        manifest = self.manifest()
        for name, recorded in manifest["checksums"].items():
            if "\0" in name or Path(name).is_absolute() or ".." in Path(name).parts:
                raise RunError(f"{self.path / MANIFEST} names a file outside the run: {name}")
            if files.checksum(self.path / name) != recorded:
                raise RunError(f"{self.path / name} does not match its checksum in {MANIFEST}")
        return manifest

    # Policies and training

    def policies(self, templates: Sequence[Any]) -> tuple[Any, ...]:
        """Reads the first policies of the list.

        Args:
            templates: Networks of the same structure, one for each policy to read; see `discovery.policy_templates`.

        Raises:
            RunError: A file is missing or damaged, or holds other arrays than its template.
        """
        names = _policy_files(len(templates))
        return tuple(files.read_tree(self.path / name, like) for name, like in zip(names, templates, strict=True))

    def write_policies(self, policies: Sequence[Any]) -> None:
        """Writes the policies of the list."""
        files.make_folder(self.path / "policies")
        for name, policy in zip(_policy_files(len(policies)), policies, strict=True):
            files.write_tree(self.path / name, policy)

    def checkpoint(self, search: Search) -> Checkpoint:
        """Reads the checkpoint; without one, returns the beginning of the search.

        Raises:
            RunError: It is damaged, or not of this experiment.
        """
        path = self.path / CHECKPOINT / "snapshot.safetensors"
        if not path.exists():
            return Checkpoint(search.begin())
        notes = files.read_notes(path)
        try:
            policies = policy_templates(search.problem, notes["policies"])
            sigma = jax.ShapeDtypeStruct((notes["sigma"], search.problem.world.robots, 2), jnp.float32)
            template = {"policies": policies, "sigma": sigma, "train": None}
            valid, finished, training = float(notes["valid"]), bool(notes["finished"]), bool(notes["training"])
            rows, seconds = int(notes["rows"]), float(notes["seconds"])
        except (KeyError, TypeError, ValueError) as error:
            raise RunError(f"{path} is not a checkpoint of this version of murmurate: {error!r}") from None
        if training:
            template["train"] = eqx.filter_eval_shape(_training_state, search, policies, sigma)
        tree = files.read_tree(path, template, _RENAMED)
        return Checkpoint(Snapshot(tree["policies"], tree["sigma"], valid, tree["train"], finished), rows, seconds)

    def checkpoint_rows(self) -> int:
        """Returns how many rows of metrics the checkpoint was saved after; 0 without a checkpoint.

        Raises:
            RunError: It is damaged.
        """
        path = self.path / CHECKPOINT / "snapshot.safetensors"
        notes = files.read_notes(path) if path.exists() else {"rows": 0}
        rows = notes.get("rows") if isinstance(notes, dict) else None
        if not isinstance(rows, int):
            raise RunError(f"{path} is not a checkpoint of this version of murmurate")
        return rows

    def write_checkpoint(self, checkpoint: Checkpoint) -> None:
        """Writes a checkpoint in place of the one before."""
        snapshot = checkpoint.snapshot
        notes = {
            "policies": len(snapshot.policies),
            "sigma": len(snapshot.sigma),
            "training": snapshot.train is not None,
            "valid": snapshot.valid,
            "finished": snapshot.finished,
            "rows": checkpoint.rows,
            "seconds": checkpoint.seconds,
        }
        tree = {"policies": snapshot.policies, "sigma": snapshot.sigma, "train": snapshot.train}
        files.make_folder(self.path / CHECKPOINT)
        files.write_tree(self.path / CHECKPOINT / "snapshot.safetensors", tree, notes)

    def initial(self, config: ExperimentConfig) -> tuple[tuple[Any, ...], dict[str, Any] | None]:
        """Reads the policies that the training began with, from its beginning to its end.

        Args:
            config: The run's configuration.

        Returns:
            The policies, and the run that they are from; `()` and None where the training began with new ones.

        Raises:
            RunError: They are damaged.
        """
        path = self.path / CHECKPOINT / "initial.safetensors"
        if not path.exists():
            return (), None
        notes = files.read_notes(path)
        if not isinstance(notes, dict) or not isinstance(notes.get("policies"), int):
            raise RunError(f"{path} is not of this version of murmurate")
        return files.read_tree(path, policy_templates(config, notes["policies"])), notes.get("origin")

    def write_initial(self, policies: Sequence[Any], origin: Mapping[str, Any] | None) -> None:
        """Writes the policies that the training begins with, so that it can be resumed without their run."""
        files.make_folder(self.path / CHECKPOINT)
        notes = {"policies": len(policies), "origin": origin}
        files.write_tree(self.path / CHECKPOINT / "initial.safetensors", tuple(policies), notes)

    def remove_checkpoint(self) -> None:
        """Removes what only an unfinished run needs."""
        shutil.rmtree(self.path / CHECKPOINT, ignore_errors=True)

    def metrics(self) -> list[dict[str, Any]]:
        """Reads the rows of metrics, one for each update; none where nothing was recorded.

        Raises:
            RunError: The file is damaged.
        """
        return self.new_metrics(0)[0]

    def new_metrics(self, offset: int) -> tuple[list[dict[str, Any]], int]:
        """Reads the rows of metrics behind an offset in the file, as `files.read_rows` does.

        Returns:
            The rows, and the offset behind them.

        Raises:
            RunError: The file is damaged.
        """
        path = self.path / METRICS
        rows, end = files.read_rows(path, offset)
        for number, row in enumerate(rows, 1):
            signals = row.get("signals")
            numbers = [row.get("policy"), row.get("update"), row.get("environment_steps")]
            if not all(_is_number(value) for value in numbers) or not isinstance(signals, dict):
                raise RunError(f"{path} is damaged: line {number} is not a row of metrics")
        return rows, end

    def append_metrics(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Appends rows of metrics, all of them or none."""
        files.append_rows(self.path / METRICS, rows)

    def truncate_metrics(self, rows: int) -> None:
        """Cuts the metrics back to their first rows, those before a checkpoint."""
        files.truncate_rows(self.path / METRICS, rows)

    # Evaluation

    def evaluation(self) -> dict[str, Any]:
        """Reads the evaluation's summary.

        Returns:
            The contents of evaluation.json. Fractions and mean steps are floats, NaN where they could not be computed;
            `starts` is a dictionary, see `describe_starts`.

        Raises:
            RunError: It is missing or incomplete.
        """
        path = self.path / EVALUATION
        summary, remedy = files.read_json_object(path), f"make it again with murmurate evaluate {self.path}"
        if "collision_free" in summary:  # version 0.1.0 counted contact and leaving the world together
            summary |= {"contact_free": summary["collision_free"], "inside": summary["collision_free"]}
        if isinstance(summary.get("starts"), str):
            kind = summary["starts"] if summary["starts"] in ("fresh", "given") else "file"
            summary["starts"] = {"kind": kind} | ({"name": summary["starts"]} if kind == "file" else {})
        needed = ("starts", "episodes", "valid_interval", "signal", "failures", *_FRACTIONS, *_STEPS)
        missing = [name for name in needed if name not in summary]
        if missing:
            raise RunError(f"{path} lacks {missing[0]}: {remedy}")
        interval, starts = summary["valid_interval"], summary["starts"]
        numbers = {name: summary[name] for name in (*_FRACTIONS, *_STEPS)} | _as_numbers(summary["signal"], "signal")
        numbers |= _as_numbers(interval if isinstance(interval, list) and len(interval) == 2 else "", "valid_interval")
        for name, value in numbers.items():
            if value is not None and not _is_number(value):
                raise RunError(f"{path} has {name} = {value!r}, which is not a number: {remedy}")
        episodes, failures = summary["episodes"], summary["failures"]
        if not isinstance(episodes, int) or episodes < 1:
            raise RunError(f"{path} has episodes = {episodes!r}, which is not a number of episodes: {remedy}")
        if not isinstance(failures, list) or not all(isinstance(index, int) for index in failures):
            raise RunError(f"{path} has failures = {failures!r}, which are not episodes: {remedy}")
        if not isinstance(starts, dict) or starts.get("kind") not in ("fresh", "file", "given"):
            raise RunError(f"{path} has starts = {starts!r}, which is unknown: {remedy}")
        for name in (*_FRACTIONS, *_STEPS):
            summary[name] = float("nan") if summary[name] is None else float(summary[name])
        return summary

    def trajectories(self) -> Trajectories:
        """Reads the episodes of the evaluation.

        Returns:
            The episodes. Version 0.1.0 did not record `terminated` and `epochs`: there they are false, and the lengths.

        Raises:
            RunError: They are missing, damaged, not of this experiment, or not finite.
        """
        path = self.path / TRAJECTORIES
        arrays = files.read_npz(path)
        required = ("positions", "lengths", "switch", "signals", "signal_names", "at_rest")
        for name in required:
            if name not in arrays:
                raise RunError(f"{path} lacks {name}")
        positions, names = arrays["positions"], arrays["signal_names"]
        if positions.ndim != 4 or positions.shape[3] != 2 or 0 in positions.shape or positions.dtype.kind != "f":
            shape = f"{positions.dtype}{list(positions.shape)}"
            raise RunError(f"{path} has positions as {shape}, not as float32[episodes, steps + 1, robots, 2]")
        episodes, configurations = positions.shape[:2]
        switches = arrays["switch"].shape[-1] if arrays["switch"].ndim else 0
        expected = {
            "lengths": ("iu", (episodes,)),
            "switch": ("iu", (episodes, switches)),
            "at_rest": ("b", (episodes,)),
            "signal_names": ("U", (len(names) if names.ndim else 0,)),
            "signals": ("f", (episodes, configurations, len(names) if names.ndim else 0)),
            "terminated": ("b", (episodes,)),
            "epochs": ("iu", (episodes,)),
        }
        for name, (kinds, shape) in expected.items():
            if name in arrays and (arrays[name].shape != shape or arrays[name].dtype.kind not in kinds):
                have = f"{arrays[name].dtype}{list(arrays[name].shape)}"
                raise RunError(f"{path} has {name} as {have}, which does not fit positions of {list(positions.shape)}")
        lengths, signals = arrays["lengths"].astype(int), arrays["signals"]
        if lengths.min() < 0 or lengths.max() >= configurations:
            raise RunError(f"{path} has lengths that are not from 0 to {configurations - 1}")
        if not (np.isfinite(positions).all() and np.isfinite(signals).all()):
            raise RunError(f"{path} has positions or signals that are not finite: the training diverged")
        return Trajectories(
            positions=positions,
            lengths=lengths,
            switch=arrays["switch"].astype(int),
            at_rest=arrays["at_rest"],
            terminated=arrays.get("terminated", np.zeros(episodes, bool)),
            epochs=arrays.get("epochs", lengths).astype(int),
            signals={str(name): signals[..., index] for index, name in enumerate(names)},
        )

    def record(self) -> dict[str, Any] | None:
        """Reads the pattern that is better than the best known one, as an entry of that table; None without one."""
        path = self.path / RECORD
        return files.read_json_object(path) if path.is_file() else None

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
            files.write_json(self.path / RECORD, record)
        else:
            with files.os_errors_as_run_errors(f"cannot write to {self.path}"):
                (self.path / RECORD).unlink(missing_ok=True)
        files.write_npz(self.path / TRAJECTORIES, arrays)
        files.write_json(self.path / EVALUATION, summary)

    def copy_to(self, folder: str | os.PathLike[str]) -> RunFolder:
        """Copies a finished run without its evaluation and figures.

        Raises:
            RunError: The folder holds something, or cannot be written to; or this run is damaged.
        """
        manifest, copy = self.verify(), RunFolder(folder)
        copy.create()
        # The manifest last: it marks the copy as complete.
        for name in (*manifest["checksums"], METRICS, MANIFEST):
            source, target = self.path / name, copy.path / name
            if source.is_file():
                files.make_folder(target.parent)
                files.write_bytes(target, files.read_bytes(source))
        return copy


def is_fresh(summary: Mapping[str, Any]) -> bool:
    """Returns whether an evaluation began at fresh starts of its experiment, not at given ones."""
    return summary["starts"]["kind"] == "fresh"


def describe_starts(summary: Mapping[str, Any]) -> str:
    """Returns in words where the episodes of an evaluation began.

    Args:
        summary: What `RunFolder.evaluation` returns. Its `starts` has the field `kind`: fresh (drawn by the seed), file
            (with the file's `name`) or given (in Python).
    """
    starts = summary["starts"]
    return f"starts of {starts['name']}" if starts["kind"] == "file" else f"{starts['kind']} starts"


def _acquire(file: Any) -> bool:
    """Locks an open file without waiting; returns whether it is ours. A file system without locks counts as locked."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno in _NO_LOCKS
    return True


def _policy_files(count: int) -> list[str]:
    return [f"policies/{index}-{policy_name(index)}.safetensors" for index in range(count)]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _as_numbers(values: Any, name: str) -> dict[str, Any]:
    """Returns the values of a list or a dictionary by the names that messages give them."""
    if isinstance(values, list):
        return {f"{name}[{index}]": value for index, value in enumerate(values)}
    return {f"{name}.{key}": value for key, value in values.items()} if isinstance(values, dict) else {name: values}


def _training_state(search: Search, policies: tuple[Any, ...], sigma: jax.Array) -> Any:
    return search.training(Snapshot(policies, sigma, 0.0, None))
