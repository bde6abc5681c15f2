"""Waypoints in metres: what is written is what was recorded, and can be followed."""

from __future__ import annotations

import csv
import io
import json

import numpy as np
import pytest

import murmurate
from murmurate.errors import InputError, RunError
from murmurate.interop.waypoints import Scale, Waypoints
from murmurate.runs import files
from murmurate.runs.evaluate import evaluate
from murmurate.runs.folder import RunFolder
from tiny import made_up_summary, tiny

RADIUS, SPEED = 1.0, 0.5


@pytest.fixture
def recorded(tmp_path):
    """Makes a run folder with given trajectories of three robots."""

    def make(positions, lengths):
        folder, (episodes, configurations) = RunFolder(tmp_path), np.shape(positions)[:2]
        positions = np.array(positions, np.float32)
        for episode, length in zip(positions, lengths, strict=True):
            episode[length:] = episode[length]
        arrays = {
            "positions": positions,
            "lengths": np.asarray(lengths, np.int32),
            "switch": np.zeros((episodes, 0), np.int32),
            "signals": np.zeros((episodes, configurations, 4), np.float32),
            "signal_names": np.array(tiny().signal_names),
            "at_rest": np.zeros(episodes, bool),
        }
        folder.write_experiment(tiny())
        folder.write_policies([{}])
        folder.write_evaluation(made_up_summary(episodes), arrays)
        folder.write_manifest({}, policies=1)
        return tmp_path

    return make


def straight(steps=4, speed=SPEED, gap=5.0, height=6.0):
    """Two robots side by side, and one that goes past them at a distance."""
    still = np.array([[-gap / 2, 0.0], [gap / 2, 0.0], [-8.0, height]])
    positions = np.repeat(still[None], steps + 1, axis=0)
    positions[:, 2, 0] += speed * np.arange(steps + 1)
    return positions


def test_times_and_places_are_scaled_and_an_episode_ends_with_its_length(recorded):
    folder = recorded([straight(), straight()], [4, 2])
    waypoints = Waypoints.from_run(folder, Scale(metres=0.05, seconds=0.4))
    first, second = waypoints.positions
    np.testing.assert_allclose(first, 0.05 * straight(), atol=5e-7)
    np.testing.assert_allclose(second, 0.05 * straight()[:3], atol=5e-7)
    np.testing.assert_allclose(waypoints.times[0], [0, 0.4, 0.8, 1.2, 1.6])
    assert waypoints.fastest == pytest.approx(SPEED * 0.05 / 0.4, rel=1e-4)
    assert waypoints.nearest == pytest.approx(0.05 * 5, rel=1e-4)
    assert waypoints.radius == pytest.approx(0.05 * RADIUS)


def test_csv_and_json_hold_the_same_numbers_and_the_scales(recorded):
    waypoints = Waypoints.from_run(recorded([straight(), straight()], [4, 2]), Scale(metres=0.05, seconds=0.4))
    lines = waypoints.as_csv().splitlines()
    reported = dict(line[2:].split(": ") for line in lines if line.startswith("#"))
    assert float(reported["metres_per_world_unit"]) == 0.05
    assert float(reported["seconds_per_step"]) == 0.4
    rows = list(csv.DictReader(io.StringIO("\n".join(line for line in lines if not line.startswith("#")))))
    assert len(rows) == 3 * (5 + 3)
    data = json.loads(files.to_json(waypoints.as_dict()))
    assert data["metres_per_world_unit"] == 0.05
    for row in rows:
        robots = data["episodes"][int(row["episode"])]["robots"][int(row["robot"])]
        match = [waypoint for waypoint in robots if waypoint[0] == float(row["time_s"])]
        assert match == [[float(row["time_s"]), float(row["x_m"]), float(row["y_m"])]]


def test_a_moment_between_two_waypoints_counts(recorded):
    # Robot 2 passes robot 0 at a distance of 2.2 in the middle of its second step.
    positions = straight(steps=2, height=2.2)
    positions[:, 2, 0] = [-3.0, -2.75, -2.25]
    waypoints = Waypoints.from_run(recorded([positions], [2]), Scale(metres=1.0))
    assert waypoints.nearest == pytest.approx(2.2, abs=1e-5)


def test_episodes_with_a_collision_or_outside_the_world_are_left_out(recorded):
    touching, away = straight(), straight()
    touching[2, 1] = touching[2, 0] + [1.9, 0.0]
    away[3, 2] = [-8.0, 12.5]
    folder = recorded([touching, straight(), away], [4, 4, 4])
    waypoints = Waypoints.from_run(folder, Scale())
    assert (waypoints.episodes, waypoints.left_out) == ((1,), (0, 2))
    with pytest.raises(RunError, match="every one of 1 episodes"):
        Waypoints.from_run(folder, Scale(), episodes=1)


def test_robots_that_are_too_large_or_too_slow_are_refused_with_what_would_do(recorded):
    folder = recorded([straight()], [4])
    Waypoints.from_run(folder, Scale(metres=0.1, robot_radius=0.2499, robot_speed=0.0501))
    with pytest.raises(InputError, match=r"--robot-radius = 0\.251: must be less than 0\.25 m.*--scale above 0\.1004"):
        Waypoints.from_run(folder, Scale(metres=0.1, robot_radius=0.251))
    with pytest.raises(InputError, match=r"--robot-speed = 0\.025: must be at least 0\.05 m/s; or --period at least 2"):
        Waypoints.from_run(folder, Scale(metres=0.1, robot_speed=0.025))
    slower = Waypoints.from_run(folder, Scale(metres=0.1, seconds=2.01, robot_speed=0.025))
    assert slower.fastest <= 0.025


def read_csv(waypoints):
    """The episode 0 of a file as its reader has it: times, and positions by time and robot."""
    lines = [line for line in waypoints.as_csv().splitlines() if not line.startswith("#")]
    rows = [row for row in csv.DictReader(io.StringIO("\n".join(lines))) if row["episode"] == "0"]
    times = sorted({float(row["time_s"]) for row in rows})
    at = {(float(row["time_s"]), int(row["robot"])): (float(row["x_m"]), float(row["y_m"])) for row in rows}
    return np.array(times), np.array([[at[time, robot] for robot in range(3)] for time in times])


@pytest.mark.parametrize(("metres", "seconds"), [(123456.789, 4444444.321), (0.001, 0.001), (1 / 3, 1 / 7)])
def test_a_csv_keeps_every_digit(recorded, metres, seconds):
    waypoints = Waypoints.from_run(recorded([straight()], [4]), Scale(metres=metres, seconds=seconds))
    times, positions = read_csv(waypoints)
    assert times.tolist() == waypoints.times[0].tolist()
    assert positions.tolist() == waypoints.positions[0].tolist()


@pytest.mark.parametrize("seconds", [1 / 3, 1 / 7, 0.0011, 4444444.321])
def test_robots_as_fast_as_allowed_can_follow_the_file(recorded, seconds):
    """The speed that the file asks for, as its reader computes it, is what it says and what is checked."""
    folder = recorded([straight(speed=0.4999)], [4])
    waypoints = Waypoints.from_run(folder, Scale(metres=0.1, seconds=seconds))
    times, positions = read_csv(waypoints)
    asked = np.linalg.norm(np.diff(positions, axis=0) / np.diff(times)[:, None, None], axis=2).max()
    assert waypoints.about()["fastest_m_per_s"] == asked
    Waypoints.from_run(folder, Scale(metres=0.1, seconds=seconds, robot_speed=float(asked)))
    with pytest.raises(InputError) as caught:
        Waypoints.from_run(folder, Scale(metres=0.1, seconds=seconds, robot_speed=float(asked) * (1 - 1e-9)))
    # What the error advises is enough.
    advised = float(str(caught.value).partition("at least ")[2].partition(" m/s")[0])
    assert asked <= advised <= 1.01 * asked
    Waypoints.from_run(folder, Scale(metres=0.1, seconds=seconds, robot_speed=advised))
    period = float(str(caught.value).partition("--period at least ")[2])
    Waypoints.from_run(folder, Scale(metres=0.1, seconds=1.01 * period, robot_speed=float(asked)))


def test_recorded_positions_faster_than_the_world_allows_are_refused(recorded):
    with pytest.raises(RunError, match="the limit is"):
        Waypoints.from_run(recorded([straight(speed=0.6)], [4]), Scale())


def test_nobody_moves(recorded):
    waypoints = Waypoints.from_run(recorded([straight()], [0]), Scale())
    assert waypoints.fastest == 0
    assert waypoints.positions[0].shape == (1, 3, 2)
    assert waypoints.nearest == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize("field", ["metres", "seconds", "robot_radius", "robot_speed"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_scales_that_mean_nothing_are_refused(field, value):
    with pytest.raises(InputError, match=r"--(scale|period|robot)"):
        Scale(**{field: value})


def test_episodes_are_as_many_as_there_are(recorded):
    folder = recorded([straight()], [4])
    for wrong in (0, 2):
        with pytest.raises(InputError, match=f"--episodes = {wrong}"):
            Waypoints.from_run(folder, Scale(), episodes=wrong)


def test_a_finished_run_is_written_and_read(finished, tmp_path):
    waypoints = Waypoints.from_run(finished, Scale(metres=0.2))
    waypoints.write(tmp_path / "way.csv", "csv")
    waypoints.write(tmp_path / "way.json", "json")
    stated = len(waypoints.about())
    table = np.loadtxt(tmp_path / "way.csv", delimiter=",", skiprows=stated + 1)
    assert table.shape == (sum(len(times) * 3 for times in waypoints.times), 5)
    assert json.loads((tmp_path / "way.json").read_text())["robots"] == 3


def test_waypoints_end_where_the_pattern_was_judged(tmp_path):
    """Robots in their own time are still under way when an episode ends: they are stopped there, and judged there."""
    run = murmurate.pretrained("C2", "visible", "async").of_size(5)
    judged = evaluate(run, 6)
    run.save(tmp_path / "run")
    judged.save(tmp_path / "run")
    waypoints = Waypoints.from_run(tmp_path / "run", Scale(metres=1.0))
    assert waypoints.episodes == tuple(np.flatnonzero(judged.validity.contact_free & judged.validity.inside))
    assert len(set(judged.trajectories.lengths)) > 1
    for index, points in zip(waypoints.episodes, waypoints.positions, strict=True):
        np.testing.assert_allclose(points[-1], judged.trajectories.final[index], atol=1e-6)
