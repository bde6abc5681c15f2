"""A made-up run for the figures: robots move from two corners to a dented ring, and later policies push it open."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from murmurate import geometry, plots
from murmurate.discovery import RestRule
from murmurate.runs.presets import preset
from murmurate.types import Trajectories

SIGNALS = {"C1": ("close", "safety", "neighbors", "visible"), "C2": ("nclose", "safety", "neighbors", "visible")}


def ring(robots, dents=(), size=8.5):
    angles = 2 * np.pi * (np.arange(robots) + 0.5) / robots - np.pi / 4
    radii = np.where(np.isin(np.arange(robots), dents), 0.55 * size, size)
    return radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def start(robots, rng):
    """Two rows across the diagonal, in the order of the ring, so that straight paths do not cross."""
    half = robots // 2
    sides = [1] * half + [-1] * (robots - half)
    rows = np.concatenate([np.arange(half) - (half - 1) / 2, -(np.arange(robots - half) - (robots - half - 1) / 2)])
    across, along = np.array([-1, 1]) / 2**0.5, np.array([1, 1]) / 2**0.5
    return rows[:, None] * across * 5 + np.array(sides)[:, None] * along * 44 + rng.uniform(-1, 1, (robots, 2))


def signals_of(positions, world, objective):
    """The definitions of design.md, written for (configurations, robots, 2)."""
    robots, diagonal = world.robots, np.hypot(world.half_width, world.half_height)
    off = ~np.eye(robots, dtype=bool)
    distance = geometry.distances(positions)[:, off]
    pairs = geometry.neighbors_and_visible(positions, world.radius, world.scan_radius)
    unsafe = np.sqrt(np.maximum(0, world.safe_distance - distance)).sum(axis=1)
    close = {
        "C1": 1 - np.linalg.norm(positions, axis=2).mean(axis=1) / diagonal,
        "C2": 1 - distance.mean(axis=1) / (2 * diagonal),
    }[objective]
    safety = 1 - unsafe / (robots * np.sqrt(world.safe_distance))
    shares = [flags[:, off].mean(axis=1) for flags in pairs]
    return dict(zip(SIGNALS[objective], (close, safety, *shares), strict=True))


def training(policies, objective, rng):
    curves, steps = [], 0
    for policy in range(policies):
        updates = np.arange(80 if policy == 0 else 50)
        first = [0.85, 0.9, 0.97, 0.72] if policy else [0.55, 0.9, 0.3, 0.25]
        last = [0.86, 0.95, 0.99, 0.8 + 0.06 * policy]
        rise = (1 - np.exp(-updates / 12))[:, None]
        values = first + (np.array(last) - first) * rise + rng.normal(0, 0.006, (len(updates), 4))
        name = ("base", "auxiliary", "auxiliary 2", "auxiliary 3")[policy]
        signals = dict(zip(SIGNALS[objective], values.T, strict=True))
        curves.append(plots.TrainingCurve(name, steps + 16384.0 * (updates + 1), signals))
        steps += 16384 * len(updates)
    return tuple(curves)


def trajectories(policies, objective, world, episodes, rng):
    robots = world.robots
    goals = [ring(robots, (1, robots // 2 + 1))] + [ring(robots)] * (policies > 1)
    goals += [ring(robots, size=8.5 + extra) for extra in range(1, policies - 1)]
    paths, switch = [], []
    for _ in range(episodes):
        path, ends = [start(robots, rng)], []
        for goal in goals:
            steps = int(np.ceil(np.abs(goal - path[-1]).max() / world.max_speed)) + int(rng.integers(2, 12))
            shares = 1 - (1 - np.arange(1, steps + 1) / steps) ** 1.3
            path += list(path[-1] + shares[:, None, None] * (goal - path[-1]))
            ends.append(len(path) - 1)
        path += [path[-1]] * RestRule().window
        paths.append(path)
        switch.append(ends[:-1])
    longest = max(len(path) for path in paths)
    positions = np.array([path + [path[-1]] * (longest - len(path)) for path in paths])
    signals = [signals_of(path, world, objective) for path in positions]
    return Trajectories(
        positions=positions.astype(np.float32),
        lengths=np.array([len(path) - 1 for path in paths]),
        switch=np.array(switch, int).reshape(episodes, policies - 1),
        at_rest=np.ones(episodes, bool),
        terminated=np.zeros(episodes, bool),
        signals={name: np.stack([values[name] for values in signals]) for name in SIGNALS[objective]},
        epochs=np.zeros(episodes, int),
        after_rest=np.zeros((episodes, 0, robots, 2), np.float32),
    )


def make_recording(*, policies=2, objective="C1", episodes=5, name="C"):
    rng = np.random.default_rng(0)
    config = replace(preset("C" if objective == "C1" else "F"), name=name)
    arrays = trajectories(policies, objective, config.world, episodes, rng)
    return plots.Recording(config, arrays, training(policies, objective, rng))


def change(recording, **arrays):
    """Returns a recording with some arrays of its trajectories replaced."""
    return replace(recording, trajectories=replace(recording.trajectories, **arrays))


@pytest.fixture(scope="session", name="make_recording")
def _make_recording():
    return make_recording


@pytest.fixture(scope="session", name="change")
def _change():
    return change


@pytest.fixture(scope="session")
def recording():
    return make_recording()


def check_labels(figure):
    """Asserts that all words outside of legends lie on the page and none on others; returns how many there are."""
    FigureCanvasAgg(figure).draw()
    texts = [text for ax in figure.axes for text in (*ax.texts, ax.title, ax.xaxis.label, ax.yaxis.label)]
    boxes = [text.get_window_extent() for text in (*figure.texts, *texts) if text.get_text()]
    boxes = [box for box in boxes if box.width > 0]
    for index, box in enumerate(boxes):
        assert min(box.x0, box.y0) >= 0
        assert box.x1 <= figure.bbox.width
        assert box.y1 <= figure.bbox.height
        assert not any(box.overlaps(other) for other in boxes[index + 1 :])
    return len(boxes)


@pytest.fixture(scope="session", name="check_labels")
def _check_labels():
    return check_labels
