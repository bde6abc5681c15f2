"""Loops that NumPy leaves to Python and JAX compiles: the one place where geometry may need JAX, and loads it then."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

__all__ = ["chunked", "picked", "placed", "repeat", "updated", "whilst"]


def repeat(xp: Any, count: int, body: Callable[[Any, Any], Any], value: Any) -> Any:
    """Returns the value after body(0, value), body(1, value), ... `count` times."""
    if xp is not np:
        from jax import lax

        return lax.fori_loop(0, count, body, value)
    for index in range(count):
        value = body(index, value)
    return value


def whilst(xp: Any, going: Callable[[Any], Any], body: Callable[[Any], Any], value: Any) -> Any:
    """Returns the value once it is no longer `going`."""
    if xp is not np:
        from jax import lax

        return lax.while_loop(going, body, value)
    while going(value):
        value = body(value)
    return value


def chunked(xp: Any, function: Callable[[tuple], Any], chunks: tuple) -> Any:
    """Returns the function of each chunk, one after another; nothing is differentiated through it.

    Args:
        xp: The namespace.
        function: Of one chunk of each array.
        chunks: Arrays whose first axis is that of chunks: apart, since XLA copies a slice of a stack again and again.
    """
    if xp is not np:
        from jax import lax

        return lax.map(function, lax.stop_gradient(chunks))
    return np.stack([function(chunk) for chunk in zip(*chunks, strict=True)])


def picked(xp: Any, array: Any, rows: Any) -> Any:
    """Returns one element of every column of an array, or several: by row, `(picks, columns)`."""
    if xp is not np:
        return xp.take_along_axis(array, rows, axis=0, mode="promise_in_bounds")
    return np.take_along_axis(array, rows, axis=0)


def placed(xp: Any, array: Any, index: Any, part: Any) -> Any:
    """Returns an array with another part at one place of its first axis; NumPy's changes in place."""
    if xp is not np:
        return array.at[index].set(part, mode="promise_in_bounds")
    array[index] = part
    return array


def updated(xp: Any, how: str, array: Any, rows: Any, values: Any) -> Any:
    """Returns a two-dimensional array after `min`, `max` or `add` of a value at one row of every column, or several.

    Args:
        xp: The namespace.
        how: Which of these.
        array: What is updated; NumPy's in place.
        rows: Row for each value, `(values, columns)`.
        values: As many.
    """
    column = xp.broadcast_to(xp.arange(rows.shape[1], dtype=rows.dtype)[None], rows.shape)
    if xp is not np:
        return getattr(array.at[rows, column], how)(values, mode="promise_in_bounds")
    {"min": np.minimum, "max": np.maximum, "add": np.add}[how].at(array, (rows, column), values)
    return array
