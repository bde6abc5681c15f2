"""Many trainings as one: of the same structure and shapes, they run side by side in one compiled program."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from murmurate.learning import sharding
from murmurate.learning.config import Hyperparameters, Shape
from murmurate.learning.environment import Environment
from murmurate.learning.ppo import TrainState, train_chunk

__all__ = ["Chunk", "train_together"]


@dataclass(frozen=True)
class Chunk:
    """Some updates of one training, about to be run.

    Attributes:
        state: Where training stands.
        env: The environment.
        hyper: Numbers that may change without recompiling.
        shape: Numbers that may not.
        updates: How many updates to run.
    """

    state: TrainState
    env: Environment
    hyper: Hyperparameters
    shape: Shape
    updates: int

    @property
    def program(self) -> Hashable:
        """What is compiled for it: chunks with the same program can run together."""
        leaves, structure = jax.tree.flatten((self.state, self.env, self.hyper))
        return structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves), self.shape, self.updates


def train_together(chunks: Sequence[Chunk]) -> list[tuple[TrainState, dict[str, Any]]]:
    """Runs chunks, those with the same program as one.

    Args:
        chunks: One for each training.

    Returns:
        For each of them where training stands then, and the metrics of every update, as `train_chunk` does.
    """
    groups: dict[Hashable, list[int]] = {}
    for place, chunk in enumerate(chunks):
        groups.setdefault(chunk.program, []).append(place)
    found: dict[int, tuple[TrainState, dict[str, Any]]] = {}
    for places in groups.values():
        found |= zip(places, _run([chunks[place] for place in places]), strict=True)
    return [found[place] for place in range(len(chunks))]


def _run(chunks: list[Chunk]) -> list[tuple[TrainState, dict[str, Any]]]:
    first = chunks[0]
    if len(chunks) == 1:
        spread = _spread((first.state, first.env, first.hyper))
        return [sharding.fetched(train_chunk(*spread, first.shape, first.updates))]
    trees = [(chunk.state, chunk.env, chunk.hyper) for chunk in chunks]
    # What all have in common stays one number: a loop whose length is the same for all stays a plain loop.
    axes = jax.tree.map(lambda *leaves: None if _same(leaves) else 0, *trees)
    joined = jax.tree.map(lambda *leaves: leaves[0] if _same(leaves) else jnp.stack(leaves), *trees)
    trained = sharding.fetched(_train(_spread(joined), axes, len(chunks), first.shape, first.updates))
    return [jax.tree.map(lambda leaf, place=place: leaf[place], trained) for place in range(len(chunks))]


def _spread(tree: tuple[TrainState, Any, Any]) -> tuple[TrainState, Any, Any]:
    """Gives each device its part of the environment's states, and all else."""
    whole = sharding.placed(eqx.tree_at(lambda t: t[0].env_state, tree, None))
    return eqx.tree_at(
        lambda t: t[0].env_state, whole, sharding.placed(tree[0].env_state, split=True), is_leaf=lambda x: x is None
    )


def _same(leaves: Sequence[Any]) -> bool:
    first = np.asarray(leaves[0])
    return all(np.array_equal(first, np.asarray(leaf)) for leaf in leaves[1:])


@eqx.filter_jit
def _train(joined: Any, axes: Any, count: int, shape: Shape, updates: int) -> tuple[TrainState, dict[str, Any]]:
    def one(tree: tuple[TrainState, Environment, Hyperparameters]) -> tuple[TrainState, dict[str, Any]]:
        return train_chunk(*tree, shape, updates)

    return eqx.filter_vmap(one, in_axes=(axes,), axis_size=count)(joined)
