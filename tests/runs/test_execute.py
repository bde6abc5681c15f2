"""Executors: which jobs are tried again and which are given up, and that no worker is left; with scripted workers."""

from __future__ import annotations

from pathlib import Path

import pytest

from murmurate.errors import RunError
from murmurate.runs import live_table
from murmurate.runs.execute import Batch, Handle, InProcess, Resources, WorkerExecutor, run_jobs
from murmurate.runs.jobs import Job, JobStatus, Progress, initial_statuses

NAMES = ("one", "two", "three")


class FileJob(Job):
    """Writes a file."""

    def __init__(self, folder):
        self.folder = folder

    def is_finished(self):
        return (self.folder / "done").exists()

    def run(self, on_progress=None):
        self.prepare()
        (self.folder / "done").touch()

    def fields(self):
        return {}

    @classmethod
    def from_spec(cls, fields):
        return cls(Path(fields["folder"]))


class ScriptedExecutor(WorkerExecutor):
    """An executor whose workers end as they are told, the next time that they are polled."""

    def __init__(self, endings, workers=None, retries=1):
        super().__init__(workers, Resources(), retries)
        self.endings = {name: list(ends) for name, ends in endings.items()}
        self.submitted, self.cancelled, self.most, self.running = [], [], 0, 0

    def submit(self, job):
        self.submitted.append(job.name)
        self.running += 1
        self.most = max(self.most, self.running)
        return ScriptedHandle(self, job, self.endings[job.name].pop(0))


class ScriptedHandle(Handle):
    def __init__(self, executor, job, ending):
        self.executor, self.job, self.ending = executor, job, ending

    def poll(self):
        if isinstance(self.ending, BaseException):
            raise self.ending
        self.executor.running -= 1
        if self.ending == "finish":
            self.job.run()
            return ""
        return self.ending

    def cancel(self):
        self.executor.cancelled.append(self.job.name)


@pytest.fixture
def jobs(tmp_path):
    return [FileJob(tmp_path / name) for name in NAMES]


def executed(jobs, endings, **options):
    executor, statuses, ended = ScriptedExecutor(endings, **options), initial_statuses(jobs), []
    executor.run(Batch(jobs, statuses, ended.append))
    return statuses, executor, ended


def test_a_failed_job_is_tried_again_then_reported_and_the_others_are_done(jobs):
    endings = {"one": ["finish"], "two": ["lost", "finish"], "three": ["lost", "lost again"]}
    statuses, executor, ended = executed(jobs, endings)
    assert statuses == {
        "one": JobStatus("done", 1, ""),
        "two": JobStatus("done", 2, ""),
        "three": JobStatus("failed", 2, "lost again"),
    }
    assert sorted(ended) == ["one", "three", "three", "two", "two"]
    assert executor.cancelled == []


def test_what_is_finished_is_not_done_again(jobs):
    jobs[1].run()
    statuses, executor, _ = executed(jobs, {"one": ["finish"], "three": ["finish"]})
    assert statuses["two"] == JobStatus("done", 0)
    assert "two" not in executor.submitted


def test_no_more_workers_at_once_than_there_are(jobs):
    _, executor, _ = executed(jobs, {name: ["finish"] for name in NAMES}, workers=2)
    assert executor.most == 2


def test_the_folder_decides_whether_a_job_is_done(jobs):
    statuses, _, _ = executed(jobs, {"one": ["finish"], "two": ["finish"], "three": ["", ""]})
    assert statuses["three"].state == "failed"
    assert "the job is not finished" in statuses["three"].error


@pytest.mark.parametrize("trouble", [KeyboardInterrupt(), RunError("no more")])
def test_whatever_ends_it_every_worker_is_ended(jobs, trouble):
    executor = ScriptedExecutor({name: [trouble] for name in NAMES})
    with pytest.raises(type(trouble)):
        run_jobs(jobs, executor, quiet=True)
    assert sorted(executor.cancelled) == sorted(NAMES)


def test_in_this_process_a_failure_ends_all_and_the_statuses_are_known(jobs, monkeypatch):
    def fail(on_progress=None):
        raise RunError("disk full")

    monkeypatch.setattr(jobs[1], "run", fail)
    statuses = initial_statuses(jobs)
    with pytest.raises(RunError, match="disk full"):
        run_jobs(jobs, InProcess(), statuses=statuses, quiet=True)
    assert [statuses[name].state for name in NAMES] == ["done", "waiting", "waiting"]


def test_lines_in_a_pipe_and_nothing_when_quiet(jobs, capsys):
    run_jobs(jobs[:2], InProcess())
    assert capsys.readouterr().out == "1 of 2: one: done\n2 of 2: two: done\n"
    run_jobs(jobs, InProcess(), quiet=True)
    assert capsys.readouterr() == ("", "")


def test_workers_that_have_gone_on_are_a_line_each_on_stderr(jobs, capsys, monkeypatch):
    """Once for each chunk of each job, by the files that its worker writes."""
    monkeypatch.setattr(live_table, "DRAW_SECONDS", 0)
    known = {"one": Progress("base", 5, 60, 0.25, 1000.0, 30.0), "two": None}
    for job in jobs:
        monkeypatch.setattr(job, "progress", lambda name=job.name: known.get(name))
    statuses = {"one": JobStatus("running", 1), "two": JobStatus("running", 1), "three": JobStatus()}
    table = live_table.LiveTable(jobs, statuses)
    table.draw()
    table.draw()
    first = "one: base: 5/60  reward +0.2500  1,000 steps/s  30 s left\n"
    assert capsys.readouterr() == ("", first)
    known |= {"two": Progress("base", 5, 60, None, None, None), "one": Progress("base", 10, 60, None, None, 25.0)}
    table.draw()
    assert capsys.readouterr() == ("", "one: base: 10/60  25 s left\ntwo: base: 5/60\n")
    quiet = live_table.LiveTable(jobs, statuses, quiet=True)
    quiet.draw()
    assert capsys.readouterr() == ("", "")
