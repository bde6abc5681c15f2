"""Training spread over devices and hosts ends as on one device, and goes on from its checkpoint when a host dies."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from safetensors.numpy import load_file

from murmurate.cli.main import main
from murmurate.discovery import Search
from murmurate.errors import InputError, RunError
from murmurate.learning import sharding
from murmurate.runs import presets, train
from murmurate.runs.folder import RunFolder
from tiny import tiny, write_toml

UPDATES = 20
OVERLAY = {"base": {"ppo": {"updates": UPDATES}}, "discovery": {"max_policies": 1, "min_policies": 1}}


@pytest.fixture(scope="module")
def toml(tmp_path_factory):
    return write_toml(tmp_path_factory.mktemp("experiment") / "tiny.toml", **OVERLAY)


@pytest.fixture(scope="module")
def one_device(tmp_path_factory):
    """The run folder of a training on one device."""
    folder = tmp_path_factory.mktemp("one-device") / "run"
    train.discover(tiny(**OVERLAY), folder)
    return folder


def start(toml, out, devices, *flags):
    """Starts `murmurate discover` with virtual devices."""
    command = [sys.executable, "-m", "murmurate", "discover", str(toml), "--out", str(out), *map(str, flags)]
    environment = os.environ | {
        "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={devices}"
    }
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def start_two_hosts(toml, out, *flags):
    """Starts two processes, each with two virtual devices, that train together."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    return [start(toml, out, 2, *flags, "--hosts", 2, "--coordinator", address, "--host", host) for host in range(2)]


def finish(process, status=0):
    output, errors = process.communicate(timeout=300)
    assert process.returncode == status, errors
    return output, errors


def rows(folder):
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


def assert_same(folder, other):
    """Compares learning curves and weights, which differ only in the order of floating-point sums."""
    assert len(rows(folder)) == len(rows(other)) == UPDATES
    for row, expected in zip(rows(folder), rows(other), strict=True):
        for name in ("reward", "policy_loss", "value_loss"):
            assert row[name] == pytest.approx(expected[name], rel=1e-4, abs=1e-5)
    weights, expected = (load_file(path / "policies" / "0-base.safetensors") for path in (folder, other))
    for name, value in weights.items():
        np.testing.assert_allclose(value, expected[name], rtol=1e-4, atol=1e-5)
    RunFolder(folder).verify()


def test_four_devices_learn_what_one_learns(toml, one_device, tmp_path):
    finish(start(toml, tmp_path / "run", 4))
    assert RunFolder(tmp_path / "run").manifest()["devices"] == 4
    assert_same(tmp_path / "run", one_device)


@pytest.mark.parametrize("learner", presets.TRAINING_PRESETS)
def test_two_devices_share_the_episodes_of_every_preset(learner, monkeypatch):
    """The search for formations has none."""
    monkeypatch.setattr(sharding, "device_count", lambda: 2)
    Search(presets.preset("C", learner)).check_devices()


@pytest.mark.nightly
def test_formations_are_searched_on_each_device_and_the_way_is_learned_on_all(tmp_path):
    small = [
        "--policy.formations",
        4,
        "--policy.hidden",
        "8,4",
        "--base.goals.updates",
        30,
        "--base.gradients.steps",
        4,
    ]
    small += ["--base.gradients.updates", 2, "--base.gradients.worlds", 8, "--discovery.sigma", 8]
    weights = []
    for devices in (1, 4):
        folder = tmp_path / str(devices)
        # So short a search finds no valid pattern.
        finish(start("D", folder, devices, *small, "--discovery.episodes", 8, "--quiet"), status=3)
        assert RunFolder(folder).manifest()["devices"] == devices
        assert [row["environment_steps"] for row in rows(folder)] == [0] * 30 + [32, 64]
        weights.append(load_file(folder / "policies" / "0-base.safetensors"))
    for name, value in weights[0].items():
        np.testing.assert_allclose(value, weights[1][name], rtol=1e-3, atol=1e-4)


@pytest.mark.nightly
def test_two_hosts_learn_what_one_device_learns(toml, one_device, tmp_path):
    first, second = start_two_hosts(toml, tmp_path / "run")
    assert "valid pattern" in finish(first)[0]
    output = finish(second)[0].splitlines()
    assert all(line.startswith("[Gloo]") for line in output), "host 1 prints nothing of its own"
    assert RunFolder(tmp_path / "run").manifest()["devices"] == 4
    assert_same(tmp_path / "run", one_device)


@pytest.mark.nightly
def test_an_error_of_the_first_host_stops_both_with_one_line(toml, one_device):
    first, second = start_two_hosts(toml, one_device)
    assert finish(first, 2)[1].splitlines()[-1].startswith(f"murmurate: {one_device} holds another run")
    assert finish(second, 2)[1].splitlines()[-1].startswith(f"murmurate: host 0 failed: {one_device} holds another run")


@pytest.mark.nightly
def test_a_run_is_resumed_on_another_number_of_devices_after_a_host_died(tmp_path):
    overlay = {**OVERLAY, "base": {"ppo": {"updates": 2000}}}
    toml, run = write_toml(tmp_path / "long.toml", **overlay), tmp_path / "run"
    first, second = start_two_hosts(toml, run)
    deadline = time.monotonic() + 200
    while not (run / "metrics.jsonl").exists() or not rows(run):
        assert time.monotonic() < deadline
        assert first.poll() is None
        time.sleep(0.05)
    second.kill()
    second.communicate()
    first.communicate(timeout=120)
    assert first.returncode != 0
    assert 0 < len(rows(run)) < 2000
    before = len(rows(run))
    resumed = start(toml, run, 1, "--resume")
    while len(rows(run)) <= before + 2:
        assert time.monotonic() < deadline
        assert resumed.poll() is None
        time.sleep(0.05)
    resumed.kill()
    resumed.communicate()
    numbers = [row["update"] for row in rows(run)]
    assert numbers == list(range(1, len(numbers) + 1))


def test_a_batch_that_the_devices_do_not_divide_is_refused(toml, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sharding, "device_count", lambda: 4)
    assert main(["discover", str(toml), "--out", str(tmp_path / "run"), "--base.ppo.worlds", "6"]) == 2
    assert capsys.readouterr().err == (
        "murmurate: base.ppo.worlds = 6: must be a multiple of the 4 devices that share it, such as 4 or 8; 3 of them "
        "divide it (CUDA_VISIBLE_DEVICES says which are used)\n"
    )
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("size", "message"),
    [(10, "such as 8 or 12; 2 of them"), (2, "such as 4; 2 of them"), (7, "such as 4 or 8; 1 of them")],
)
def test_the_message_names_possible_sizes(monkeypatch, size, message):
    monkeypatch.setattr(sharding, "device_count", lambda: 4)
    with pytest.raises(InputError, match=message):
        sharding.check_divides("worlds", size)
    sharding.check_divides("worlds", 4 * size)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--hosts", "2"], "--hosts 2 needs --host as well"),
        (["--hosts", "2", "--host", "0"], "--hosts 2 needs --coordinator as well"),
        (["--hosts", "many", "--host", "0", "--coordinator", "a:1"], "--hosts = 'many': must be an integer"),
        (["--hosts", "2", "--host", "2", "--coordinator", "a:1"], "--host = 2: must be an integer >= 0 and <= 1"),
        (["--hosts", "2", "--host", "1", "--coordinator", "a"], "--coordinator = 'a': must be HOST:PORT"),
        (["--host", "0"], "--host and --coordinator go with --hosts"),
        (["--hosts", "auto", "--host", "0"], "--hosts auto needs neither --host nor --coordinator"),
        (["--hosts", "auto", "--seeds", "2"], "--hosts is for one run"),
    ],
)
def test_wrong_flags_for_hosts_are_one_line(flags, message, tmp_path, capsys):
    assert main(["discover", "C", "--out", str(tmp_path / "run"), *flags]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("error", [ValueError("no cluster"), RuntimeError("initialized\ntwice")])
def test_an_error_of_jax_is_one_line(monkeypatch, error):
    def fail(**_):
        raise error

    monkeypatch.setattr(sharding.jax.distributed, "initialize", fail)
    with pytest.raises((InputError, RunError), match=r"used on a cluster|initialized twice") as raised:
        sharding.initialize()
    assert "\n" not in str(raised.value)
