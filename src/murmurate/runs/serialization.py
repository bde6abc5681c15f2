"""PyTrees of arrays, as policies and training states are, in safetensors files: bit for bit, and free of pickle."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import safetensors
import safetensors.numpy

from murmurate.errors import RunError
from murmurate.runs import storage

__all__ = ["load", "read_notes", "save"]

T = TypeVar("T")


def save(path: str | Path, tree: Any, notes: Any = None) -> None:
    """Writes the arrays of a PyTree to a safetensors file, named by their places in the tree, whole or not at all.

    Leaves that are not arrays (activation functions, for example) belong to the template that `load` is given.

    Args:
        path: The file.
        tree: Equinox modules, optax states, dictionaries and the like; PRNG keys as `jax.random.key_data`.
        notes: Anything that JSON can hold, kept in the header of the file for `read_notes`.

    Raises:
        RunError: The file cannot be written.
    """
    arrays = {name: np.asarray(leaf, order="C") for name, leaf in _named_leaves(tree) if _is_array(leaf)}
    header = None if notes is None else {"notes": storage.to_json(notes)}
    storage.write_bytes(path, safetensors.numpy.save(arrays, metadata=header))


def load(path: str | Path, template: T) -> T:
    """Reads a file of `save`, bit for bit.

    Args:
        path: The file.
        template: A tree of the same structure; its arrays, or `jax.ShapeDtypeStruct`s, say what the file must hold.

    Returns:
        The template with the arrays of the file.

    Raises:
        RunError: The file is missing or damaged, or its names, shapes or types are not those of the template.
    """
    data = storage.read_bytes(path)
    try:
        arrays = safetensors.numpy.load(data)
    except (safetensors.SafetensorError, KeyError, ValueError) as error:
        raise RunError(f"{path} is not a valid safetensors file: {error}") from None
    named = _named_leaves(template)
    expected = {name for name, leaf in named if _is_array(leaf)}
    for problem, names in (("lacks", expected - arrays.keys()), ("has the unexpected", arrays.keys() - expected)):
        if names:
            raise RunError(f"{path} {problem} array {min(names)!r}")
    leaves = [_fitted(path, name, arrays[name], leaf) if _is_array(leaf) else leaf for name, leaf in named]
    return jax.tree_util.tree_unflatten(jax.tree_util.tree_structure(template), leaves)


def read_notes(path: str | Path) -> Any:
    """Reads the notes of a file of `save`; None when it has none.

    Raises:
        RunError: The file is missing or damaged.
    """
    try:
        with storage.os_errors_as_run_errors(f"cannot read {path}"), safetensors.safe_open(path, framework="numpy") as file:
            return json.loads((file.metadata() or {}).get("notes", "null"))
    except (safetensors.SafetensorError, ValueError) as error:
        raise RunError(f"{path} is not a valid safetensors file: {error}") from None


def _named_leaves(tree: Any) -> list[tuple[str, Any]]:
    """Returns the leaves with their places as names, such as `layers/0/weight`."""
    named = [
        (jax.tree_util.keystr(place, simple=True, separator="/"), leaf)
        for place, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]
    ]
    if len({name for name, _ in named}) < len(named):
        raise ValueError("two leaves of the tree have the same name")
    return named


def _is_array(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray | jax.ShapeDtypeStruct)


def _fitted(path: str | Path, name: str, array: np.ndarray, leaf: Any) -> Any:
    """Returns the array in the library of the template's leaf, after comparing shape and type."""
    if array.shape != leaf.shape or array.dtype != leaf.dtype:
        have, want = (f"{x.dtype}{list(x.shape)}" for x in (array, leaf))
        raise RunError(f"{path} has {name!r} as {have}, but {want} is needed")
    return array.copy() if isinstance(leaf, np.ndarray) else jnp.array(array)
