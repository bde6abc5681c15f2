"""Stable-Baselines3's PPO on the Gymnasium environment; needs `pip install "murmurate[gymnasium,sb3]"`."""

from __future__ import annotations

import sys

try:
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.evaluation import evaluate_policy
    from stable_baselines3.common.vec_env import VecNormalize

    from murmurate.interop.gymnasium import ENV_ID
except ModuleNotFoundError as error:  # the extra is not installed
    print(f'stable_baselines3_ppo.py: {error}; pip install "murmurate[gymnasium,sb3]"', file=sys.stderr)
    sys.exit(2)


def main(robots: int = 4, steps: int = 200_000, envs: int = 8, horizon: int = 150, seed: int = 0) -> float:
    """Trains; returns the mean reward of an episode afterwards."""
    options = {"robots": robots, "objective": "C1", "horizon": horizon}
    env = VecNormalize(make_vec_env(ENV_ID, n_envs=envs, seed=seed, env_kwargs=options))
    model = PPO("MlpPolicy", env, n_steps=256, batch_size=256, seed=seed, verbose=1)
    model.learn(total_timesteps=steps)
    env.training, env.norm_reward = False, False
    mean, deviation = evaluate_policy(model, env, n_eval_episodes=20)
    print(f"reward of an episode: {mean:+.3f} +- {deviation:.3f}")
    return float(mean)


if __name__ == "__main__":
    main()
