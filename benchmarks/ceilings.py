"""What the machine can do at best, through the same compiler: each kind of work alone, on data that suits it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from benchmarks.timing import Case

__all__ = ["COPY", "FUNCTIONS", "PART", "PLAIN", "PRODUCTS", "ROOTS", "VARIED", "Extent", "ceiling_cases"]

PART = "ceiling"
PRODUCTS = "matrix product"
PLAIN = "multiply and add"
VARIED = "compare, multiply, add, choose"
ROOTS = "square root"
FUNCTIONS = "hyperbolic tangent"
COPY = "copy"

DEPTH = 16
"""Links of a chain before its array is stored again: many enough for the arithmetic to be what counts."""


@dataclass(frozen=True)
class Extent:
    """How much is computed.

    Attributes:
        side: Of the square matrices.
        copied: Numbers of the array that is copied.
        chained: Numbers of the arrays on which plain work is done: few enough for the processor's caches.
        links: Turns of each chain, in all, for each number.
    """

    side: int = 2048
    copied: int = 1 << 25
    chained: int = 1 << 16
    links: int = 1 << 10


def ceiling_cases(extent: Extent) -> list[Case]:
    """Returns the six: operations a second of five kinds, and bytes a second."""
    turns = max(extent.links // DEPTH, 1)
    chains = {
        PLAIN: (lambda x, p, q: x * p + q, 2, 8),
        VARIED: (lambda x, p, q: jnp.where(x > p, x * p, x + q), 4, 2),
        ROOTS: (lambda x, p, q: jnp.sqrt(x), 1, 1),
        FUNCTIONS: (lambda x, p, q: jnp.tanh(x), 1, 1 / 8),
    }
    cases = [_product(extent.side), _copy(extent.copied)]
    for name, (link, operations, often) in chains.items():
        cases.append(_chain(name, link, operations, extent.chained, max(round(often * turns), 1)))
    return cases


def _product(side: int) -> Case:
    def prepare() -> Callable[[], Any]:
        matrix = jax.random.normal(jax.random.key(0), (side, side))
        run = jax.jit(lambda a: a @ a)
        return lambda: run(matrix)

    return Case(PART, PRODUCTS, 2 * side**3, prepare, unit="operations")


def _copy(numbers: int) -> Case:
    """In place, as a new array would be paid for in pages, not in bytes: each number is read, changed and written."""

    def prepare() -> Callable[[], Any]:
        @jax.jit
        def run(factor: Any) -> Any:
            return jax.lax.fori_loop(0, COPIES, lambda _, x: x * factor, jnp.broadcast_to(factor, (numbers,)))[0]

        return lambda: run(jnp.float32(0.999))

    return Case(PART, COPY, COPIES * 2 * 4 * numbers, prepare, unit="bytes")


COPIES = 8


def _chain(name: str, link: Callable[[Any, Any, Any], Any], operations: int, numbers: int, turns: int) -> Case:
    """The same few operations again and again on each number of an array, none of them on the number beside it."""

    def prepare() -> Callable[[], Any]:
        @jax.jit
        def run(x: Any, p: Any, q: Any) -> Any:
            def turn(_: Any, x: Any) -> Any:
                for _ in range(DEPTH):
                    x = link(x, p, q)
                return x

            return jax.lax.fori_loop(0, turns, turn, x)

        # Numbers that stay in range however often: all chains lead to a value between 0 and 1.
        return lambda: run(jnp.linspace(0.5, 1.0, numbers), jnp.float32(0.5), jnp.float32(0.25))

    return Case(PART, name, operations * DEPTH * turns * numbers, prepare, unit="operations")
