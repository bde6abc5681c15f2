"""Who is tried again, who is given up, and that no worker is left behind: with workers that only pretend."""

from __future__ import annotations

import pytest

from murmurate.errors import RunError
from murmurate.runs import storage
from murmurate.sweeps import plan
from murmurate.sweeps.conduct import conduct, standing


class Pretender:
    """A backend whose jobs end as they are told, the next time that they are asked."""

    def __init__(self, endings, workers=None):
        self.workers, self.endings = workers, endings
        self.submitted, self.cancelled, self.most, self.open = [], [], 0, 0

    def submit(self, folder):
        self.submitted.append(folder.name)
        self.open += 1
        self.most = max(self.most, self.open)
        return Pretence(self, folder, self.endings[folder.name].pop(0))

    def close(self):
        """Nothing is held."""


class Pretence:
    def __init__(self, backend, folder, ending):
        self.backend, self.folder, self.ending = backend, folder, ending

    def poll(self):
        if isinstance(self.ending, BaseException):
            raise self.ending
        self.backend.open -= 1
        if self.ending == "finish":
            storage.write_json(self.folder / storage.MANIFEST, {"format": storage.FORMAT})
            return ""
        return self.ending

    def cancel(self):
        self.backend.cancelled.append(self.folder.name)


@pytest.fixture
def folders(written, tmp_path):
    sweep = plan.read_sweep(written('experiments = ["one.toml", "two.toml", "three.toml"]'))
    return {name.partition("-")[0]: path for name, path in plan.lay_out(sweep, tmp_path / "out").items()}


def conducted(folders, endings, retries=1, workers=None):
    backend = Pretender({folders[name].name: list(ends) for name, ends in endings.items()}, workers)
    standings = {name: standing(folder) for name, folder in folders.items()}
    told = []
    conduct(folders, standings, backend, retries, told.append)
    return standings, backend, told


def test_a_failed_run_is_tried_again_then_reported_and_the_others_are_done(folders):
    endings = {"one": ["finish"], "two": ["lost", "finish"], "three": ["lost", "lost again"]}
    standings, backend, told = conducted(folders, endings)
    assert {name: (s.status, s.attempts, s.error) for name, s in standings.items()} == {
        "one": ("done", 1, ""),
        "two": ("done", 2, ""),
        "three": ("failed", 2, "lost again"),
    }
    assert sorted(told) == ["one", "three", "three", "two", "two"]
    assert backend.cancelled == []


def test_what_is_finished_is_not_begun_again(folders):
    storage.write_json(folders["two"] / storage.MANIFEST, {"format": storage.FORMAT})
    standings, backend, _ = conducted(folders, {"one": ["finish"], "three": ["finish"]})
    assert standings["two"].attempts == 0
    assert folders["two"].name not in backend.submitted


def test_no_more_workers_at_once_than_there_are(folders):
    _, backend, _ = conducted(folders, {name: ["finish"] for name in folders}, workers=2)
    assert backend.most == 2


def test_a_worker_that_says_it_is_done_is_not_believed(folders):
    standings, _, _ = conducted(folders, {"one": ["finish"], "two": ["finish"], "three": ["", ""]})
    assert standings["three"].status == "failed"
    assert "the run is not finished" in standings["three"].error


@pytest.mark.parametrize("trouble", [KeyboardInterrupt(), RunError("no more")])
def test_whatever_ends_it_every_worker_is_ended(folders, trouble):
    backend = Pretender({path.name: [trouble] for path in folders.values()})
    standings = {name: standing(folder) for name, folder in folders.items()}
    with pytest.raises(type(trouble)):
        conduct(folders, standings, backend, 1, lambda name: None)
    assert sorted(backend.cancelled) == sorted(path.name for path in folders.values())
