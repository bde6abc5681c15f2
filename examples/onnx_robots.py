"""Runs an exported cascade with NumPy and onnxruntime alone: `murmurate export RUN --onnx --out swarm.onnx`."""

from __future__ import annotations

import sys

import numpy as np

try:
    import onnxruntime
except ModuleNotFoundError as error:  # the extra is not installed
    print(f'onnx_robots.py: {error}; pip install "murmurate[onnx]"', file=sys.stderr)
    sys.exit(2)


def main(path: str, robots: int | None = None, spacing: float = 6.0, max_steps: int = 3000) -> np.ndarray:
    """Runs a swarm from a grid until it is at rest; returns its positions, `(robots, 2)`, world units."""
    session = onnxruntime.InferenceSession(path)
    about = session.get_modelmeta().custom_metadata_map
    robots, policies = robots or int(about["robots"]), len(about["policies"].split(","))
    if robots > int(about.get("largest_swarm", robots)):
        sys.exit(f"{path} is for swarms of at most {about['largest_swarm']} robots")
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
