"""Builds the parts of a problem: its world, environment, networks and cascade."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate import prng
from murmurate.discovery.cascade import Cascade
from murmurate.discovery.problem import Problem, check_problem
from murmurate.errors import InputError
from murmurate.policies import ShieldWrapper
from murmurate.registry import Strategy
from murmurate.world import (
    Configuration,
    DeadZone,
    LocalObservation,
    SchedulerWrapper,
    Signal,
    Start,
    World,
    WorldConfig,
    Wrapper,
    check_start,
    draw_starts,
    with_array_leaves,
)

__all__ = ["build_cascade", "build_environment", "build_networks", "build_world", "check_parts", "policy_templates"]


def build_world(problem: Problem, start: Start | None = None) -> World:
    """Builds the world as evaluation measures it: the problem's start, and the signals' own weights.

    Args:
        problem: The problem.
        start: A prepared start to use instead of the problem's own.

    Raises:
        InputError: The start is not possible in this world.
    """
    check_problem(problem)
    start = check_start(problem.start, problem.world) if start is None else start
    return with_array_leaves(World.create(problem.world, start, problem.objective_signals))


def build_environment(problem: Problem, world: World, perceived: WorldConfig | None = None) -> World | Wrapper:
    """Puts the scheduler, the sensing, the shield and the dead zone of a problem around a world.

    Args:
        problem: The problem.
        world: The world.
        perceived: The sizes by which robots perceive the world and shields act: in training with a margin, those of the
            world without it.
    """
    check_problem(problem)
    perceived = world.config if perceived is None else perceived
    env: World | Wrapper = world
    if not problem.scheduler.is_trivial:
        env = SchedulerWrapper(env, problem.scheduler)
    if problem.policy.perceives:
        env = LocalObservation(env, problem.sensing, perceived)
    if not problem.shield.is_trivial:
        env = ShieldWrapper(env, with_array_leaves(problem.prepared_shield), perceived)
    if problem.rest.dead_zone:
        env = DeadZone(env, jnp.asarray(problem.least_speed, jnp.float32), problem.sidestep)
    return env


def build_networks(problem: Problem, key: PRNGKeyArray) -> tuple[Any, Any]:
    """Builds fresh policy and value networks."""
    check_problem(problem)
    networks = _networks(problem.policy, problem.world, problem.landmark, key)
    # An array made of a Python number is weakly typed: training would compile once more at its second chunk.
    return jax.tree.map(lambda x: jnp.asarray(x, x.dtype) if eqx.is_array(x) else x, networks)


def build_cascade(problem: Problem, policies: Sequence[Any], world: World | None = None) -> Cascade:
    """Returns the list of policies as it is executed.

    Args:
        problem: The problem.
        policies: The policy networks.
        world: The world of `build_world`, where it is built already.
    """
    check_problem(problem)
    world = build_world(problem) if world is None else world
    return Cascade(tuple(policies), build_environment(problem, world), problem.rest_in_steps)


@prng.reproducible()
def policy_templates(problem: Problem, count: int) -> tuple[Any, ...]:
    """Returns `count` policy networks without numbers, to load weights into."""
    check_problem(problem)
    key = jax.eval_shape(lambda: prng.key(0))
    template, _ = eqx.filter_eval_shape(_networks, problem.policy, problem.world, problem.landmark, key)
    return (template,) * count


def check_parts(problem: Problem) -> None:
    """Checks that the strategies that are not of this package return what they should, once and before any training.

    Raises:
        InputError: One cannot be evaluated, returns another shape or type, or numbers that are not finite; exploration
            is scheduled for a policy without a spread to schedule; or a signal that gradients are to improve has none.
    """
    check_problem(problem)
    world = build_world(problem)
    for index in range(min(2, problem.discovery.max_policies)):
        if problem.stage(index).learner == "gradients":
            _check_gradients(problem, index, world)
    robots, batch = problem.world.robots, 2
    positions = jnp.moveaxis(jnp.asarray(draw_starts(world.start, prng.key(problem.seed), batch, world.config)), 0, -1)
    each, pairs, whole = (robots, batch), (robots, robots, batch), (batch,)
    for name, signal in world.objective.signals.items():
        if signal.is_foreign():

            def measure(signal: Signal = signal) -> tuple[Any, ...]:
                configuration = Configuration(positions, world.config)
                return signal(configuration), signal.value(configuration), signal.credit(configuration)

            expected = {"__call__": each, "value": whole, "credit": each}
            _check(f"signals.{name}", signal, measure, expected)
    env = build_environment(problem, world)
    if problem.sensing.is_foreign() and problem.policy.perceives:

        def perceive() -> tuple[Any]:
            return (problem.sensing.perceived(Configuration(positions, world.config)),)

        _check("sensing", problem.sensing, perceive, {"perceived": pairs}, jnp.bool_)
    if problem.scheduler.is_foreign():

        def schedule() -> tuple[Any]:
            return (env.step(env.state(positions), jnp.zeros_like(positions))[0].positions,)

        _check("scheduler", problem.scheduler, schedule, {"activate": (robots, 2, batch)})
    if problem.shield.is_foreign():

        def shorten() -> tuple[Any]:
            return (
                problem.prepared_shield(jnp.zeros_like(positions), env.observe(env.state(positions)), problem.world),
            )

        _check("shield", problem.shield, shorten, {"__call__": (robots, 2, batch)})
    if problem.policy.is_foreign():
        _check_policy(problem, env, positions)


STRETCHES = ((1.0, 1.0), (0.3, 0.3), (0.1, 0.1), (10.0, 10.0), (1.0, 0.02))
"""Starts are stretched so along the axes to find out whether signals have gradients: some have only in a crowd, on a
line or far apart."""


def _check_gradients(problem: Problem, index: int, world: World) -> None:
    """Checks that the signals that a policy is refined by have gradients.

    A signal that counts changes from one configuration to the next, but its gradient is 0 wherever it is defined.
    """
    drawn = jnp.moveaxis(jnp.asarray(draw_starts(world.start, prng.key(problem.seed), 4, world.config)), 0, -1)
    positions = jnp.concatenate([drawn * jnp.asarray(stretch)[:, None] for stretch in STRETCHES], axis=-1)
    signals, weights = problem.refinement(index)
    section = f"{'base' if index == 0 else 'auxiliary'}.gradients.weights"
    for name, signal in signals.items():

        def measure(positions: Array, signal: Signal = signal) -> Array:
            return signal.value(Configuration(positions, world.config))

        def slopes(positions: Array, measure: Any = measure) -> tuple[Array, Array]:
            values, back = jax.vjp(measure, positions)
            return values, back(jnp.ones_like(values))[0]

        values, gradient = map(np.asarray, eqx.filter_jit(slopes)(positions))
        if not np.isfinite(gradient).all():
            allowed = "0: its gradient is not finite where robots have the same distance or place"
            raise InputError(f"{section}.{name}", weights[name], allowed)
        if not gradient.any() and np.ptp(values) > 0:
            allowed = "0: it has no gradient, because it counts (see smooth_visible, smooth_safety, compact, exposed)"
            raise InputError(f"{section}.{name}", weights[name], allowed)


def _check_policy(problem: Problem, env: World | Wrapper, positions: Float[Array, "robots 2 batch"]) -> None:
    robots, _, batch = positions.shape

    def act() -> tuple[Any, ...]:
        policy, value = problem.policy.networks(problem.world, problem.landmark, prng.key(problem.seed))
        observation = env.observe(env.state(positions))
        velocities = policy(observation)
        action = policy.distribution(observation).sample(prng.key(problem.seed))
        return velocities, action, policy.distribution(observation).log_prob(action), value(observation)

    actions = (robots if problem.policy.credit == "robots" else 1, batch)
    velocities = (robots, 2, batch)
    expected = {"__call__": velocities, "sample": velocities, "log_prob": actions, "the value network": actions}
    _check("policy", problem.policy, act, expected)
    policy = policy_templates(problem, 1)[0]
    for index, name in enumerate(("base", "auxiliary")):
        if problem.stage(index).ppo.exploration == "scheduled" and not hasattr(policy, "log_std"):
            raise InputError(f"{name}.ppo.exploration", "scheduled", "learned: the policy network has no log_std")


def _check(
    field: str, part: Strategy, function: Callable[[], tuple[Any, ...]], expected: Mapping[str, tuple], kind: Any = None
) -> None:
    """Evaluates a strategy and compares what it returns with the expected shapes and kind of numbers."""
    kind = jnp.floating if kind is None else kind
    try:
        result = eqx.filter_jit(function)()
    except InputError:
        raise
    except Exception as error:  # a user's class may raise anything
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        raise InputError(field, part.name, f"a class that can be evaluated ({reason})") from None
    for (what, shape), value in zip(expected.items(), result, strict=True):
        have = f"{getattr(value, 'dtype', type(value).__name__)}{list(getattr(value, 'shape', ()))}"
        name = "float" if kind is jnp.floating else "bool"
        wanted = f"a class whose {what} returns {name}{list(shape)} for {shape[-1]} configurations, not {have}"
        if getattr(value, "shape", None) != shape or not jnp.issubdtype(value.dtype, kind):
            raise InputError(field, part.name, wanted)
        if kind is jnp.floating and not np.isfinite(np.asarray(value)).all():
            raise InputError(field, part.name, f"a class whose {what} returns finite numbers")


@eqx.filter_jit
def _networks(policy: Any, world: WorldConfig, landmark: bool, key: PRNGKeyArray) -> tuple[Any, Any]:
    return policy.networks(world, landmark, key)
