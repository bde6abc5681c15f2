"""A swarm that moves at random, as one agent of Gymnasium: `python examples/random_agent.py`."""

from __future__ import annotations

import sys

try:
    import gymnasium

    from murmurate.interop.gymnasium import ENV_ID
except ModuleNotFoundError as error:  # the extra is not installed
    print(f'random_agent.py: {error}; pip install "murmurate[gymnasium]"', file=sys.stderr)
    sys.exit(2)


def main(robots: int = 6, episodes: int = 5, horizon: int = 100, seed: int = 0) -> list[int]:
    """Plays some episodes; returns the length of each."""
    env = gymnasium.make(ENV_ID, robots=robots, objective="C2", horizon=horizon)
    env.action_space.seed(seed)
    env.reset(seed=seed)
    lengths = []
    for _ in range(episodes):
        length, total, over = 0, 0.0, False
        while not over:
            _, reward, terminated, truncated, info = env.step(env.action_space.sample())
            length, total, over = length + 1, total + float(reward), terminated or truncated
        end = "in contact or outside the world" if terminated else "at the time limit"
        print(f"{length} steps, reward {total:+.3f}, ended {end}; {info['visible']:.0%} of all pairs saw each other")
        lengths.append(length)
        env.reset()
    env.close()
    return lengths


if __name__ == "__main__":
    main()
