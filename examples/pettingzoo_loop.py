"""Robots as agents of their own: each goes to the landmark, and away from whom it comes too near.

`python examples/pettingzoo_loop.py`.
"""

from __future__ import annotations

import numpy as np

from murmurate.interop.pettingzoo import parallel_env
from murmurate.world import VisibleSensing

COMFORTABLE = 6.0
"""Distance that a robot likes to keep, world units."""


def velocity(rows: np.ndarray) -> np.ndarray:
    """Decides on what one robot perceives, in its own frame: `x, y, 1` for each robot seen, and for the landmark."""
    others, landmark = rows[:-1], rows[-1, :2]
    wish = landmark / max(np.linalg.norm(landmark), 1.0)
    for x, y, seen in others:
        distance = np.hypot(x, y)
        if seen and distance < COMFORTABLE:
            wish -= (COMFORTABLE / distance - 1) * np.array([x, y]) / distance
    return wish.astype(np.float32)


def main(robots: int = 6, horizon: int = 200, seed: int = 0) -> float:
    """Plays one episode; returns the reward that all agents shared."""
    # Nobody knows where north is, and who is hidden is not seen.
    sensing = VisibleSensing(rotation=True)
    env = parallel_env(robots=robots, objective="C1", sensing=sensing, horizon=horizon)
    observations, infos = env.reset(seed=seed)
    total, steps = 0.0, 0
    while env.agents:
        actions = {agent: velocity(observations[agent]) for agent in env.agents}
        observations, rewards, _, _, infos = env.step(actions)
        total, steps = total + rewards["robot_0"], steps + 1
    env.close()
    signals = ", ".join(f"{name} {value:.2f}" for name, value in infos["robot_0"].items())
    print(f"{steps} steps, reward {total:+.3f}; at the end {signals}")
    return total


if __name__ == "__main__":
    main()
