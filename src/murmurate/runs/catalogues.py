"""Catalogues in folders: the valid patterns of finished runs, sorted into classes and written as JSON and CSV."""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from murmurate.errors import InputError, RunError
from murmurate.runs import experiment as configuration
from murmurate.runs import storage, table
from murmurate.runs.evaluate import EVALUATION, FRESH, TRAJECTORIES
from murmurate.analysis import Catalogue, Finding
from murmurate.analysis.optimum.best_known import best_known
from murmurate.analysis.optimum.formation import Target

__all__ = ["CATALOGUE", "CLASSES", "findings", "look", "save"]

CATALOGUE, CLASSES = "catalogue.json", "catalogue.csv"


def findings(folder: str | Path) -> tuple[Finding, ...]:
    """Reads what was found: the valid patterns of a run's evaluation, or all of a catalogue's.

    Args:
        folder: Of a finished run, or of a catalogue.

    Raises:
        RunError: It is missing or neither of them, or damaged, or of an unknown version.
    """
    folder = Path(folder)
    if (folder / CATALOGUE).is_file():
        try:
            return Catalogue.from_dict(storage.read_json(folder / CATALOGUE)).findings
        except InputError as error:
            raise RunError(f"{folder / CATALOGUE}: {error}") from None
    manifest = storage.read_manifest(folder)
    storage.verify(folder, manifest)
    config, summary = configuration.load(folder), table.read_evaluation(folder)
    failures = summary.get("failures")
    if not isinstance(failures, list):
        raise RunError(f"{folder / EVALUATION} lacks failures: make it again with murmurate evaluate {folder}")
    target = Target(config.world, config.objective)
    known = best_known(target)
    found = []
    for episode, positions in enumerate(_finals(folder, config.world.robots)):
        if episode in failures:
            continue
        value = target.value(positions)
        found.append(
            Finding(
                positions=positions,
                radius=config.world.radius,
                safe_distance=config.world.safe_distance,
                scan_radius=config.world.scan_radius,
                objective=config.objective,
                value=value,
                gap=None if known is None else known - value,
                experiment=config.name,
                policy=config.policy.name,
                start=config.start.name if summary["starts"] == FRESH else str(summary["starts"]),
                seed=config.seed,
                run=_identity(manifest, summary),
                episode=episode,
            )
        )
    return tuple(found)


def look(folder: str | Path) -> None:
    """Makes sure that a catalogue may be written to a folder: a new or empty one, or one that holds a catalogue.

    Raises:
        RunError: The folder holds other files.
    """
    folder = Path(folder)
    with storage.os_errors_as_run_errors(f"cannot write to {folder}"):
        present = list(folder.iterdir()) if folder.exists() else []
    if present and not (folder / CATALOGUE).is_file():
        raise RunError(f"{folder} holds other files: choose another --out")


def save(catalogue: Catalogue, folder: str | Path) -> None:
    """Writes a catalogue as JSON, which can be read again, and its classes as CSV.

    Raises:
        RunError: A file cannot be written.
    """
    folder = Path(folder)
    storage.make_folder(folder)
    storage.write_json(folder / CATALOGUE, catalogue.to_dict())
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(catalogue.rows())
    storage.write_text(folder / CLASSES, text.getvalue())


def _finals(folder: Path, robots: int) -> Float[np.ndarray, "episodes robots 2"]:
    """Returns the last configuration of each episode."""
    positions = storage.read_npz(folder / TRAJECTORIES).get("positions", np.empty(0))
    if positions.ndim != 4 or positions.shape[2:] != (robots, 2) or not positions.shape[1]:
        raise RunError(f"{folder / TRAJECTORIES} does not hold the positions of {robots} robots")
    return positions[:, -1].astype(float)


def _identity(manifest: Mapping[str, Any], summary: Mapping[str, Any]) -> str:
    """Names the policies and the starts that they were evaluated from."""
    told = [manifest["checksums"], summary["starts"], summary.get("seed"), summary["episodes"]]
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:16]
