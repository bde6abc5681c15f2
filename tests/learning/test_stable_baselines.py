"""The same small problem, the same numbers: our PPO and Stable-Baselines3's learn it equally fast and equally well.

Stable-Baselines3 brings PyTorch along, so it belongs to no extra. In an environment of its own:

    pip install stable-baselines3 -e '.[dev]'
    pytest tests/learning/test_stable_baselines.py -m slow -s
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import probes
import pytest

from murmurate.learning import Hyperparameters, PPOConfig, Shape, init, train_chunk
from murmurate.policies import Gaussian
from murmurate.policies.layers import Dense

stable_baselines3 = pytest.importorskip("stable_baselines3")
gymnasium = pytest.importorskip("gymnasium")

# The warnings of another project are not ours to mend.
pytestmark = [pytest.mark.nightly, pytest.mark.filterwarnings("default")]

SEEDS = range(5)
HORIZON = 16
WIDTHS = (32, 32)
LOG_STD = -0.5
CHECKS = (8, 40)
"""Updates after which the policies are compared: while they still improve, and when they have."""

NUMBERS = PPOConfig(
    updates=CHECKS[-1],
    worlds=16,
    steps=64,
    epochs=5,
    minibatches=8,
    policy_rate=1e-3,
    policy_rate_end=1e-3,
    value_rate=1e-3,
    value_rate_end=1e-3,
    reward_scale=1.0,
)


def advance(xp, position, action):
    """A point in the plane takes a step of up to a quarter along each axis and pays its distance from the origin."""
    after = position + 0.25 * xp.clip(action, -1, 1)
    return after, -xp.sqrt(xp.sum(after**2, axis=-2))


def mean_return(act):
    """The mean undiscounted return of a deterministic policy from 256 fixed starts; positions are (2, starts)."""
    position = np.random.default_rng(0).uniform(-1.5, 1.5, (2, 256)).astype(np.float32)
    total = 0.0
    for _ in range(HORIZON):
        position, reward = advance(np, position, act(position))
        total += reward.mean()
    return float(total)


class Plane(eqx.Module):
    """The problem for our PPO: positions are (1, 2, batch), and the reward of the one agent is the whole reward."""

    def reset_batch(self, key, batch):
        position = jax.random.uniform(key, (1, 2, batch), minval=-1.5, maxval=1.5)
        return position, jnp.zeros(batch, jnp.int32)

    def step(self, state, action):
        position, age = state
        after, reward = advance(jnp, position, action)
        truncated = age + 1 >= HORIZON
        return (after, age + 1), probes.transition(reward[0], jnp.zeros_like(truncated), truncated, {})

    def observe(self, state):
        return state[0]


class GymPlane(gymnasium.Env):
    """The problem for Stable-Baselines3; positions are (2,)."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.position = self.np_random.uniform(-1.5, 1.5, 2).astype(np.float32)
        self.age = 0
        return self.position, {}

    def step(self, action):
        after, reward = advance(np, self.position[:, None], action[:, None])
        self.position, self.age = after[:, 0], self.age + 1
        return self.position, float(reward[0]), False, self.age >= HORIZON, {}


class Network(eqx.Module):
    """Two tanh layers, initialised as Stable-Baselines3 does."""

    layers: tuple[Dense, ...]
    head: Dense

    def __init__(self, out, gain, key):
        *keys, last = jax.random.split(key, len(WIDTHS) + 1)
        sizes = (2, *WIDTHS)
        self.layers = tuple(Dense(i, o, k, gain=2**0.5) for i, o, k in zip(sizes[:-1], WIDTHS, keys, strict=True))
        self.head = Dense(WIDTHS[-1], out, last, gain=gain)

    def __call__(self, position):
        x = position[0]
        for layer in self.layers:
            x = jnp.tanh(layer(x))
        return self.head(x)


class Policy(eqx.Module):
    """Normal actions around a network's."""

    mean: Network
    log_std: jax.Array

    def distribution(self, position):
        return Gaussian(self.mean(position)[None], self.log_std, joint=True)


def ours(seed):
    """Mean returns of our PPO's policy, before learning and at each check."""
    first, second, reset, key = jax.random.split(jax.random.key(seed), 4)
    env = Plane()
    policy = Policy(Network(2, 0.01, first), jnp.full((1, 2, 1), LOG_STD))
    state = init(policy, Network(1, 1.0, second), env.reset_batch(reset, NUMBERS.worlds), key)
    returns, done = [], 0
    for check in (0, *CHECKS):
        if check > done:
            hyper, shape = Hyperparameters.from_config(NUMBERS), Shape.from_config(NUMBERS)
            state, _ = train_chunk(state, env, hyper, shape, check - done)
        mean, done = eqx.filter_jit(state.policy.mean), check
        returns.append(mean_return(lambda position, mean=mean: np.asarray(mean(position[None]))))
    return returns


def theirs(seed):
    """The same of Stable-Baselines3's."""
    worlds = stable_baselines3.common.env_util.make_vec_env(GymPlane, NUMBERS.worlds, seed=seed)
    model = stable_baselines3.PPO(
        "MlpPolicy",
        worlds,
        learning_rate=NUMBERS.policy_rate,
        n_steps=NUMBERS.steps,
        batch_size=NUMBERS.worlds * NUMBERS.steps // NUMBERS.minibatches,
        n_epochs=NUMBERS.epochs,
        gamma=NUMBERS.discount,
        gae_lambda=NUMBERS.gae_lambda,
        clip_range=NUMBERS.clip,
        max_grad_norm=NUMBERS.max_gradient,
        policy_kwargs={"net_arch": {"pi": list(WIDTHS), "vf": list(WIDTHS)}, "log_std_init": LOG_STD},
        seed=seed,
        device="cpu",
    )
    returns, done = [], 0
    for check in (0, *CHECKS):
        if check > done:
            model.learn((check - done) * NUMBERS.worlds * NUMBERS.steps, reset_num_timesteps=False)
        done = check
        returns.append(mean_return(lambda position: model.predict(position.T, deterministic=True)[0].T))
    return returns


def test_both_learn_alike():
    """At each check the means over the seeds differ by no more than the seeds themselves do."""
    our, their = (np.array([learner(seed) for seed in SEEDS]) for learner in (ours, theirs))
    for column, updates in enumerate((0, *CHECKS)):
        for name, returns in (("murmurate", our), ("Stable-Baselines3", their)):
            each = " ".join(f"{value:.3f}" for value in returns[:, column])
            mean, spread = returns[:, column].mean(), returns[:, column].std(ddof=1)
            print(f"{updates:3d} updates, {name:17s}: {each}   mean {mean:.3f}, standard deviation {spread:.3f}")
    spread = np.maximum(our.std(axis=0, ddof=1), their.std(axis=0, ddof=1))
    assert (np.abs(our.mean(axis=0) - their.mean(axis=0)) <= 2 * spread)[1:].all()
    # And what they agree on is success.
    assert (our[:, -1] > 0.5 * our[:, 0]).all()
    assert (their[:, -1] > 0.5 * their[:, 0]).all()
