"""Runs an exported cascade with NumPy and onnxruntime alone: `murmurate export RUN --onnx --out swarm.onnx`."""

from __future__ import annotations

import sys
from typing import NoReturn

import numpy as np

try:
    import onnxruntime
except ModuleNotFoundError as error:  # the extra is not installed
    print(f'onnx_robots.py: {error}; pip install "murmurate[onnx]"', file=sys.stderr)
    sys.exit(2)


def fail(message: str) -> NoReturn:
    """Ends the program with one line."""
    print(f"onnx_robots.py: {message}", file=sys.stderr)
    sys.exit(2)


def open_model(path: str) -> onnxruntime.InferenceSession:
    """Opens the model of a cascade."""
    try:
        session = onnxruntime.InferenceSession(path)
    except Exception as error:  # onnxruntime has an exception of its own for everything that is wrong with a file
        fail(" ".join(f"cannot open {path}: {error}".split()))
    if [each.name for each in session.get_inputs()] != ["positions", "memory"]:
        fail(f"{path} is no model of a cascade: export one without --policy, of robots that know all positions")
    return session


def main(path: str, robots: int | None = None, spacing: float = 6.0, max_steps: int = 3000) -> np.ndarray:
    """Runs a swarm from a grid until it is at rest; returns its positions, `(robots, 2)`, world units."""
    session = open_model(path)
    about = session.get_modelmeta().custom_metadata_map
    robots, policies = int(about["robots"]) if robots is None else robots, len(about["policies"].split(","))
    smallest, largest = (int(about.get(name, about["robots"])) for name in ("smallest_swarm", "largest_swarm"))
    if not smallest <= robots <= largest:
        fail(f"{path} is for swarms of {smallest if smallest == largest else f'{smallest} to {largest}'} robots")
    grid = np.stack(np.meshgrid(*2 * [np.arange(np.ceil(np.sqrt(robots)))]), axis=-1).reshape(-1, 2)[:robots]
    noise = np.random.default_rng(0).uniform(-1, 1, grid.shape)
    positions = (spacing * (grid - grid.mean(axis=0)) + noise).astype(np.float32)[None]  # a batch of one swarm
    memory = np.zeros((1, session.get_inputs()[1].shape[1]), np.float32)
    for step in range(max_steps):
        velocities, memory = session.run(None, {"positions": positions, "memory": memory})
        if memory[0, 0] == policies:  # the last policy has brought the swarm to rest
            print(f"{robots} robots at rest after {step} steps")
            break
        positions = positions + velocities
    return positions[0]


if __name__ == "__main__":
    try:
        path, robots = sys.argv[1], [int(word) for word in sys.argv[2:3]]
    except (IndexError, ValueError):
        print("usage: python examples/onnx_robots.py MODEL.onnx [ROBOTS]", file=sys.stderr)
        sys.exit(2)
    print(main(path, *robots))
