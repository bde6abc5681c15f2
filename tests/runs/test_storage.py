from __future__ import annotations

import errno
import json
import math
import os
import resource
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from murmurate.errors import RunError
from murmurate.runs import serialization, storage


@pytest.fixture
def full_disk():
    """No file can grow beyond 4 KiB: writing fails in the middle, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def os_errors_as_run_errors(caught) -> str:
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_json_has_no_nan_and_takes_arrays(tmp_path):
    value = {"a": math.nan, "b": np.float32(0.5), "c": jnp.arange(2), "d": [np.bool_(True), None], 1: (math.inf,)}
    storage.write_json(tmp_path / "x.json", value)
    assert storage.read_json(tmp_path / "x.json") == {"a": None, "b": 0.5, "c": [0, 1], "d": [True, None], "1": [None]}
    (tmp_path / "x.json").write_text("{")
    with pytest.raises(RunError, match="not valid JSON"):
        storage.read_json(tmp_path / "x.json")


def test_npz(tmp_path):
    path = tmp_path / "x.npz"
    storage.write_npz(path, {"positions": jnp.ones((2, 3)), "names": np.array(["close", "safety"])})
    arrays = storage.read_npz(path)
    assert arrays["positions"].dtype == np.float32
    assert arrays["names"].tolist() == ["close", "safety"]
    with pytest.raises(TypeError, match="objects"):
        storage.write_npz(path, {"x": np.array([{}])})
    np.savez(path, x=np.array([{}], dtype=object))
    with pytest.raises(RunError, match="not a valid npz"):
        storage.read_npz(path)
    path.write_bytes(b"PK\x03\x04")
    with pytest.raises(RunError, match="not a valid npz"):
        storage.read_npz(path)


def test_lines(tmp_path):
    path = tmp_path / "metrics.jsonl"
    storage.truncate_lines(path, 0)
    storage.append_lines(path, [{"update": 0, "kl": math.nan}, {"update": 1}])
    storage.append_lines(path, [{"update": 2}])
    assert json.loads(path.read_text().splitlines()[0]) == {"update": 0, "kl": None}
    with path.open("a") as file:
        file.write('{"update": 3')  # killed here
    storage.truncate_lines(path, 3)
    assert path.read_text().splitlines()[2:] == ['{"update": 2}']
    storage.truncate_lines(path, 1)
    storage.append_lines(path, [{"update": 1}])
    assert len(path.read_text().splitlines()) == 2
    with pytest.raises(RunError, match="has 2 rows, but the checkpoint was saved after 5"):
        storage.truncate_lines(path, 5)


def test_a_full_disk_leaves_what_was_there(tmp_path, full_disk):
    path = tmp_path / "x"
    storage.write_bytes(path, b"before")
    with pytest.raises(RunError, match="cannot write") as caught:
        storage.write_bytes(path, bytes(10_000))
    assert os_errors_as_run_errors(caught) == f"cannot write {path}: {os.strerror(errno.EFBIG)}"
    assert path.read_bytes() == b"before"
    storage.append_lines(tmp_path / "rows", ["first"])
    with pytest.raises(RunError, match="cannot write"):
        storage.append_lines(tmp_path / "rows", ["second", "x" * 10_000])
    assert (tmp_path / "rows").read_text() == '"first"\n'
    assert sorted(file.name for file in tmp_path.iterdir()) == ["rows", "x"]


def test_a_full_disk_is_found_when_the_folder_is_claimed(tmp_path, full_disk):
    with pytest.raises(RunError, match="cannot write"):
        storage.claim(tmp_path / "runs" / "C")
    assert not list(tmp_path.iterdir())


def test_a_file_in_the_way_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    for act in (
        lambda: storage.claim(tmp_path / "file"),
        lambda: storage.claim(tmp_path / "file" / "run"),
        lambda: storage.write_text(tmp_path / "file" / "x", "x"),
        lambda: storage.append_lines(tmp_path / "file" / "x", [1]),
        lambda: storage.write_text(tmp_path / "missing" / "x", "x"),
    ):
        with pytest.raises(RunError, match="cannot write") as caught:
            act()
        os_errors_as_run_errors(caught)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_an_unwritable_folder_is_one_line(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(RunError, match="Permission denied"):
        storage.claim(tmp_path / "run")


def test_written_files_have_ordinary_permissions(tmp_path):
    storage.write_text(tmp_path / "x", "x")
    (tmp_path / "y").write_text("y")
    assert (tmp_path / "x").stat().st_mode == (tmp_path / "y").stat().st_mode


def test_a_killed_writer_leaves_the_old_file(tmp_path):
    path = tmp_path / "x"
    path.write_text("old")
    code = (
        "import os, signal, sys; from murmurate.runs import storage\n"
        "os.fsync = lambda file: os.kill(os.getpid(), signal.SIGKILL)\n"
        "storage.write_text(sys.argv[1], 'new')"
    )
    subprocess.run([sys.executable, "-c", code, str(path)], check=False)
    assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir() if file != path] == [".x.partial"]
    storage.write_text(path, "new")
    assert [file.name for file in tmp_path.iterdir()] == ["x"]


def test_claiming(tmp_path):
    folder = tmp_path / "runs" / "C"
    assert storage.claim(folder, resume=True) == "new"
    assert not list(folder.iterdir())
    (folder / ".experiment.toml.partial").write_text("killed here")
    assert storage.claim(folder) == "new"
    storage.write_text(folder / storage.EXPERIMENT, "")
    with pytest.raises(RunError, match=r"holds another run: continue it with --resume, or choose another --out$"):
        storage.claim(folder)
    assert storage.claim(folder, resume=True) == "unfinished"
    storage.write_json(folder / storage.MANIFEST, {})
    assert storage.claim(folder, resume=True) == "finished"
    (tmp_path / "thesis.tex").write_text("")
    for resume in (False, True):
        with pytest.raises(RunError, match="choose another --out"):
            storage.claim(tmp_path, resume)


def a_run(folder: Path) -> dict:
    (folder / "policies").mkdir()
    storage.write_text(folder / storage.EXPERIMENT, "name = 'C'")
    serialization.save(folder / "policies" / "0-base.safetensors", {"a": jnp.zeros(3)})
    names = [storage.EXPERIMENT, "policies/0-base.safetensors"]
    manifest = {"format": storage.FORMAT, "checksums": storage.checksums(folder, names)}
    storage.write_json(folder / storage.MANIFEST, manifest)
    return manifest


def test_a_run_verifies(tmp_path):
    manifest = a_run(tmp_path)
    assert storage.read_manifest(tmp_path) == manifest
    storage.verify(tmp_path, manifest)
    path = tmp_path / "policies" / "0-base.safetensors"
    data = path.read_bytes()
    path.write_bytes(data[:-1] + b"\x01")
    with pytest.raises(RunError, match=r"0-base\.safetensors does not match its checksum in manifest\.json$"):
        storage.verify(tmp_path, manifest)
    path.unlink()
    with pytest.raises(RunError, match="cannot read"):
        storage.verify(tmp_path, manifest)


@pytest.mark.parametrize("manifest", [{"format": 2}, {"format": "1"}, {}, [], 1])
def test_unknown_formats_are_refused(tmp_path, manifest):
    storage.write_json(tmp_path / storage.MANIFEST, manifest)
    with pytest.raises(RunError, match="this version of murmurate reads format 1"):
        storage.read_manifest(tmp_path)


@pytest.mark.parametrize("checksums", [None, [], {"../x": "0"}, {"/etc/hostname": "0"}])
def test_strange_checksums_are_refused(tmp_path, checksums):
    with pytest.raises(RunError, match=r"no checksums|outside the run"):
        storage.verify(tmp_path, {"checksums": checksums})


def test_folders_without_a_finished_run(tmp_path):
    with pytest.raises(RunError, match=r"holds no run"):
        storage.read_manifest(tmp_path)
    (tmp_path / storage.EXPERIMENT).write_text("")
    with pytest.raises(RunError, match="unfinished run"):
        storage.read_manifest(tmp_path)


def test_versions():
    assert set(storage.versions()) == {"python", "jax", "jaxlib", "equinox", "optax", "numpy"}
    assert storage.versions()["jax"] == jax.__version__
