"""Robots as agents of their own: each goes to the landmark, and away from robots that are too near.

`python examples/pettingzoo_loop.py`.
"""

from __future__ import annotations

import sys

import numpy as np

from murmurate.world import VisibleSensing

try:
    from murmurate.interop.pettingzoo import parallel_env
except ModuleNotFoundError as error:  # the extra is not installed
    print(f"pettingzoo_loop.py: {error}", file=sys.stderr)
    sys.exit(2)

PREFERRED_DISTANCE = 6.0
"""Distance that a robot tries to keep, world units."""


def velocity(rows: np.ndarray) -> np.ndarray:
    """Returns the velocity of a robot from what it perceives: `x, y, 1` for each robot seen, and for the landmark."""
    others, landmark = rows[:-1], rows[-1, :2]
    wish = landmark / max(np.linalg.norm(landmark), 1.0)
    for x, y, seen in others:
        distance = np.hypot(x, y)
        if seen and distance < PREFERRED_DISTANCE:
            wish -= (PREFERRED_DISTANCE / distance - 1) * np.array([x, y]) / distance
    return wish.astype(np.float32)


def main(robots: int = 6, horizon: int = 200, seed: int = 0) -> float:
    """Plays one episode; returns the reward, which all agents share."""
    # Robots have no common direction, and do not see robots that are hidden by others.
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
