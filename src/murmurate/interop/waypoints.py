"""Recorded episodes for multi-robot test beds: time-stamped waypoints in metres.

A world has no unit of length or time, so both scales are stated: metres per world unit, seconds per step. The numbers
are checked as they are written, after rounding: that robots keep apart at any moment, and how fast they have to be.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from murmurate.discovery.validity import contact_free_and_inside
from murmurate.errors import MAX_MAGNITUDE, InputError, RunError, check_number, check_path
from murmurate.geometry import closest_approach
from murmurate.representation import short_repr
from murmurate.runs import files
from murmurate.runs.experiment import ExperimentConfig
from murmurate.runs.folder import RunFolder
from murmurate.types import Trajectories

__all__ = ["FORMATS", "Format", "Scale", "Waypoints"]

Format = Literal["csv", "json"]
FORMATS = ("csv", "json")

COLUMNS = ("episode", "time_s", "robot", "x_m", "y_m")

DIGITS = 6
"""Decimals of metres and seconds: micrometres and microseconds."""


@dataclass(frozen=True)
class Scale:
    """The scales of length and time, and the robots that are to follow the waypoints.

    Attributes:
        metres: Metres of a world unit.
        seconds: Seconds of a step.
        robot_radius: Radius of these robots, metres; None: the world's, scaled.
        robot_speed: Speed that they reach, metres per second; None: not limited.
    """

    metres: float = 0.1
    seconds: float = 1.0
    robot_radius: float | None = None
    robot_speed: float | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for flag, value in (("--scale", self.metres), ("--period", self.seconds)):
            check_number(flag, value, 1e-3, MAX_MAGNITUDE)
        for flag, value in (("--robot-radius", self.robot_radius), ("--robot-speed", self.robot_speed)):
            if value is not None:
                check_number(flag, value, 0, MAX_MAGNITUDE, exclusive_low=True)


@dataclass(frozen=True, eq=False)
class Waypoints:
    """Episodes of a run, scaled and rounded as they are written.

    Attributes:
        experiment: The run's experiment.
        scale: The scales.
        episodes: Indices of the episodes in the run's evaluation.
        times: Time of every waypoint, seconds, one array for each episode.
        positions: Centres, metres, one array for each episode.
        left_out: Episodes that are left out, as they ended in contact or outside the world.
    """

    experiment: ExperimentConfig
    scale: Scale
    episodes: tuple[int, ...]
    times: tuple[Float[np.ndarray, " _"], ...]
    positions: tuple[Float[np.ndarray, "_ robots 2"], ...]
    left_out: tuple[int, ...]

    __repr__ = short_repr

    @classmethod
    def from_run(cls, folder: str | Path, scale: Scale, episodes: int | None = None, trust: bool = False) -> Waypoints:
        """Reads the episodes that a run recorded.

        Args:
            folder: The run folder.
            scale: The scales.
            episodes: Number of episodes to take; None: all of them.
            trust: Whether modules that the run's configuration names may be imported.

        Raises:
            RunError: The folder is missing, unfinished or damaged, or no episode can be followed.
            InputError: There are not as many episodes, or the robots of `scale` cannot follow.
        """
        run = RunFolder(folder)
        run.verify()
        experiment = run.experiment(trust)
        trajectories = run.trajectories(experiment)
        if episodes is not None:
            check_number("--episodes", episodes, 1, len(trajectories.positions), integer=True)
        return cls.from_trajectories(experiment, trajectories, scale, episodes, folder)

    @classmethod
    def from_trajectories(
        cls,
        experiment: ExperimentConfig,
        trajectories: Trajectories,
        scale: Scale,
        episodes: int | None = None,
        where: str | Path = "trajectories",
    ) -> Waypoints:
        """Scales the first episodes, without those that ended in contact or outside the world.

        Args:
            experiment: The experiment that they are of.
            trajectories: The episodes.
            scale: The scales.
            episodes: Number of episodes to take; None: all of them.
            where: Where they are from, for messages.

        Raises:
            RunError: No episode can be followed.
            InputError: The robots of `scale` cannot follow.
        """
        positions, lengths = trajectories.positions.astype(float), trajectories.lengths
        chosen = range(len(positions) if episodes is None else episodes)
        contact_free, inside = contact_free_and_inside(positions[: len(chosen)], experiment.world)
        passable = np.flatnonzero(contact_free & inside).tolist()
        if not passable:
            raise RunError(f"{where}: every one of {len(chosen)} episodes ended in contact or outside the world")
        points = [np.round(scale.metres * positions[index, : lengths[index] + 1], DIGITS) for index in passable]
        times = [np.round(scale.seconds * np.arange(len(path)), DIGITS) for path in points]
        left_out = tuple(sorted(set(chosen) - set(passable)))
        scaled = cls(experiment, scale, tuple(passable), tuple(times), tuple(points), left_out)
        scaled.check()
        return scaled

    @property
    def fastest(self) -> float:
        """The greatest speed between two waypoints, metres per second."""
        return max(float(np.linalg.norm(velocities, axis=2).max(initial=0)) for velocities in self._velocities())

    @property
    def nearest(self) -> float:
        """The least distance of two centres at any moment, metres."""
        steps = zip(self.positions, self.times, self._velocities(), strict=True)
        return min(_nearest(points, np.diff(times), velocities) for points, times, velocities in steps)

    @property
    def radius(self) -> float:
        """Radius of the robots that are to follow, metres."""
        return self.scale.robot_radius or self.scale.metres * self.experiment.world.radius

    @property
    def limit(self) -> float:
        """The world's bound on each component of a velocity, metres per second."""
        return self.experiment.world.max_speed * self.scale.metres / self.scale.seconds

    def check(self) -> None:
        """Checks that robots can follow the waypoints: fast enough, and never in contact.

        Raises:
            InputError: The robots of `scale` are too slow or too large.
        """
        # A rounded position is off by half a last digit, a difference of two by one.
        slack = 10.0**-DIGITS
        component = max(float(np.abs(velocities).max(initial=0)) for velocities in self._velocities())
        if component > self.limit + slack / self.scale.seconds:
            raise RunError(f"a robot's velocity has a component of {component:g} m/s; the limit is {self.limit:g} m/s")
        speed, fastest = self.scale.robot_speed, self.fastest
        if speed is not None and fastest > speed:
            period = self.scale.seconds * fastest / speed
            allowed = f"at least {_at_least(fastest)} m/s; or --period at least {_at_least(period)}"
            raise InputError("--robot-speed", speed, allowed)
        if self.nearest <= 2 * self.radius:
            scale = self.scale.metres * 2 * self.radius / self.nearest
            allowed = f"less than {_at_most(self.nearest / 2)} m, as centres come; or --scale above {_at_least(scale)}"
            raise InputError("--robot-radius", self.radius, allowed)

    def write(self, path: str | Path, kind: Format) -> None:
        """Writes the waypoints, whole or not at all.

        Raises:
            RunError: The file cannot be written.
        """
        check_path("path", path)
        files.write_text(path, self.as_csv() if kind == "csv" else files.to_json(self.as_dict()) + "\n")

    def about(self) -> dict[str, Any]:
        """Returns the scales, and the greatest speed and least distance of the waypoints."""
        return {
            "experiment": self.experiment.name,
            "robots": self.experiment.world.robots,
            "metres_per_world_unit": self.scale.metres,
            "seconds_per_step": self.scale.seconds,
            "robot_radius_m": self.radius,
            "fastest_m_per_s": self.fastest,
            "least_distance_of_centres_m": self.nearest,
        }

    def as_csv(self) -> str:
        """Returns a table with a row for each waypoint, below comment lines with the scales."""
        text = io.StringIO()
        for name, value in self.about().items():
            text.write(f"# {name}: {value}\n")
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow(COLUMNS)
        for episode, times, positions in zip(self.episodes, self.times, self.positions, strict=True):
            for time, configuration in zip(times, positions, strict=True):
                points = enumerate(configuration)
                rows.writerows((episode, _exact(time), robot, *map(_exact, at)) for robot, at in points)
        return text.getvalue()

    def as_dict(self) -> dict[str, Any]:
        """Returns the scales, and for each robot of each episode its waypoints (time, x, y)."""
        episodes = zip(self.episodes, self.times, self.positions, strict=True)
        return {
            **self.about(),
            "columns": ["time_s", "x_m", "y_m"],
            "episodes": [
                {
                    "episode": episode,
                    "robots": [np.column_stack([times, positions[:, robot]]) for robot in range(positions.shape[1])],
                }
                for episode, times, positions in episodes
            ],
        }

    def _velocities(self) -> list[Float[np.ndarray, "steps robots 2"]]:
        pairs = zip(self.positions, self.times, strict=True)
        return [np.diff(points, axis=0) / np.diff(times)[:, None, None] for points, times in pairs]


def _nearest(positions: np.ndarray, durations: np.ndarray, velocities: np.ndarray) -> float:
    """Returns the least distance of two centres at any moment."""
    others = ~np.eye(positions.shape[1], dtype=bool)
    moves = durations[:, None, None] * velocities
    if not len(moves):  # an episode of no steps
        moves = np.zeros_like(positions)
    return float(closest_approach(positions[: len(moves)], moves)[:, others].min())


def _exact(value: float) -> str:
    """Writes a number so that reading it gives the same one, at any magnitude: what was checked is what is written."""
    return repr(float(value))


def _at_least(value: float, digits: int = 4) -> str:
    """Writes a number with a few digits, rounded up: an advice that can be followed."""
    return _rounded(value, digits, math.ceil)


def _at_most(value: float, digits: int = 4) -> str:
    """Writes a number with a few digits, rounded down."""
    return _rounded(value, digits, math.floor)


def _rounded(value: float, digits: int, rounding: Callable[[float], int]) -> str:
    if not value:
        return "0"
    unit = 10.0 ** (math.floor(math.log10(abs(value))) - digits + 1)
    exact = round(value / unit)
    # What has so few digits already stays as it is, whatever the last bit of the quotient.
    steps = exact if math.isclose(exact * unit, value, rel_tol=1e-12) else rounding(value / unit)
    return f"{steps * unit:.{digits}g}"
