"""Files written whole or not at all and checked when read: JSON, NumPy arrays, rows of metrics, trees of arrays.

Every file is written under another name and then moved into place, so that a killed process or a full disk never leaves
half a file. Nothing is pickled, no link is followed (see `untrusted`), and whatever is read has a bound: the size of a
file, how deep it nests, the digits of a number, the memory of its arrays. A file from a stranger is safe to read: all
that can come of it is a `RunError`.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import math
import os
import sys
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeVar

import jax
import numpy as np
import safetensors
import safetensors.numpy

from murmurate import untrusted
from murmurate.errors import RunError, one_line

__all__ = [
    "MAX_ARRAY_BYTES",
    "MAX_BYTES",
    "MAX_JSON_BYTES",
    "ArrayHeader",
    "append_rows",
    "check_plain",
    "checksum",
    "entries",
    "fit_tree",
    "inside",
    "is_number",
    "make_folder",
    "make_writable",
    "os_errors_as_run_errors",
    "parse_json",
    "read_bytes",
    "read_json",
    "read_json_object",
    "read_last_rows",
    "read_notes",
    "read_npz",
    "read_rows",
    "read_tree",
    "remove_partial",
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

MAX_BYTES = 1 << 30
"""Size of any file that is read, at most."""

MAX_JSON_BYTES = 1 << 25
"""Size of a JSON file: a catalogue of 40,000 patterns of ten robots. As Python objects it takes much more memory."""

MAX_ROWS_BYTES = 1 << 28
"""Size of a file of rows: half a million updates."""

MAX_DEPTH = 32
"""How deep JSON and TOML may nest: what is written here nests four or five deep."""

MAX_DIGITS = 400
"""Digits of an integer: more than a float can hold, and few enough for Python to read."""

MAX_ARRAY_BYTES = 1 << 32
"""Memory of the arrays that are read of one file: more than the greatest rollout, see `run.MAX_RECORD_BYTES`."""


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


def inside(folder: str | Path, name: str) -> Path:
    """Returns the path of a file or folder inside a folder, which may be a stranger's.

    Raises:
        RunError: A part of the name is a link there: it could lead anywhere.
    """
    with os_errors_as_run_errors(f"cannot use {Path(folder) / name}"):
        return untrusted.check_inside(folder, name)


def remove_partial(folder: str | Path) -> None:
    """Removes the unfinished files that killed processes left in a folder, which no other process may be writing to."""
    with contextlib.suppress(OSError):
        for path in untrusted.partial_files(Path(folder)):
            path.unlink(missing_ok=True)


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
            with untrusted.create(folder / "probe", bytes(_PROBE_BYTES)):
                pass
    except BaseException:
        for path in missing:
            with contextlib.suppress(OSError):
                path.rmdir()
        raise


# Whole files


def read_bytes(path: str | Path, max_bytes: int = MAX_BYTES) -> bytes:
    """Reads a regular file; a link is not followed.

    Raises:
        RunError: It is missing, larger than `max_bytes`, or cannot be read.
    """
    with os_errors_as_run_errors(f"cannot read {path}"):
        return untrusted.read(path, max_bytes)


def write_bytes(path: str | Path, data: bytes) -> None:
    """Writes a file whole or not at all.

    Raises:
        RunError: It cannot be written; the file that was there before still is.
    """
    with os_errors_as_run_errors(f"cannot write {path}"):
        untrusted.replace(path, data)


def write_text(path: str | Path, text: str) -> None:
    """Writes a text file (UTF-8) whole or not at all; see `write_bytes`."""
    write_bytes(path, text.encode())


def checksum(path: str | Path) -> str:
    """Returns the SHA-256 of a file.

    Raises:
        RunError: It cannot be read.
    """
    return hashlib.sha256(read_bytes(path)).hexdigest()


# JSON and arrays


def to_json(value: Any, indent: int | None = None) -> str:
    """Returns a value as JSON; NaN and infinities, which JSON does not have, become null."""
    return json.dumps(_plain(value), indent=indent, allow_nan=False)


def write_json(path: str | Path, value: Any) -> None:
    """Writes a JSON file whole or not at all; NaN and infinities, which JSON does not have, become null."""
    write_text(path, to_json(value, indent=2) + "\n")


def parse_json(data: bytes | str) -> Any:
    """Reads JSON (UTF-8) that may be a stranger's.

    Raises:
        ValueError: It is not JSON, nests deeper than `MAX_DEPTH`, or holds numbers or text that cannot be written.
    """
    try:
        text = data.decode() if isinstance(data, bytes) else data
        value = json.loads(text, parse_int=_integer, parse_float=_float, parse_constant=_float)
    except RecursionError:
        raise ValueError(f"it nests deeper than {MAX_DEPTH}") from None
    check_plain(value, has_surrogates="\\ud" in text.lower())
    return value


def check_plain(value: Any, has_surrogates: bool = True) -> None:
    """Checks that lists and dictionaries nest no deeper than `MAX_DEPTH`, and that texts can be written.

    Args:
        value: What was read.
        has_surrogates: Whether a text may hold half of a character, as JSON can spell it.

    Raises:
        ValueError: They do not.
    """
    level, depth = [value], 0
    while level:
        depth += 1
        if depth > MAX_DEPTH + 1:
            raise ValueError(f"it nests deeper than {MAX_DEPTH}")
        inner: list[Any] = []
        for item in level:
            if isinstance(item, dict):
                inner += item.values()
                if has_surrogates:
                    inner += item.keys()
            elif isinstance(item, list):
                inner += item
            elif has_surrogates and isinstance(item, str):
                item.encode()  # UnicodeEncodeError is a ValueError
        level = [item for item in inner if isinstance(item, dict | list) or (has_surrogates and isinstance(item, str))]


def is_number(value: Any) -> bool:
    """Returns whether a value that was read is a number that a float holds; `parse_json` reads longer integers too."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def _integer(text: str) -> int:
    if len(text) > MAX_DIGITS:
        raise ValueError(f"an integer has more than {MAX_DIGITS} digits")
    return int(text)


def _float(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"the number {text[:20]} is not finite")
    return number


def read_json(path: str | Path) -> Any:
    """Reads a JSON file.

    Raises:
        RunError: The file is missing, is not JSON, or see `parse_json`.
    """
    data = read_bytes(path, MAX_JSON_BYTES)
    try:
        return parse_json(data)
    except ValueError as error:
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


class ArrayHeader(NamedTuple):
    """What an npz file says about one of its arrays before the array itself.

    Attributes:
        shape: Its shape.
        dtype: Its type.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    def __str__(self) -> str:
        return f"{self.dtype}{list(self.shape)}"


def read_npz(
    path: str | Path, names: Iterable[str] | None = None, check: Callable[[dict[str, ArrayHeader]], None] | None = None
) -> dict[str, np.ndarray]:
    """Reads arrays of an npz file; pickled objects are refused.

    Args:
        path: The file.
        names: The arrays that are wanted, those that there are; all by default. No other one is loaded.
        check: Called with the headers of these arrays before any of them takes memory.

    Raises:
        RunError: The file is missing or damaged, or the arrays take more memory than `MAX_ARRAY_BYTES`.
    """
    data = read_bytes(path)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name.removesuffix(".npy"): name for name in archive.namelist() if name.endswith(".npy")}
            wanted = members.keys() if names is None else [name for name in names if name in members]
            headers = {}
            for name in wanted:
                info = archive.getinfo(members[name])
                if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise ValueError(f"{name} is compressed in an unknown way")
                with archive.open(info) as file:
                    headers[name] = _array_header(file, info.file_size)
            if sum(math.prod(shape) * dtype.itemsize for shape, dtype in headers.values()) > MAX_ARRAY_BYTES:
                raise ValueError(f"its arrays take more than {MAX_ARRAY_BYTES >> 30} GiB of memory")
            if check is not None:
                check(headers)
            arrays = {}
            for name in headers:
                with archive.open(members[name]) as file:
                    arrays[name] = np.lib.format.read_array(file, allow_pickle=False)
            return arrays
    except RunError:
        raise
    except Exception as error:  # zipfile, zlib and numpy each have errors of their own for a damaged file
        raise RunError(f"{path} is not a valid npz file: {one_line(str(error), 100)}") from None


def _array_header(file: Any, size: int) -> ArrayHeader:
    """Reads the header of an array in a file of a size, which must be that of the array."""
    version = np.lib.format.read_magic(file)
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version]
    shape, _, dtype = read(file)
    if dtype.hasobject:
        raise ValueError("it holds Python objects")
    if any(length < 0 for length in shape) or file.tell() + math.prod(shape) * dtype.itemsize != size:
        raise ValueError(f"an array is of another size than its shape {list(shape)} says")
    return ArrayHeader(shape, dtype)


# Rows: one JSON object a line


def append_rows(path: str | Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Appends one line of JSON for each row, all of them or none.

    Raises:
        RunError: The file cannot be written.
    """
    data = "".join(to_json(row) + "\n" for row in rows).encode()
    if not data:
        return
    with os_errors_as_run_errors(f"cannot write {path}"), _open_rows(path) as file:
        size = file.seek(0, os.SEEK_END)
        try:
            while data:  # an unbuffered write may take only part of the data
                data = data[file.write(data) :]
            os.fsync(file.fileno())
        except BaseException:
            file.truncate(size)
            raise


def _open_rows(path: str | Path) -> BinaryIO:
    untrusted.detach(path, MAX_ROWS_BYTES)
    return untrusted.append(path)


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
    lines = _lines(path, offset)
    for number, line in enumerate(lines, 1):
        if not line.endswith(b"\n"):  # the process was killed here
            break
        try:
            row = parse_json(line)
        except ValueError:
            row = None
        if not isinstance(row, dict):
            behind = f" behind byte {offset}" if offset else ""
            raise RunError(f"{path} is damaged: line {number}{behind} is not a JSON object")
        rows.append(row)
    return rows, offset + sum(map(len, lines[: len(rows)]))


def read_last_rows(path: str | Path, max_bytes: int) -> list[dict[str, Any]]:
    """Reads the rows in the last bytes of a file of `append_rows`; what is no row, or only a part of one, is left out.

    Raises:
        RunError: The file is missing or cannot be read.
    """
    with os_errors_as_run_errors(f"cannot read {path}"):
        data = untrusted.read_end(path, max_bytes)
    rows = []
    for line in data.split(b"\n"):
        with contextlib.suppress(ValueError):
            rows.append(parse_json(line))
    return [row for row in rows if isinstance(row, dict)]


def truncate_rows(path: str | Path, count: int) -> None:
    """Cuts a file of `append_rows` back to its first rows; a missing file has none.

    Raises:
        RunError: The file has fewer rows, or cannot be written.
    """
    lines = _lines(path)
    complete = [line for line in lines[:count] if line.endswith(b"\n")]
    if len(complete) < count:
        raise RunError(f"{path} has {len(complete)} rows, but the checkpoint was saved after {count}")
    if len(lines) > count:
        write_bytes(path, b"".join(complete))


def _lines(path: str | Path, offset: int = 0) -> list[bytes]:
    if not os.path.lexists(path):
        return []
    return io.BytesIO(read_bytes(path, MAX_ROWS_BYTES)[offset:]).readlines()


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
    arrays = _read_safetensors(path)[0]
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
    return _read_safetensors(path)[1]


def _read_safetensors(path: str | Path) -> tuple[dict[str, np.ndarray], Any]:
    """Returns the arrays of a file, and its notes."""
    data = read_bytes(path)
    try:
        arrays = safetensors.numpy.load(data)
        # A file that could be loaded begins with the length of its header.
        header = parse_json(data[8 : 8 + int.from_bytes(data[:8], "little")])
        return arrays, parse_json(header.get("__metadata__", {}).get("notes", "null"))
    except Exception as error:  # the package has errors of its own, and lets those of NumPy pass
        raise RunError(f"{path} is not a valid safetensors file: {one_line(str(error), 100)}") from None


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
        leaves.append(array.copy() if isinstance(leaf, np.ndarray) else jax.device_put(array))
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


def _plain(value: Any) -> Any:
    """Returns a value as JSON has it: numbers and arrays of NumPy and JAX as Python's, what is not finite as None."""
    if isinstance(value, Mapping):
        return {str(name): _plain(inner) for name, inner in value.items()}
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
