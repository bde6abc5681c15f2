"""A training that is asked to end, or that cannot go on: one line, an exit status, and what was reached is kept."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest

from murmurate.cli.main import main
from murmurate.interrupts import raise_if_interrupted, sigterm_as_interrupt
from murmurate.runs import train
from murmurate.runs.folder import RunFolder
from tiny import write_toml

LONG = {"ppo": {"updates": 100_000}}

# A shell that starts a process in the background lets it ignore SIGINT.
INTERRUPTIBLY = """
import signal, sys
from murmurate.cli.main import main
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends Ctrl-C to all processes of a console")
@pytest.mark.parametrize("request_to_end", [signal.SIGTERM, signal.SIGINT])
def test_a_request_to_end_is_one_line_and_the_run_goes_on_later(tmp_path, request_to_end):
    folder = RunFolder(tmp_path / "run")
    toml = write_toml(tmp_path / "long.toml", base=LONG)
    command = [sys.executable, "-c", INTERRUPTIBLY, "discover", str(toml), "--out", str(folder.path), "--quiet"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        until = time.monotonic() + 120
        while not folder.checkpoint_rows() and process.poll() is None and time.monotonic() < until:
            time.sleep(0.05)
        process.send_signal(request_to_end)
        _, reported = process.communicate(timeout=60)
    assert process.returncode == 130
    line = f"murmurate: interrupted; add --resume to the same command to go on with {folder.path}\n"
    assert reported.endswith(line)
    assert "Traceback" not in reported
    assert folder.inspect(resume=True) == "unfinished"
    assert folder.checkpoint_rows() > 0


class Finalised:
    """Python drops what is raised while an object is finalised, and goes on."""

    def __del__(self):
        signal.raise_signal(signal.SIGTERM)


def test_no_request_is_lost_in_a_finaliser(tmp_path, capsys, monkeypatch):
    toml = write_toml(tmp_path / "long.toml", base=LONG)
    report = train._report

    def report_and_finalise(*arguments, **numbers):
        report(*arguments, **numbers)
        Finalised()

    monkeypatch.setattr(train, "_report", report_and_finalise)
    assert main(["discover", str(toml), "--out", str(tmp_path / "run"), "--quiet"]) == 130
    assert capsys.readouterr().err.startswith("murmurate: interrupted; add --resume")
    # It was of that command alone.
    raise_if_interrupted()


def test_the_outermost_block_ends_a_request():
    with sigterm_as_interrupt():
        with sigterm_as_interrupt():
            Finalised()
        with pytest.raises(KeyboardInterrupt):
            raise_if_interrupted()
    raise_if_interrupted()


def test_divergence_is_said_with_the_update_and_the_quantity(tmp_path, capsys):
    toml = write_toml(tmp_path / "tiny.toml")
    arguments = ["--out", str(tmp_path / "run"), "--quiet", "--base.ppo.reward_scale", "1e30"]
    assert main(["discover", str(toml), *arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "the training of the base policy diverged at update 1: " in error
    assert "is NaN or infinite; the checkpoint before it is kept" in error
    assert not (tmp_path / "run" / "manifest.json").exists()
