"""Stable-Baselines3's PPO and ours on the same world, by the clock.

python -m benchmarks.stable_baselines (needs `pip install "murmurate[gymnasium,sb3]"`, which brings PyTorch)

Four robots gather at the origin from random starts. Both learn by the same reward, in episodes of the same length, with
a tanh network over all positions of two layers of 64, each with its own project's usual numbers otherwise. A return is
the mean over 200 starts that neither trains on, of the most likely action. Compiling counts, looking does not.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator

import gymnasium
import jax.numpy as jnp
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

from murmurate.discovery import Search
from murmurate.interop.gymnasium import ENV_ID
from murmurate.runs import presets
from murmurate.world import WorldConfig, scaled_to

ROBOTS, HORIZON, STARTS = 4, 150, 200
OPTIONS = {"robots": ROBOTS, "objective": "C1", "horizon": HORIZON, "start": "random"}

Act = Callable[[np.ndarray], np.ndarray]
Row = tuple[int, float, float, float]


def judged(act: Act, seed: int = 12345) -> tuple[float, float]:
    """Returns the mean return, and the share of swarms that end mutually visible without having touched."""
    # What has ended begins anew and no longer counts.
    env = gymnasium.make_vec(ENV_ID, STARTS, vectorization_mode="vector_entry_point", **OPTIONS)
    positions, _ = env.reset(seed=seed)
    total, alive, seen = np.zeros(STARTS), np.ones(STARTS, bool), np.zeros(STARTS, bool)
    for _ in range(HORIZON):
        positions, reward, terminated, truncated, info = env.step(act(positions))
        total += alive * reward
        seen = np.where(alive, info["visible"] > 1 - 1e-6, seen)
        alive &= ~terminated
        if not alive.any() or truncated.any():
            break
    env.close()
    return float(total.mean()), float((alive & seen).mean())


def train_stable_baselines(steps: int, chunks: int, seed: int) -> Iterator[Row]:
    """Trains with Stable-Baselines3; yields steps, seconds, return and share as it goes."""
    env = VecNormalize(make_vec_env(ENV_ID, n_envs=8, seed=seed, env_kwargs=OPTIONS))
    layers = {"net_arch": [64, 64]}
    model = PPO("MlpPolicy", env, n_steps=256, batch_size=256, seed=seed, policy_kwargs=layers, device="cpu")

    def act(positions: np.ndarray) -> np.ndarray:
        return model.predict(env.normalize_obs(positions), deterministic=True)[0]

    seconds = 0.0
    for _ in range(chunks):
        begun = time.perf_counter()
        model.learn(steps // chunks, reset_num_timesteps=False)
        seconds += time.perf_counter() - begun
        yield model.num_timesteps, seconds, *judged(act)


def train_murmurate(updates: int, seed: int) -> Iterator[Row]:
    """Trains with `murmurate.learning`; yields the same."""
    world = scaled_to(WorldConfig(), ROBOTS)
    sizes = {name: getattr(world, name) for name in ("robots", "half_width", "half_height", "scan_radius")}
    stage = {"horizon": HORIZON, "repeat": 1, "ppo": {"updates": updates}, "weights": {"visible": 1.0}}
    fields = {
        "objective": "C1",
        "world": sizes,
        "start": {"use": "random"},
        "policy": {"use": "central", "hidden": [64, 64]},
        "base": stage,
        "seed": seed,
        "discovery": {"min_policies": 1, "max_policies": 1, "chunk": 10},
    }
    search = Search(presets.resolve("C", fields))
    snapshot, seconds, policy = search.begin(), 0.0, None

    def act(positions: np.ndarray) -> np.ndarray:
        assert policy is not None
        return np.moveaxis(np.asarray(policy(jnp.moveaxis(jnp.asarray(positions), 0, -1))), -1, 0) / world.max_speed

    while not snapshot.policies:
        begun = time.perf_counter()
        snapshot, rows = search.advance(snapshot)
        policy = snapshot.train.policy if snapshot.train is not None else snapshot.policies[0]
        float(policy.log_std.sum())  # waits for the end of the work
        seconds += time.perf_counter() - begun
        yield rows[-1]["policy_steps"], seconds, *judged(act)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=1_000_000, help="environment steps of Stable-Baselines3")
    parser.add_argument("--updates", type=int, default=100, help="updates of ours")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print("| learner | environment steps | seconds | return | mutually visible, untouched |")
    print("| --- | ---: | ---: | ---: | ---: |")
    runs = {
        "murmurate": train_murmurate(options.updates, options.seed),
        "Stable-Baselines3": train_stable_baselines(options.steps, 10, options.seed),
    }
    for name, rows in runs.items():
        for steps, seconds, reward, share in rows:
            print(f"| {name} | {steps:,} | {seconds:.0f} | {reward:+.3f} | {share:.1%} |", flush=True)


if __name__ == "__main__":
    main()
