"""The parts of an update, each as its own program on the data of a training: their seconds, and what they compute."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from benchmarks.measure import Case, compiler_cost
from murmurate import prng
from murmurate.learning import Batch, Chunk, collect, policy_loss, step_with_autoreset, value_loss

__all__ = ["PART", "PIECES", "SIGNALS", "piece_cases", "update_cost"]

PART = "piece"
SIGNALS = "signals, of the world"
TINY = 1e-9
"""Factor that changes next to nothing, but makes each turn of a loop wait for the one before."""


@dataclass(frozen=True)
class Loop:
    """A part of an update: a program that is a loop, and how often the loop turns.

    Attributes:
        program: The program, not compiled.
        arguments: Its arguments.
        turns: Turns of the loop; the compiler counts the operations of one.
        counted: The program and arguments whose operations count for one turn, if not those above.
    """

    program: Callable[..., Any]
    arguments: tuple[Any, ...]
    turns: int
    counted: tuple[Any, ...] = ()

    def prepare(self) -> Callable[[], Any]:
        """Returns the run: the compiled program on its arguments."""
        compiled = eqx.filter_jit(self.program)
        return lambda: compiled(*self.arguments)

    def cost(self) -> dict[str, float]:
        """Returns what the compiler counts in all turns."""
        counts = compiler_cost(*(self.counted or (self.program, *self.arguments)))
        return {name: self.turns * count for name, count in counts.items()}


@dataclass(frozen=True)
class Material:
    """The data that the parts of one update work on, collected with the training's own policy.

    Attributes:
        chunk: The training.
        rollout: One batch of trajectories.
        parts: The same as minibatches; advantages and targets are random numbers.
    """

    chunk: Chunk
    rollout: Any
    parts: Batch

    @classmethod
    def from_chunk(cls, chunk: Chunk) -> Material:
        """Collects the data."""
        state, shape = chunk.state, chunk.shape
        run = eqx.filter_jit(lambda env, policy, state, key: collect(env, policy, state, key, shape.steps)[1])
        rollout = run(chunk.env, state.policy, state.env_state, prng.key(0))
        advantage, target = jax.random.normal(prng.key(1), (2, *rollout.log_prob.shape), jnp.float32)

        def split(x: jax.Array) -> jax.Array:
            """(time, ..., batch) -> (minibatches, ..., time * batch / minibatches)."""
            x = jnp.moveaxis(x, 0, -2)
            return jnp.moveaxis(x.reshape((*x.shape[:-2], shape.minibatches, -1)), -2, 0)

        flat = (rollout.observation, rollout.action, rollout.log_prob, advantage, target)
        return cls(chunk, rollout, Batch(*jax.jit(lambda tree: jax.tree.map(split, tree))(flat)))

    @property
    def world(self) -> Any:
        """The world inside all wrappers."""
        return self.chunk.env.unwrapped

    @property
    def action_repeat(self) -> int:
        """Steps for which each action is repeated."""
        return int(self.chunk.env.times)

    @property
    def states(self) -> Any:
        """A state of every parallel episode."""
        return self.chunk.state.env_state


def piece_cases(kind: str, make: Callable[[], Chunk]) -> list[Case]:
    """Returns the parts of one update of a policy.

    Args:
        kind: The kind of policy.
        make: Makes its training; called once, when the first of the cases is prepared.
    """
    material = functools.cache(lambda: Material.from_chunk(make()))
    return [
        Case(PART, f"{kind}: {name}", 1, lambda piece=piece: piece(material()).prepare(), unit="updates")
        for name, piece in PIECES.items()
        if name != "sensing" or kind == "local"
    ]


def update_cost(kind: str, chunk: Chunk) -> dict[str, float]:
    """Returns what the compiler counts in the parts of one update of a policy, all together."""
    material = Material.from_chunk(chunk)
    total: dict[str, float] = {}
    for name, piece in PIECES.items():
        # Signals are part of the world's step.
        if name != SIGNALS and (name != "sensing" or kind == "local"):
            for key, count in piece(material).cost().items():
                total[key] = total.get(key, 0.0) + count
    return total


def _sensing(material: Material) -> Loop:
    """Observes twice per decision: to act, and for the value of the next state."""
    turns = 2 * material.chunk.shape.steps

    def run(env: Any, states: Any) -> Any:
        def look(carry: tuple[Any, Any], _: None) -> tuple[Any, None]:
            states, seen = carry
            moved = states.positions + TINY * jnp.sum(seen.view.x, axis=1)[:, None]
            states = eqx.tree_at(lambda s: s.unwrapped.positions, states, moved)
            return (states, env.observe(states)), None

        return jax.lax.scan(look, (states, env.observe(states)), None, length=turns - 1)[0]

    env, states = material.chunk.env, material.states
    return Loop(run, (env, states), turns, (lambda env, states: env.observe(states), env, states))


def _stepping(material: Material) -> Loop:
    """Steps the world, its signals and fresh starts, with the actions that were taken; nothing is observed.

    Counted are the steps alone: how often episodes end, so how many starts are drawn, is not known to the compiler.
    """
    actions = material.rollout.action
    keys = jax.random.split(prng.key(2), actions.shape[0])

    def run(env: Any, states: Any, actions: Any, keys: Any) -> Any:
        return jax.lax.scan(lambda state, xs: step_with_autoreset(env, state, *xs)[:2], states, (actions, keys))

    def step(world: Any, state: Any, action: Any) -> Any:
        return world.step(state, action)

    return Loop(
        run,
        (material.chunk.env, material.states, actions, keys),
        material.chunk.shape.steps * material.action_repeat,
        (step, material.world, material.states.unwrapped, actions[0]),
    )


def _signals(material: Material) -> Loop:
    """Computes the signals at every step of the world, and each robot's part if the policy learns from it."""
    seen, repeat = material.rollout.observation, material.action_repeat

    def run(world: Any, positions: Any) -> Any:
        def measure(last: Any, positions: Any) -> tuple[Any, None]:
            for _ in range(repeat):
                last = world.state(positions + TINY * last.objective)
            return last, None

        return jax.lax.scan(measure, world.state(positions[0]), positions)[0]

    return Loop(run, (material.world, getattr(seen, "positions", seen)), material.chunk.shape.steps)


def _acting(material: Material) -> Loop:
    """Runs the policy forward, samples, and computes the log density, at every decision."""
    turns = material.chunk.shape.steps
    keys = jax.random.split(prng.key(3), turns)

    def run(policy: Any, observations: Any, keys: Any) -> Any:
        def act(xs: tuple[Any, Any]) -> Any:
            distribution = policy.distribution(xs[0])
            action = distribution.sample(xs[1])
            return action, distribution.log_prob(action)

        return jax.lax.map(act, (observations, keys))

    return Loop(run, (material.chunk.state.policy, material.rollout.observation, keys), turns)


def _valuing(material: Material) -> Loop:
    """Runs the value network forward, before and after every decision."""

    def run(value: Any, before: Any, after: Any) -> Any:
        return jax.lax.map(value, before), jax.lax.map(value, after)

    rollout, chunk = material.rollout, material.chunk
    return Loop(run, (chunk.state.value, rollout.observation, rollout.next_observation), chunk.shape.steps)


def _policy_gradient(material: Material) -> Loop:
    def gradient(policy: Any, part: Batch) -> Any:
        return eqx.filter_grad(policy_loss, has_aux=True)(policy, part, 0.2)[0]

    return _gradients(material, material.chunk.state.policy, gradient)


def _value_gradient(material: Material) -> Loop:
    return _gradients(material, material.chunk.state.value, eqx.filter_grad(value_loss))


def _gradients(material: Material, network: Any, gradient: Callable[[Any, Batch], Any]) -> Loop:
    """Computes the gradient of every minibatch of every epoch, without Adam."""
    shape = material.chunk.shape

    def run(network: Any, parts: Batch) -> Any:
        def step(network: Any, part: Batch) -> tuple[Any, None]:
            down = jax.tree.map(lambda g: -TINY * g, gradient(network, part))
            return eqx.apply_updates(network, down), None

        def epoch(_: Any, network: Any) -> Any:
            return jax.lax.scan(step, network, parts)[0]

        return jax.lax.fori_loop(0, shape.epochs, epoch, network)

    return Loop(run, (network, material.parts), shape.epochs * shape.minibatches)


PIECES: dict[str, Callable[[Material], Loop]] = {
    "sensing": _sensing,
    "world": _stepping,
    SIGNALS: _signals,
    "policy forward": _acting,
    "value forward": _valuing,
    "policy gradient": _policy_gradient,
    "value gradient": _value_gradient,
}
"""The parts of an update, except advantages, shuffling, Adam and metrics; signals are part of the world."""
