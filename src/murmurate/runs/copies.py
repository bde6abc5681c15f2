"""What each of several hosts keeps of a run: the first one the run folder, the others a copy that ends with them.

So every host does the same with what it has, and the run folder need not be the same place for all.
"""

from __future__ import annotations

import io
import tarfile
import tempfile
from pathlib import Path

import jax

from murmurate.runs import storage
from murmurate.learning import hosts

__all__ = ["place"]

_kept: list[tempfile.TemporaryDirectory[str]] = []  # each goes with the process


def place(folder: Path, resume: bool) -> Path:
    """Returns where this host keeps a run, with all in it that the first host's folder holds.

    Args:
        folder: The run folder, on the first host.
        resume: Continue what that holds.

    Raises:
        RunError: The folder holds something that would be overwritten.
    """
    if jax.process_count() == 1:
        return folder
    if hosts.is_first():
        hosts.sent(_packed(folder) if storage.look(folder, resume) != "new" else b"")
        return folder
    data = hosts.sent(b"")
    _kept.append(tempfile.TemporaryDirectory(prefix="murmurate-"))
    copy = Path(_kept[-1].name)
    if data:
        with tarfile.open(fileobj=io.BytesIO(data)) as archive:
            archive.extractall(copy / folder.name, filter="data")
    return copy / folder.name


def _packed(folder: Path) -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        archive.add(folder, arcname=".")
    return buffer.getvalue()
