"""Catalogues in folders: the valid patterns of finished runs, sorted into classes and written as JSON and CSV."""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from murmurate.analysis import Catalogue, Finding
from murmurate.analysis.optimum.best_known import best_known
from murmurate.analysis.optimum.formation import Target
from murmurate.errors import InputError, RunError, check_path
from murmurate.runs import escape, files
from murmurate.runs.evaluate import evaluated
from murmurate.runs.folder import RunFolder, is_fresh, trained_checksums
from murmurate.world import Configuration, Objective

__all__ = ["CATALOGUE", "CLASSES", "MAP", "check_target", "read_findings", "write"]

CATALOGUE, CLASSES, MAP = "catalogue.json", "catalogue.csv", "map.csv"


def read_findings(folder: str | Path, trust: bool = False) -> tuple[Finding, ...]:
    """Reads the valid patterns of a run's evaluation, or all patterns of a catalogue.

    Args:
        folder: The folder of a finished run, or of a catalogue.
        trust: Whether modules that the run's configuration names may be imported.

    Raises:
        RunError: It is missing or neither of them, or damaged, or of an unknown version.
    """
    check_path("folder", folder)
    path = Path(folder) / CATALOGUE
    if path.is_file():
        try:
            return Catalogue.from_dict(files.read_json(path)).findings
        except InputError as error:
            raise RunError(f"{path}: {error}") from None
    return _run_findings(RunFolder(folder), trust)


def check_target(folder: str | Path) -> None:
    """Checks that a catalogue may be written to a folder: a new or empty one, or one that holds a catalogue.

    Raises:
        RunError: The folder holds other files.
    """
    check_path("folder", folder)
    if files.entries(folder) and not (Path(folder) / CATALOGUE).is_file():
        raise RunError(f"{folder} holds other files: choose another --out")


def write(catalogue: Catalogue, folder: str | Path) -> None:
    """Writes a catalogue as JSON, which can be read again, and its classes and its map as CSV.

    Raises:
        RunError: A file cannot be written.
    """
    check_path("folder", folder)
    folder = Path(folder)
    files.make_folder(folder)
    files.write_json(folder / CATALOGUE, catalogue.to_dict())
    for name, rows in ((CLASSES, catalogue.rows()), (MAP, catalogue.map_rows())):
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([*map(escape.cell, row)] for row in rows)
        files.write_text(folder / name, text.getvalue())


def _run_findings(run: RunFolder, trust: bool) -> tuple[Finding, ...]:
    manifest, config, summary = run.verify(), run.experiment(trust), evaluated(run, trust)
    episodes = sorted(set(range(summary["episodes"])) - set(summary["failures"]))
    if not episodes:  # the trajectories may not even be finite
        return ()
    final = run.trajectories(config).final.astype(float)
    objective = Objective(config.objective_signals)
    values = [float(objective(objective.measure(Configuration(points, config.world)))) for points in final]
    # Only for the paper's objectives, with its own weights, best-known patterns are kept.
    known = best_known(Target(config.world, config.objective)) if config.has_paper_objective else None
    return tuple(
        Finding(
            positions=final[episode],
            radius=config.world.radius,
            safe_distance=config.world.safe_distance,
            scan_radius=config.world.scan_radius,
            objective=config.objective if config.has_paper_objective else "custom",
            value=values[episode],
            gap=None if known is None else known - values[episode],
            experiment=config.name,
            policy=config.policy.name,
            start=config.start.name if is_fresh(summary) else summary["starts"].get("name", "given"),
            seed=config.seed,
            run=_identity(manifest, summary),
            episode=episode,
        )
        for episode in episodes
    )


def _identity(manifest: Mapping[str, Any], summary: Mapping[str, Any]) -> str:
    """Returns a short checksum of the policies and of the starts that they were evaluated from."""
    starts = "fresh" if is_fresh(summary) else summary["starts"]
    evaluation = [trained_checksums(manifest), starts, summary.get("seed"), summary["episodes"]]
    return hashlib.sha256(json.dumps(evaluation, sort_keys=True).encode()).hexdigest()[:16]
