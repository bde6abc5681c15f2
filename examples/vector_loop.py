"""Policy gradients by hand on the vector environment, in NumPy alone: `python examples/vector_loop.py`.

Every robot has the same five weights for each component of its velocity. The swarm learns to gather at
the origin. Patterns without collisions are what `murmurate discover` is for.
"""

from __future__ import annotations

import sys

import numpy as np

try:
    import gymnasium
    from gymnasium.vector import AutoresetMode

    from murmurate.interop.gymnasium import ENV_ID
except ModuleNotFoundError as error:  # the extra is not installed
    print(f'vector_loop.py: {error}; pip install "murmurate[gymnasium]"', file=sys.stderr)
    sys.exit(2)

DEVIATION, DISCOUNT, RATE = 0.5, 0.9, 0.05


def features(positions: np.ndarray) -> np.ndarray:
    """Returns what each robot's velocity depends on: its position, the offset of its nearest neighbour, and 1."""
    offsets = positions[:, None] - positions[:, :, None]
    apart = np.linalg.norm(offsets, axis=-1) + 1e9 * np.eye(positions.shape[1])
    nearest = np.take_along_axis(offsets, apart.argmin(axis=2)[:, :, None, None], axis=2)[:, :, 0]
    closeness = np.exp(-apart.min(axis=2) / 3)[..., None]
    return np.concatenate([positions / 30, closeness * nearest / 3, np.ones_like(closeness)], axis=-1)


def rewards_to_go(rewards: np.ndarray, over: np.ndarray) -> np.ndarray:
    """Returns the discounted sums of rewards up to the end of each episode; time is the first axis."""
    total, sums = np.zeros_like(rewards[0]), np.empty_like(rewards)
    for step in reversed(range(len(rewards))):
        total = rewards[step] + DISCOUNT * np.where(over[step], 0, total)
        sums[step] = total
    return sums


def main(updates: int = 60, num_envs: int = 64, robots: int = 5, steps: int = 24, seed: int = 0) -> list[float]:
    """Trains; returns the mean reward per step at each update."""
    # A new episode begins in the step that ends the one before, so every row below is one step of one episode.
    envs = gymnasium.make_vec(ENV_ID, num_envs=num_envs, robots=robots, autoreset_mode=AutoresetMode.SAME_STEP)
    rng, weights, history = np.random.default_rng(seed), np.zeros((5, 2)), []
    observation, _ = envs.reset(seed=seed)
    for update in range(updates):
        inputs, noise, rewards, over = [], [], [], []
        for _ in range(steps):
            inputs.append(features(observation))
            noise.append(DEVIATION * rng.standard_normal(observation.shape))
            observation, reward, terminated, truncated, _ = envs.step(inputs[-1] @ weights + noise[-1])
            rewards.append(reward)
            over.append(terminated | truncated)
        gains = rewards_to_go(np.array(rewards), np.array(over))
        advantage = (gains - gains.mean()) / (gains.std() + 1e-8)
        # The gradient of the log density of a normal distribution is the noise over the variance.
        gradient = np.einsum("teri,terv,te->iv", inputs, noise, advantage) / (DEVIATION**2 * advantage.size)
        weights += RATE * gradient
        history.append(float(np.mean(rewards)))
        if update % 10 == 0:
            print(f"update {update}: reward {history[-1]:+.4f} a step, {np.mean(over):.1%} of steps ended an episode")
    envs.close()
    return history


if __name__ == "__main__":
    main()
