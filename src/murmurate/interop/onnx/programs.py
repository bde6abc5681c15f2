"""What leaves as an ONNX model, as functions of arrays whose batch is the FIRST axis, as everybody else has it.

A model takes and gives float32. What it computes for each kind of policy:

- `central`, `equivariant`: velocities `(batch, robots, 2)` of positions `(batch, robots, 2)`.
- `local`: the velocity `(batch, 2)` of one robot from what it alone perceives, `(batch, others, 2)`, in its own frame.
- a cascade: the velocities of the policy that is in charge, and what it has to remember until the next step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from murmurate.errors import InputError
from murmurate.policies.local import LocalNetwork
from murmurate.runs.run import Run
from murmurate.types import Observation, View
from murmurate.world import Configuration, Objective

__all__ = ["LARGEST", "Program", "cascade", "objective", "policy"]

LARGEST = 256
"""Largest swarm that a cascade for any number of robots serves: its memory holds that swarm's window of rest."""

_CHARGE, _SINCE, _OBJECTIVE, _CHANGES = 0, 1, 2, 3
"""Columns of a cascade's memory; the changes fill the rest."""


@dataclass(frozen=True)
class Program:
    """A function to be exported.

    Attributes:
        function: The function itself: arrays in, a tuple of arrays out.
        inputs: Shape of each input by name; `batch` and `robots` or `others` stand for any number.
        outputs: Names of the outputs.
        about: What whoever runs it should know, by name.
    """

    function: Callable[..., tuple[Array, ...]]
    inputs: dict[str, tuple[int | str, ...]]
    outputs: tuple[str, ...]
    about: dict[str, str]


class _Scale(NamedTuple):
    """All that depends on how large the swarm is."""

    half_width: Any
    half_height: Any
    scan_radius: Any
    tolerance: Any
    switch_tolerance: Any
    max_steps: Any
    window: Any


def policy(run: Run, index: int) -> Program:
    """Returns the program of one policy of a run.

    Args:
        run: The run.
        index: The policy's place in the list.

    Raises:
        InputError: There is no policy at that place.
    """
    policies = run.cascade.policies
    if not 0 <= index < len(policies):
        allowed = "0, the only policy" if len(policies) == 1 else f"0 to {len(policies) - 1}"
        raise InputError("--policy", index, f"{allowed} of {run.folder}")
    chosen = policies[index]
    about = {**_about(run), "policies": str(index)}
    if isinstance(chosen, LocalNetwork):
        return _local(chosen, run, about)
    return Program(
        lambda positions: (_batch_first(chosen(_batch_last(positions))),),
        {"positions": ("batch", _robots(run), 2)},
        ("velocities",),
        {**about, "positions": "of all robots, world units", "velocities": "world units per step"},
    )


def cascade(run: Run) -> Program:
    """Returns the program of a run's whole cascade, which remembers from one step to the next.

    Raises:
        InputError: The robots act on what they alone perceive, and several policies follow each other: no robot alone
            can tell when the swarm is at rest.
    """
    policies = run.cascade.policies
    if run.experiment.policy.perceives:
        if len(policies) > 1:
            raise InputError(
                "--policy", None, f"0 to {len(policies) - 1}: no robot alone can tell when the next begins"
            )
        return policy(run, 0)
    scale = _scale(run)
    count, width = len(policies), _longest_window(run)

    def step(positions: Array, memory: Array) -> tuple[Array, Array]:
        inner, sizes = _batch_last(positions), scale(positions.shape[1])
        now = _objective(run, inner, sizes)
        charge, since, changes = _remembered(memory, now, count, sizes)
        velocities = jnp.zeros_like(inner)
        for index, one in enumerate(policies):
            velocities = jnp.where(charge == index, one(inner), velocities)
        active = charge < count
        columns = [charge, since + active, now]
        after = jnp.concatenate([jnp.stack(columns, axis=1), changes], axis=1)
        return _batch_first(velocities), after

    about = {
        **_about(run),
        "policies": ", ".join(map(str, range(count))),
        "positions": "of all robots, world units",
        "velocities": "world units per step; 0 once the swarm is at rest",
        "memory": "zeros at first, then what the step before gave; "
        f"its first number is the policy in charge, {count} at rest",
    }
    memory = ("batch", _CHANGES + width)
    return Program(step, {"positions": ("batch", _robots(run), 2), "memory": memory}, ("velocities", "after"), about)


def objective(run: Run, positions: Float[np.ndarray, "batch robots 2"]) -> Float[np.ndarray, " batch"]:
    """Returns the objective of configurations, all weights 1, as a cascade measures it."""
    return np.asarray(_objective(run, _batch_last(jnp.asarray(positions)), _scale(run)(positions.shape[1])))


def _local(chosen: LocalNetwork, run: Run, about: dict[str, str]) -> Program:
    world = chosen.world
    inputs: dict[str, tuple[int | str, ...]] = {"others": ("batch", "others", 2)}
    if chosen.landmark:
        inputs["point"] = ("batch", 2)
    if run.experiment.sensing.walls:
        inputs["walls"] = ("batch", 4, 2)

    def act(others: Array, *more: Array) -> tuple[Array]:
        told = dict(zip(list(inputs)[1:], more, strict=True))
        x, y = (jnp.transpose(others[:, :, axis])[None] for axis in (0, 1))
        # Whoever is where the robot itself is fills up a batch of views of unequal length.
        seen = (x != 0) | (y != 0)
        where = jnp.transpose(told["point"]) if "point" in told else jnp.zeros_like(jnp.transpose(others[:, 0]))
        walls = jnp.moveaxis(told["walls"], 0, -1)[None] if "walls" in told else None
        one = jnp.ones_like(x[:, 0])
        view = View(x, y, seen, world.radius * one, where[0] * one, where[1] * one, walls)
        # An acting policy looks at its view alone; the rest of an observation serves training.
        nothing = jnp.zeros((1, 2, 1), x.dtype)
        velocity = chosen(Observation(view, nothing, nothing[:, 0]))
        return (jnp.transpose(velocity[0]),)

    words = {
        "others": "those that the robot perceives, from where it is, in its own frame, "
        f"robots' radius {world.radius:g}; (0, 0) is nobody",
        "velocity": "in its own frame, world units per step",
    }
    if "walls" in inputs:
        words["walls"] = "the nearest point of each wall, likewise, opposite walls two places apart"
    return Program(act, inputs, ("velocity",), {**about, **words})


def _remembered(memory: Array, objective: Array, count: int, sizes: _Scale) -> tuple[Array, Array, Array]:
    """Says which policy is in charge now, for how many steps it has been, and the last changes of the objective.

    As `discovery.cascade` does it, but a step later: a change is known when the next configuration is.
    """
    charge, since, changes = memory[:, _CHARGE], memory[:, _SINCE], memory[:, _CHANGES:]
    change = jnp.abs(objective - memory[:, _OBJECTIVE])
    begun = since > 0
    shifted = jnp.concatenate([changes[:, 1:], change[:, None]], axis=1)
    last = charge == count - 1
    tolerance = jnp.where(last, sizes.tolerance, sizes.switch_tolerance)
    width = shifted.shape[1]
    in_window = jnp.arange(width) >= width - sizes.window
    mean = jnp.sum(jnp.where(in_window, shifted, 0.0), axis=1) / sizes.window
    rested = (since >= sizes.window) & (mean < tolerance)
    over = begun & (charge < count) & (rested | (since >= sizes.max_steps))
    return charge + over, jnp.where(over, 0.0, since), jnp.where(begun[:, None], shifted, changes)


def _objective(run: Run, positions: Float[Array, "robots 2 batch"], sizes: _Scale) -> Float[Array, " batch"]:
    """Measures the objective as the cascade does, in the world that a swarm of that size has."""
    experiment = run.experiment
    world = experiment.world
    sizes_of_world = (sizes.half_width, sizes.half_height, sizes.scan_radius)
    world = eqx.tree_at(lambda w: (w.half_width, w.half_height, w.scan_radius), world, sizes_of_world)
    objective = Objective(experiment.objective_signals)
    return objective(objective.measure(Configuration(positions, world)))


def _scale(run: Run) -> Callable[[Any], _Scale]:
    """Returns what depends on the swarm's size, as a function of the size."""
    experiment = run.experiment

    def of(problem: Any) -> _Scale:
        rest, world = problem.rest_in_steps, problem.world
        return _Scale(
            world.half_width,
            world.half_height,
            world.scan_radius,
            rest.tolerance,
            rest.switch_tolerance,
            rest.max_steps,
            rest.window,
        )

    if isinstance(_robots(run), int):
        own = of(experiment)
        return lambda robots: own
    table = np.array([of(experiment.of_size(robots)) for robots in range(2, LARGEST + 1)], np.float32)

    def looked_up(robots: Any) -> _Scale:
        return _Scale(*jnp.asarray(table)[jnp.asarray(robots) - 2])

    return looked_up


def _longest_window(run: Run) -> int:
    """Returns over how many steps the largest swarm that the model serves has to rest."""
    largest = run.experiment if isinstance(_robots(run), int) else run.experiment.of_size(LARGEST)
    return largest.rest_in_steps.window


def _robots(run: Run) -> int | str:
    """The axis of robots: a number where a policy knows them by number, any number otherwise."""
    return run.experiment.world.robots if not run.experiment.policy.any_size else "robots"


def _about(run: Run) -> dict[str, str]:
    world = run.experiment.world
    return {
        "experiment": run.experiment.name,
        "kind": run.experiment.policy.name,
        "robots": str(world.robots),
        "radius": f"{world.radius:g}",
        "max_speed": f"{world.max_speed:g}",
        "safe_distance": f"{world.safe_distance:g}",
    }


def _batch_last(positions: Float[Array, "batch robots 2"]) -> Float[Array, "robots 2 batch"]:
    return jnp.moveaxis(positions, 0, -1)


def _batch_first(velocities: Float[Array, "robots 2 batch"]) -> Float[Array, "batch robots 2"]:
    return jnp.moveaxis(velocities, -1, 0)
