"""Checks of what users pass to the public functions, and the change from batch first to batch last and back.

Shapes are always checked. Values are checked unless JAX is tracing a program, in which they are unknown.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from murmurate.errors import InputError
from murmurate.geometry._batch_last.loops import is_traced

__all__ = ["check_length", "check_squares", "check_vectors", "pairs_first", "robots_first", "to_batch_last", "to_last"]

VECTORS = "finite numbers of shape (..., robots, 2)"


def check_vectors(field: str, vectors: Any) -> tuple[Any, Any]:
    """Returns the array namespace and a floating-point array of shape (..., robots, 2).

    Args:
        field: What the vectors are, for messages.
        vectors: Positions or velocities: an array, or nested lists.

    Raises:
        InputError: The shape is another one, or a number is not finite or too great.
    """
    if not hasattr(vectors, "__array_namespace__"):
        try:
            vectors = np.asarray(vectors)
        except ValueError:  # NumPy's error for rows of different lengths
            raise InputError(field, type(vectors).__name__, VECTORS) from None
    xp, shape = vectors.__array_namespace__(), tuple(vectors.shape)
    # A symbolic number of robots, in a program for swarms of any size, is not compared with 0.
    empty = len(shape) >= 2 and isinstance(shape[-2], int) and shape[-2] == 0
    if len(shape) < 2 or shape[-1] != 2 or empty:
        raise InputError(field, shape, VECTORS)
    if np.dtype(vectors.dtype).kind not in "iuf" and not xp.isdtype(vectors.dtype, "real floating"):
        raise InputError(field, str(vectors.dtype), VECTORS)
    if not xp.isdtype(vectors.dtype, "real floating"):
        vectors = vectors.astype(float)
    if not is_traced(vectors):
        numbers = np.asarray(vectors, dtype=float)
        finite = np.isfinite(numbers).all(axis=-1)
        if not finite.all():
            raise InputError(field, numbers[~finite][0].tolist(), VECTORS)
        check_squares(field, vectors, VECTORS)
    return xp, vectors


def check_squares(field: str, array: Any, allowed: str) -> None:
    """Checks that no square overflows: robots at one place would seem to be infinitely far apart. NaN passes.

    Args:
        field: What the numbers are, for messages.
        array: A floating-point array.
        allowed: What else they must be, for messages.

    Raises:
        InputError: One does.
    """
    if is_traced(array):
        return
    limit = math.sqrt(float(array.__array_namespace__().finfo(array.dtype).max)) / 4
    numbers = np.asarray(array, dtype=float)
    great = np.abs(numbers) > limit
    if great.any():
        raise InputError(
            field, numbers[great][0].item(), f"{allowed} and of magnitude up to {limit:.2g} in {np.dtype(array.dtype)}"
        )


def to_batch_last(field: str, vectors: Any) -> tuple[Any, Any]:
    """Returns the array namespace and checked vectors as (robots, 2, *batch), for the kernels."""
    xp, vectors = check_vectors(field, vectors)
    return xp, to_last(xp, vectors)


def to_last(xp: Any, vectors: Any) -> Any:
    """Returns (*batch, robots, 2) as (robots, 2, *batch)."""
    return xp.moveaxis(vectors, (-2, -1), (0, 1))


def pairs_first(xp: Any, pairs: Any) -> Any:
    """Returns a kernel's (robots, robots, *batch) as (*batch, robots, robots)."""
    return xp.moveaxis(pairs, (0, 1), (-2, -1))


def robots_first(xp: Any, values: Any) -> Any:
    """Returns a kernel's (robots, *batch) as (*batch, robots)."""
    return xp.moveaxis(values, 0, -1)


def check_length(field: str, value: Any, *, infinite: bool = False) -> None:
    """Checks one length, such as a radius.

    Args:
        field: What it is the length of.
        value: The number; an array of no axes will do.
        infinite: Whether infinity is allowed.

    Raises:
        InputError: It is not one number > 0.
    """
    allowed = "a number > 0" if infinite else "a finite number > 0"
    if is_traced(value) and value.ndim == 0:
        return
    try:
        number = math.nan if isinstance(value, bool | np.bool_ | str) or np.ndim(value) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not (number > 0 and (infinite or number < math.inf)):
        raise InputError(field, value, allowed)
