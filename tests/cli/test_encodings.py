"""Names that the terminal's encoding does not have, or that are in no encoding at all, end no command."""

from __future__ import annotations

import io
import os
import shutil
import sys

import pytest

from murmurate.cli.main import main
from murmurate.runs import escape


@pytest.fixture
def run_encoded(monkeypatch):
    """Runs a command whose output goes to a terminal or a pipe of an encoding; returns status, stdout and stderr."""

    def run(encoding, errors, *arguments):
        out = io.TextIOWrapper(io.BytesIO(), encoding=encoding, errors=errors)
        err = io.TextIOWrapper(io.BytesIO(), encoding=encoding, errors="backslashreplace")
        monkeypatch.setattr(sys, "stdout", out)
        monkeypatch.setattr(sys, "stderr", err)
        status = main([str(word) for word in arguments])
        out.flush()
        err.flush()
        assert (out.errors, err.errors) == (errors, "backslashreplace")
        return status, out.buffer.getvalue().decode(encoding), err.buffer.getvalue().decode(encoding)

    return run


@pytest.mark.parametrize(
    ("encoding", "errors", "name", "shown"),
    [
        ("ascii", "strict", "dépôt-☃", "d?p?t-?"),
        # what Python takes in the locale C
        pytest.param("ascii", "surrogateescape", "dépôt-☃", "d?p?t-?", marks=pytest.mark.nightly),
        pytest.param("cp1252", "strict", "dépôt-☃", "dépôt-?", marks=pytest.mark.nightly),
        ("utf-8", "strict", os.fsdecode(b"d\xe9p"), r"d\udce9p"),  # escaped: in no encoding
    ],
)
def test_output_is_replaced_where_it_cannot_be_encoded(
    encoding, errors, name, shown, run_encoded, discovered, tiny_toml, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / name
    folder.mkdir()
    run = shutil.copytree(discovered, folder / name)
    monkeypatch.chdir(folder)
    shutil.copytree(discovered, folder / "other")
    (folder / "line.csv").write_text("start,x,y\n0,-6,0\n0,0,0\n0,6,0\n")
    for arguments, part in {
        ("discover", tiny_toml, "--out", name, "--resume"): f"picture: {shown}",
        ("evaluate", name, "--out", f"{name}2"): f"picture: {shown}2",
        ("evaluate", name, "--starts", "line.csv", "--out", f"{name}3"): f"picture: {shown}3",
        ("show", name, "--episode", "0", "--animation", f"{name}.webp"): f"animation: {shown}.webp",
        ("show", name, "other", "--out", f"{name}4"): f"picture: {shown}4",
        # In a table, the backslash is escaped once more: a page would act on it.
        ("table", name, "other"): f"| {shown if name.isprintable() else escape.markdown(name)} | tiny ",
        ("catalogue", name, "--out", f"{name}5"): f"plates: {shown}5",
        ("export", name, "--trajectories", "csv", "--episodes", "1"): f"waypoints: {shown}.csv",
    }.items():
        status, out, err = run_encoded(encoding, errors, *arguments)
        assert (status, part in out, "Traceback" in err) == (0, True, False), (arguments, out, err)
    for arguments in (("evaluate", f"{name}9"), ("discover", "C", "--world.robots", name), (name,)):
        status, out, err = run_encoded(encoding, errors, *arguments)
        assert (status, out, err.count("\n")) == (2, "", 1)
    assert run.exists()


def test_the_page_of_a_comparison_holds_the_command_whatever_its_names(run_encoded, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = os.fsdecode(b"d\xe9p")
    arguments = ("compare", "--methods", "learned", "--robots", "3", "--episodes", "2", "--out", name)
    status, out, _ = run_encoded("ascii", "strict", *arguments)
    assert (status, r"table: d\udce9p" in out) == (0, True)
    assert r"--out 'd\udce9p'" in (tmp_path / name / "comparison.md").read_text("utf-8")
