"""Several trainings in one compiled program, for those whose structure and shapes agree."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from murmurate.learning import sharding
from murmurate.learning.environment import Environment
from murmurate.learning.goals import GoalEnvironment
from murmurate.learning.ppo import TrainState, train_chunk
from murmurate.representation import short_repr

__all__ = ["Chunk", "train_together"]


@dataclass(frozen=True)
class Chunk:
    """The next updates of one training.

    Attributes:
        state: The state of training.
        env: The environment.
        hyper: Numbers that can change without recompiling.
        shape: Numbers that cannot.
        updates: Number of updates.
        train: Runs them: see `ppo.train_chunk`.
    """

    state: TrainState
    env: Environment | GoalEnvironment
    hyper: Any
    shape: Hashable
    updates: int
    train: Callable[..., tuple[TrainState, dict[str, Any]]] = train_chunk

    __repr__ = short_repr

    @property
    def program(self) -> Hashable:
        """Everything that the compiled program depends on: chunks that agree in it can run together."""
        leaves, structure = jax.tree.flatten((self.state, self.env, self.hyper))
        kinds = tuple((leaf.shape, leaf.dtype) if eqx.is_array(leaf) else leaf for leaf in leaves)
        return structure, kinds, self.shape, self.updates, self.train


def train_together(chunks: Sequence[Chunk]) -> list[tuple[TrainState, dict[str, Any]]]:
    """Runs the chunks of several trainings; those with the same program run side by side.

    Args:
        chunks: One for each training.

    Returns:
        The result of `train_chunk` for each chunk, in their order.
    """
    groups: dict[Hashable, list[int]] = {}
    for index, chunk in enumerate(chunks):
        groups.setdefault(chunk.program, []).append(index)
    results: dict[int, tuple[TrainState, dict[str, Any]]] = {}
    for indices in groups.values():
        results |= zip(indices, _run([chunks[index] for index in indices]), strict=True)
    return [results[index] for index in range(len(chunks))]


def _run(chunks: list[Chunk]) -> list[tuple[TrainState, dict[str, Any]]]:
    first = chunks[0]
    if len(chunks) == 1:
        tree = _put((first.state, first.env, first.hyper))
        return [sharding.to_host(first.train(*tree, first.shape, first.updates))]
    trees = [(chunk.state, chunk.env, chunk.hyper) for chunk in chunks]
    # A leaf that is the same in all is not batched: a loop whose length all share then stays a plain loop.
    axes = jax.tree.map(lambda *leaves: None if _same(leaves) else 0, *trees)
    joined = jax.tree.map(lambda *leaves: leaves[0] if _same(leaves) else jnp.stack(leaves), *trees)
    trained = sharding.to_host(_train(_put(joined), axes, len(chunks), first.train, first.shape, first.updates))
    return [
        jax.tree.map(lambda leaf, index=index: leaf[index] if eqx.is_array(leaf) else leaf, trained)
        for index in range(len(chunks))
    ]


def _put(tree: tuple[TrainState, Any, Any]) -> tuple[TrainState, Any, Any]:
    """Splits the environment's states over the devices, and puts everything else on each of them."""
    whole = sharding.device_put(eqx.tree_at(lambda t: t[0].env_state, tree, None))
    return eqx.tree_at(
        lambda t: t[0].env_state, whole, sharding.device_put(tree[0].env_state, split=True), is_leaf=lambda x: x is None
    )


def _same(leaves: Sequence[Any]) -> bool:
    if not all(map(eqx.is_array_like, leaves)):
        return all(leaf == leaves[0] for leaf in leaves[1:])
    first = np.asarray(leaves[0])
    return all(np.array_equal(first, np.asarray(leaf)) for leaf in leaves[1:])


@eqx.filter_jit
def _train(
    joined: Any, axes: Any, count: int, train_chunk: Callable[..., Any], shape: Hashable, updates: int
) -> tuple[TrainState, dict[str, Any]]:
    def train(tree: tuple[TrainState, Environment, Any]) -> tuple[TrainState, dict[str, Any]]:
        return train_chunk(*tree, shape, updates)

    return eqx.filter_vmap(train, in_axes=(axes,), axis_size=count)(joined)
