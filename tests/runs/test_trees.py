from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
import safetensors.numpy

from murmurate.errors import RunError
from murmurate.runs import serialization


def os_errors_as_run_errors(caught) -> str:
    assert "\n" not in str(caught.value)
    return str(caught.value)


def some_tree():
    model = eqx.nn.MLP(2, 3, 4, 1, key=jax.random.key(0))
    optimizer = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(1e-3))
    return {
        "model": model,
        "optimizer": optimizer.init(eqx.filter(model, eqx.is_array)),
        "key": jax.random.key_data(jax.random.key(7)),
        "mask": jnp.array([True, False]),
        "counts": (np.arange(3, dtype=np.int32), jnp.zeros((0, 2))),
        "odd": jnp.array([jnp.nan, -0.0, jnp.inf, 1e-40], jnp.float32),
        "nothing": None,
    }


def bits(tree):
    return [
        (leaf.dtype, leaf.shape, np.asarray(leaf).tobytes()) for leaf in jax.tree.leaves(tree) if eqx.is_array(leaf)
    ]


def zeros(tree):
    return jax.tree.map(lambda leaf: leaf * 0 if eqx.is_array(leaf) and leaf.dtype != bool else leaf, tree)


def test_trees_come_back_bit_for_bit(tmp_path):
    tree = some_tree()
    serialization.save(tmp_path / "tree.safetensors", tree)
    again = serialization.load(tmp_path / "tree.safetensors", zeros(tree))
    assert bits(again) == bits(tree)
    assert jax.tree.structure(again) == jax.tree.structure(tree)
    assert isinstance(again["counts"][0], np.ndarray)
    assert isinstance(again["odd"], jax.Array)
    assert again["model"](jnp.ones(2)).tolist() == tree["model"](jnp.ones(2)).tolist()
    names = set(safetensors.numpy.load_file(tmp_path / "tree.safetensors"))
    assert {"model/layers/0/weight", "optimizer/1/0/count", "key", "mask"} <= names


def test_trees_load_into_shapes_alone(tmp_path):
    serialization.save(tmp_path / "x", {"a": jnp.arange(3.0)})
    shapes = jax.eval_shape(lambda: {"a": jnp.zeros(3)})
    assert serialization.load(tmp_path / "x", shapes)["a"].tolist() == [0, 1, 2]


def test_transposed_arrays_keep_their_elements(tmp_path):
    array = np.arange(6, dtype=np.float32).reshape(2, 3).T
    serialization.save(tmp_path / "x", array)
    assert (serialization.load(tmp_path / "x", np.zeros((3, 2), np.float32)) == array).all()


@pytest.mark.parametrize(
    ("template", "line"),
    [
        ({"a": jnp.zeros(3), "b": jnp.zeros(1)}, "lacks array 'b'"),
        ({}, "has the unexpected array 'a'"),
        ({"a": jnp.zeros(4)}, "has 'a' as float32[3], but float32[4] is needed"),
        ({"a": jnp.zeros(3, jnp.int32)}, "has 'a' as float32[3], but int32[3] is needed"),
    ],
)
def test_trees_must_fit_the_template(tmp_path, template, line):
    serialization.save(tmp_path / "x", {"a": jnp.zeros(3)})
    with pytest.raises(RunError) as caught:
        serialization.load(tmp_path / "x", template)
    assert os_errors_as_run_errors(caught) == f"{tmp_path / 'x'} {line}"


def test_trees_refuse_what_they_cannot_keep(tmp_path):
    with pytest.raises(TypeError):
        serialization.save(tmp_path / "x", {"key": jax.random.key(0)})
    with pytest.raises(ValueError, match="same name"):
        serialization.save(tmp_path / "x", {"a/b": jnp.zeros(1), "a": {"b": jnp.zeros(1)}})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("damage", [lambda data: b"", lambda data: data[:-1], lambda data: b"\x80\x04" + data])
def test_damaged_trees_are_one_line(tmp_path, damage):
    path = tmp_path / "x"
    serialization.save(path, {"a": jnp.zeros(3)})
    path.write_bytes(damage(path.read_bytes()))
    for read in (lambda: serialization.load(path, {"a": jnp.zeros(3)}), lambda: serialization.read_notes(path)):
        with pytest.raises(RunError, match="not a valid safetensors file") as caught:
            read()
        os_errors_as_run_errors(caught)


def test_notes(tmp_path):
    notes = {"policy": 1, "rows": 12, "seconds": 0.1, "names": ["base"], "reward": jnp.float32(0.5)}
    serialization.save(tmp_path / "x", {"a": jnp.zeros(3)}, notes)
    assert serialization.read_notes(tmp_path / "x") == {**notes, "reward": 0.5}
    serialization.save(tmp_path / "x", {"a": jnp.zeros(3)})
    assert serialization.read_notes(tmp_path / "x") is None
    with pytest.raises(RunError, match="cannot read"):
        serialization.read_notes(tmp_path / "y")
