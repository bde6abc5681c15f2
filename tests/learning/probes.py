"""Environments whose values are known, and the smallest networks that can learn them. Nothing here is a swarm."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from murmurate.learning import Hyperparameters, PPOConfig, Shape, init, train_chunk

LONGEST = 6
"""Steps that a `Clock` can tell apart."""

traces = 0
"""How often `step` of any environment here was traced: it grows only while something compiles."""


class Step(NamedTuple):
    """A transition."""

    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array
    credit: jax.Array
    signals: dict[str, jax.Array]


def transition(reward, terminated, truncated, signals):
    # Arrays of their own, as every environment makes them: one action a step answers for the whole reward.
    return Step(reward, terminated, truncated, reward[None], signals)


class Clock(eqx.Module):
    """Pays a known reward at each step, whatever the action is, and ends after `horizon` steps.

    The state is the age; the observation too, or always 0 where the environment is not to tell (`tells` = 0).
    """

    rewards: jax.Array
    horizon: jax.Array
    terminates: jax.Array
    tells: jax.Array

    def reset_batch(self, key, batch):
        return jnp.zeros(batch, jnp.int32)

    def step(self, age, action):
        global traces
        traces += 1
        ends = age + 1 >= self.horizon
        reward = self.rewards[age] + 0 * action[0]
        return age + 1, transition(reward, ends & self.terminates, ends & ~self.terminates, {"age": age.astype(float)})

    def observe(self, age):
        return age * self.tells


def clock(rewards, terminates, tells, horizon=LONGEST):
    """A `Clock` for jit: every number is an array."""
    rewards = np.resize(np.asarray(rewards, np.float32), LONGEST + 1)
    return jax.tree.map(jnp.asarray, Clock(rewards, horizon, terminates, int(tells)))


class Line(eqx.Module):
    """A point on a line is paid for every step nearer to 0, and punished for leaving |x| <= 2, where it terminates.

    Fresh starts are unlike any other: their second coordinate numbers the call that drew them.
    """

    horizon: jax.Array
    price: jax.Array = eqx.field(default_factory=lambda: jnp.ones(()))

    def reset_batch(self, key, batch):
        return jax.random.uniform(key, (batch,), minval=-1.5, maxval=1.5), jnp.zeros(batch, jnp.int32)

    def step(self, state, action):
        global traces
        traces += 1
        x, age = state
        after = x + 0.25 * jnp.clip(action[0], -1, 1)
        terminated = jnp.abs(after) > 2
        reward = self.price * jnp.where(terminated, -1.0, jnp.abs(x) - jnp.abs(after))
        truncated = (age + 1 >= self.horizon) & ~terminated
        return (after, age + 1), transition(reward, terminated, truncated, {"distance": jnp.abs(after)})

    def observe(self, state):
        return state[0]


class Normal(NamedTuple):
    """Normal actions around a mean, `(actions, batch)`."""

    mean: jax.Array
    log_std: jax.Array

    def sample(self, key):
        return self.mean + jnp.exp(self.log_std) * jax.random.normal(key, self.mean.shape)

    def log_prob(self, action):
        z = (action - self.mean) / jnp.exp(self.log_std)
        return -0.5 * z * z - self.log_std - 0.5 * jnp.log(2 * jnp.pi)


class Linear(eqx.Module):
    """Actions from a line through the observation."""

    slope: jax.Array
    offset: jax.Array
    log_std: jax.Array

    def __call__(self, observation):
        return (self.slope * observation + self.offset)[None]

    def distribution(self, observation):
        return Normal(self(observation), self.log_std)


class Table(eqx.Module):
    """One value for each observation that is a number from 0 to `LONGEST`."""

    values: jax.Array

    def __call__(self, observation):
        return self.values[observation][None]


class Parabola(eqx.Module):
    """Values from the square of the observation."""

    curve: jax.Array
    offset: jax.Array

    def __call__(self, observation):
        return (self.curve * observation**2 + self.offset)[None]


def linear():
    return Linear(jnp.zeros(()), jnp.zeros(()), jnp.full((), -1.0))


def table():
    return Table(jnp.zeros(LONGEST + 1))


def parabola():
    return Parabola(jnp.zeros(()), jnp.zeros(()))


CONFIG = {"updates": 10, "worlds": 8, "steps": 8, "epochs": 2, "minibatches": 2, "discount": 0.9, "reward_scale": 1.0}


fresh = eqx.filter_jit(lambda env, key, worlds: env.reset_batch(key, worlds))


def begin(env, value, seed=0, worlds=CONFIG["worlds"], policy=None):
    """A training state at its beginning."""
    reset, key = jax.random.split(jax.random.key(seed))
    return init(policy or linear(), value, fresh(env, reset, worlds), key)


def train(state, env, count, /, **numbers):
    """Runs `count` updates with `CONFIG`, changed by `numbers`."""
    config = PPOConfig(**{**CONFIG, **numbers})
    return train_chunk(state, env, Hyperparameters.from_config(config), Shape.from_config(config), count)
