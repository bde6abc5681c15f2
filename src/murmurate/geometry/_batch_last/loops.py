"""Loops that run in Python for NumPy and are compiled for JAX. Geometry imports JAX only here, once it is given JAX."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np

__all__ = [
    "fori_loop",
    "is_traced",
    "map_chunks",
    "scatter",
    "set_row",
    "sum_over_third_robots",
    "sum_terms",
    "take",
    "while_loop",
]


def is_traced(value: Any) -> bool:
    """Returns whether a value is unknown because JAX is tracing a program."""
    if "jax" not in sys.modules:
        return False
    from jax.core import Tracer

    return isinstance(value, Tracer)


def fori_loop(xp: Any, count: int, body: Callable[[Any, Any], Any], value: Any) -> Any:
    """Returns the value after body(0, value), body(1, value), ... `count` times."""
    if xp is not np:
        from jax import lax

        return lax.fori_loop(0, count, body, value)
    for index in range(count):
        value = body(index, value)
    return value


def while_loop(xp: Any, condition: Callable[[Any], Any], body: Callable[[Any], Any], value: Any) -> Any:
    """Returns the value after as many calls of `body` as make the condition false."""
    if xp is not np:
        from jax import lax

        return lax.while_loop(condition, body, value)
    while condition(value):
        value = body(value)
    return value


def map_chunks(xp: Any, function: Callable[[tuple], Any], chunks: tuple) -> Any:
    """Returns a function's results for all chunks, computed one after another and stacked; gradients are stopped.

    Args:
        xp: The namespace of the arrays.
        function: Takes a tuple: one chunk of each array.
        chunks: Arrays whose first axis numbers the chunks. They are separate arrays because XLA would copy each slice
            of a stacked one.
    """
    if xp is not np:
        from jax import lax

        return lax.map(function, lax.stop_gradient(chunks))
    return np.stack([function(chunk) for chunk in zip(*chunks, strict=True)])


def take(xp: Any, array: Any, rows: Any) -> Any:
    """Returns elements of each column of an array by their row numbers, `(elements, columns)`."""
    if xp is not np:
        return xp.take_along_axis(array, rows, axis=0, mode="promise_in_bounds")
    return np.take_along_axis(array, rows, axis=0)


def set_row(xp: Any, array: Any, index: Any, row: Any) -> Any:
    """Returns an array with one row of its first axis replaced; a NumPy array is changed in place."""
    if xp is not np:
        return array.at[index].set(row, mode="promise_in_bounds")
    array[index] = row
    return array


def sum_terms(term: Callable[[int], tuple[Any, ...]], count: int) -> tuple[Any, ...]:
    """Returns the sums of the terms 0 to count - 1, each a tuple of arrays, by adding whole arrays one after another.

    XLA's CPU backend does not vectorise a reduction over a middle axis once its operand is fused into it. It does
    vectorise the addition of slices along the batch, which is about five times faster for a swarm of ten. The additions
    are a loop of the program: written out one by one, those of a swarm of ten made an update of PPO take half as long
    again, and compile a fifth longer.

    Args:
        term: Returns the arrays of one term.
        count: Number of terms: an integer, or a symbol in a program for swarms of any size, whose terms are reduced at
            once.
    """
    if not isinstance(count, int):
        import jax

        terms = jax.vmap(term)(jax.lax.iota("int32", count))
        return tuple(array.sum(axis=0) for array in terms)
    total = term(0)
    if not isinstance(total[0], np.ndarray):
        from jax import lax

        return lax.fori_loop(1, count, lambda i, sums: _add(sums, term(i)), total)
    for index in range(1, count):
        total = _add(total, term(index))
    return total


def sum_over_third_robots(
    term: Callable[[tuple[Any, ...], tuple[Any, ...], Any], tuple[Any, ...]], arrays: tuple[Any, ...]
) -> tuple[Any, ...]:
    """Returns, for every observer k and robot i, the sum over all robots j of a function of k's numbers of i and of j.

    The gradient is computed by two sums of the same kind, over what each robot is as i and as j. What JAX derives from
    the sum instead adds whole arrays of zeros for each slice that a term takes, which is three times slower for a
    swarm of sixteen.

    Args:
        term: Takes the arrays at i, those at j, and whether i is j; computes element by element. It must not use any
            other array.
        arrays: Numbers of each robot as each observer sees it, `(observers, robots, *batch)`.
    """
    if isinstance(arrays[0], np.ndarray):
        return _sum_over_third_robots(np, term, arrays)
    import jax
    from jax import numpy as jnp

    @jax.custom_vjp
    def total(arrays: tuple[Any, ...]) -> tuple[Any, ...]:
        return _sum_over_third_robots(jnp, term, arrays)

    def forward(arrays: tuple[Any, ...]) -> tuple[Any, Any]:
        return total(arrays), arrays

    def backward(arrays: tuple[Any, ...], gradient: tuple[Any, ...]) -> tuple[Any]:
        number = _numbers(jnp, arrays)

        def add_gradient(robot: int, sums: tuple[Any, ...]) -> tuple[Any, ...]:
            numbers, same = tuple(array[:, robot, None] for array in arrays), number == robot
            as_first = jax.vjp(lambda first: term(first, numbers, same), arrays)[1](gradient)[0]
            of_robot = tuple(jnp.broadcast_to(g[:, robot, None], g.shape) for g in gradient)
            as_other = jax.vjp(lambda other: term(numbers, other, same), arrays)[1](of_robot)[0]
            return _add(sums, _add(as_first, as_other))

        zeros = tuple(jnp.zeros_like(array) for array in arrays)
        return (jax.lax.fori_loop(0, arrays[0].shape[1], add_gradient, zeros),)

    total.defvjp(forward, backward)
    return total(arrays)


def _sum_over_third_robots(xp: Any, term: Any, arrays: tuple[Any, ...]) -> tuple[Any, ...]:
    number = _numbers(xp, arrays)
    others = lambda j: tuple(array[:, j, None] for array in arrays)  # noqa: E731
    return sum_terms(lambda j: term(arrays, others(j), number == j), arrays[0].shape[1])


def _numbers(xp: Any, arrays: tuple[Any, ...]) -> Any:
    """Returns the numbers of the robots that are seen, along their axis."""
    shape = arrays[0].shape
    if xp is not np:
        from jax import lax

        return lax.broadcasted_iota(np.int32, shape[1:], 0)
    return np.arange(shape[1]).reshape(-1, *(1,) * (len(shape) - 2))


def _add(first: tuple[Any, ...], second: tuple[Any, ...]) -> tuple[Any, ...]:
    return tuple(a + b for a, b in zip(first, second, strict=True))


def other_robots(xp: Any, positions: Any) -> Any:
    """Returns which pairs are of two different robots, `(robots, robots, *ones)` to broadcast over the batch.

    Where positions are products, a compiler may round one of the two that it subtracts and not the other: a robot is
    then not at its own place.

    Args:
        xp: The namespace of the arrays.
        positions: Positions of the robots, `(robots, 2, *batch)`.
    """
    number = xp.arange(positions.shape[0])
    other = number[:, None] != number[None]
    return xp.reshape(other, (*other.shape, *(1,) * (positions.ndim - 2)))


def scatter(xp: Any, operation: str, array: Any, rows: Any, values: Any) -> Any:
    """Returns a two-dimensional array after `min`, `max` or `add` of values into rows of each column.

    Args:
        xp: The namespace of the arrays.
        operation: min, max or add.
        array: The array that is updated; a NumPy array is changed in place.
        rows: The row of each value, `(values, columns)`.
        values: The values, `(values, columns)`.
    """
    column = xp.broadcast_to(xp.arange(rows.shape[1], dtype=rows.dtype)[None], rows.shape)
    if xp is not np:
        return getattr(array.at[rows, column], operation)(values, mode="promise_in_bounds")
    {"min": np.minimum, "max": np.maximum, "add": np.add}[operation].at(array, (rows, column), values)
    return array
