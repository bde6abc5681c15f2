"""Other projects in the same run, where they are installed: nothing here needs them, nothing is copied from them."""

from __future__ import annotations

import importlib
import importlib.util
import logging
from collections.abc import Callable, Sequence
from typing import Any

import jax

from benchmarks.measure import Case

__all__ = ["JAXMARL", "PART", "SB3", "VMAS", "peer_cases"]

PART = "peer"
JAXMARL = "JaxMARL MPE_simple_spread_v3"
VMAS = "VMAS dispersion"
SB3 = "Stable-Baselines3 PPO on murmurate/Gathering-v0"
AGENTS = 10
SHARE = 20
"""VMAS takes so many times fewer steps a run: PyTorch goes from one operation to the next."""


def peer_cases(worlds: Sequence[int], steps: int) -> list[Case]:
    """Returns the cases of what is installed.

    Args:
        worlds: Numbers of worlds that step side by side.
        steps: Steps of a run.
    """
    cases = []
    for count in worlds:
        if _installed("jaxmarl"):
            cases.append(_jaxmarl(count, steps))
        if _installed("vmas"):
            cases.append(_vmas(count, max(steps // SHARE, 2)))
    if _installed("stable_baselines3") and _installed("gymnasium"):
        cases.append(_stable_baselines())
    return cases


def _installed(package: str) -> bool:
    return importlib.util.find_spec(package) is not None


def _jaxmarl(worlds: int, steps: int) -> Case:
    """JaxMARL's simple spread, vectorised over worlds; a step begins ended episodes anew."""

    def prepare() -> Callable[[], Any]:
        env = importlib.import_module("jaxmarl").make("MPE_simple_spread_v3", num_agents=AGENTS)
        keys = jax.random.split(jax.random.key(0), (steps, worlds))
        actions = jax.random.randint(jax.random.key(1), (steps, env.num_agents, worlds), 0, 5)
        state = jax.jit(jax.vmap(env.reset))(keys[0])[1]

        def step(state: Any, now: tuple[Any, Any]) -> tuple[Any, Any]:
            key, action = now
            by_agent = dict(zip(env.agents, action, strict=True))
            # Its observations are not asked for, so XLA leaves them out: to JaxMARL's advantage.
            _, state, reward, done, _ = jax.vmap(env.step)(key, state, by_agent)
            return state, (reward, done["__all__"])

        run = jax.jit(lambda state, keys, actions: jax.lax.scan(step, state, (keys, actions)))
        return lambda: run(state, keys, actions)

    return Case(PART, JAXMARL, worlds * steps, prepare, AGENTS, worlds)


def _vmas(worlds: int, steps: int) -> Case:
    """VMAS's dispersion: agents are points among pieces of food, without collisions; observations come with a step."""

    def prepare() -> Callable[[], Any]:
        torch = importlib.import_module("torch")
        # It warns that a renderer is missing, which is not needed.
        logging.disable(logging.WARNING)
        vmas = importlib.import_module("vmas")
        logging.disable(logging.NOTSET)
        device = "cuda" if jax.default_backend() == "gpu" else "cpu"
        env = vmas.make_env("dispersion", num_envs=worlds, device=device, seed=0, n_agents=AGENTS)
        env.reset()
        actions = 2 * torch.rand(steps, AGENTS, worlds, 2, device=device) - 1

        def run() -> float:
            total = 0.0
            for action in actions:
                total = env.step(list(action))[1][0].sum()
            return float(total)  # waits for the device

        return run

    return Case(PART, VMAS, worlds * steps, prepare, AGENTS, worlds)


def _stable_baselines() -> Case:
    """Its PPO on our Gymnasium environment, eight of them one after another in one process: one update a run."""
    envs, rollout = 8, 64

    def prepare() -> Callable[[], Any]:
        environments = importlib.import_module("murmurate.interop.gymnasium")
        ppo = importlib.import_module("stable_baselines3").PPO
        make = importlib.import_module("stable_baselines3.common.env_util").make_vec_env
        env = make(environments.ENV_ID, n_envs=envs, seed=0, env_kwargs={"robots": AGENTS, "objective": "C1"})
        model = ppo("MlpPolicy", env, n_steps=rollout, batch_size=256, seed=0, device="cpu")

        def run() -> int:
            model.learn(rollout * envs, reset_num_timesteps=False)
            return model.num_timesteps

        return run

    return Case(PART, SB3, rollout * envs, prepare, AGENTS, envs)
