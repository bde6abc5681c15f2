"""Files written whole or not at all and checked when read: JSON, NumPy arrays, rows of metrics, trees of arrays.

Every file is written under another name and then moved into place, so that a killed process or a full disk never leaves
half a file. Nothing is pickled: a file from a stranger is safe to read.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import safetensors
import safetensors.numpy

from murmurate.errors import RunError

__all__ = [
    "append_rows",
    "checksum",
    "entries",
    "fit_tree",
    "make_folder",
    "make_writable",
    "os_errors_as_run_errors",
    "read_bytes",
    "read_json",
    "read_json_object",
    "read_notes",
    "read_npz",
    "read_rows",
    "read_tree",
    "to_json",
    "truncate_rows",
    "write_bytes",
    "write_json",
    "write_npz",
    "write_text",
    "write_tree",
]

T = TypeVar("T")

_PROBE_BYTES = 1 << 16


@contextlib.contextmanager
def os_errors_as_run_errors(what: str) -> Iterator[None]:
    """Turns an `OSError` into a `RunError` that begins with `what`."""
    try:
        yield
    except OSError as error:
        raise RunError(f"{what}: {error.strerror or error}") from error


# Folders


def entries(folder: str | Path) -> set[str]:
    """Returns the names in a folder, without unfinished files and locks; a missing folder has none.

    Raises:
        RunError: It cannot be written to, as where it is a file.
    """
    folder = Path(folder)
    with os_errors_as_run_errors(f"cannot write to {folder}"):
        names = {path.name for path in folder.iterdir()} if folder.exists() else set()
    return {name for name in names if not (name.startswith(".") and name.endswith((".partial", ".lock")))}


def make_folder(path: str | Path) -> None:
    """Creates a folder where there is none.

    Raises:
        RunError: It cannot be created.
    """
    with os_errors_as_run_errors(f"cannot create {path}"):
        Path(path).mkdir(parents=True, exist_ok=True)


def make_writable(folder: str | Path) -> None:
    """Creates a folder and writes a file on trial; removes the folders that it created if that fails.

    Raises:
        RunError: The folder cannot be created or written to.
    """
    folder = Path(folder)
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        with os_errors_as_run_errors(f"cannot write to {folder}"):
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
        RunError: It cannot be written; the file that was there before still is.
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


def checksum(path: str | Path) -> str:
    """Returns the SHA-256 of a file.

    Raises:
        RunError: It cannot be read.
    """
    with os_errors_as_run_errors(f"cannot read {path}"), Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# JSON and arrays


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
    except (ValueError, RecursionError) as error:
        raise RunError(f"{path} is not valid JSON: {error}") from None


def read_json_object(path: str | Path) -> dict[str, Any]:
    """Reads a JSON file that holds an object.

    Raises:
        RunError: The file is missing, is not JSON, or holds something else.
    """
    value = read_json(path)
    if not isinstance(value, dict):
        raise RunError(f"{path} does not hold a JSON object")
    return value


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


# Rows: one JSON object a line


def append_rows(path: str | Path, rows: Iterable[Mapping[str, Any]]) -> None:
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


def read_rows(path: str | Path, offset: int = 0) -> tuple[list[dict[str, Any]], int]:
    """Reads a file of `append_rows`; a missing file has no rows, and a last line without its end is left out.

    Args:
        path: The file.
        offset: Bytes at its beginning to leave out, as an earlier call returned them.

    Returns:
        The rows, and the offset behind them.

    Raises:
        RunError: A line is not a JSON object, or the file cannot be read.
    """
    rows: list[dict[str, Any]] = []
    if not Path(path).exists():
        return rows, offset
    with os_errors_as_run_errors(f"cannot read {path}"), Path(path).open("rb") as file:
        file.seek(offset)
        lines = file.readlines()
    for number, line in enumerate(lines, 1):
        if not line.endswith(b"\n"):  # the process was killed here
            break
        try:
            row = json.loads(line)
        except (ValueError, RecursionError):
            row = None
        if not isinstance(row, dict):
            behind = f" behind byte {offset}" if offset else ""
            raise RunError(f"{path} is damaged: line {number}{behind} is not a JSON object")
        rows.append(row)
    return rows, offset + sum(map(len, lines[: len(rows)]))


def truncate_rows(path: str | Path, count: int) -> None:
    """Cuts a file of `append_rows` back to its first rows; a missing file has none.

    Raises:
        RunError: The file has fewer rows, or cannot be written.
    """
    path = Path(path)
    with os_errors_as_run_errors(f"cannot read {path}"):
        lines = path.read_bytes().splitlines(keepends=True) if path.exists() else []
    complete = [line for line in lines[:count] if line.endswith(b"\n")]
    if len(complete) < count:
        raise RunError(f"{path} has {len(complete)} rows, but the checkpoint was saved after {count}")
    if len(lines) > count:
        write_bytes(path, b"".join(complete))


# Trees of arrays, as policies and training states are: safetensors files, bit for bit


def write_tree(path: str | Path, tree: Any, notes: Any = None) -> None:
    """Writes the arrays of a PyTree to a safetensors file, named by their positions in the tree, whole or not at all.

    Leaves that are not arrays (activation functions, for example) belong to the template that `read_tree` is given.

    Args:
        path: The file.
        tree: Equinox modules, optax states, dictionaries and the like; PRNG keys as `jax.random.key_data`.
        notes: Anything that JSON can hold, kept in the header of the file for `read_notes`.

    Raises:
        RunError: The file cannot be written.
    """
    header = None if notes is None else {"notes": to_json(notes)}
    write_bytes(path, safetensors.numpy.save(_arrays(tree), metadata=header))


def read_tree(path: str | Path, template: T, renamed: Mapping[str, str] | None = None) -> T:
    """Reads a file of `write_tree`, bit for bit.

    Args:
        path: The file.
        template: A tree of the same structure; its arrays, or `jax.ShapeDtypeStruct`s, say what the file must hold.
        renamed: New names of fields that older versions called otherwise: used where the template has no array of the
            old name.

    Returns:
        The template with the arrays of the file.

    Raises:
        RunError: The file is missing or damaged, or its names, shapes or types are not those of the template.
    """
    data = read_bytes(path)
    try:
        arrays = safetensors.numpy.load(data)
    except (safetensors.SafetensorError, KeyError, ValueError) as error:
        raise RunError(f"{path} is not a valid safetensors file: {error}") from None
    if renamed:
        known = {name for name, _ in _named_leaves(template)}
        new_names = {name: "/".join(renamed.get(part, part) for part in name.split("/")) for name in arrays}
        arrays = {name if name in known else new_names[name]: array for name, array in arrays.items()}
    return _fit(arrays, template, str(path))


def fit_tree(tree: Any, template: T, source: str) -> T:
    """Returns a template with the arrays of another tree, matched by their positions in the tree.

    Args:
        tree: The tree that holds the arrays.
        template: See `read_tree`.
        source: What the message calls the tree.

    Raises:
        RunError: The names, shapes or types of the arrays are not those of the template.
    """
    return _fit(_arrays(tree), template, source)


def read_notes(path: str | Path) -> Any:
    """Reads the notes of a file of `write_tree`; None when it has none.

    Raises:
        RunError: The file is missing or damaged.
    """
    try:
        with os_errors_as_run_errors(f"cannot read {path}"), safetensors.safe_open(path, framework="numpy") as file:
            return json.loads((file.metadata() or {}).get("notes", "null"))
    except (safetensors.SafetensorError, ValueError) as error:
        raise RunError(f"{path} is not a valid safetensors file: {error}") from None


def _fit(arrays: Mapping[str, np.ndarray], template: T, source: str) -> T:
    named = _named_leaves(template)
    expected = {name for name, leaf in named if _is_array(leaf)}
    for problem, names in (("lacks", expected - arrays.keys()), ("has the unexpected", arrays.keys() - expected)):
        if names:
            raise RunError(f"{source} {problem} array {min(names)!r}")
    leaves = []
    for name, leaf in named:
        if not _is_array(leaf):
            leaves.append(leaf)
            continue
        array = arrays[name]
        if array.shape != leaf.shape or array.dtype != leaf.dtype:
            have, want = (f"{x.dtype}{list(x.shape)}" for x in (array, leaf))
            raise RunError(f"{source} has {name!r} as {have}, but {want} is needed")
        # An array of the library that the template's leaf belongs to.
        leaves.append(array.copy() if isinstance(leaf, np.ndarray) else jnp.array(array))
    return jax.tree_util.tree_unflatten(jax.tree_util.tree_structure(template), leaves)


def _arrays(tree: Any) -> dict[str, np.ndarray]:
    return {name: np.asarray(leaf, order="C") for name, leaf in _named_leaves(tree) if _is_array(leaf)}


def _named_leaves(tree: Any) -> list[tuple[str, Any]]:
    """Returns the leaves with their positions in the tree as names, such as `layers/0/weight`."""
    named = [
        (jax.tree_util.keystr(path, simple=True, separator="/"), leaf)
        for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]
    ]
    if len({name for name, _ in named}) < len(named):
        raise ValueError("two leaves of the tree have the same name")
    return named


def _is_array(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray | jax.ShapeDtypeStruct)


def _write_synced(path: Path, data: bytes) -> None:
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _plain(value: Any) -> Any:
    """Returns a value as JSON has it: numbers and arrays of NumPy and JAX as Python's, what is not finite as None."""
    if isinstance(value, Mapping):
        return {str(name): _plain(inner) for name, inner in value.items()}
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
