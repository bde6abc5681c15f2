"""A run folder made up for the pictures: robots walk from two corners to a ring, the last policies push it open."""

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from murmurate import geometry

SIGNALS = {"C1": ("close", "safety", "neighbors", "visible"), "C2": ("nclose", "safety", "neighbors", "visible")}
WORLD = {
    "half_width": 45.0,
    "half_height": 45.0,
    "radius": 1.0,
    "scan_radius": 20.0,
    "safe_distance": 5.0,
    "max_speed": 1.0,
}


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
    robots, diagonal = positions.shape[1], np.hypot(world["half_width"], world["half_height"])
    off = ~np.eye(robots, dtype=bool)
    distance = geometry.distances(positions)[:, off]
    flags = geometry.neighbors_and_visible(positions, world["radius"], world["scan_radius"])
    unsafe = np.sqrt(np.maximum(0, world["safe_distance"] - distance)).sum(axis=1)
    close = {
        "C1": 1 - np.linalg.norm(positions, axis=2).mean(axis=1) / diagonal,
        "C2": 1 - distance.mean(axis=1) / (2 * diagonal),
    }[objective]
    safety = 1 - unsafe / (robots * np.sqrt(world["safe_distance"]))
    return np.stack([close, safety, *(pairs[:, off].mean(axis=1) for pairs in flags)], axis=-1)


def metrics(policies, objective, rng):
    rows, steps = [], 0
    for policy in range(policies):
        for update in range(80 if policy == 0 else 50):
            steps += 16384
            rise = 1 - np.exp(-update / 12)
            levels = np.array([[0.55, 0.9, 0.3, 0.25], [0.86, 0.95, 0.99, 0.8 + 0.06 * policy]])
            if policy:
                levels[0] = [0.85, 0.9, 0.97, 0.72]
            values = levels[0] + (levels[1] - levels[0]) * rise + rng.normal(0, 0.006, 4)
            rows.append(
                {
                    "policy": policy,
                    "name": ("base", "auxiliary", "auxiliary 2", "auxiliary 3")[policy],
                    "update": update,
                    "environment_steps": steps,
                    "reward": 0.01,
                    "objective": float(values.sum()),
                    "signals": dict(zip(SIGNALS[objective], values.tolist(), strict=True)),
                }
            )
    return rows


def trajectories(policies, objective, world, robots, episodes, rng):
    goals = [ring(robots, (1, robots // 2 + 1))] + [ring(robots)] * (policies > 1)
    goals += [ring(robots, size=8.5 + extra) for extra in range(1, policies - 1)]
    paths, switch = [], []
    for _ in range(episodes):
        path, ends = [start(robots, rng)], []
        for goal in goals:
            steps = int(np.ceil(np.abs(goal - path[-1]).max() / world["max_speed"])) + int(rng.integers(2, 12))
            shares = 1 - (1 - np.arange(1, steps + 1) / steps) ** 1.3
            path += list(path[-1] + shares[:, None, None] * (goal - path[-1]))
            ends.append(len(path) - 1)
        paths.append(path)
        switch.append(ends[:-1])
    longest = max(len(path) for path in paths)
    positions = np.array([path + [path[-1]] * (longest - len(path)) for path in paths])
    signals = np.array([signals_of(path, world, objective) for path in positions])
    return {
        "positions": positions.astype(np.float32),
        "lengths": np.array([len(path) - 1 for path in paths], np.int32),
        "switch": np.array(switch, np.int32).reshape(episodes, policies - 1),
        "objective": signals.sum(-1).astype(np.float32),
        "signals": signals.astype(np.float32),
        "signal_names": np.array(SIGNALS[objective]),
        "at_rest": np.ones(episodes, bool),
    }


def make_run(folder, *, policies=2, objective="C1", robots=10, episodes=5, name="C", kind="distributed", **sizes):
    """Writes a run folder."""
    folder, rng = Path(folder), np.random.default_rng(0)
    folder.mkdir(parents=True, exist_ok=True)
    world = WORLD | sizes
    arrays = trajectories(policies, objective, world, robots, episodes, rng)
    table = "\n".join(f"{key} = {value}" for key, value in (world | {"robots": robots}).items())
    (folder / "experiment.toml").write_text(
        f'name = "{name}"\nobjective = "{objective}"\nseed = 0\n[world]\n{table}\n[start]\nkind = "{kind}"\n'
    )
    evaluation = {"experiment": name, "robots": robots, "episodes": episodes, "valid": 1.0}
    (folder / "evaluation.json").write_text(json.dumps(evaluation))
    rows = metrics(policies, objective, rng)
    (folder / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    np.savez_compressed(folder / "trajectories.npz", **arrays)
    return folder


@pytest.fixture(scope="session", name="make_run")
def _make_run():
    return make_run


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("runs") / "C")


def check_labels(figure):
    """Asserts that all words outside of legends lie on the page and none on others; returns how many there are."""
    FigureCanvasAgg(figure).draw()
    texts = [text for ax in figure.axes for text in (*ax.texts, ax.title, ax.xaxis.label, ax.yaxis.label)]
    boxes = [text.get_window_extent() for text in (*figure.texts, *texts) if text.get_text()]
    boxes = [box for box in boxes if box.width > 0]
    for place, box in enumerate(boxes):
        assert min(box.x0, box.y0) >= 0
        assert box.x1 <= figure.bbox.width
        assert box.y1 <= figure.bbox.height
        assert not any(box.overlaps(other) for other in boxes[place + 1 :])
    return len(boxes)


@pytest.fixture(scope="session", name="check_labels")
def _check_labels():
    return check_labels
