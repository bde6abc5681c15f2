"""Clipped proximal policy optimisation: collect trajectories, estimate advantages, improve; all under one jit.

Policy and value are two networks, each with its own optimiser and learning rate (the paper's alpha and beta). Nothing
here knows what the environment is about.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, UInt32

from murmurate import prng
from murmurate.errors import InputError
from murmurate.learning import sharding
from murmurate.learning.advantage import generalized_advantage, rewards_to_go
from murmurate.learning.config import Hyperparameters, Shape
from murmurate.learning.environment import Environment, Policy, Transition, Value, features_of, step_with_autoreset
from murmurate.learning.losses import Batch, policy_loss, value_loss
from murmurate.representation import short_repr

__all__ = ["Rollout", "TrainState", "collect", "init", "set_log_std", "train_chunk"]

_adam = optax.scale_by_adam(eps=1e-5)


class TrainState(eqx.Module):
    """Everything that training carries from one update to the next; a checkpoint saves it whole."""

    policy: Any
    value: Any
    policy_moments: Any
    value_moments: Any
    env_state: Any
    key: UInt32[Array, "..."]
    update: Int[Array, ""]
    average: Any = None

    __repr__ = short_repr

    @property
    def result(self) -> Any:
        """The policy that the training returns: an average over its updates where it keeps one, else the last one."""
        return self.policy if self.average is None else self.average


class Rollout(eqx.Module):
    """Trajectories collected with one policy; time first, batch last.

    Attributes:
        observation: What the networks act on: the policy's features of each observation, where it has any.
        next_observation: What was observed after each step, before any reset.
        action: The sampled actions.
        log_prob: Their log densities.
        transition: The results of the steps.
    """

    observation: Any
    next_observation: Any
    action: Any
    log_prob: Float[Array, "*time actions batch"]
    transition: Any

    __repr__ = short_repr


def init(policy: Policy, value: Value, env_state: Any, key: PRNGKeyArray) -> TrainState:
    """Returns the state of training before its first update."""
    return TrainState(
        policy=policy,
        value=value,
        policy_moments=_adam.init(eqx.filter(policy, eqx.is_inexact_array)),
        value_moments=_adam.init(eqx.filter(value, eqx.is_inexact_array)),
        env_state=env_state,
        key=jax.random.key_data(key),
        update=jnp.zeros((), jnp.int32),
    )


def set_log_std(policy: Any, log_std: Any, *, scheduled: bool = False) -> Any:
    """Returns the policy with every entry of its `log_std` replaced; a policy without `log_std` stays as it is.

    Args:
        policy: The policy network.
        log_std: The new logarithm of the standard deviation.
        scheduled: The training will set `log_std` again at every update.

    Raises:
        InputError: The training schedules `log_std`, but the policy has none.
    """
    if hasattr(policy, "log_std"):
        return eqx.tree_at(lambda p: p.log_std, policy, jnp.full_like(policy.log_std, log_std))
    if scheduled:
        raise InputError("exploration", "scheduled", "learned for a policy that has no array `log_std`")
    return policy


def collect(env: Environment, policy: Policy, state: Any, key: PRNGKeyArray, steps: int) -> tuple[Any, Rollout]:
    """Steps every episode of the batch with actions sampled from a policy.

    Returns:
        The states after the last step, and the trajectories.
    """

    def step(state: Any, key: PRNGKeyArray) -> tuple[Any, Rollout]:
        sample_key, reset_key = jax.random.split(key)
        observation = features_of(policy, env.observe(state))
        distribution = policy.distribution(observation)
        action = distribution.sample(sample_key)
        state, transition, next_observation = step_with_autoreset(env, state, action, reset_key)
        return state, Rollout(observation, next_observation, action, distribution.log_prob(action), transition)

    return jax.lax.scan(step, state, jax.random.split(key, steps))


def flatten_time(x: Array) -> Array:
    """(time, ..., batch) -> (..., time * batch)."""
    x = jnp.moveaxis(x, 0, -2)
    return x.reshape((*x.shape[:-2], -1))


def _batch(policy: Policy, value: Value, rollout: Rollout, hyper: Hyperparameters, shape: Shape) -> Batch:
    """Computes advantages and value targets."""
    transition: Transition = rollout.transition
    reward = hyper.reward_scale * transition.credit
    before, after = _values(policy, value, rollout)
    ends = (transition.terminated[:, None], transition.truncated[:, None])
    advantage = generalized_advantage(reward, before, after, *ends, hyper.discount, hyper.gae_lambda)
    target = advantage + before if shape.value_target == "gae" else rewards_to_go(reward, after, *ends)
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    flat = (rollout.observation, rollout.action, rollout.log_prob, advantage, target)
    return Batch(*jax.tree.map(flatten_time, flat))


def _values(policy: Policy, value: Value, rollout: Rollout) -> tuple[Array, Array]:
    """Returns the values before and after every step.

    What is observed after a step is observed before the next one, unless the episode is then begun anew. So values of
    the last step, and of those after which an episode was truncated, are all that is computed besides.
    """
    # One step of all worlds at a time, which bounds the memory.
    before = jax.lax.map(value, rollout.observation)
    steps, batch = rollout.transition.truncated.shape
    other = rollout.transition.truncated.at[-1].set(True).reshape(-1)
    order = jnp.argsort(~other, stable=True)
    observations = jax.tree.map(flatten_time, rollout.next_observation)

    def compute(carry: tuple[Any, Array]) -> tuple[Any, Array]:
        turn, after = carry
        chosen = jax.lax.dynamic_slice_in_dim(order, turn * batch, batch)
        observation = jax.tree.map(lambda x: x[..., chosen], observations)
        return turn + 1, after.at[:, chosen].set(value(features_of(policy, observation)))

    after = flatten_time(jnp.concatenate([before[1:], before[-1:]]))
    turns = -(-jnp.sum(other, dtype=jnp.int32) // batch)
    _, after = jax.lax.while_loop(lambda carry: carry[0] < turns, compute, (jnp.zeros((), jnp.int32), after))
    return before, jnp.moveaxis(after.reshape(after.shape[0], steps, batch), 1, 0)


def split_minibatches(batch: Any, key: PRNGKeyArray, count: int) -> Any:
    """Shuffles the steps and splits them into minibatches, on a new first axis; each is spread over the devices."""
    order = jax.random.permutation(key, jnp.arange(jax.tree.leaves(batch)[0].shape[-1], dtype=jnp.int32))

    def split(x: Array) -> Array:
        return jnp.moveaxis(x[..., order].reshape((*x.shape[:-1], count, -1)), -2, 0)

    return sharding.shard_batch(jax.tree.map(split, batch))


def descend(network: Any, moments: Any, gradient: Any, rate: Any, max_gradient: Any) -> tuple[Any, Any]:
    """Takes one step of Adam, after clipping the gradient's global norm."""
    norm = optax.tree.norm(gradient)
    gradient = jax.tree.map(lambda g: g * jnp.minimum(1.0, max_gradient / (norm + 1e-12)), gradient)
    direction, moments = _adam.update(gradient, moments)
    return eqx.apply_updates(network, jax.tree.map(lambda d: -rate * d, direction)), moments


def _improve(
    state: TrainState, batch: Batch, hyper: Hyperparameters, progress: Any
) -> tuple[TrainState, dict[str, Any]]:
    """Takes one step of each network on one minibatch."""
    policy_rate, value_rate = hyper.policy_rate(progress), hyper.value_rate(progress)
    (loss, diagnostics), gradient = eqx.filter_value_and_grad(policy_loss, has_aux=True)(
        state.policy, batch, hyper.clip(progress)
    )
    if hyper.log_std is not None:
        gradient = eqx.tree_at(lambda g: g.log_std, gradient, replace_fn=jnp.zeros_like)
    policy, policy_moments = descend(state.policy, state.policy_moments, gradient, policy_rate, hyper.max_gradient)
    error, gradient = eqx.filter_value_and_grad(value_loss)(state.value, batch)
    value, value_moments = descend(state.value, state.value_moments, gradient, value_rate, hyper.max_gradient)
    state = eqx.tree_at(
        lambda s: (s.policy, s.value, s.policy_moments, s.value_moments),
        state,
        (policy, value, policy_moments, value_moments),
    )
    return state, {"policy_loss": loss, "value_loss": error, **diagnostics}


def all_finite(tree: Any) -> Bool[Array, ""]:
    leaves = jax.tree.leaves(eqx.filter(tree, eqx.is_inexact_array))
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in leaves]))


def _update(
    state: TrainState, env: Environment, hyper: Hyperparameters, shape: Shape
) -> tuple[TrainState, dict[str, Any]]:
    """Collects one batch of trajectories and learns from it (one turn of Algorithm 1's loop)."""
    key, collect_key, shuffle_key = jax.random.split(prng.wrap(state.key), 3)
    progress = state.update.astype(jnp.float32) / jnp.maximum(hyper.updates - 1, 1).astype(jnp.float32)
    if hyper.log_std is not None:
        state = eqx.tree_at(
            lambda s: s.policy, state, set_log_std(state.policy, hyper.log_std(progress), scheduled=True)
        )
    env_state, rollout = sharding.shard_batch(collect(env, state.policy, state.env_state, collect_key, shape.steps))
    # A shuffle takes steps from everywhere, so every device gets the whole batch, once.
    batch = sharding.replicate(_batch(state.policy, state.value, rollout, hyper, shape))

    def epoch(state: TrainState, key: PRNGKeyArray) -> tuple[TrainState, dict[str, Any]]:
        def step(state: TrainState, part: Batch) -> tuple[TrainState, dict[str, Any]]:
            return _improve(state, part, hyper, progress)

        return scan_state(step, state, split_minibatches(batch, key, shape.minibatches))

    state, losses = scan_state(epoch, state, jax.random.split(shuffle_key, shape.epochs))
    transition = rollout.transition
    losses = jax.tree.map(jnp.mean, losses)
    metrics = {
        "reward": transition.reward.mean(),
        "terminated": transition.terminated.mean(dtype=jnp.float32),
        "signals": jax.tree.map(jnp.mean, transition.signals),
        **losses,
        "finite": all_finite((state.policy, state.value, losses)),
    }
    state = eqx.tree_at(
        lambda s: (s.env_state, s.key, s.update), state, (env_state, jax.random.key_data(key), state.update + 1)
    )
    return state, metrics


def scan_state(
    step: Callable[[TrainState, Any], tuple[TrainState, Any]], state: TrainState, xs: Any, length: int | None = None
) -> tuple[TrainState, Any]:
    """Scans over a training state whose networks may have leaves that are no arrays, such as activation functions."""
    arrays, rest = eqx.partition(state, eqx.is_array)

    def step_arrays(arrays: Any, x: Any) -> tuple[Any, Any]:
        state, result = step(eqx.combine(arrays, rest), x)
        return eqx.filter(state, eqx.is_array), result

    arrays, results = jax.lax.scan(step_arrays, arrays, xs, length=length)
    return eqx.combine(arrays, rest), results


@eqx.filter_jit
def train_chunk(
    state: TrainState, env: Environment, hyper: Hyperparameters, shape: Shape, updates: int
) -> tuple[TrainState, dict[str, Any]]:
    """Runs some updates without returning to Python.

    With several devices each simulates a part of the batch and computes its part of every gradient. What is returned is
    whole on each of them.

    Args:
        state: The state of training.
        env: The environment.
        hyper: Numbers that can change without recompiling.
        shape: Numbers that cannot.
        updates: Number of updates.

    Returns:
        The state of training after the updates, and the metrics of every update, each on a first axis of length
        `updates`. The metric `finite` is false from the first update on after which a parameter or a loss is NaN or
        infinite.
    """

    def step(state: TrainState, _: None) -> tuple[TrainState, dict[str, Any]]:
        return _update(state, env, hyper, shape)

    state = eqx.tree_at(lambda s: s.env_state, state, sharding.shard_batch(state.env_state))
    return sharding.replicate(scan_state(step, state, None, length=updates))
