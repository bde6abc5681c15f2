"""Where the time of an update goes: each of its parts as a program of its own, on what it works on in training."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from benchmarks.timing import Case
from murmurate.learning import Batch, Chunk, collect, policy_loss, step_with_autoreset, value_loss

__all__ = ["PART", "PIECES", "SIGNALS", "piece_cases"]

PART = "piece"
SIGNALS = "signals, of the world"
TINY = 1e-9
"""A step along a gradient that changes next to nothing, but that the next minibatch has to wait for."""


@dataclass(frozen=True)
class Material:
    """What the parts of one update work on, all of it collected by its own policy.

    Attributes:
        chunk: The training.
        rollout: One batch of trajectories.
        parts: The same as minibatches; advantages and targets are random numbers.
    """

    chunk: Chunk
    rollout: Any
    parts: Batch

    @property
    def repeat(self) -> int:
        """Steps for which an action is kept up."""
        env = self.chunk.env
        return int(getattr(env, "env", env).times) if hasattr(env, "sensing") else int(env.times)

    @property
    def states(self) -> Any:
        """A state of every parallel episode."""
        return self.chunk.state.env_state


def piece_cases(kind: str, make: Callable[[], Chunk]) -> list[Case]:
    """Returns the parts of one update of a policy.

    Args:
        kind: Of the policy.
        make: Makes its training; called once, when the first of the cases is prepared.
    """
    material = functools.cache(lambda: _material(make()))
    return [
        Case(PART, f"{kind}: {name}", 1, functools.partial(_prepared, piece, material), unit="updates")
        for name, piece in PIECES.items()
        if name != "sensing" or kind == "local"
    ]


def _prepared(piece: Callable[[Material], Callable[[], Any]], material: Callable[[], Material]) -> Callable[[], Any]:
    return piece(material())


def _material(chunk: Chunk) -> Material:
    state, shape = chunk.state, chunk.shape
    run = eqx.filter_jit(lambda env, policy, state, key: collect(env, policy, state, key, shape.steps)[1])
    rollout = run(chunk.env, state.policy, state.env_state, jax.random.key(0))
    advantage, target = jax.random.normal(jax.random.key(1), (2, *rollout.log_prob.shape))

    def deal(x: jax.Array) -> jax.Array:
        """(time, ..., batch) -> (minibatches, ..., time * batch / minibatches)."""
        x = jnp.moveaxis(x, 0, -2)
        return jnp.moveaxis(x.reshape((*x.shape[:-2], shape.minibatches, -1)), -2, 0)

    flat = (rollout.observation, rollout.action, rollout.log_prob, advantage, target)
    return Material(chunk, rollout, Batch(*jax.jit(lambda tree: jax.tree.map(deal, tree))(flat)))


def _sensing(material: Material) -> Callable[[], Any]:
    """Robots look twice at every step: to act, and for the value of where they came to."""
    env, states, looks = material.chunk.env, material.states, 2 * material.chunk.shape.steps

    @eqx.filter_jit
    def run(env: Any, states: Any) -> Any:
        def look(now: tuple[Any, Any], _: None) -> tuple[Any, None]:
            states, seen = now
            moved = _positions(states) + TINY * jnp.sum(seen.view.x, axis=1)[:, None]
            states = eqx.tree_at(_positions, states, moved)
            return (states, env.observe(states)), None

        return jax.lax.scan(look, (states, env.observe(states)), None, length=looks - 1)[0]

    return lambda: run(env, states)


def _positions(state: Any) -> jax.Array:
    while hasattr(state, "world"):
        state = state.world
    return state.positions


def _stepping(material: Material) -> Callable[[], Any]:
    """The world, its signals and fresh starts, with the actions that were taken; nobody looks."""
    actions = material.rollout.action
    keys = jax.random.split(jax.random.key(2), actions.shape[0])

    @eqx.filter_jit
    def run(env: Any, states: Any, actions: Any, keys: Any) -> Any:
        return jax.lax.scan(lambda state, now: step_with_autoreset(env, state, *now)[:2], states, (actions, keys))

    return lambda: run(material.chunk.env, material.states, actions, keys)


def _signals(material: Material) -> Callable[[], Any]:
    """As often as the world steps, with each robot's share of them where that is what it learns by."""
    env = material.chunk.env
    world = (env.env if hasattr(env, "sensing") else env).env
    seen, repeat = material.rollout.observation, material.repeat
    positions = getattr(seen, "positions", seen)

    @eqx.filter_jit
    def run(world: Any, positions: Any) -> Any:
        def measure(last: Any, positions: Any) -> tuple[Any, None]:
            for _ in range(repeat):
                last = world.state(positions + TINY * last.objective)
            return last, None

        return jax.lax.scan(measure, world.state(positions[0]), positions)[0]

    return lambda: run(world, positions)


def _acting(material: Material) -> Callable[[], Any]:
    """The policy's forward pass, a sample and its log density, at every decision."""
    rollout = material.rollout
    keys = jax.random.split(jax.random.key(3), material.chunk.shape.steps)

    @eqx.filter_jit
    def run(policy: Any, observations: Any, keys: Any) -> Any:
        def act(now: tuple[Any, Any]) -> Any:
            distribution = policy.distribution(now[0])
            action = distribution.sample(now[1])
            return action, distribution.log_prob(action)

        return jax.lax.map(act, (observations, keys))

    return lambda: run(material.chunk.state.policy, rollout.observation, keys)


def _valuing(material: Material) -> Callable[[], Any]:
    """The value network's forward passes, before and after every decision."""
    rollout = material.rollout

    @eqx.filter_jit
    def run(value: Any, before: Any, after: Any) -> Any:
        return jax.lax.map(value, before), jax.lax.map(value, after)

    return lambda: run(material.chunk.state.value, rollout.observation, rollout.next_observation)


def _policy_gradient(material: Material) -> Callable[[], Any]:
    def gradient(policy: Any, part: Batch) -> Any:
        return eqx.filter_grad(policy_loss, has_aux=True)(policy, part, 0.2)[0]

    return _descending(material, material.chunk.state.policy, gradient)


def _value_gradient(material: Material) -> Callable[[], Any]:
    return _descending(material, material.chunk.state.value, eqx.filter_grad(value_loss))


def _descending(material: Material, network: Any, gradient: Callable[[Any, Batch], Any]) -> Callable[[], Any]:
    """The gradient of every minibatch of every epoch, without Adam."""
    epochs = material.chunk.shape.epochs

    @eqx.filter_jit
    def run(network: Any, parts: Batch) -> Any:
        def step(network: Any, part: Batch) -> tuple[Any, None]:
            down = jax.tree.map(lambda g: -TINY * g, gradient(network, part))
            return eqx.apply_updates(network, down), None

        def epoch(_: Any, network: Any) -> Any:
            return jax.lax.scan(step, network, parts)[0]

        return jax.lax.fori_loop(0, epochs, epoch, network)

    return lambda: run(network, material.parts)


PIECES: dict[str, Callable[[Material], Callable[[], Any]]] = {
    "sensing": _sensing,
    "world": _stepping,
    SIGNALS: _signals,
    "policy forward": _acting,
    "value forward": _valuing,
    "policy gradient": _policy_gradient,
    "value gradient": _value_gradient,
}
"""The parts that add up to an update, but for advantages, shuffling, Adam, metrics; signals are part of the world."""
