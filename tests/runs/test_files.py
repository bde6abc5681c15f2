from __future__ import annotations

import errno
import json
import math
import os
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
import safetensors.numpy

from murmurate.errors import RunError
from murmurate.runs import files


@pytest.fixture
def full_disk():
    """No file can grow beyond 4 KiB: writing fails in the middle, as on a full disk."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def one_line(caught) -> str:
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_json_has_no_nan_and_takes_arrays(tmp_path):
    value = {"a": math.nan, "b": np.float32(0.5), "c": jnp.arange(2), "d": [np.bool_(True), None], 1: (math.inf,)}
    files.write_json(tmp_path / "x.json", value)
    assert files.read_json(tmp_path / "x.json") == {"a": None, "b": 0.5, "c": [0, 1], "d": [True, None], "1": [None]}
    (tmp_path / "x.json").write_text("{")
    with pytest.raises(RunError, match="not valid JSON"):
        files.read_json(tmp_path / "x.json")


def test_npz(tmp_path):
    path = tmp_path / "x.npz"
    files.write_npz(path, {"positions": jnp.ones((2, 3)), "names": np.array(["close", "safety"])})
    arrays = files.read_npz(path)
    assert arrays["positions"].dtype == np.float32
    assert arrays["names"].tolist() == ["close", "safety"]
    with pytest.raises(TypeError, match="objects"):
        files.write_npz(path, {"x": np.array([{}])})
    np.savez(path, x=np.array([{}], dtype=object))
    with pytest.raises(RunError, match="not a valid npz"):
        files.read_npz(path)
    path.write_bytes(b"PK\x03\x04")
    with pytest.raises(RunError, match="not a valid npz"):
        files.read_npz(path)


def test_lines(tmp_path):
    path = tmp_path / "metrics.jsonl"
    files.truncate_rows(path, 0)
    files.append_rows(path, [{"update": 0, "kl": math.nan}, {"update": 1}])
    files.append_rows(path, [{"update": 2}])
    assert json.loads(path.read_text().splitlines()[0]) == {"update": 0, "kl": None}
    with path.open("a") as file:
        file.write('{"update": 3')  # killed here
    files.truncate_rows(path, 3)
    assert path.read_text().splitlines()[2:] == ['{"update": 2}']
    files.truncate_rows(path, 1)
    files.append_rows(path, [{"update": 1}])
    assert len(path.read_text().splitlines()) == 2
    with pytest.raises(RunError, match="has 2 rows, but the checkpoint was saved after 5"):
        files.truncate_rows(path, 5)


def test_a_full_disk_leaves_what_was_there(tmp_path, full_disk):
    path = tmp_path / "x"
    files.write_bytes(path, b"before")
    with pytest.raises(RunError, match="cannot write") as caught:
        files.write_bytes(path, bytes(10_000))
    assert one_line(caught) == f"cannot write {path}: {os.strerror(errno.EFBIG)}"
    assert path.read_bytes() == b"before"
    files.append_rows(tmp_path / "rows", [{"row": 1}])
    with pytest.raises(RunError, match="cannot write"):
        files.append_rows(tmp_path / "rows", [{"row": 2}, {"row": "x" * 10_000}])
    assert (tmp_path / "rows").read_text() == '{"row": 1}\n'
    assert sorted(file.name for file in tmp_path.iterdir()) == ["rows", "x"]


def test_a_full_disk_is_found_before_anything_is_written(tmp_path, full_disk):
    with pytest.raises(RunError, match="cannot write"):
        files.make_writable(tmp_path / "runs" / "C")
    assert not list(tmp_path.iterdir())


def test_a_file_in_the_way_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    for write in (
        lambda: files.make_writable(tmp_path / "file"),
        lambda: files.make_writable(tmp_path / "file" / "run"),
        lambda: files.write_text(tmp_path / "file" / "x", "x"),
        lambda: files.append_rows(tmp_path / "file" / "x", [{}]),
        lambda: files.write_text(tmp_path / "missing" / "x", "x"),
    ):
        with pytest.raises(RunError, match="cannot write") as caught:
            write()
        one_line(caught)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.skipif(getattr(os, "geteuid", int)() == 0, reason="root, and Windows, may write anywhere")
def test_an_unwritable_folder_is_one_line(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(RunError, match="Permission denied"):
        files.make_writable(tmp_path / "run")


def test_written_files_have_ordinary_permissions(tmp_path):
    files.write_text(tmp_path / "x", "x")
    (tmp_path / "y").write_text("y")
    assert (tmp_path / "x").stat().st_mode == (tmp_path / "y").stat().st_mode


def test_a_killed_writer_leaves_the_old_file(tmp_path):
    path = tmp_path / "x"
    path.write_text("old")
    code = (
        "import os, sys; from murmurate.runs import files\n"
        "os.fsync = lambda file: os._exit(9)\n"
        "files.write_text(sys.argv[1], 'new')"
    )
    subprocess.run([sys.executable, "-c", code, str(path)], check=False)
    assert path.read_text() == "old"
    assert [file.suffix for file in tmp_path.iterdir() if file != path] == [".partial"]
    assert files.entries(tmp_path) == {"x"}
    files.write_text(path, "new")
    files.remove_partial(tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["x"]


@pytest.mark.parametrize("line", ["{", "3", "[" * 100_000])
def test_damaged_rows_are_one_line(tmp_path, line):
    path = tmp_path / "rows"
    assert files.read_rows(path) == ([], 0)
    files.append_rows(path, [{"a": 1}])
    with path.open("a") as file:
        file.write('{"a": 2')  # killed here
    assert files.read_rows(path) == ([{"a": 1}], 9)
    with path.open("a") as file:
        file.write("}\n")
    assert files.read_rows(path, 9) == ([{"a": 2}], 18)
    path.write_text(line + "\n")
    with pytest.raises(RunError, match="line 1 is not a JSON object") as caught:
        files.read_rows(path)
    one_line(caught)


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
    files.write_tree(tmp_path / "tree.safetensors", tree)
    again = files.read_tree(tmp_path / "tree.safetensors", zeros(tree))
    assert bits(again) == bits(tree)
    assert jax.tree.structure(again) == jax.tree.structure(tree)
    assert isinstance(again["counts"][0], np.ndarray)
    assert isinstance(again["odd"], jax.Array)
    assert again["model"](jnp.ones(2)).tolist() == tree["model"](jnp.ones(2)).tolist()
    names = set(safetensors.numpy.load_file(tmp_path / "tree.safetensors"))
    assert {"model/layers/0/weight", "optimizer/1/0/count", "key", "mask"} <= names


def test_trees_load_into_shapes_alone(tmp_path):
    files.write_tree(tmp_path / "x", {"a": jnp.arange(3.0)})
    shapes = jax.eval_shape(lambda: {"a": jnp.zeros(3)})
    assert files.read_tree(tmp_path / "x", shapes)["a"].tolist() == [0, 1, 2]


def test_transposed_arrays_keep_their_elements(tmp_path):
    array = np.arange(6, dtype=np.float32).reshape(2, 3).T
    files.write_tree(tmp_path / "x", array)
    assert (files.read_tree(tmp_path / "x", np.zeros((3, 2), np.float32)) == array).all()


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
    files.write_tree(tmp_path / "x", {"a": jnp.zeros(3)})
    with pytest.raises(RunError) as caught:
        files.read_tree(tmp_path / "x", template)
    assert one_line(caught) == f"{tmp_path / 'x'} {line}"


def test_trees_refuse_what_they_cannot_keep(tmp_path):
    with pytest.raises(TypeError):
        files.write_tree(tmp_path / "x", {"key": jax.random.key(0)})
    with pytest.raises(ValueError, match="same name"):
        files.write_tree(tmp_path / "x", {"a/b": jnp.zeros(1), "a": {"b": jnp.zeros(1)}})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("damage", [lambda data: b"", lambda data: data[:-1], lambda data: b"\x80\x04" + data])
def test_damaged_trees_are_one_line(tmp_path, damage):
    path = tmp_path / "x"
    files.write_tree(path, {"a": jnp.zeros(3)})
    path.write_bytes(damage(path.read_bytes()))
    for read in (lambda: files.read_tree(path, {"a": jnp.zeros(3)}), lambda: files.read_notes(path)):
        with pytest.raises(RunError, match="not a valid safetensors file") as caught:
            read()
        one_line(caught)


def test_notes(tmp_path):
    notes = {"policy": 1, "rows": 12, "seconds": 0.1, "names": ["base"], "reward": jnp.float32(0.5)}
    files.write_tree(tmp_path / "x", {"a": jnp.zeros(3)}, notes)
    assert files.read_notes(tmp_path / "x") == {**notes, "reward": 0.5}
    files.write_tree(tmp_path / "x", {"a": jnp.zeros(3)})
    assert files.read_notes(tmp_path / "x") is None
    with pytest.raises(RunError, match="cannot read"):
        files.read_notes(tmp_path / "y")


def test_trees_are_fitted_to_a_template():
    tree, template = {"a": jnp.arange(3.0)}, jax.eval_shape(lambda: {"a": jnp.zeros(3)})
    assert files.fit_tree(tree, template, "it")["a"].tolist() == [0, 1, 2]
    with pytest.raises(RunError, match=r"it has 'a' as float32\[3\], but float32\[2\] is needed"):
        files.fit_tree(tree, {"a": jnp.zeros(2)}, "it")
