"""What is timed: our world, our training of both policies, and JaxMARL's nearest environment beside them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from benchmarks.timing import Case
from murmurate.discovery import Discovery
from murmurate.experiments import presets
from murmurate.experiments.config import ExperimentConfig
from murmurate.learning import restarting_step

__all__ = ["JAXMARL", "Size", "all_cases"]

JAXMARL = "JaxMARL `MPE_simple_spread_v3`"
EXPERIMENT = "C"
SPEED = 0.2
"""Bound on the random velocities of the timed steps, as a share of the speed limit: a swarm that stays in the world."""


@dataclass(frozen=True)
class Size:
    """How much is timed.

    Attributes:
        worlds: Numbers of worlds that step side by side.
        steps: Steps of each of them in one run.
        training: Fields of `PPOConfig` to replace in the timed training.
    """

    worlds: Sequence[int] = (256, 1024)
    steps: int = 200
    training: dict[str, int] | None = None


def all_cases(size: Size) -> list[Case]:
    """Returns every case; JaxMARL's only where it is installed."""
    cases = []
    for worlds in size.worlds:
        cases += [stepping(worlds, size.steps), stepping(worlds, size.steps, restart=True)]
        if _jaxmarl():
            cases.append(jaxmarl_stepping(worlds, size.steps))
    return cases + [training(kind, size.training or {}) for kind in ("equivariant", "central")]


def stepping(worlds: int, steps: int, restart: bool = False) -> Case:
    """The world of ten robots with all its signals, with or without beginning new episodes."""

    def prepare() -> Callable[[], Any]:
        world = Discovery(presets.preset(EXPERIMENT)).world
        state = jax.jit(lambda world, key: world.reset_batch(key, worlds))(world, jax.random.key(0))
        # Episodes of all ages, so that some end at every step.
        ages = jax.random.randint(jax.random.key(1), (worlds,), 0, world.horizon, jnp.int32)
        state = eqx.tree_at(lambda s: s.step, state, ages)
        bound = SPEED * world.max_speed
        velocities = jax.random.uniform(jax.random.key(2), (steps, *state.positions.shape), minval=-bound, maxval=bound)
        keys = jax.random.split(jax.random.key(3), steps)

        def one(world: Any, state: Any, velocities: Any, key: Any) -> tuple[Any, Any]:
            return restarting_step(world, state, velocities, key)[:2] if restart else world.step(state, velocities)

        @jax.jit
        def run(world: Any, state: Any, velocities: Any, keys: Any) -> Any:
            return jax.lax.scan(lambda state, now: one(world, state, *now), state, (velocities, keys))

        return lambda: run(world, state, velocities, keys)

    name = "world step, all signals" + (", ended episodes begun anew" if restart else "")
    return Case(name, worlds, worlds * steps, prepare)


def training(kind: str, numbers: dict[str, int]) -> Case:
    """The first chunk of the base policy's training, as `murmurate discover` runs it."""
    config: ExperimentConfig = presets.resolve(EXPERIMENT, {"policy": {"kind": kind}, "base": {"ppo": numbers}})
    stage = config.base

    def prepare() -> Callable[[], Any]:
        discovery = Discovery(config)
        begin = discovery.begin()
        begin = replace(begin, train=discovery.template(begin))
        return lambda: discovery.advance(begin)[0].train

    pace = f", an action every {stage.repeat} steps" if stage.repeat > 1 else ""
    updates = min(config.discovery.chunk, stage.ppo.updates)
    return Case(f"training, {kind} policy{pace}", stage.ppo.worlds, updates * stage.steps_per_update, prepare)


def jaxmarl_stepping(worlds: int, steps: int) -> Case:
    """JaxMARL's simple spread with ten agents, vectorised over worlds; a step begins ended episodes anew."""

    def prepare() -> Callable[[], Any]:
        env = _jaxmarl().make("MPE_simple_spread_v3", num_agents=10)
        keys = jax.random.split(jax.random.key(0), (steps, worlds))
        actions = jax.random.randint(jax.random.key(1), (steps, env.num_agents, worlds), 0, 5)
        state = jax.jit(jax.vmap(env.reset))(keys[0])[1]

        def one(state: Any, now: tuple[Any, Any]) -> tuple[Any, Any]:
            key, action = now
            by_agent = dict(zip(env.agents, action, strict=True))
            # Its observations are not asked for, so XLA leaves them out: to JaxMARL's advantage.
            _, state, reward, done, _ = jax.vmap(env.step)(key, state, by_agent)
            return state, (reward, done["__all__"])

        run = jax.jit(lambda state, keys, actions: jax.lax.scan(one, state, (keys, actions)))
        return lambda: run(state, keys, actions)

    return Case(JAXMARL, worlds, worlds * steps, prepare)


def _jaxmarl() -> Any:
    """Returns the package, or None where it is not installed."""
    try:
        import jaxmarl
    except ImportError:
        return None
    return jaxmarl
