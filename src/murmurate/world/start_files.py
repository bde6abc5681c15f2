"""Initial configurations that are given: files of starts, arrays, and the checks of both."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from murmurate import untrusted
from murmurate.errors import InputError, check_number, check_path
from murmurate.geometry import _batch_last
from murmurate.world.config import WorldConfig, check_world

__all__ = ["MAX_STARTS_BYTES", "check_configurations", "checked_starts", "read_named_starts", "read_starts"]

MAX_STARTS_BYTES = 1 << 26
"""Size of a file of starts, at most."""


def read_starts(path: str | Path, robots: int | None) -> Float[np.ndarray, "starts robots 2"]:
    """Reads a CSV file of starts: the header `start,x,y`, then one row for each robot of each start.

    Args:
        path: The file.
        robots: How many robots each start must have; None: as many as the first one.

    Returns:
        The starts in the order of their first rows.

    Raises:
        InputError: See `read_named_starts`.
    """
    return np.array(list(read_named_starts(path, robots).values()))


def read_named_starts(path: str | Path, robots: int | None) -> dict[str, Float[np.ndarray, "robots 2"]]:
    """Reads a CSV file of starts as `read_starts` does, by what its column `start` calls them.

    Raises:
        InputError: A column is missing or there twice, a row has too many cells, a value is no finite number, or a
            start has another number of robots.
    """
    check_path("path", path)
    if robots is not None:
        check_number("robots", robots, 1, integer=True)
    source = str(path)
    try:
        # Spreadsheets begin files with a byte-order mark.
        text = untrusted.read(path, MAX_STARTS_BYTES, follow=True).decode("utf-8-sig")
        reader = csv.DictReader(io.StringIO(text, newline=""))
        header = list(reader.fieldnames or ())
        if {"start", "x", "y"} - set(header):
            raise InputError(source, "another header", "a table with the header start,x,y")
        twice = [name for name in ("start", "x", "y") if header.count(name) > 1]
        if twice:
            where = f"{source} line {reader.line_num}: header"
            raise InputError(where, ",".join(header), f"without a second column {twice[0]}")
        starts: dict[str, list[tuple[float, float]]] = {}
        for row in reader:
            extra: Any = row.pop(None, None)  # type: ignore[call-overload]
            if extra:
                # Numbers with decimal commas make such rows: their halves would be read as other numbers.
                allowed = f"of {len(header)} cells, as the header is; decimals are written with a point"
                raise InputError(f"{source} line {reader.line_num}: row", ",".join([*row.values(), *extra]), allowed)
            point = (_coordinate(source, reader.line_num, row, "x"), _coordinate(source, reader.line_num, row, "y"))
            starts.setdefault(str(row["start"]), []).append(point)
    except (OSError, ValueError, csv.Error) as error:
        if isinstance(error, InputError):
            raise
        reason = getattr(error, "strerror", None) or "it is not text"
        raise InputError("starts", source, f"a readable CSV file ({reason})") from None
    if not starts:
        raise InputError(source, "no rows", "at least one start")
    expected = len(next(iter(starts.values()))) if robots is None else robots
    for name, points in starts.items():
        if len(points) != expected:
            raise InputError(f"{source}: start {name}", f"{len(points)} robots", f"{expected} robots")
    return {name: np.array(points) for name, points in starts.items()}


def _coordinate(source: str, line: int, row: dict[str, str | None], column: str) -> float:
    text = row[column]
    try:
        # Python reads 5_0 as 50; nobody else does, and the digit is more likely to be a slip.
        value = math.nan if "_" in (text or "") else float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{source} line {line}: {column}", text, "a finite number")
    return value


def checked_starts(field: str, points: Any, robots: int) -> Any:
    """Returns configurations as an array, after checking that it is one of numbers of the right shape.

    Args:
        field: What they are called in an error.
        points: The configurations.
        robots: Number of robots.

    Raises:
        InputError: It is none.
    """
    allowed = f"finite numbers of shape (episodes, {robots}, 2)"
    try:
        array = np.asarray(points, float)
    except (TypeError, ValueError):
        raise InputError(field, points, allowed) from None
    if array.ndim != 3 or array.shape[1:] != (robots, 2) or not len(array):
        raise InputError(field, f"an array {array.shape}", allowed)
    return array


def check_configurations(
    points: Float[np.ndarray, "starts robots 2"], world: WorldConfig, source: str, names: Sequence[str] | None = None
) -> None:
    """Checks that no given configuration is in contact or outside the world.

    Args:
        points: The configurations, world units.
        world: Sizes of the world and its robots.
        source: Where they are from, for error messages.
        names: What their source calls them; by default their numbers, from 0 on.

    Raises:
        InputError: One is; the message names which.
    """
    check_world(world)
    points = checked_starts(source, points, world.robots)
    # Runs compute with float32, so the rounded positions are what must be free of contact.
    with np.errstate(over="ignore"):
        points = points.astype(np.float32).astype(float)
    for name, configuration in zip(names or range(len(points)), points, strict=True):
        if not (np.abs(configuration) <= world.bounds).all():
            allowed = f"inside |x| <= {world.half_width:g}, |y| <= {world.half_height:g}"
            raise InputError(f"{source}: start {name}", "a robot outside", allowed)
        if (_batch_last.clearances(configuration, world.radius) <= 0).any():
            raise InputError(f"{source}: start {name}", "overlapping robots", f"more than {2 * world.radius:g} apart")
