"""The environments inside the wrappers of other packages; each test is skipped where its package is missing."""

from __future__ import annotations

import numpy as np
import pytest
from by_hand import SWARM, TRIANGLE
from gymnasium.vector import AutoresetMode

import murmurate.interop.gymnasium as adapter
from murmurate.interop.pettingzoo import parallel_env

# Their own warnings are not ours.
pytestmark = pytest.mark.filterwarnings("ignore")

HORIZON = 3
NAMES = ["robot_0", "robot_1", "robot_2"]
STILL = np.zeros(2, np.float32)


def make():
    return parallel_env(**SWARM, horizon=HORIZON)


def begin(env):
    return env.reset(seed=0, options={"positions": TRIANGLE})


def observed_until_after_the_end(env):
    """Returns how many agents observe something after each of several steps, past the end of the episode."""
    begin(env)
    return [len(env.step(dict.fromkeys(env.agents, STILL))[0]) for _ in range(HORIZON + 2)]


@pytest.mark.parametrize("name", ["frame_stack_v1", "flatten_v0", "pad_observations_v0", "dtype_v0"])
def test_supersuit_wraps_what_agents_observe(name):
    supersuit = pytest.importorskip("supersuit")
    arguments = {"frame_stack_v1": [2], "dtype_v0": [np.float64]}.get(name, [])
    wrapped = getattr(supersuit, name)(make(), *arguments)
    assert observed_until_after_the_end(wrapped) == [3, 3, 3, 0, 0]
    observations, _ = begin(wrapped)
    for agent in NAMES:
        assert wrapped.observation_space(agent).contains(observations[agent])


def test_supersuit_keeps_agents_for_a_step_after_their_end():
    supersuit = pytest.importorskip("supersuit")
    assert observed_until_after_the_end(supersuit.black_death_v3(make())) == [3, 3, 3, 3, 0]


@pytest.mark.parametrize("black_death", [False, True])
def test_supersuit_makes_a_vector_environment_of_the_agents(black_death):
    supersuit = pytest.importorskip("supersuit")
    env = supersuit.black_death_v3(make()) if black_death else make()
    vector = supersuit.pettingzoo_env_to_vec_env_v1(env)
    vectors = supersuit.concat_vec_envs_v1(vector, 2, num_cpus=0, base_class="gymnasium")
    observations, _ = vectors.reset(seed=0)
    assert observations.shape == (6, *env.observation_space("robot_0").shape)
    ended = [vectors.step(np.zeros((6, 2), np.float32))[3].all() for _ in range(2 * HORIZON + 2)]
    # With black_death_v3 agents end one step after the episode, when they have left.
    period = HORIZON + black_death
    assert ended == [(step + 1) % period == 0 for step in range(len(ended))]
    vectors.close()


def test_torchrl_collects_episodes_of_the_agents():
    pytest.importorskip("torchrl")
    from torchrl.envs import PettingZooWrapper
    from torchrl.envs.utils import check_env_specs

    env = PettingZooWrapper(make(), use_mask=True)
    assert env.group_map == {"robot": NAMES}
    check_env_specs(env)
    rollout = env.rollout(2 * HORIZON, break_when_any_done=False)
    done = rollout["next", "robot", "done"][..., 0].numpy()
    assert (done == done[:, :1]).all()
    assert done[:HORIZON].any()
    assert done[HORIZON:].any()
    # Agents have left after the end, and the next episode begins with all of them.
    assert (rollout["next", "robot", "mask"].numpy() == ~done).all()
    assert rollout["robot", "mask"].all()
    assert rollout["next", "robot", "observation"].shape == (6, 3, 3, 3)


def test_torchrl_collects_episodes_of_many_worlds():
    pytest.importorskip("torchrl")
    from torchrl.envs import GymWrapper
    from torchrl.envs.utils import check_env_specs

    # TorchRL refuses NEXT_STEP, Gymnasium's default.
    env = GymWrapper(adapter.GatheringVectorEnv(2, **SWARM, horizon=HORIZON, autoreset_mode=AutoresetMode.SAME_STEP))
    check_env_specs(env)
    done = env.rollout(2 * HORIZON, break_when_any_done=False)["next", "done"][..., 0]
    assert done.shape == (2, 6)
    assert done[:, :HORIZON].any(dim=1).all()
    assert done[:, HORIZON:].any(dim=1).all()


@pytest.mark.nightly
def test_rllib_steps_the_agents():
    wrappers = pytest.importorskip("ray.rllib.env.wrappers.pettingzoo_env", exc_type=ImportError)
    env = wrappers.ParallelPettingZooEnv(make())
    assert (set(env.agents), set(env.possible_agents)) == (set(NAMES), set(NAMES))
    observations, _ = env.reset(seed=0, options={"positions": TRIANGLE})
    assert list(observations) == NAMES
    for step in range(HORIZON):
        observations, rewards, _, truncated, _ = env.step(dict.fromkeys(NAMES, STILL))
        assert list(observations) == list(rewards) == NAMES
        assert truncated["__all__"] == (step == HORIZON - 1)
    assert env.step({})[0] == {}


@pytest.mark.nightly
def test_rllib_collects_episodes():
    pytest.importorskip("ray.rllib.env.wrappers.pettingzoo_env", exc_type=ImportError)
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.connectors.env_to_module import FlattenObservations
    from ray.rllib.env.multi_agent_env_runner import MultiAgentEnvRunner
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
    from ray.tune.registry import register_env

    register_env("murmurate", lambda config: ParallelPettingZooEnv(make()))
    config = (
        PPOConfig().environment("murmurate").multi_agent(policies={"all"}, policy_mapping_fn=lambda *_, **__: "all")
    )
    # RLlib's own networks take no matrices.
    config.env_runners(env_to_module_connector=lambda *_, **__: FlattenObservations(multi_agent=True))
    runner = MultiAgentEnvRunner(config=config)
    episodes = runner.sample(num_episodes=2, random_actions=True)
    assert len(episodes) == 2
    assert all(set(episode.agent_ids) == set(NAMES) and episode.is_done for episode in episodes)
    assert all(1 <= len(episode) <= HORIZON for episode in episodes)
    runner.stop()
