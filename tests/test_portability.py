"""Linux, macOS and Windows: nothing but POSIX's is needed, and what Windows does otherwise is provided for."""

from __future__ import annotations

import errno
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from murmurate import interrupts, untrusted

ROOT = Path(__file__).parents[1]
# Not those that are indented: in a `try` that says what to do without them.
POSIX_ONLY = re.compile(r"^(?:import|from) (?:fcntl|grp|posix|pty|pwd|readline|resource|syslog|termios|tty)\b", re.M)


@pytest.mark.parametrize("folder", ["src", "benchmarks", "examples", "tests", "docs"])
def test_no_module_that_windows_lacks_is_imported(folder):
    paths = list((ROOT / folder).rglob("*.py"))
    assert paths
    assert [path for path in paths if POSIX_ONLY.search(path.read_text(encoding="utf-8"))] == []


def test_another_system_reads_runs_and_shows_help(tiny_run, tmp_path):
    arguments = [ROOT / "tests" / "elsewhere.py", tiny_run(), tmp_path / "copy"]
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "cp1252"}
    ended = subprocess.run(
        [sys.executable, "-X", "warn_default_encoding", *arguments],
        env={**os.environ, **plain, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        check=False,
        timeout=120,
    )
    assert ended.returncode == 0, ended.stderr.decode("cp1252")
    printed = ended.stdout.decode("cp1252")
    assert "murmurate sweep" in printed
    assert "Traceback" not in ended.stderr.decode("cp1252")


FORKS = re.compile(r"os\.fork\(|get_context\((?!\"spawn\")|set_start_method|multiprocessing\.(Process|Pool)\(")


def test_no_process_is_forked():
    """Windows has no fork, and JAX that has been started does not survive one: processes begin as new programs."""
    paths = list((ROOT / "src").rglob("*.py"))
    assert paths
    assert [path.name for path in paths if FORKS.search(path.read_text(encoding="utf-8"))] == []


# Files


@pytest.fixture(params=[False, True], ids=["posix", "windows"])
def keeps_open_files(request, monkeypatch):
    monkeypatch.setattr(untrusted, "_KEEPS_OPEN_FILES", request.param or os.name == "nt")
    return request.param


def test_a_lock_is_held_by_one_and_leaves_nothing(tmp_path, keeps_open_files):
    path = tmp_path / ".lock"
    with untrusted.locked(path):
        with pytest.raises(BlockingIOError), untrusted.locked(path):
            pass
        assert path.stat().st_size == 0
    assert not path.exists()
    with pytest.raises(ZeroDivisionError), untrusted.locked(path):
        1 / 0  # noqa: B018
    with untrusted.locked(path):
        pass
    assert not path.exists()


def test_who_waits_for_a_lock_gets_it_in_turn(tmp_path):
    path, holders, most = tmp_path / ".lock", [], []

    def work():
        for _ in range(3):
            with untrusted.locked(path, wait=True):
                holders.append(None)
                most.append(len(holders))
                time.sleep(0.002)
                holders.pop()

    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert most == [1] * 9
    assert not path.exists()


def test_a_file_system_without_locks_locks_nothing(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise OSError(errno.ENOLCK, "no locks")

    monkeypatch.setattr(untrusted, "lock_descriptor", refuse)
    with untrusted.locked(tmp_path / ".lock"), untrusted.locked(tmp_path / ".lock"):
        pass
    monkeypatch.setattr(untrusted, "_NO_LOCKS", ())
    with pytest.raises(OSError, match="no locks"), untrusted.locked(tmp_path / ".lock"):
        pass


def test_a_file_that_a_reader_has_open_is_replaced_once_it_is_closed(tmp_path, monkeypatch, keeps_open_files):
    path, tries, replace = tmp_path / "x", [], os.replace

    def open_twice(source, target):
        tries.append(target)
        if len(tries) <= 2:
            raise PermissionError(13, "Permission denied")
        replace(source, target)

    monkeypatch.setattr(os, "replace", open_twice)
    if not keeps_open_files:
        with pytest.raises(PermissionError):
            untrusted.replace(path, b"new")
        assert len(tries) == 1
        return
    untrusted.replace(path, b"new")
    assert (path.read_bytes(), len(tries)) == (b"new", 3)
    tries.clear()
    monkeypatch.setattr(untrusted, "REPLACE_SECONDS", -1.0)
    with pytest.raises(PermissionError):
        untrusted.replace(path, b"newer")
    assert (path.read_bytes(), list(tmp_path.iterdir())) == (b"new", [path])


def test_a_junction_is_a_link(tmp_path, monkeypatch):
    class Junction:
        st_mode = 0o040755
        st_reparse_tag = untrusted._JUNCTION

    monkeypatch.setattr(os, "lstat", lambda path: Junction())
    with pytest.raises(OSError, match="policies is a link"):
        untrusted.check_inside(tmp_path, "policies")


# Signals


def test_requests_to_end_are_those_that_the_system_has():
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), interrupts.sigterm_as_interrupt():
        signal.raise_signal(interrupts._REQUESTS[-1])
    assert signal.getsignal(signal.SIGTERM) == before
    assert (len(interrupts._REQUESTS) == 2) == (sys.platform == "win32")
