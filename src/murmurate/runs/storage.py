"""The files of a run folder: written whole or not at all, checked when read, free of pickle.

Every file is written beside its place and then moved there, so that a killed process or a full disk never leaves half a
file under its name. Trees of arrays, as policies are, have `trees`; a run from a stranger is safe to open.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import math
import os
import platform
from collections.abc import Iterable, Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np

from murmurate.errors import RunError

__all__ = [
    "EXPERIMENT",
    "FORMAT",
    "MANIFEST",
    "append_lines",
    "checksums",
    "claim",
    "look",
    "make_folder",
    "os_errors_as_run_errors",
    "read_bytes",
    "read_json",
    "read_manifest",
    "read_npz",
    "to_json",
    "truncate_lines",
    "verify",
    "versions",
    "write_bytes",
    "write_json",
    "write_npz",
    "write_text",
]

FORMAT = 1
MANIFEST = "manifest.json"
EXPERIMENT = "experiment.toml"
_PACKAGES = ("jax", "jaxlib", "equinox", "optax", "numpy")
_PROBE_BYTES = 1 << 16


# Claiming a folder


Found = Literal["new", "unfinished", "finished"]


def look(folder: str | Path, resume: bool = False) -> Found:
    """Makes sure that nothing in a folder would be overwritten; writes nothing.

    Args:
        folder: The output folder.
        resume: Continue the run that the folder holds, if it holds one.

    Returns:
        What the folder holds: nothing yet, a run to continue, or a finished run. Without `resume`, always "new".

    Raises:
        RunError: The folder holds something that would be overwritten, or cannot be read.
    """
    folder = Path(folder)
    with os_errors_as_run_errors(f"cannot write to {folder}"):
        present = {path.name for path in folder.iterdir() if not _is_partial(path)} if folder.exists() else set()
        is_run = bool(present & {EXPERIMENT, MANIFEST})
        if present and not is_run:
            raise RunError(f"{folder} holds other files: choose another --out")
        if is_run and not resume:
            raise RunError(f"{folder} holds another run: continue it with --resume, or choose another --out")
    if MANIFEST in present:
        return "finished"
    return "unfinished" if is_run else "new"


def claim(folder: str | Path, resume: bool = False) -> Found:
    """Makes sure that a run may be written to a folder, and creates it; nothing else is written.

    Args:
        folder: The output folder.
        resume: Continue the run that the folder holds, if it holds one.

    Returns:
        What the folder holds; see `look`.

    Raises:
        RunError: The folder holds something that would be overwritten, or cannot be written to.
    """
    found, folder = look(folder, resume), Path(folder)
    if found != "finished":
        with os_errors_as_run_errors(f"cannot write to {folder}"):
            _make_writable(folder)
    return found


def _make_writable(folder: Path) -> None:
    """Creates a folder and tries it out; whatever was created is taken away again when that fails."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".probe.partial"
        try:
            _write_synced(probe, bytes(_PROBE_BYTES))
        finally:
            probe.unlink(missing_ok=True)
    except BaseException:
        for path in missing:
            with contextlib.suppress(OSError):
                path.rmdir()
        raise


# Whole files


def make_folder(path: str | Path) -> None:
    """Creates a folder where there is none.

    Raises:
        RunError: It cannot be created.
    """
    with os_errors_as_run_errors(f"cannot create {path}"):
        Path(path).mkdir(parents=True, exist_ok=True)


def read_bytes(path: str | Path) -> bytes:
    """Reads a file.

    Raises:
        RunError: It is missing or cannot be read.
    """
    with os_errors_as_run_errors(f"cannot read {path}"):
        return Path(path).read_bytes()


def write_bytes(path: str | Path, data: bytes) -> None:
    """Writes a file whole or not at all.

    Raises:
        RunError: It cannot be written; what stood there before still does.
    """
    path = Path(path)
    partial = path.with_name(f".{path.name}.partial")
    try:
        with os_errors_as_run_errors(f"cannot write {path}"):
            _write_synced(partial, data)
            partial.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            partial.unlink()
        raise


def write_text(path: str | Path, text: str) -> None:
    """Writes a text file (UTF-8) whole or not at all; see `write_bytes`."""
    write_bytes(path, text.encode())


def to_json(value: Any, indent: int | None = None) -> str:
    """Returns a value as JSON; NaN and infinities, which JSON does not have, become null."""
    return json.dumps(_plain(value), indent=indent, allow_nan=False)


def write_json(path: str | Path, value: Any) -> None:
    """Writes a JSON file whole or not at all; NaN and infinities, which JSON does not have, become null."""
    write_text(path, to_json(value, indent=2) + "\n")


def read_json(path: str | Path) -> Any:
    """Reads a JSON file.

    Raises:
        RunError: The file is missing or is not JSON.
    """
    try:
        return json.loads(read_bytes(path))
    except ValueError as error:
        raise RunError(f"{path} is not valid JSON: {error}") from None


def write_npz(path: str | Path, arrays: Mapping[str, Any]) -> None:
    """Writes named arrays as a compressed npz file, whole or not at all.

    Raises:
        RunError: The file cannot be written.
        TypeError: An array holds Python objects, which NumPy would pickle.
    """
    named: dict[str, Any] = {name: np.asarray(array) for name, array in arrays.items()}
    for name, array in named.items():
        if array.dtype.hasobject:
            raise TypeError(f"{name} holds Python objects")
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **named)
    write_bytes(path, buffer.getvalue())


def read_npz(path: str | Path) -> dict[str, np.ndarray]:
    """Reads the arrays of an npz file; pickled objects are refused.

    Raises:
        RunError: The file is missing or damaged.
    """
    data = read_bytes(path)
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            return dict(file)
    except Exception as error:  # zipfile, zlib and numpy each have errors of their own for a damaged file
        raise RunError(f"{path} is not a valid npz file: {error}") from None


# Lines


def append_lines(path: str | Path, rows: Iterable[Any]) -> None:
    """Appends one line of JSON for each row, all of them or none.

    Raises:
        RunError: The file cannot be written.
    """
    data = "".join(to_json(row) + "\n" for row in rows).encode()
    with os_errors_as_run_errors(f"cannot write {path}"), Path(path).open("ab", buffering=0) as file:
        size = file.tell()
        try:
            while data:  # an unbuffered write may take only part of the data
                data = data[file.write(data) :]
            os.fsync(file.fileno())
        except BaseException:
            file.truncate(size)
            raise


def truncate_lines(path: str | Path, count: int) -> None:
    """Cuts a file back to its first `count` lines, as a checkpoint says on resuming; a missing file has none.

    Raises:
        RunError: The file has fewer lines, or cannot be written.
    """
    path = Path(path)
    with os_errors_as_run_errors(f"cannot read {path}"):
        lines = path.read_bytes().splitlines(keepends=True) if path.exists() else []
    kept = [line for line in lines[:count] if line.endswith(b"\n")]
    if len(kept) < count:
        raise RunError(f"{path} has {len(kept)} rows, but the checkpoint was saved after {count}")
    if len(lines) > count:
        write_bytes(path, b"".join(kept))


# The manifest


def versions() -> dict[str, str]:
    """Returns the versions of Python and of the packages that a run's numbers depend on."""
    return {"python": platform.python_version()} | {package: metadata.version(package) for package in _PACKAGES}


def checksums(folder: str | Path, names: Iterable[str]) -> dict[str, str]:
    """Returns the SHA-256 of files by their paths relative to the run folder.

    Raises:
        RunError: A file cannot be read.
    """
    return {name: _checksum(Path(folder) / name) for name in names}


def read_manifest(folder: str | Path) -> dict[str, Any]:
    """Reads the manifest of a finished run.

    Raises:
        RunError: The folder holds no finished run, or one of a format that this version does not know.
    """
    folder = Path(folder)
    path = folder / MANIFEST
    if not path.is_file():
        if (folder / EXPERIMENT).is_file():
            raise RunError(f"{folder} holds an unfinished run: finish it with murmurate discover --resume")
        raise RunError(f"{folder} holds no run: it has no {MANIFEST}")
    manifest = read_json(path)
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        found = manifest.get("format") if isinstance(manifest, dict) else None
        raise RunError(f"{path} has format {found!r}; this version of murmurate reads format {FORMAT}")
    return manifest


def verify(folder: str | Path, manifest: Mapping[str, Any]) -> None:
    """Compares the files of a run with the checksums in its manifest.

    Raises:
        RunError: A file is missing or changed, or the manifest has no checksums or names files outside the folder.
    """
    recorded = manifest.get("checksums")
    if not isinstance(recorded, dict):
        raise RunError(f"{Path(folder) / MANIFEST} has no checksums")
    for name, checksum in recorded.items():
        if "\0" in name or Path(name).is_absolute() or ".." in Path(name).parts:
            raise RunError(f"{Path(folder) / MANIFEST} names a file outside the run: {name}")
        if _checksum(Path(folder) / name) != checksum:
            raise RunError(f"{Path(folder) / name} does not match its checksum in {MANIFEST}")


def _checksum(path: Path) -> str:
    with os_errors_as_run_errors(f"cannot read {path}"), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# Shared


def _write_synced(path: Path, data: bytes) -> None:
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


@contextlib.contextmanager
def os_errors_as_run_errors(what: str) -> Iterator[None]:
    """Turns what the operating system says into one line about the run."""
    try:
        yield
    except OSError as error:
        raise RunError(f"{what}: {error.strerror or error}") from error


def _is_partial(path: Path) -> bool:
    return path.name.startswith(".") and path.name.endswith(".partial")


def _plain(value: Any) -> Any:
    """Returns a value as JSON has it: numbers and arrays of NumPy and JAX as Python's, what is not finite as None."""
    if isinstance(value, Mapping):
        return {str(name): _plain(inner) for name, inner in value.items()}
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
