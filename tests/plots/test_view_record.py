"""Reading a run folder: what is right comes out as recorded, what is wrong is one line that names the file."""

import shutil

import numpy as np
import pytest

from murmurate.errors import InputError, RunError
from murmurate.plots import Record


@pytest.fixture
def copy(run, tmp_path):
    return shutil.copytree(run, tmp_path / "copy")


def change(folder, **arrays):
    kept = dict(np.load(folder / "trajectories.npz"))
    kept.update(arrays)
    np.savez(folder / "trajectories.npz", **{name: value for name, value in kept.items() if value is not None})


def test_reads_what_was_recorded(run):
    record = Record.open(str(run))
    arrays = np.load(run / "trajectories.npz")
    assert record.name == "C"
    assert record.objective == "C1"
    assert (record.sizes.robots, record.sizes.radius, record.sizes.safe_distance) == (10, 1.0, 5.0)
    assert record.policies == ("base", "auxiliary")
    assert [len(curve.environment_steps) for curve in record.training] == [80, 50]
    assert record.manifest == {}
    np.testing.assert_array_equal(record.positions, arrays["positions"])
    assert record.valid.all()


def test_an_episode_ends_at_its_rest(run):
    record = Record.open(run)
    episode = record.episode(1)
    assert len(episode.positions) == record.lengths[1] + 1 == episode.steps + 1
    assert set(episode.signals) == {"close", "safety", "neighbors", "visible"}
    objective = np.load(run / "trajectories.npz")["objective"][1]
    np.testing.assert_allclose(episode.objective, objective[: episode.steps + 1], rtol=1e-6)
    (switch,) = episode.switches
    assert [episode.policy_at(step) for step in (0, switch - 1, switch, episode.steps)] == [0, 0, 1, 1]


def test_typical_is_the_median_of_the_valid(copy):
    lengths = np.load(copy / "trajectories.npz")["lengths"]
    record = Record.open(copy)
    assert record.lengths[record.typical()] == np.sort(lengths)[2]
    slow, fast = int(np.argmax(lengths)), int(np.argmin(lengths))
    at_rest = np.zeros(5, bool)
    at_rest[[slow, fast]] = True
    change(copy, at_rest=at_rest)
    assert Record.open(copy).typical() == fast
    change(copy, at_rest=np.zeros(5, bool))
    assert Record.open(copy).typical() == record.typical()
    assert (record.episode().outcome, Record.open(copy).episode().outcome) == ("at rest", "not at rest")


def test_a_collision_on_the_way_is_not_valid(copy):
    positions = np.load(copy / "trajectories.npz")["positions"]
    # Two robots change places within one step and back: clean at both ends, not between.
    positions[0, 5, :2] = [[-3, 30], [3, 30]]
    positions[0, 6, :2] = [[3, 30], [-3, 30]]
    change(copy, positions=positions)
    assert Record.open(copy).valid.tolist() == [False, True, True, True, True]


@pytest.mark.parametrize("index", [-1, 5])
def test_no_such_episode(run, index):
    with pytest.raises(InputError, match="episode = "):
        Record.open(run).episode(index)


def test_no_such_folder(tmp_path):
    with pytest.raises(RunError, match="no such folder"):
        Record.open(tmp_path / "nowhere")


@pytest.mark.parametrize("name", ["experiment.toml", "evaluation.json", "metrics.jsonl", "trajectories.npz"])
def test_each_file_is_needed(copy, name):
    (copy / name).unlink()
    with pytest.raises(RunError, match=f"{name} is missing") as caught:
        Record.open(copy)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("experiment.toml", b"= 3"),
        ("experiment.toml", b'objective = "C1"'),
        ("experiment.toml", b'objective = "C1"\nworld = 3'),
        ("evaluation.json", b"[1, 2]"),
        ("evaluation.json", b'{"episodes": "many", "valid": 1}'),
        ("manifest.json", b"{"),
        ("metrics.jsonl", b'{"policy": 0}\n'),
        ("metrics.jsonl", b'{"policy": 0, "name": "base", "upd'),
        ("metrics.jsonl", b"\xff\xfe"),
        ("trajectories.npz", b"not an archive"),
        ("trajectories.npz", b"PK\x03\x04 cut off"),
        ("trajectories.npz", b""),
    ],
)
def test_a_malformed_file_is_named(copy, name, content):
    (copy / name).write_bytes(content)
    with pytest.raises(RunError, match=f"{name} is malformed") as caught:
        Record.open(copy)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new"),
    [('"C1"', '"C3"'), ("radius = 1.0", "radius = -1.0"), ("robots = 10", "robots = 1.5"), ("half_width = 45.0", "")],
)
def test_a_malformed_experiment_is_named(copy, old, new):
    file = copy / "experiment.toml"
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(RunError, match=r"experiment\.toml is malformed"):
        Record.open(copy)


@pytest.mark.parametrize(
    "arrays",
    [
        {"lengths": None},
        {"lengths": np.full(5, 10_000)},
        {"lengths": np.full(4, 3)},
        {"switch": np.zeros(5, int)},
        {"positions": np.zeros((5, 9, 9, 2))},
        {"positions": np.full((5, 60, 10, 2), np.nan)},
        {"signals": np.zeros((5, 9, 4))},
        {"at_rest": np.array([object()] * 5)},
    ],
)
def test_malformed_trajectories_are_named(copy, arrays):
    change(copy, **arrays)
    with pytest.raises(RunError, match=r"trajectories\.npz is malformed"):
        Record.open(copy)


def test_a_switch_that_never_happened_falls_on_the_end(copy):
    switch = np.load(copy / "trajectories.npz")["switch"]
    switch[2] = 10_000
    change(copy, switch=switch)
    episode = Record.open(copy).episode(2)
    assert episode.switches == (episode.steps,)
