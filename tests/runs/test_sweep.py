"""Sweeps by the command, with real workers: on this machine's cores, on a Ray of two workers, and by submitit."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from filelock import FileLock

import murmurate
from murmurate.cli.main import main
from murmurate.runs.clusters import Slurm
from murmurate.runs.execute import Resources, run_jobs
from murmurate.runs.folder import RunFolder
from murmurate.runs.grid import Grid
from murmurate.runs.jobs import training_jobs
from tiny import tiny, write_toml

LONG = {"base": {"ppo": {"updates": 150}}, "discovery": {"chunk": 2, "min_policies": 1, "max_policies": 1}}
"""Some seconds of training with many checkpoints: time to be killed in."""

TWO = 'experiments = ["long.toml"]\nseeds = 2\n'

INTERRUPTIBLY = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.SIG_DFL)
os.execv(sys.argv[1], sys.argv[1:])
"""
"""Becomes a command: whoever runs these tests in the background may have them ignore interrupts, and all they start."""


@pytest.fixture
def folder(tmp_path):
    write_toml(tmp_path / "long.toml", name="long", **LONG)
    (tmp_path / "sweep.toml").write_text(TWO)
    return tmp_path


def words(folder, *options):
    command = [sys.executable, "-m", "murmurate", "sweep", str(folder / "sweep.toml"), "--out", str(folder / "out")]
    return [*command, "--workers", "2", *options]


def finish(folder, *options):
    ended = subprocess.run(words(folder, *options), capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode in (0, 3), ended.stderr + ended.stdout
    return ended.stdout, table_of(folder / "out")


def table_of(out):
    with (out / "results.csv").open(encoding="utf-8", newline="") as file:
        return {row["run"]: row for row in csv.DictReader(file)}


def wait_for(condition, seconds=120):
    until = time.monotonic() + seconds
    while not (result := condition()):
        assert time.monotonic() < until
        time.sleep(0.05)
    return result


def workers(out):
    """Numbers of the processes that train a run of a folder, by the run."""
    if not Path("/proc").is_dir():
        pytest.skip("the processes of other systems than Linux are not looked for")
    result = {}
    for process in Path("/proc").glob("[0-9]*"):
        try:
            opened = {os.readlink(path) for path in (process / "fd").iterdir()}
            command = (process / "cmdline").read_bytes()
        except OSError:
            continue
        for log in opened & {str(path) for path in out.glob("*/worker.log")}:
            if b"runs.worker" in command:
                result[Path(log).parent.name] = int(process.name)
    return result


def begun(out):
    """The runs that have written a checkpoint and metrics, and are not finished."""
    return [path.parent.name for path in out.glob("*/metrics.jsonl") if not (path.parent / "manifest.json").exists()]


def same(path, other):
    return all(
        (path / name).read_bytes() == (other / name).read_bytes()
        for name in ("experiment.toml", "policies/0-base.safetensors")
    )


def parent(process):
    return int(Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rsplit(")")[-1].split()[1])


def killed_in_the_middle(folder, *options, whom=lambda process: process):
    """Runs a sweep, kills one of its workers when it has got somewhere, and returns which and what was printed."""
    out = folder / "out"
    with subprocess.Popen(
        words(folder, *options), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as sweep:
        (name, process) = wait_for(lambda: [item for item in workers(out).items() if item[0] in begun(out)])[0]
        os.kill(whom(process), signal.SIGKILL)
        printed, _ = sweep.communicate(timeout=300)
    assert sweep.returncode in (0, 3), printed
    return name, printed


@pytest.mark.nightly
def test_a_killed_worker_costs_nothing_and_changes_nothing(folder):
    killed, printed = killed_in_the_middle(folder)
    assert f"{killed}: to be tried again, attempt 1 failed: killed by SIGKILL" in printed
    rows = table_of(folder / "out")
    assert {row["status"] for row in rows.values()} == {"done"}
    assert {name: int(row["attempts"]) for name, row in rows.items()} == {
        name: 2 if name == killed else 1 for name in rows
    }
    (folder / "again").mkdir()
    write_toml(folder / "again" / "long.toml", name="long", **LONG)
    (folder / "again" / "sweep.toml").write_text(TWO)
    finish(folder / "again")
    for name in rows:
        assert same(folder / "out" / name, folder / "again" / "out" / name)
        murmurate.load(folder / "out" / name)
        assert not (folder / "out" / name / "worker.log").exists()


@pytest.mark.nightly
def test_an_interrupted_sweep_leaves_nobody_behind_and_goes_on(folder):
    out = folder / "out"
    command = [sys.executable, "-c", INTERRUPTIBLY, *words(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as sweep:
        wait_for(lambda: begun(out))
        sweep.send_signal(signal.SIGINT)
        _, reported = sweep.communicate(timeout=60)
    assert sweep.returncode == 130
    assert reported.strip().endswith("interrupted; the same command goes on")
    assert not workers(out)
    assert "unfinished" in {row["status"] for row in table_of(out).values()}
    printed, rows = finish(folder)
    assert {row["status"] for row in rows.values()} == {"done"}
    assert f"table: {out / 'results.csv'}" in printed


def test_two_sweeps_never_work_in_one_folder(folder, capsys):
    (folder / "out").mkdir()
    with FileLock(folder / "out" / ".lock"):
        assert main(["sweep", str(folder / "sweep.toml"), "--out", str(folder / "out")]) == 2
    assert "another command is at work there" in capsys.readouterr().err
    assert os.listdir(folder / "out") == [".lock"]


OWN_SIGNAL = """
import jax.numpy as jnp
from murmurate.world import Signal

class Calm(Signal):
    def __call__(self, configuration):
        return jnp.cos(configuration.positions).mean(axis=1)
"""


@pytest.mark.nightly
def test_runs_with_a_signal_of_ones_own_end_in_one_table(tmp_path):
    write_toml(tmp_path / "tiny.toml")
    (tmp_path / "mine.py").write_text(OWN_SIGNAL)
    text = 'experiments = ["tiny.toml"]\n[fields.signals.calm]\nuse = "mine:Calm"\n[grid]\n'
    (tmp_path / "sweep.toml").write_text(f'{text}"signals.calm.weight" = [0.5, 1.0]\n')
    printed, rows = finish(tmp_path, "--parquet")
    assert [(row["signals.calm.weight"], row["status"], row["attempts"]) for row in rows.values()] == [
        ("0.5", "done", "1"),
        ("1.0", "done", "1"),
    ]
    for name, row in rows.items():
        assert float(row["valid"]) == RunFolder(tmp_path / "out" / name).evaluation()["valid"]
        assert f"| {name} |" in printed
    from pyarrow import parquet

    assert parquet.read_table(tmp_path / "out" / "results.parquet").column("run").to_pylist() == list(rows)


@pytest.mark.nightly
def test_ray_with_two_workers_one_of_which_is_killed(folder):
    killed, printed = killed_in_the_middle(folder, "--backend", "ray", whom=parent)
    assert f"{killed}: to be tried again, attempt 1 failed: the worker died" in printed
    assert {row["status"] for row in table_of(folder / "out").values()} == {"done"}
    assert not workers(folder / "out")


@pytest.mark.nightly
def test_no_cluster_at_an_address_is_told_within_half_a_minute(folder):
    start = time.monotonic()
    command = [*words(folder), "--backend", "ray", "--address", "127.0.0.1:1"]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert time.monotonic() - start < 30
    assert ended.returncode == 2
    assert "--address = '127.0.0.1:1': must be the address of a Ray cluster" in ended.stderr
    assert "Traceback" not in ended.stderr
    assert not (folder / "out").exists()


@pytest.mark.nightly
def test_submitit_carries_a_run_to_its_end(tmp_path):
    """With submitit's executor for one machine: there is no Slurm to submit to here."""
    out, grid = tmp_path / "out", Grid.product([tiny()])
    with Slurm(out, resources=Resources(), retries=0, cluster="local") as executor:
        statuses = run_jobs(training_jobs(grid, out), executor, quiet=True)
    assert [(status.state, status.error) for status in statuses.values()] == [("done", "")]
    for name in grid.runs:
        RunFolder(out / name).verify()
