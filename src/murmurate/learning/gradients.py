"""Short-horizon actor-critic: improves a policy by the gradient of its own rollouts through a differentiable world.

Every update follows each episode for a short segment with the most likely actions, and ascends the gradient of the
discounted rewards of the segment plus the value of where it ends (Xu et al., Accelerated Policy Learning with Parallel
Differentiable Simulation, 2022). The value network learns from the same segment. What no gradient leads to is not
found this way: reinforcement learning discovers a policy first. Nothing here knows what the environment is about.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate import prng
from murmurate.errors import MAX_INTEGER, MAX_MAGNITUDE, InputError, check_number
from murmurate.learning import sharding
from murmurate.learning.advantage import generalized_advantage
from murmurate.learning.config import MAX_RATE, Schedule
from murmurate.learning.environment import Environment
from murmurate.learning.ppo import (
    TrainState,
    all_finite,
    descend,
    flatten_time,
    init,
    scan_state,
    split_minibatches,
)
from murmurate.representation import short_repr

__all__ = ["GradientConfig", "GradientHyperparameters", "Segment", "train_chunk"]


@dataclass(frozen=True)
class GradientConfig:
    """Configuration of the refinement by gradients.

    Attributes:
        updates: Number of updates, each from a new segment of every episode.
        worlds: Number of parallel episodes.
        steps: Steps of a segment.
        epochs: Passes of the value network over each segment.
        minibatches: Minibatches in each of these passes.
        discount: Discount of the rewards.
        gae_lambda: How far the value's targets look ahead: 0 for one step, 1 for the whole segment.
        policy_rate: Learning rate of the policy at the first update.
        policy_rate_end: The same at the last update.
        value_rate: Learning rate of the value network at the first update.
        value_rate_end: The same at the last update.
        reward_scale: Factor on every reward in training.
        max_gradient: Bound on the global norm of each network's gradient.
        max_state_gradient: Bound on the norm of each episode's gradient by its state, at every step. Where robots
            almost touch, the next steps depend on it without bound, and one episode would drown all others.
        average: The policy that training returns has the exponential moving average of the weights over about so many
            updates; 0 for the weights of the last one.
        weights: Weights in the reward of signals that have a gradient, by name: of the objective, of one's own, or of
            the package; gathering stands for centered (C1) or compact (C2).
        margins: Margins of the package's signals among them, by name, in place of their own.
        motion_cost: What each step at the speed limit along an axis costs, and a shorter one in proportion.
    """

    updates: int = 600
    worlds: int = 64
    steps: int = 24
    epochs: int = 2
    minibatches: int = 4
    discount: float = 0.97
    gae_lambda: float = 0.95
    policy_rate: float = 1e-3
    policy_rate_end: float = 5e-5
    value_rate: float = 1e-3
    value_rate_end: float = 1e-4
    reward_scale: float = 0.03
    max_gradient: float = 1.0
    max_state_gradient: float = 10.0
    average: int = 0
    weights: Mapping[str, float] = field(
        default_factory=lambda: {
            "gathering": 1.0,
            "smooth_safety": 5.0,
            "smooth_visible": 10.0,
            "exposed": 2.0,
        }
    )
    margins: Mapping[str, float] = field(default_factory=dict)
    motion_cost: float = 0.0

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for name in ("updates", "worlds", "steps", "epochs", "minibatches"):
            check_number(name, getattr(self, name), 1, MAX_INTEGER, integer=True)
        check_number("average", self.average, 0, MAX_INTEGER, integer=True)
        if (self.worlds * self.steps) % self.minibatches:
            allowed = f"a divisor of worlds * steps = {self.worlds * self.steps}"
            raise InputError("minibatches", self.minibatches, allowed)
        for name in ("discount", "gae_lambda"):
            check_number(name, getattr(self, name), 0, 1)
        for name in ("policy_rate", "policy_rate_end", "value_rate", "value_rate_end"):
            check_number(name, getattr(self, name), 0, MAX_RATE)
        for name in ("reward_scale", "max_gradient", "max_state_gradient"):
            check_number(name, getattr(self, name), 0, MAX_RATE, exclusive_low=True)
        for name, weight in self.weights.items():
            check_number(f"weights.{name}", weight, 0, MAX_MAGNITUDE)
        for name, margin in self.margins.items():
            check_number(f"margins.{name}", margin, 0, MAX_MAGNITUDE)
        check_number("motion_cost", self.motion_cost, 0, MAX_MAGNITUDE)


class GradientHyperparameters(eqx.Module):
    """The numbers of `GradientConfig` that can change without recompiling."""

    updates: Any
    discount: Any
    gae_lambda: Any
    policy_rate: Schedule
    value_rate: Schedule
    reward_scale: Any
    max_gradient: Any
    max_state_gradient: Any
    average: Any

    __repr__ = short_repr

    @classmethod
    def from_config(cls, config: GradientConfig) -> GradientHyperparameters:
        """Returns the numbers of a configuration."""
        numbers = cls(
            updates=jnp.asarray(config.updates, jnp.int32),
            discount=config.discount,
            gae_lambda=config.gae_lambda,
            policy_rate=Schedule(config.policy_rate, config.policy_rate_end),
            value_rate=Schedule(config.value_rate, config.value_rate_end),
            reward_scale=config.reward_scale,
            max_gradient=config.max_gradient,
            max_state_gradient=config.max_state_gradient,
            average=config.average,
        )
        # Equinox compiles plain numbers into the program, so they become arrays; their type is not left to JAX's flags.
        return jax.tree.map(lambda x: x if isinstance(x, jax.Array) else jnp.asarray(x, jnp.float32), numbers)


@dataclass(frozen=True)
class Segment:
    """The numbers of `GradientConfig` that change what is compiled."""

    worlds: int
    steps: int
    epochs: int
    minibatches: int

    __repr__ = short_repr

    @classmethod
    def from_config(cls, config: GradientConfig) -> Segment:
        """Returns the numbers of a configuration."""
        return cls(config.worlds, config.steps, config.epochs, config.minibatches)


@jax.custom_vjp
def limit_gradient(state: Any, bound: Any) -> Any:
    """Returns the floating-point arrays of a state; each episode's gradient by them is shortened to a norm.

    Gradients are those of a mean over the episodes, which are the last axis of every array. A gradient that is not
    finite becomes 0: what came before has no part in it.

    Args:
        state: Arrays, or None where there is none.
        bound: The largest norm.
    """
    del bound
    return state


def _limit_forward(state: Any, bound: Any) -> tuple[Any, Any]:
    return state, bound


def _limit_backward(bound: Any, gradient: Any) -> tuple[Any, None]:
    squares = [jnp.sum(leaf**2, axis=tuple(range(leaf.ndim - 1))) for leaf in jax.tree.leaves(gradient)]
    square = jnp.sum(jnp.stack(squares), axis=0)
    norm = jnp.sqrt(square) * square.shape[-1]
    factor = jnp.where(norm > bound, bound / norm, 1.0)
    usable = jnp.isfinite(square)
    return jax.tree.map(lambda leaf: jnp.where(usable, factor * leaf, 0.0), gradient), None


limit_gradient.defvjp(_limit_forward, _limit_backward)


def segment_return(
    policy: Any, value: Any, env: Environment, state: Any, hyper: GradientHyperparameters, steps: int
) -> tuple[Float[Array, ""], Any]:
    """Computes what is maximised: the discounted rewards of a segment and the value of its last state.

    An episode that terminates counts up to there. Nothing is reset within a segment, so that every step is reached by
    gradients from all later ones.

    Args:
        policy: A policy network; called, it returns the most likely action.
        value: A value network; the mean over its actions is the value.
        env: The environment; the rewards and states of its `step` are differentiable by the action.
        state: The states that the segment begins with.
        hyper: The numbers of the learner.
        steps: Steps of the segment.

    Returns:
        The mean over the episodes; and the states after the segment, the observations before its steps and after the
        last one, the transitions, and which episodes had not terminated before each step.
    """

    # What a step computes is computed again for its gradient: memory for all pairs at all steps would not last.
    @jax.checkpoint
    def step(carry: tuple[Any, Array], _: None) -> tuple[tuple[Any, Array], tuple[Any, Any, Array]]:
        state, alive = carry
        floats, rest = eqx.partition(state, eqx.is_inexact_array)
        state = eqx.combine(limit_gradient(floats, hyper.max_state_gradient), rest)
        observation = env.observe(state)
        after, transition = env.step(state, policy(observation))
        return (after, alive & ~transition.terminated), (observation, transition, alive)

    alive = jnp.ones(jax.eval_shape(env.step, state, policy(env.observe(state)))[1].reward.shape, bool)
    (last, survived), (observations, transitions, counted) = jax.lax.scan(step, (state, alive), None, length=steps)
    final = env.observe(last)
    discounts = hyper.discount ** jnp.arange(steps, dtype=jnp.float32)[:, None]
    rewards = jnp.where(counted, hyper.reward_scale * jnp.mean(transitions.credit, axis=1), 0.0)
    ahead = jnp.where(survived, jnp.mean(value(final), axis=0), 0.0)
    total = jnp.mean(jnp.sum(discounts * rewards, axis=0) + hyper.discount**steps * ahead)
    return total, (last, observations, final, transitions, counted)


def _update(
    state: TrainState, env: Environment, hyper: GradientHyperparameters, shape: Segment
) -> tuple[TrainState, dict[str, Any]]:
    """Follows every episode for a segment and takes one step of the policy, several of the value network."""
    key, reset_key, shuffle_key = jax.random.split(prng.wrap(state.key), 3)
    progress = state.update.astype(jnp.float32) / jnp.maximum(hyper.updates - 1, 1).astype(jnp.float32)

    def loss(policy: Any) -> tuple[Float[Array, ""], Any]:
        total, rest = segment_return(policy, state.value, env, state.env_state, hyper, shape.steps)
        return -total, rest

    (error, (last, observations, final, transitions, counted)), gradient = eqx.filter_value_and_grad(
        loss, has_aux=True
    )(state.policy)
    norm = optax.tree.norm(gradient)
    # Of one episode's steps without a finite gradient nothing is left here; what else may fail is left out as a whole.
    usable = jnp.isfinite(norm)
    gradient = jax.tree.map(lambda g: jnp.where(usable, g, 0.0), gradient)
    policy, policy_moments = descend(
        state.policy, state.policy_moments, gradient, hyper.policy_rate(progress), hyper.max_gradient
    )
    state = eqx.tree_at(lambda s: (s.policy, s.policy_moments), state, (policy, policy_moments))
    if state.average is not None:
        # The plain mean of the first updates, which forgets where it began.
        share = 1 / jnp.minimum(state.update.astype(jnp.float32) + 1, hyper.average)
        weights, rest = eqx.partition(policy, eqx.is_inexact_array)
        average = optax.incremental_update(weights, eqx.filter(state.average, eqx.is_inexact_array), share)
        state = eqx.tree_at(lambda s: s.average, state, eqx.combine(average, rest))
    before = jax.lax.map(lambda x: jnp.mean(state.value(x), axis=0), observations)
    after = jnp.concatenate([before[1:], jnp.mean(state.value(final), axis=0)[None]])
    rewards = jnp.where(counted, hyper.reward_scale * jnp.mean(transitions.credit, axis=1), 0.0)
    ended = transitions.terminated | ~counted
    advantage = generalized_advantage(
        rewards[:, None], before[:, None], after[:, None], ended[:, None], jnp.zeros_like(ended)[:, None],
        hyper.discount, hyper.gae_lambda,
    )[:, 0]  # fmt: skip
    # What follows a contact is none of the world's states, and has no value.
    target = jnp.where(counted, advantage + before, 0.0)
    batch = jax.tree.map(flatten_time, (observations, target, counted))
    batch = sharding.replicate(batch)

    def value_loss(value: Any, part: Any) -> Float[Array, ""]:
        observation, target, counts = part
        return jnp.mean(jnp.where(counts, jnp.mean(value(observation), axis=0) - target, 0.0) ** 2)

    def epoch(state: TrainState, key: Any) -> tuple[TrainState, Array]:
        def step(state: TrainState, part: Any) -> tuple[TrainState, Array]:
            error, gradient = eqx.filter_value_and_grad(value_loss)(state.value, part)
            value, moments = descend(
                state.value, state.value_moments, gradient, hyper.value_rate(progress), hyper.max_gradient
            )
            return eqx.tree_at(lambda s: (s.value, s.value_moments), state, (value, moments)), error

        return scan_state(step, state, split_minibatches(batch, key, shape.minibatches))

    state, value_error = scan_state(epoch, state, jax.random.split(shuffle_key, shape.epochs))
    metrics = {
        "reward": transitions.reward.mean(),
        "terminated": transitions.terminated.mean(dtype=jnp.float32),
        "signals": jax.tree.map(jnp.mean, transitions.signals),
        "policy_loss": error,
        "value_loss": value_error.mean(),
        "gradient": jnp.where(usable, norm, 0.0),
        "finite": all_finite((state.policy, state.value, value_error)),
    }
    done = jnp.any(transitions.terminated | transitions.truncated, axis=0)

    def reset(after: Any) -> Any:
        fresh = env.reset_batch(reset_key, shape.worlds)
        return jax.tree.map(lambda new, old: jnp.where(done, new, old), fresh, after)

    env_state = jax.lax.cond(jnp.any(done), reset, lambda after: after, last)
    state = eqx.tree_at(
        lambda s: (s.env_state, s.key, s.update), state, (env_state, jax.random.key_data(key), state.update + 1)
    )
    return state, metrics


def begin(policy: Any, value: Any, env_state: Any, key: PRNGKeyArray, config: GradientConfig) -> TrainState:
    """Returns the state of training before its first update.

    Args:
        policy: The policy network.
        value: The value network.
        env_state: The states of the environment.
        key: The key of the training.
        config: Says whether an average of the weights is kept.
    """
    state = init(policy, value, env_state, key)
    return replace(state, average=policy) if config.average else state


@eqx.filter_jit
def train_chunk(
    state: TrainState, env: Environment, hyper: GradientHyperparameters, shape: Segment, updates: int
) -> tuple[TrainState, dict[str, Any]]:
    """Runs some updates without returning to Python; arguments and results are those of `ppo.train_chunk`.

    Args:
        state: The state of training.
        env: The environment; the rewards and states of its `step` are differentiable by the action.
        hyper: Numbers that can change without recompiling.
        shape: Numbers that cannot.
        updates: Number of updates.

    Returns:
        The state of training after the updates, and the metrics of every update.
    """

    def step(state: TrainState, _: None) -> tuple[TrainState, dict[str, Any]]:
        return _update(state, env, hyper, shape)

    state = eqx.tree_at(lambda s: s.env_state, state, sharding.shard_batch(state.env_state))
    return sharding.replicate(scan_state(step, state, None, length=updates))
