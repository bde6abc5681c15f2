"""A folder from a stranger: links, pipes, devices, files of any size; nothing outside of it is read or written."""

from __future__ import annotations

import json
import os
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from murmurate import untrusted
from murmurate.cli.main import main
from murmurate.errors import MAX_LINE, InputError, RunError, one_line, shown
from murmurate.runs import comparison, config_io, experiment, files
from murmurate.runs.folder import MANIFEST, RunFolder
from murmurate.runs.grid import Grid
from murmurate.runs.jobs import TrainingJob
from murmurate.runs.run import Run
from tiny import seal, tiny, write_toml

SECRET = "root:x:0:0"


@pytest.fixture
def outside(tmp_path):
    """A file of the user's, which no run may read or change."""
    path = tmp_path / "outside.txt"
    path.write_text(f"{SECRET}\n")
    yield path
    assert path.read_text() == f"{SECRET}\n"


@pytest.fixture
def strange(finished, tmp_path):
    return RunFolder(shutil.copytree(finished, tmp_path / "run"))


def put(path, kind, target):
    path.unlink(missing_ok=True)
    if kind == "link":
        path.symlink_to(target)
    elif kind == "pipe":
        if not hasattr(os, "mkfifo"):
            pytest.skip("this system has no pipes with a name")
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")


READS = {
    "experiment.toml": lambda run: run.experiment(),
    "manifest.json": lambda run: run.manifest(),
    "policies/0-base.safetensors": lambda run: run.verify(),
    "metrics.jsonl": lambda run: run.metrics(),
    "evaluation.json": lambda run: run.evaluation(),
    "trajectories.npz": lambda run: run.trajectories(tiny()),
    "record.json": lambda run: run.record(),
}


@pytest.mark.parametrize("kind", ["link", "pipe", "device"])
@pytest.mark.parametrize("name", READS)
def test_only_regular_files_of_the_folder_are_read(strange, outside, name, kind):
    put(strange.path / name, kind, outside)
    with pytest.raises(RunError) as caught:
        READS[name](strange)
    assert ("is a link" if kind != "pipe" else "no regular file") in str(caught.value)
    assert SECRET not in str(caught.value)


def test_an_unfinished_run_is_read_as_carefully(strange, outside):
    (strange.path / MANIFEST).unlink()
    (strange.path / "checkpoint").mkdir()
    put(strange.path / "checkpoint" / "snapshot.safetensors", "link", outside)
    put(strange.path / "metrics.jsonl", "link", outside)
    for use in (
        strange.checkpoint_rows,
        strange.metrics,
        lambda: strange.append_metrics([{}]),
        lambda: strange.truncate_metrics(0),
    ):
        with pytest.raises(RunError, match="is a link"):
            use()
    assert strange.last_metrics() == []


@pytest.mark.parametrize("name", ["policies", "checkpoint", "figures"])
def test_a_linked_folder_is_refused(strange, tmp_path, name):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "discovery.png").write_text("mine")
    shutil.rmtree(strange.path / name, ignore_errors=True)
    (strange.path / name).symlink_to(elsewhere)
    uses = {
        "policies": lambda: strange.write_policies(()),
        "checkpoint": lambda: strange.write_initial((), None),
        "figures": lambda: strange.figures,
    }
    with pytest.raises(RunError, match=f"{name} is a link"):
        uses[name]()
    assert main(["evaluate", str(strange.path), "--episodes", "2"]) == (0 if name == "checkpoint" else 2)
    assert [(path.name, path.read_text()) for path in elsewhere.iterdir()] == [("discovery.png", "mine")]


def test_writing_replaces_links_and_follows_none(strange, outside, tmp_path):
    for name in (".evaluation.json.partial", ".trajectories.npz.partial", ".probe.partial"):
        put(strange.path / name, "link", outside)
    strange.write_evaluation(strange.evaluation(), files.read_npz(strange.path / "trajectories.npz"))
    (strange.path / MANIFEST).unlink()
    strange.create(resume=True)
    put(tmp_path / "x", "link", outside)
    files.write_text(tmp_path / "x", "new")
    assert not (tmp_path / "x").is_symlink()
    put(tmp_path / "y", "link", outside)
    with pytest.raises(RunError, match="is a link"):
        files.append_rows(tmp_path / "y", [{}])


def test_a_copy_holds_nothing_from_outside(strange, outside, tmp_path):
    put(strange.path / "metrics.jsonl", "link", outside)
    for copy in (strange.copy_to, Run.open(strange.path).save):
        with pytest.raises(RunError, match=r"metrics\.jsonl is a link"):
            copy(tmp_path / "copy")
        assert not (tmp_path / "copy").exists()


@pytest.mark.parametrize("name", [".training.lock", ".lock", ".worker.lock", "worker.log"])
def test_locks_and_logs_are_no_links(strange, outside, name):
    from murmurate.runs import worker
    from murmurate.runs.execute import locked

    put(strange.path / name, "link", outside)
    if "worker" in name:
        assert "is a link" in worker.work(json.dumps({"class": "x:y", "folder": str(strange.path)}))
        assert worker.end_reason(1, strange.path) == "the worker ended with status 1"
        assert not (strange.path / worker.LOG).exists() or name == worker.LOG
        return
    lock = strange.lock() if name == ".training.lock" else locked(strange.path)
    with pytest.raises(RunError, match="is a link"), lock:
        pass


def test_a_backup_of_hard_links_is_read_and_writing_changes_none_of_its_files(strange, tmp_path):
    from murmurate.runs import worker

    (strange.path / worker.LOG).write_text("a log")
    (strange.path / ".training.lock").write_text("")
    backup = RunFolder(shutil.copytree(strange.path, tmp_path / "backup", copy_function=os.link))
    before = {path: path.read_bytes() for path in sorted(backup.path.rglob("*")) if path.is_file()}
    assert all(path.stat().st_nlink == 2 for path in before)
    run = Run.open(backup.path)
    assert backup.evaluation() == strange.evaluation()
    assert backup.metrics() == strange.metrics()

    with strange.lock():
        strange.append_metrics([{"policy": 0}])
        assert files.read_rows(strange.path / "metrics.jsonl")[0] == [*backup.metrics(), {"policy": 0}]
        strange.truncate_metrics(1)
    strange.unfinish()
    strange.write_experiment(run.experiment)
    strange.write_policies(run.cascade.policies)
    strange.write_manifest(run.manifest, len(run.cascade.policies))
    assert worker.work(json.dumps({"class": "json:none", "folder": str(strange.path)}))
    assert main(["evaluate", str(strange.path), "--episodes", "4", "--quiet"]) == 0
    assert {path: path.read_bytes() for path in before} == before
    assert backup.is_whole()

    # A stranger's metrics may be a hard link to any file of the user's: it is no metrics, and stays as it is.
    mine = tmp_path / "mine.txt"
    mine.write_text("mine\n")
    (strange.path / "metrics.jsonl").unlink()
    os.link(mine, strange.path / "metrics.jsonl")
    strange.append_metrics([{"policy": 0}])
    assert mine.read_text() == "mine\n"


def test_folders_of_a_sweep_or_comparison_are_no_links(strange, tmp_path):
    grid = Grid({"run": tiny()})
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "run").symlink_to(strange.path)
    with pytest.raises(RunError, match="run is a link"):
        grid.check(tmp_path / "out")
    (tmp_path / "out" / ".conditions").symlink_to(strange.path)
    with pytest.raises(RunError, match=r"\.conditions is a link"):
        comparison.compare(comparison.Comparison(tiny(), 1), [], {}, tmp_path / "out")
    (tmp_path / "out" / ".conditions").unlink()
    (tmp_path / "out" / ".conditions").mkdir()
    (tmp_path / "out" / ".conditions" / "circle-3").symlink_to(strange.path)
    with pytest.raises(RunError, match="circle-3 is a link"):
        comparison.compare(comparison.Comparison(tiny(), 1), [], {}, tmp_path / "out")
    assert (strange.path / "policies" / "0-base.safetensors").exists()


@pytest.mark.parametrize("file", ["../outside.txt", "/etc/passwd", "./starts.csv", "starts.csv"])
def test_the_starts_of_a_run_are_its_own(strange, outside, file):
    path = strange.path / "experiment.toml"
    start = f'[start]\nuse = "file"\nfile = "{file}"\n'
    text = config_io.dump_toml(tiny())
    path.write_text(text[: text.index("[start]")] + start + text[text.index("[policy]") :])
    put(strange.path / "starts.csv", "link", outside)
    with pytest.raises(RunError) as caught:
        strange.experiment()
    assert SECRET not in str(caught.value)
    assert ("starts.csv is a link" if file == "starts.csv" else "the run's own file of starts") in str(caught.value)


@pytest.mark.parametrize(("kind", "reason"), [("pipe", "no regular file"), ("device", "is a link")])
def test_the_starts_of_a_run_are_a_regular_file(strange, outside, kind, reason):
    path = strange.path / "experiment.toml"
    text = config_io.dump_toml(tiny())
    start = '[start]\nuse = "file"\nfile = "starts.csv"\n'
    path.write_text(text[: text.index("[start]")] + start + text[text.index("[policy]") :])
    (strange.path / "starts.csv").write_text("start,x,y\n0,-6,0\n0,0,0\n0,6,0\n")
    seal(strange)
    assert Run.open(strange.path).starts(1).shape == (1, 3, 2)
    put(strange.path / "starts.csv", kind, outside)
    with pytest.raises(RunError, match=rf"starts\.csv.* {reason}"):
        Run.open(strange.path)


def test_the_starts_of_a_mixture_are_the_run_s_own_too(strange):
    text = config_io.dump_toml(tiny())
    start = '[start]\nuse = "mixture"\n[start.second]\nuse = "file"\nfile = "/etc/passwd"\n'
    text = text[: text.index("[start]")] + start + text[text.index("[policy]") :]
    (strange.path / "experiment.toml").write_text(text)
    with pytest.raises(RunError, match=r"start\.second\.file = '/etc/passwd': must be starts\.csv"):
        strange.experiment()


def test_a_file_that_the_user_names_may_be_a_link(tmp_path, capsys):
    write_toml(tmp_path / "real.toml")
    (tmp_path / "link.toml").symlink_to("real.toml")
    assert experiment.read_toml(tmp_path / "link.toml")["name"] == "tiny"


# What is read has a bound


DEEP = 100_000


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("[" * DEEP + "]" * DEEP, "nests deeper than 32"),
        ("[" * 40 + "]" * 40, "nests deeper than 32"),
        ('{"a": ' * 40 + "1" + "}" * 40, "nests deeper than 32"),
        (f"[{'9' * 5000}]", "an integer has more than 400 digits"),
        ("[1e999]", "the number 1e999 is not finite"),
        ("[NaN]", "the number NaN is not finite"),
        ('["\\ud800"]', "surrogates not allowed"),
        ('{"\\uDfff": 1}', "surrogates not allowed"),
        ("\udcff", "invalid start byte"),
    ],
)
def test_json_is_bounded(tmp_path, text, line):
    path = tmp_path / "x.json"
    path.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(RunError, match="is not valid JSON") as caught:
        files.read_json(path)
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


def test_json_that_is_plain_is_read(tmp_path):
    value = {"a": [{"b": [1, -2.5, "é\U0001f600", None, True]}], "n": 10**300}
    files.write_json(tmp_path / "x.json", value)
    assert files.read_json(tmp_path / "x.json") == value
    (tmp_path / "x.json").write_text('["\\ud83d\\ude00"]')
    assert files.read_json(tmp_path / "x.json") == ["\U0001f600"]


@pytest.mark.parametrize(
    "text",
    [
        "x = " + "[" * DEEP + "]" * DEEP,
        "x = " + "{a = " * 500 + "1" + "}" * 500,
        ".".join("a" * DEEP) + " = 1",
        "x = {" + ".".join("a" * DEEP) + " = 1}",
        f"seed = {'9' * 5000}",
        "\udcff",
    ],
)
def test_toml_is_bounded(tmp_path, text):
    path = tmp_path / "x.toml"
    path.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(InputError, match="must be valid TOML"):
        config_io.load_toml(path)


def test_large_files_are_not_read(tmp_path):
    with (tmp_path / "x.json").open("wb") as file:
        file.truncate(files.MAX_JSON_BYTES + 1)  # takes no space on disk
    with pytest.raises(RunError, match="is larger than 32768 KiB"):
        files.read_json(tmp_path / "x.json")
    with (tmp_path / "x.toml").open("wb") as file:
        file.truncate(1 << 30)
    with pytest.raises(OSError, match="is larger than 1024 KiB") as caught:
        config_io.load_toml(tmp_path / "x.toml")
    assert caught.value.filename == str(tmp_path / "x.toml")


@pytest.mark.skipif(not os.path.exists("/proc/self/mem"), reason="only Linux has this file")
def test_errors_in_the_middle_of_a_file_name_it_too():
    """Nothing is at the first address of a process: the file opens, and cannot be read."""
    with pytest.raises(OSError, match="Input/output error") as caught:
        untrusted.read("/proc/self/mem", 1 << 10)
    assert caught.value.filename == "/proc/self/mem"


def test_only_needed_arrays_are_loaded(strange, monkeypatch):
    """An array of gigabytes that nobody needs costs nothing; one that is needed is refused by its header."""
    path = strange.path / "trajectories.npz"
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive, archive.open("huge.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (1 << 22,)})
        file.write(bytes(1 << 25))
    seal(strange)
    assert strange.trajectories(tiny()).positions.shape[0] == 200
    assert "huge" not in files.read_npz(path, ["lengths"])
    monkeypatch.setattr(files, "MAX_ARRAY_BYTES", 1 << 20)
    with pytest.raises(RunError, match="arrays take more than 0 GiB"):
        files.read_npz(path)


@pytest.mark.parametrize(
    ("header", "data"),
    [
        ({"descr": "<f4", "fortran_order": False, "shape": (1 << 40, 2)}, bytes(8)),
        ({"descr": "<f4", "fortran_order": False, "shape": (-1, 2)}, bytes(8)),
        ({"descr": "|O", "fortran_order": False, "shape": (1,)}, bytes(8)),
    ],
)
def test_headers_of_arrays_are_not_believed(tmp_path, header, data):
    path = tmp_path / "x.npz"
    with zipfile.ZipFile(path, "w") as archive, archive.open("a.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, header)
        file.write(data)
    with pytest.raises(RunError, match="is not a valid npz file"):
        files.read_npz(path)


def test_rows_of_metrics_that_the_board_cannot_show_are_left_out(strange):
    good = strange.metrics()[-1]
    rows = [{}, {**good, "policy": "x"}, {**good, "update": None}, {**good, "steps_per_second": []}, good]
    (strange.path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows) + "[1, 2\n[[")
    assert strange.last_metrics() == [good]
    assert TrainingJob(strange.path, tiny()).progress() is not None


# What fits in memory and time


@pytest.mark.parametrize(
    ("flags", "line"),
    [
        (["--world.robots", "10000"], "world.robots = 10000: must be at most 4096: memory holds no more pairs"),
        (["--world.robots", "1" + "0" * 40], "must be an integer >= 2 and <= 10000"),
        (["--rest.max_steps", "2147483647"], "rest.max_steps = 2147483647: must be an integer >= 1 and <= 10000000"),
        (["--base.ppo.worlds", "100000000"], "base.ppo.worlds = 100000000: must be at most 29826161 with 3 robots"),
        (["--discovery.sigma", "100000000"], "discovery.sigma = 100000000: must be at most 29826161 with 3 robots"),
        (["--world.radius", "1e-22", "--world.half_width", "1e-22"], "must be at least 1e-09"),
        (["--rest.window", "20000000"], "rest.window = 20000000: must be at most 4194304 with 3 robots"),
        (["--policy.hidden", "60000,60000"], "policy.hidden = (60000, 60000): must be small enough: memory holds"),
        (["--policy", "local", "--policy.hidden", "60000,60000"], "policy.hidden = (60000, 60000): must be small"),
        (["--policy.hidden", "2147483647,2147483647"], "must be small enough: memory holds 134,217,728 weights"),
    ],
)
def test_what_does_not_fit_is_one_line_and_leaves_no_folder(tmp_path, capsys, flags, line):
    toml = write_toml(tmp_path / "tiny.toml")
    assert main(["discover", str(toml), "--out", str(tmp_path / "run"), *flags]) == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_an_evaluation_ends_where_memory_would(strange, monkeypatch):
    from murmurate.discovery import limits

    run = Run.open(strange.path)
    monkeypatch.setattr(limits, "MAX_RECORD_BYTES", 4 * 2 * 3 * 2 * 50)
    with pytest.raises(RunError, match="50 episodes of 3 robots did not come to rest in 1 steps"):
        run.rollout(50)
    assert len(run.rollout(2).lengths) == 2


def test_what_follows_after_rest_ends_where_memory_would(strange, monkeypatch):
    from murmurate.discovery import cascade

    run = Run.open(strange.path)
    rest = replace(run.experiment.rest, dead_zone=0.0, stillness=1.0)
    creeping = run.under(replace(run.experiment, rest=rest))
    assert creeping.rollout(2).after_rest.shape[1] == 200
    monkeypatch.setattr(cascade, "MAX_RECORD_BYTES", 4 * 2 * 3 * 2 * 199)
    with pytest.raises(RunError, match="the 200 steps after rest are more than memory holds: try fewer episodes"):
        creeping.rollout(2)


# What messages and pages show


def test_lines_are_short_and_printable():
    assert one_line("a\x1b]0;title\x07b\u202ec\n d") == "a\\x1b]0;title\\x07b\\u202ec d"
    assert len(one_line("x" * 10_000)) == MAX_LINE
    assert one_line("x" * 5000 + " the end").endswith("x the end")
    assert len(str(InputError("field" * 1000, "v" * 9000, "small"))) <= MAX_LINE
    assert str(InputError("seed", 10**5000, "small")) == "seed = <int>: must be small"
    deep = []
    for _ in range(5000):
        deep = [deep]
    assert len(shown(deep)) < 150
    assert shown("it's") == repr("it's")
    assert shown([1, 2.5, None, True]) == "[1, 2.5, None, True]"


# Sweeps


def test_a_damaged_finished_run_is_trained_again(strange):
    """A sweep says so of a run that it cannot read; what is whole stays as it is."""
    job = TrainingJob(strange.path, tiny())
    before = (strange.path / "policies" / "0-base.safetensors").read_bytes()
    assert job.is_finished()
    job.prepare()
    assert strange.inspect(resume=True) == "finished"
    (strange.path / "policies" / "0-base.safetensors").write_bytes(b"")
    assert not job.is_finished()
    job.prepare()
    assert strange.inspect(resume=True) == "unfinished"
    job.run()
    assert job.is_finished()
    assert (strange.path / "policies" / "0-base.safetensors").read_bytes() == before


@pytest.mark.parametrize("name", ["evaluation.json", "trajectories.npz", "metrics.jsonl"])
def test_every_file_of_a_finished_run_counts(strange, name):
    (strange.path / name).write_bytes(b"")
    assert not TrainingJob(strange.path, tiny()).is_finished()


def test_compiled_programs_are_the_user_s_own(tmp_path, monkeypatch):
    """What lies in the folder of a sweep, which may be a stranger's, is never loaded as a program."""
    from murmurate import compilation_cache

    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MURMURATE_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    (tmp_path / ".compiled").mkdir()
    assert compilation_cache.folder().is_relative_to(tmp_path / "home" / "murmurate")
    sources = Path(compilation_cache.__file__).parent.rglob("*.py")
    assert not [path for path in sources if ".compiled" in path.read_text("utf-8")]
