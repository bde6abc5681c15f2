"""Builds the parts of a problem: its world, environment, networks and cascade."""

from __future__ import annotations

import math
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
from murmurate.learning import LEARNERS, PPOConfig, features_of
from murmurate.policies import ShieldWrapper
from murmurate.registry import Strategy
from murmurate.world import (
    SMOOTH_SIGNALS,
    Clock,
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
from murmurate.world.randomness import draw_each

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
        env = DeadZone(env, with_array_leaves(problem.slow_moves), perceived)
    return env


def build_networks(problem: Problem, key: PRNGKeyArray) -> tuple[Any, Any]:
    """Builds fresh policy and value networks."""
    check_problem(problem)
    networks = _networks(problem.policy, problem.world, problem.landmark, problem.sizes, key)
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
    template, _ = eqx.filter_eval_shape(_networks, problem.policy, problem.world, problem.landmark, problem.sizes, key)
    return (template,) * count


def check_parts(problem: Problem) -> None:
    """Checks that the strategies that are not of this package return what they should, once and before any training.

    Raises:
        InputError: One cannot be evaluated, returns another shape or type, or numbers that are not finite; ppo is to
            schedule the exploration of a policy without a spread; or a signal that gradients are to improve has none.
    """
    check_problem(problem)
    world = build_world(problem)
    for index in range(min(2, problem.discovery.max_policies)):
        for learner in problem.stage(index).learners:
            if LEARNERS[learner].needs_gradients:
                _check_gradients(problem, index, learner, world)
    robots, batch = problem.world.robots, 2
    each, moves, whole = _floats(robots, batch), _floats(robots, 2, batch), _floats(batch)
    positions = jnp.moveaxis(jnp.asarray(draw_starts(world.start, prng.key(problem.seed), batch, world.config)), 0, -1)
    for name, signal in world.objective.signals.items():
        if signal.is_foreign():

            def measure(signal: Signal = signal) -> tuple[Any, ...]:
                configuration = Configuration(positions, world.config)
                return signal(configuration), signal.value(configuration), signal.credit(configuration)

            expected = {"__call__ returns": each, "value returns": whole, "credit returns": each}
            _check(f"signals.{name}", signal, measure, expected)
    env = build_environment(problem, world)
    if problem.sensing.is_foreign() and problem.policy.perceives:

        def perceive() -> tuple[Any]:
            return (problem.sensing.perceived(Configuration(positions, world.config)),)

        pairs = jax.ShapeDtypeStruct((robots, robots, batch), jnp.bool_)
        _check("sensing", problem.sensing, perceive, {"perceived returns": pairs})
    if problem.scheduler.is_foreign():
        _check_scheduler(problem, positions)
    if problem.shield.is_foreign():

        def shorten() -> tuple[Any]:
            return (
                problem.prepared_shield(jnp.zeros_like(positions), env.observe(env.state(positions)), problem.world),
            )

        _check("shield", problem.shield, shorten, {"__call__ returns": moves})
    if problem.policy.is_foreign():
        _check_policy(problem, env, positions)


STRETCHES = ((1.0, 1.0), (0.3, 0.3), (0.1, 0.1), (10.0, 10.0), (1.0, 0.02))
"""Starts are stretched so along the axes to find out whether signals have gradients: some have only in a crowd, on a
line or far apart."""


def _check_gradients(problem: Problem, index: int, learner: str, world: World) -> None:
    """Checks that the signals that a policy is refined by have gradients.

    A signal that counts changes from one configuration to the next, but its gradient is 0 wherever it is defined.
    """
    drawn = jnp.moveaxis(jnp.asarray(draw_starts(world.start, prng.key(problem.seed), 4, world.config)), 0, -1)
    positions = jnp.concatenate([drawn * jnp.asarray(stretch)[:, None] for stretch in STRETCHES], axis=-1)
    signals, weights = problem.refinement(index, learner)
    section = f"{'base' if index == 0 else 'auxiliary'}.{learner}.weights"
    if LEARNERS[learner].searches_goals and not any(weights[name] for name in weights if name != "smooth_safety"):
        allowed = f"weights of signals with gradients, by which goals are searched (yours, {', '.join(SMOOTH_SIGNALS)})"
        raise InputError(section, weights, allowed)
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
            allowed = f"0: it has no gradient, because it counts (see {', '.join(SMOOTH_SIGNALS)})"
            raise InputError(f"{section}.{name}", weights[name], allowed)


def _check_policy(problem: Problem, env: World | Wrapper, positions: Float[Array, "robots 2 batch"]) -> None:
    robots, _, batch = positions.shape

    def act() -> tuple[Any, ...]:
        policy, value = problem.policy.networks(problem.world, problem.landmark, prng.key(problem.seed))
        observation = env.observe(env.state(positions))
        distribution = policy.distribution(features_of(policy, observation))
        action = distribution.sample(prng.key(problem.seed))
        return policy(observation), action, distribution.log_prob(action), value(features_of(policy, observation))

    moves, actions = _floats(robots, 2, batch), _floats(robots if problem.policy.credit == "robots" else 1, batch)
    expected = {"__call__": moves, "sample": moves, "log_prob": actions, "the value network": actions}
    _check("policy", problem.policy, act, {f"{what} returns": form for what, form in expected.items()})
    policy = policy_templates(problem, 1)[0]
    for index in range(min(2, problem.discovery.max_policies)):
        numbers = problem.stage(index).learning(0)
        scheduled = isinstance(numbers, PPOConfig) and numbers.exploration == "scheduled"
        if scheduled and not hasattr(policy, "log_std"):
            section = "base" if index == 0 else "auxiliary"
            raise InputError(f"{section}.ppo.exploration", "scheduled", "learned: the policy network has no log_std")


def _check_scheduler(problem: Problem, positions: Float[Array, "robots 2 batch"]) -> None:
    """Checks what the scheduler decides at the first step of an episode."""
    robots, _, batch = positions.shape
    clock = Clock(jnp.zeros(batch, jnp.int32), jnp.zeros((robots, batch), jnp.int32), positions)

    def activate() -> tuple[Any, ...]:
        activation = draw_each(problem.scheduler.activate, jax.random.split(prng.key(problem.seed), batch), clock)
        return tuple(getattr(activation, name) for name in limits)

    limits: dict[str, tuple[Any, float, float]] = {
        "active": (jnp.bool_, 0, 1),
        "pause": (jnp.int32, 0, math.inf),
        "delay": (jnp.int32, 0, _stated(problem.scheduler.max_delay)),
        "move_steps": (jnp.int32, 1, _stated(problem.scheduler.max_move_steps)),
        "completion": (jnp.float32, 0, 1),
    }
    expected = {
        f"activate returns {name}": jax.ShapeDtypeStruct((robots, batch), dtype)
        for name, (dtype, _, _) in limits.items()
    }
    _check("scheduler", problem.scheduler, activate, expected, [(low, high) for _, low, high in limits.values()])


def _stated(steps: int | None) -> float:
    return math.inf if steps is None else steps


def _floats(*shape: int) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, jnp.float32)


def _check(
    field: str,
    part: Strategy,
    function: Callable[[], tuple[Any, ...]],
    expected: Mapping[str, jax.ShapeDtypeStruct],
    limits: Sequence[tuple[float, float]] | None = None,
) -> None:
    """Evaluates a strategy and checks what it returns.

    Args:
        field: The field that chooses it, for messages.
        part: The strategy.
        function: Evaluates it.
        expected: Shape and type of each thing that it returns, by what messages say of it.
        limits: The least and the greatest value of each; by default any finite number is allowed.
    """
    try:
        result = eqx.filter_jit(function)()
    except InputError:
        raise
    except Exception as error:  # a user's class may raise anything
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        raise InputError(field, part.name, f"a class that can be evaluated ({reason})") from None
    limits = [(-math.inf, math.inf)] * len(expected) if limits is None else limits
    for (what, form), (low, high), value in zip(expected.items(), limits, result, strict=True):
        have = f"{getattr(value, 'dtype', type(value).__name__)}{list(getattr(value, 'shape', ()))}"
        if (getattr(value, "shape", None), getattr(value, "dtype", None)) != (form.shape, form.dtype):
            count, wanted = form.shape[-1], f"{form.dtype}{list(form.shape)}"
            raise InputError(field, part.name, f"a class whose {what} {wanted} for {count} configurations, not {have}")
        values = np.asarray(value)
        if not np.isfinite(values).all():
            raise InputError(field, part.name, f"a class whose {what} finite numbers")
        if (values < low).any() or (values > high).any():
            allowed = f"of at least {low:g}" + (f" and at most {high:g}" if math.isfinite(high) else "")
            raise InputError(field, part.name, f"a class whose {what} {allowed}")


@eqx.filter_jit
def _networks(
    policy: Any, world: WorldConfig, landmark: bool, sizes: tuple[int, ...], key: PRNGKeyArray
) -> tuple[Any, Any]:
    network, value = policy.networks(world, landmark, key)
    if policy.has_goals and sizes:
        network = network.with_sizes(sizes, jax.random.fold_in(key, len(sizes)))
    return network, value
