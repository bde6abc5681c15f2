"""What is exported as an ONNX model: functions of float32 arrays whose FIRST axis is the batch.

- A policy that acts on all positions: velocities `(batch, robots, 2)` from positions `(batch, robots, 2)`.
- A policy that acts on each robot's own view: the velocity `(batch, 2)` of one robot from what it alone perceives,
  `(batch, others, 2)`, in its own frame.
- A cascade: the velocities of its active policy, and the memory to pass to the next step.

The dead zone and the shield of a run are part of its programs. Its scheduler is not: it says when a robot looks, and
then the robot runs the model. A program that contains classes of a user's own is for swarms of the run's own size,
because such a class need not work with a symbolic number of robots.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from murmurate.discovery.rest import RestLimits, all_still, has_ended
from murmurate.errors import InputError
from murmurate.registry import Strategy
from murmurate.runs import config_io
from murmurate.runs.run import Run
from murmurate.types import Observation, View
from murmurate.world import Configuration, Objective, WorldConfig, apply_dead_zone

__all__ = ["MAX_ROBOTS", "MIN_ROBOTS", "TABLE_SHAPE", "Program", "cascade_program", "objective", "policy_program"]

MIN_ROBOTS = 2
"""Smallest swarm that has an objective: a robot alone has neither neighbours nor distances."""

MAX_ROBOTS = 256
"""Largest swarm for which a cascade for any number of robots works: its memory holds that swarm's window of rest."""

POSITIONS = "of all robots, world units"
VELOCITIES = "world units per step, within the speed limit"

_ACTIVE_POLICY, _STEPS_ACTIVE, _STILL_STEPS, _OBJECTIVE, _CHANGES = 0, 1, 2, 3, 4
"""Columns of a cascade's memory; the recent changes of the objective fill the rest."""


@dataclass(frozen=True)
class Program:
    """A function to be exported.

    Attributes:
        function: The function: arrays in, a tuple of arrays out.
        inputs: Shape of each input by name; `batch`, `robots` and `others` stand for any number.
        outputs: Names of the outputs.
        metadata: What a user of the model should know, by name.
        foreign: The parts that are classes of a user's own, by the field of the configuration that names them.
        policy: Place of the only policy; None for a cascade, which has memory.
    """

    function: Callable[..., tuple[Array, ...]]
    inputs: Mapping[str, tuple[int | str, ...]]
    outputs: tuple[str, ...]
    metadata: Mapping[str, str]
    foreign: Mapping[str, Strategy]
    policy: int | None = None

    @functools.cached_property
    def jitted(self) -> Callable[..., tuple[Array, ...]]:
        """The function, compiled once for each shape of its inputs."""
        return jax.jit(self.function)


def policy_program(run: Run, index: int) -> Program:
    """Returns the program of one policy of a run.

    Args:
        run: The run.
        index: Place of the policy in the list.

    Raises:
        InputError: There is no policy at that place.
    """
    policies = run.cascade.policies
    if not 0 <= index < len(policies):
        allowed = "0, the only policy" if len(policies) == 1 else f"0 to {len(policies) - 1}"
        raise InputError("--policy", index, f"{allowed} of {run.folder}")
    policy, experiment = policies[index], run.experiment
    foreign = _foreign(policy=experiment.policy, shield=experiment.shield)
    if experiment.policy.perceives:
        return _view_program(run, index, foreign)
    robots = _robots(run, foreign)
    # Without a shield, velocities do not depend on the sides of the world, and there is no limit to the swarm's size.
    sizes = None if experiment.shield.is_trivial else _sizes(run, foreign)

    def act(positions: Array) -> tuple[Array]:
        world = experiment.world if sizes is None else sizes(positions.shape[1])[0]
        return (_batch_first(_shielded(run, policy, _batch_last(positions), world)),)

    metadata = _metadata(run, str(index), positions=POSITIONS, velocities=VELOCITIES)
    return Program(act, {"positions": ("batch", robots, 2)}, ("velocities",), metadata, foreign, index)


def cascade_program(run: Run) -> Program:
    """Returns the program of a run's whole cascade, which carries its memory from step to step.

    Raises:
        InputError: The robots act on their own views, and there are several policies: no robot alone can tell when the
            swarm is at rest.
    """
    policies, experiment = run.cascade.policies, run.experiment
    count = len(policies)
    if experiment.policy.perceives:
        if count > 1:
            raise InputError("--policy", None, f"0 to {count - 1}: no robot alone can tell when the next begins")
        return policy_program(run, 0)
    signals = {f"signals.{name}": signal for name, signal in experiment.objective_signals.items()}
    foreign = _foreign(policy=experiment.policy, shield=experiment.shield, **signals)
    robots, sizes = _robots(run, foreign), _sizes(run, foreign)
    # In a larger world, rest must last longer: the memory is as wide as the longest window.
    largest = experiment if isinstance(robots, int) else experiment.of_size(MAX_ROBOTS)
    width = largest.rest_in_steps.window

    def step(positions: Array, memory: Array) -> tuple[Array, Array]:
        inner, (world, limits) = _batch_last(positions), sizes(positions.shape[1])
        value = _objective(run, inner, world)
        active_policy, steps_active, still_steps, changes = _recall(memory, value, count, limits)
        velocities = jnp.zeros_like(inner)
        for index, policy in enumerate(policies):
            velocities = jnp.where(active_policy == index, _shielded(run, policy, inner, world), velocities)
        is_still = all_still(velocities, experiment.rest.stillness, world.radius)
        still_steps = jnp.where(is_still, still_steps + 1, 0.0)
        columns = [active_policy, steps_active + (active_policy < count), still_steps, value]
        after = jnp.concatenate([jnp.stack(columns, axis=1), changes], axis=1)
        return _batch_first(velocities), after

    metadata = _metadata(
        run,
        ", ".join(map(str, range(count))),
        positions=POSITIONS,
        velocities=f"{VELOCITIES}; 0 once the swarm is at rest",
        memory="zeros at first, then `after` of the step before; "
        f"its first number is the active policy, {count} at rest",
    )
    inputs = {"positions": ("batch", robots, 2), "memory": ("batch", _CHANGES + width)}
    return Program(step, inputs, ("velocities", "after"), metadata, foreign)


def objective(run: Run, positions: Float[np.ndarray, "batch robots 2"]) -> Float[np.ndarray, " batch"]:
    """Returns the objective of configurations with the signals' own weights, as a cascade measures it."""
    robots = positions.shape[1]
    world = run.experiment.world if robots == run.experiment.world.robots else run.experiment.of_size(robots).world
    measure = jax.jit(lambda positions: _objective(run, _batch_last(positions), world))
    return np.asarray(measure(jnp.asarray(positions)))


def _view_program(run: Run, index: int, foreign: Mapping[str, Strategy]) -> Program:
    """Returns the program of one robot that acts on its own view."""
    policy, experiment = run.cascade.policies[index], run.experiment
    world = experiment.world
    others: int | str = world.robots - 1 if foreign else "others"
    inputs: dict[str, tuple[int | str, ...]] = {"others": ("batch", others, 2)}
    about = {
        "others": "positions of the robots that the robot perceives, relative to itself, in its own frame, in a unit "
        f"in which a robot's radius is {world.radius:g}; (0, 0) stands for no robot",
        "sensing": f"{experiment.sensing.name}: what the robots perceived in training",
        "velocity": "in the robot's own frame, world units per step",
    }
    if experiment.landmark:
        inputs["point"] = ("batch", 2)
        about["point"] = "the gathering point, in the same coordinates"
    if experiment.sensing.sees_walls(experiment.world):
        inputs["walls"] = ("batch", 4, 2)
        about["walls"] = "the nearest point of each wall, in the same coordinates, opposite walls two places apart"

    def act(others: Array, *further: Array) -> tuple[Array]:
        given = dict(zip(list(inputs)[1:], further, strict=True))
        x, y = (jnp.transpose(others[:, :, axis])[None] for axis in (0, 1))
        seen = (x != 0) | (y != 0)
        ones = jnp.ones_like(x.sum(axis=1))  # by a sum, because there may be no first one of the others
        point = jnp.transpose(given["point"]) if "point" in given else jnp.zeros_like(jnp.transpose(others.sum(axis=1)))
        walls = jnp.moveaxis(given["walls"], 0, -1)[None] if "walls" in given else None
        view = View(x, y, seen, world.radius * ones, point[0] * ones, point[1] * ones, walls)
        # NaN in place of what a robot cannot know: a policy that uses it is found out by its velocity.
        unknown = jnp.full((1, 2, *ones.shape[1:]), jnp.nan, x.dtype)
        observation = Observation(view, unknown, unknown[:, 0])
        wanted = apply_dead_zone(policy(observation), observation, experiment.slow_moves, world)
        velocity = experiment.prepared_shield(wanted, observation, world)
        return (jnp.transpose(velocity[0]),)

    return Program(act, inputs, ("velocity",), _metadata(run, str(index), **about), foreign, index)


_SCALED = ("half_width", "half_height", "scan_radius")
"""What of a world depends on the number of robots."""

_scaled_lengths = operator.attrgetter(*_SCALED)

TABLE_SHAPE = (MAX_ROBOTS - MIN_ROBOTS + 1, len(_SCALED) + len(RestLimits._fields))
"""Shape of the table of everything that depends on the number of robots."""


def _sizes(run: Run, foreign: Mapping[str, Strategy]) -> Callable[[Any], tuple[WorldConfig, RestLimits]]:
    """Returns the world and the limits of rest as a function of the number of robots."""
    experiment = run.experiment
    if isinstance(_robots(run, foreign), int):
        return lambda robots: (experiment.world, RestLimits.from_rule(experiment.rest_in_steps))
    # The number of robots is known when the model runs: what depends on it is looked up in a table.
    problems = (experiment.of_size(robots) for robots in range(MIN_ROBOTS, MAX_ROBOTS + 1))
    rows = [(*_scaled_lengths(problem.world), *RestLimits.from_rule(problem.rest_in_steps)) for problem in problems]
    table = np.array(rows, np.float32)

    def look_up(robots: Any) -> tuple[WorldConfig, RestLimits]:
        index = jnp.asarray(robots) - MIN_ROBOTS
        # A negative index would count from the end; behind the end, the model fails.
        row = tuple(jnp.asarray(table)[jnp.where(index < 0, len(table), index)])
        lengths, limits = row[: len(_SCALED)], row[len(_SCALED) :]
        return eqx.tree_at(_scaled_lengths, experiment.world, lengths), RestLimits(*limits)

    return look_up


def _robots(run: Run, foreign: Mapping[str, Strategy]) -> int | str:
    """Returns the length of the robots' axis: a number, or `robots` for any number."""
    fixed = bool(foreign) or not run.experiment.policy.any_size
    return run.experiment.world.robots if fixed else "robots"


def _foreign(**parts: Strategy) -> dict[str, Strategy]:
    return {field: part for field, part in parts.items() if part.is_foreign()}


def _shielded(
    run: Run, policy: Any, positions: Float[Array, "robots 2 batch"], world: WorldConfig
) -> Float[Array, "robots 2 batch"]:
    """Returns the velocities of a policy as they are executed: after dead zone and shield, within the speed limit."""
    wanted = apply_dead_zone(policy(positions), positions, run.experiment.slow_moves, world)
    velocities = run.experiment.prepared_shield(wanted, positions, world)
    return jnp.clip(velocities, -world.max_speed, world.max_speed)


def _recall(memory: Array, objective: Array, count: int, limits: RestLimits) -> tuple[Array, Array, Array, Array]:
    """Returns the active policy, for how many steps it has been active and all robots still, and the recent changes.

    A policy ends as in `discovery.cascade`, one step later: a change is known with the next configuration. How far
    robots move is what the policy decides.
    """
    active_policy, steps_active = memory[:, _ACTIVE_POLICY], memory[:, _STEPS_ACTIVE]
    changes = memory[:, _CHANGES:]
    change = jnp.abs(objective - memory[:, _OBJECTIVE])
    has_moved = steps_active > 0
    shifted = jnp.concatenate([changes[:, 1:], change[:, None]], axis=1)
    still_steps, is_last = memory[:, _STILL_STEPS], active_policy == count - 1
    width = shifted.shape[1]
    in_window = jnp.arange(width) >= width - limits.window
    mean = jnp.sum(jnp.where(in_window, shifted, 0.0), axis=1) / limits.window
    _, ended = has_ended(is_last, still_steps, mean, steps_active, limits)
    over = has_moved & (active_policy < count) & ended
    return (
        active_policy + over,
        jnp.where(over, 0.0, steps_active),
        jnp.where(over, 0.0, still_steps),
        jnp.where(has_moved[:, None], shifted, changes),
    )


def _objective(run: Run, positions: Float[Array, "robots 2 batch"], world: WorldConfig) -> Float[Array, " batch"]:
    signals = Objective(run.experiment.objective_signals)
    return signals(signals.measure(Configuration(positions, world)))


def _metadata(run: Run, policies: str, **about: str) -> dict[str, str]:
    experiment, world = run.experiment, run.experiment.world
    parts = {"policy": experiment.policy, "shield": experiment.shield, "scheduler": experiment.scheduler}
    # As the scheduler needs it: a robot may run the model under this scheduler, and under no slower one.
    _, *shield_fields = config_io.to_dict(experiment.prepared_shield).items()
    return {
        "experiment": experiment.name,
        **{name: part.name for name, part in parts.items()},
        **{f"shield.{name}": str(value) for name, value in shield_fields},
        "policies": policies,
        "robots": str(world.robots),
        "radius": f"{world.radius:g}",
        "max_speed": f"{world.max_speed:g}",
        "safe_distance": f"{world.safe_distance:g}",
        "scan_radius": f"{world.scan_radius:g}",
        **about,
    }


def _batch_last(positions: Float[Array, "batch robots 2"]) -> Float[Array, "robots 2 batch"]:
    return jnp.moveaxis(positions, 0, -1)


def _batch_first(velocities: Float[Array, "robots 2 batch"]) -> Float[Array, "batch robots 2"]:
    return jnp.moveaxis(velocities, -1, 0)
