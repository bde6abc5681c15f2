"""Training spread over devices and hosts: as on one device, and survived by its checkpoint when a host dies."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from safetensors.numpy import load_file

from murmurate.cli.main import main
from murmurate.errors import InputError
from murmurate.runs import storage, train
from murmurate.learning import hosts, sharding
from tiny import tiny, write_toml

UPDATES = 60
OVERLAY = {"base": {"ppo": {"updates": UPDATES}}, "discovery": {"max_policies": 1, "min_policies": 1}}


@pytest.fixture(scope="module")
def toml(tmp_path_factory):
    path = tmp_path_factory.mktemp("experiment") / "tiny.toml"
    return write_toml(path, **OVERLAY)


@pytest.fixture(scope="module")
def alone(toml, tmp_path_factory):
    """The run of one device."""
    folder = tmp_path_factory.mktemp("alone") / "run"
    train.discover(tiny(**OVERLAY), folder)
    return folder


def start(toml, out, count, *words):
    """Starts the command on some virtual devices."""
    command = [sys.executable, "-m", "murmurate", "discover", str(toml), "--out", str(out), *map(str, words)]
    environment = os.environ | {"XLA_FLAGS": f"--xla_force_host_platform_device_count={count}"}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def two_hosts(toml, out):
    """Starts two processes with two virtual devices each, that train together."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    words = ("--hosts", 2, "--coordinator", address, "--host")
    return [start(toml, out, 2, *words, index) for index in range(2)]


def ended(process, status=0):
    printed, told = process.communicate(timeout=300)
    assert process.returncode == status, told
    return printed, told


def rows(folder):
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


def assert_same(folder, other):
    """The same learning curve and the same weights, but for the order of sums."""
    assert len(rows(folder)) == len(rows(other)) == UPDATES
    for row, expected in zip(rows(folder), rows(other), strict=True):
        for name in ("reward", "policy_loss", "value_loss"):
            assert row[name] == pytest.approx(expected[name], rel=1e-4, abs=1e-5)
    weights, expected = (load_file(path / "policies" / "0-base.safetensors") for path in (folder, other))
    for name, value in weights.items():
        np.testing.assert_allclose(value, expected[name], rtol=1e-4, atol=1e-5)
    storage.verify(folder, storage.read_manifest(folder))


def test_four_devices_learn_what_one_learns(toml, alone, tmp_path):
    ended(start(toml, tmp_path / "run", 4))
    assert storage.read_manifest(tmp_path / "run")["devices"] == 4
    assert_same(tmp_path / "run", alone)


def test_two_processes_learn_what_one_learns(toml, alone, tmp_path):
    first, other = two_hosts(toml, tmp_path / "run")
    assert "valid pattern" in ended(first)[0]
    assert ended(other) == ("", "")
    assert storage.read_manifest(tmp_path / "run")["devices"] == 4
    assert_same(tmp_path / "run", alone)


def test_a_host_that_dies_leaves_a_checkpoint_for_any_number_of_devices(toml, alone, tmp_path):
    run = tmp_path / "run"
    first, other = two_hosts(toml, run)
    until = time.monotonic() + 200
    while not (run / "metrics.jsonl").exists() or not rows(run):
        assert time.monotonic() < until
        assert first.poll() is None
        time.sleep(0.05)
    other.send_signal(signal.SIGKILL)
    _, told = ended(first, 2)
    assert told.strip().splitlines()[-1].startswith("murmurate: another host is gone or cannot be reached")
    assert "--resume" in told
    assert "Traceback" not in told
    other.communicate()
    assert 0 < len(rows(run)) < UPDATES
    assert main(["discover", str(toml), "--out", str(run), "--resume"]) == 0
    assert storage.read_manifest(run)["devices"] == 1
    assert_same(run, alone)


def test_a_batch_that_devices_do_not_divide_is_refused(toml, tmp_path):
    _, told = ended(start(toml, tmp_path / "run", 4, "--base.ppo.worlds", 6), 2)
    assert told == (
        "murmurate: base.ppo.worlds = 6: must be a multiple of the 4 devices that share it, such as 4 or 8; 3 of them "
        "divide it (CUDA_VISIBLE_DEVICES says which are used)\n"
    )
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("size", "words"),
    [(10, "such as 8 or 12; 2 of them"), (2, "such as 4; 2 of them"), (7, "such as 4 or 8; 1 of them")],
)
def test_what_would_be_possible_is_said(monkeypatch, size, words):
    monkeypatch.setattr(devices, "count", lambda: 4)
    with pytest.raises(InputError, match=words):
        sharding.check_divides("worlds", size)
    sharding.check_divides("worlds", 4 * size)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--hosts", "2"], "--hosts 2 needs --host as well"),
        (["--hosts", "2", "--host", "0"], "--hosts 2 needs --coordinator as well"),
        (["--hosts", "many", "--host", "0", "--coordinator", "a:1"], "--hosts = 'many': must be an integer"),
        (["--hosts", "2", "--host", "2", "--coordinator", "a:1"], "--host = 2: must be an integer >= 0 and <= 1"),
        (["--hosts", "2", "--host", "1", "--coordinator", "a"], "--coordinator = 'a': must be HOST:PORT"),
        (["--host", "0"], "--host and --coordinator go with --hosts"),
        (["--hosts", "auto", "--host", "0"], "--hosts auto finds out by itself"),
        (["--hosts", "auto", "--seeds", "2"], "--hosts is for one run"),
        (["--hosts", "2", "--host", "1", "--coordinator", "127.0.0.1:1"], "the first host: none answered within 0.3 s"),
    ],
)
def test_hosts_that_cannot_come_together_are_told_in_one_line(words, told, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("murmurate.cli.discover.go_on_attended", lambda: None)
    monkeypatch.setattr(hosts, "_PATIENCE", 0.3)
    assert main(["discover", "C", "--out", str(tmp_path / "run"), *words]) == 2
    error = capsys.readouterr().err
    assert told in error
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "run").exists()
