"""The checkpoint of an unfinished run: one file, replaced whole after every chunk of updates."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp

from murmurate.discovery import Search, Snapshot, policy_templates
from murmurate.errors import RunError
from murmurate.runs import storage, serialization

__all__ = ["Checkpoint", "load", "remove", "save"]

_FOLDER = "checkpoint"
_FILE = "snapshot.safetensors"


@dataclass(frozen=True)
class Checkpoint:
    """How far a run has come.

    Attributes:
        snapshot: How far the discovery has come.
        rows: Rows of metrics until then.
        seconds: Time that training took until then.
    """

    snapshot: Snapshot
    rows: int = 0
    seconds: float = 0.0


def save(folder: str | Path, checkpoint: Checkpoint) -> None:
    """Writes a checkpoint in the place of the one before.

    Raises:
        RunError: It cannot be written; the one before still stands.
    """
    snapshot = checkpoint.snapshot
    tree = {"policies": snapshot.policies, "sigma": snapshot.sigma, "train": snapshot.train}
    notes = {
        "policies": len(snapshot.policies),
        "sigma": len(snapshot.sigma),
        "training": snapshot.train is not None,
        "valid": snapshot.valid,
        "finished": snapshot.finished,
        "rows": checkpoint.rows,
        "seconds": checkpoint.seconds,
    }
    storage.make_folder(Path(folder) / _FOLDER)
    serialization.save(Path(folder) / _FOLDER / _FILE, tree, notes)


def load(folder: str | Path, search: Search) -> Checkpoint:
    """Reads the checkpoint of a run; where there is none yet, the beginning.

    Raises:
        RunError: It is damaged, or not of this experiment.
    """
    path = Path(folder) / _FOLDER / _FILE
    if not path.exists():
        return Checkpoint(search.begin())
    notes = serialization.read_notes(path)
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
    tree = serialization.load(path, template)
    snapshot = Snapshot(tree["policies"], tree["sigma"], valid, tree["train"], finished)
    return Checkpoint(snapshot, rows, seconds)


def remove(folder: str | Path) -> None:
    """Removes the checkpoint of a run that is finished."""
    shutil.rmtree(Path(folder) / _FOLDER, ignore_errors=True)


def _training_state(search: Search, policies: tuple, sigma: jax.Array) -> object:
    return search.training(Snapshot(policies, sigma, 0.0, None))
