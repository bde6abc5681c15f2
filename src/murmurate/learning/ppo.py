"""Clipped proximal policy optimisation: collect, estimate, improve, all under one jit.

Policy and value are two networks with an optimiser and a learning rate each (the paper's alpha and beta). Nothing here
knows what the environment is about.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int, PRNGKeyArray, UInt32

from murmurate.learning import sharding
from murmurate.learning.advantage import generalized_advantage, rewards_to_go
from murmurate.learning.config import Hyperparameters, Shape
from murmurate.learning.environment import Environment, Transition, step_with_autoreset
from murmurate.learning.losses import Batch, policy_loss, value_loss

__all__ = ["Rollout", "TrainState", "collect", "init", "train_chunk"]

_adam = optax.scale_by_adam(eps=1e-5)


class TrainState(eqx.Module):
    """All that training carries from one update to the next; saving it is a checkpoint."""

    policy: Any
    value: Any
    policy_moments: Any
    value_moments: Any
    env_state: Any
    key: UInt32[Array, "..."]
    update: Int[Array, ""]


class Rollout(eqx.Module):
    """Trajectories collected by one policy; time first, batch last."""

    observation: Any
    next_observation: Any
    action: Any
    log_prob: Float[Array, "time actions batch"]
    transition: Any


def init(policy: Any, value: Any, env_state: Any, key: PRNGKeyArray) -> TrainState:
    """Begins training from the given networks and states of the environment."""
    return TrainState(
        policy=policy,
        value=value,
        policy_moments=_adam.init(eqx.filter(policy, eqx.is_inexact_array)),
        value_moments=_adam.init(eqx.filter(value, eqx.is_inexact_array)),
        env_state=env_state,
        key=jax.random.key_data(key),
        update=jnp.zeros((), jnp.int32),
    )


def collect(env: Environment, policy: Any, state: Any, key: PRNGKeyArray, steps: int) -> tuple[Any, Rollout]:
    """Lets a policy act, with exploration noise, for some steps in every episode of the batch.

    Returns:
        The states to go on from, and what happened.
    """

    def one(state: Any, key: PRNGKeyArray) -> tuple[Any, Rollout]:
        act, restart = jax.random.split(key)
        observation = env.observe(state)
        distribution = policy.distribution(observation)
        action = distribution.sample(act)
        state, transition, after = step_with_autoreset(env, state, action, restart)
        return state, Rollout(observation, after, action, distribution.log_prob(action), transition)

    return jax.lax.scan(one, state, jax.random.split(key, steps))


def _flatten(x: Array) -> Array:
    """(time, ..., batch) -> (..., time * batch)."""
    x = jnp.moveaxis(x, 0, -2)
    return x.reshape((*x.shape[:-2], -1))


def _batch(value: Any, rollout: Rollout, hyper: Hyperparameters, shape: Shape) -> Batch:
    """Estimates advantages and value targets."""
    transition: Transition = rollout.transition
    reward = hyper.reward_scale * transition.credit
    before, after = jax.lax.map(value, rollout.observation), jax.lax.map(value, rollout.next_observation)
    ends = (transition.terminated[:, None], transition.truncated[:, None])
    advantage = generalized_advantage(reward, before, after, *ends, hyper.discount, hyper.gae_lambda)
    target = advantage + before if shape.value_target == "gae" else rewards_to_go(reward, after, *ends)
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    flat = (rollout.observation, rollout.action, rollout.log_prob, advantage, target)
    return Batch(*jax.tree.map(_flatten, flat))


def _minibatches(batch: Batch, key: PRNGKeyArray, count: int) -> Batch:
    """Shuffles the steps and deals them into minibatches, on a new first axis; each is spread over the devices."""
    order = jax.random.permutation(key, batch.log_prob.shape[-1])

    def deal(x: Array) -> Array:
        return jnp.moveaxis(x[..., order].reshape((*x.shape[:-1], count, -1)), -2, 0)

    return sharding.parted(jax.tree.map(deal, batch))


def _descend(network: Any, moments: Any, gradient: Any, rate: Any, max_gradient: Any) -> tuple[Any, Any]:
    """One step of Adam on a gradient whose GLOBAL norm is bounded."""
    norm = optax.tree.norm(gradient)
    gradient = jax.tree.map(lambda g: g * jnp.minimum(1.0, max_gradient / (norm + 1e-12)), gradient)
    direction, moments = _adam.update(gradient, moments)
    return eqx.apply_updates(network, jax.tree.map(lambda d: -rate * d, direction)), moments


def _improve(
    state: TrainState, batch: Batch, hyper: Hyperparameters, progress: Any
) -> tuple[TrainState, dict[str, Any]]:
    """One minibatch: a step of each network."""
    rates = hyper.policy_rate(progress), hyper.value_rate(progress)
    (loss, report), gradient = eqx.filter_value_and_grad(policy_loss, has_aux=True)(
        state.policy, batch, hyper.clip(progress)
    )
    if hyper.log_std is not None:
        gradient = eqx.tree_at(lambda g: g.log_std, gradient, replace_fn=jnp.zeros_like)
    policy, policy_moments = _descend(state.policy, state.policy_moments, gradient, rates[0], hyper.max_gradient)
    error, gradient = eqx.filter_value_and_grad(value_loss)(state.value, batch)
    value, value_moments = _descend(state.value, state.value_moments, gradient, rates[1], hyper.max_gradient)
    state = eqx.tree_at(
        lambda s: (s.policy, s.value, s.policy_moments, s.value_moments),
        state,
        (policy, value, policy_moments, value_moments),
    )
    return state, {"policy_loss": loss, "value_loss": error, **report}


def _update(
    state: TrainState, env: Environment, hyper: Hyperparameters, shape: Shape
) -> tuple[TrainState, dict[str, Any]]:
    """Collects one batch of trajectories and learns from it (one turn of Algorithm 1's loop)."""
    key, act, shuffle = jax.random.split(jax.random.wrap_key_data(state.key), 3)
    progress = state.update / jnp.maximum(hyper.updates - 1, 1)
    if hyper.log_std is not None:
        spread = jnp.full_like(state.policy.log_std, hyper.log_std(progress))
        state = eqx.tree_at(lambda s: s.policy.log_std, state, spread)
    env_state, rollout = sharding.parted(collect(env, state.policy, state.env_state, act, shape.steps))
    # Whole on every device, once: a shuffle takes from everywhere.
    batch = sharding.replicated(_batch(state.value, rollout, hyper, shape))

    def epoch(state: TrainState, key: PRNGKeyArray) -> tuple[TrainState, dict[str, Any]]:
        def step(state: TrainState, part: Batch) -> tuple[TrainState, dict[str, Any]]:
            return _improve(state, part, hyper, progress)

        return jax.lax.scan(step, state, _minibatches(batch, key, shape.minibatches))

    state, report = jax.lax.scan(epoch, state, jax.random.split(shuffle, shape.epochs))
    transition = rollout.transition
    metrics = {
        "reward": transition.reward.mean(),
        "terminated": transition.terminated.mean(dtype=jnp.float32),
        "signals": jax.tree.map(jnp.mean, transition.signals),
        **jax.tree.map(jnp.mean, report),
    }
    state = eqx.tree_at(
        lambda s: (s.env_state, s.key, s.update), state, (env_state, jax.random.key_data(key), state.update + 1)
    )
    return state, metrics


@eqx.filter_jit
def train_chunk(
    state: TrainState, env: Environment, hyper: Hyperparameters, shape: Shape, updates: int
) -> tuple[TrainState, dict[str, Any]]:
    """Runs some updates without visiting the host.

    With several devices each simulates a part of the batch and computes its part of every gradient; what is returned is
    whole on each of them.

    Args:
        state: Where training stands.
        env: The environment.
        hyper: Numbers that may change without recompiling.
        shape: Numbers that may not.
        updates: How many updates to run.

    Returns:
        Where training stands then, and the metrics of every update, each on a first axis of length `updates`.
    """

    def step(state: TrainState, _: None) -> tuple[TrainState, dict[str, Any]]:
        return _update(state, env, hyper, shape)

    state = eqx.tree_at(lambda s: s.env_state, state, sharding.parted(state.env_state))
    return sharding.replicated(jax.lax.scan(step, state, None, length=updates))
