"""ONNX models of policies and cascades, checked against what they were made of."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import export as jax_export
from jax.extend.core import jaxpr_as_fun

from murmurate.geometry import visible
from murmurate.interop import missing_extra
from murmurate.interop.onnx import programs
from murmurate.interop.onnx.programs import Program
from murmurate.runs.run import Run
from murmurate.world import WorldConfig

try:
    import jax2onnx
    import onnxruntime
except ModuleNotFoundError as error:
    raise missing_extra("onnx") from error

__all__ = ["CHECKED", "TOLERANCE", "Model", "export"]

CHECKED = 1000
"""Configurations on which a model is compared with what it was made of."""

TOLERANCE = 1e-5
"""Greatest difference of velocities that passes, world units per step."""

OTHERS = (2, 3, 5, 12)
"""Other swarm sizes on which a model that takes any is compared."""

EPISODES = 8
"""Episodes of the run whose configurations are among these."""


@dataclass(frozen=True)
class Model:
    """An ONNX model.

    Attributes:
        data: The contents of the file.
        program: What it was made of.
    """

    data: bytes
    program: Program

    def session(self) -> Any:
        """Opens the model with onnxruntime, as whoever receives the file would."""
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 3  # of unused constants it would warn
        return onnxruntime.InferenceSession(self.data, options, providers=["CPUExecutionProvider"])

    def difference(self, run: Run, configurations: int = CHECKED, seed: int = 0) -> float:
        """Runs the model beside what it was made of, and returns the greatest difference of velocities.

        Configurations are random ones and those that the run's swarms pass on their way to a pattern; where the model
        takes any number of robots, also random ones of two to twelve.

        Args:
            run: The run that was exported.
            configurations: How many, about equally many of each swarm size.
            seed: Seed of the starts.
        """
        session, ours = self.session(), jax.jit(self.program.function)
        greatest = 0.0
        for inputs in _samples(run, self.program, configurations, seed):
            theirs = session.run(None, inputs)
            expected = ours(*map(jnp.asarray, inputs.values()))
            for one, other in zip(theirs, expected, strict=True):
                greatest = max(greatest, float(np.abs(one - np.asarray(other)).max()))
        return greatest


def export(run: Run, index: int | None = None) -> Model:
    """Makes an ONNX model of a run's cascade, or of one of its policies.

    Args:
        run: The run.
        index: The place of the policy; None for the whole cascade.

    Raises:
        InputError: There is no policy at that place, or the cascade cannot be executed by robots on their own.
    """
    program = programs.cascade(run) if index is None else programs.policy(run, index)
    specs = _specs(program)
    # jax2onnx replaces functions of jax.numpy by its own while it traces, and those do not know of swarms of any size:
    # it is given the program in JAX's own primitives.
    traced = jax.make_jaxpr(program.function)(*specs)
    with _quiet():
        proto = jax2onnx.to_onnx(
            lambda *inputs: tuple(jaxpr_as_fun(traced)(*inputs)),
            inputs=specs,
            model_name="murmurate",
            input_names=list(program.inputs),
            output_names=list(program.outputs),
        )
    for name, text in program.about.items():
        proto.metadata_props.add(key=name, value=text)
    return Model(proto.SerializeToString(), program)


def _specs(program: Program) -> list[jax.ShapeDtypeStruct]:
    """Returns the inputs' shapes, with a symbol for what may be any number."""
    names = sorted({axis for shape in program.inputs.values() for axis in shape if isinstance(axis, str)})
    symbols: dict[int | str, Any] = dict(zip(names, jax_export.symbolic_shape(", ".join(names)), strict=True))
    shapes = [tuple(symbols.get(axis, axis) for axis in shape) for shape in program.inputs.values()]
    return [jax.ShapeDtypeStruct(shape, jnp.float32) for shape in shapes]


def _samples(run: Run, program: Program, configurations: int, seed: int) -> Iterator[dict[str, np.ndarray]]:
    """Draws inputs: of the run's own swarm, and where others fit too, of others."""
    rng = np.random.default_rng(seed)
    own = run.experiment.world.robots
    sizes = [own] if own in program.inputs[next(iter(program.inputs))] else [own, *OTHERS]
    for robots in sizes:
        positions = _positions(run, robots, -(-configurations // len(sizes)), rng)
        inputs = {"positions": positions, "others": _view(run, positions, rng)}
        if "memory" in program.inputs:
            inputs["memory"] = _memory(run, positions, int(program.inputs["memory"][1]), rng)
        if "point" in program.inputs:
            inputs["point"] = -positions[:, 0]
        if "walls" in program.inputs:
            inputs["walls"] = _walls(run.experiment.of_size(robots).world, positions[:, 0])
        yield {name: inputs[name].astype(np.float32) for name in program.inputs}


def _positions(run: Run, robots: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draws configurations: half of the run's own as it passes them on its way to a pattern, all others at random."""
    world = run.experiment.world
    side = world.safe_distance * np.sqrt(robots) * rng.uniform(0.5, 2, (count, 1, 1))
    positions = side * rng.uniform(-1, 1, (count, robots, 2))
    if robots == world.robots:
        passed = run.rollout(EPISODES, int(rng.integers(2**31))).positions
        passed = passed.reshape(-1, robots, 2)
        half = count // 2
        positions[:half] = passed[rng.choice(len(passed), half)]
    return positions


def _view(run: Run, positions: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Returns what the first robot of each configuration sees of the others, turned at random."""
    world = run.experiment.world
    others = positions[:, 1:] - positions[:, :1]
    seen = visible(positions, world.radius, world.scan_radius)[:, 0, 1:]
    angle = rng.uniform(0, 2 * np.pi, len(positions))
    turn = np.moveaxis(np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]), -1, 0)
    return np.where(seen[..., None], others @ turn, 0.0)


def _walls(world: WorldConfig, position: np.ndarray) -> np.ndarray:
    """Returns the nearest point of each wall from where a robot is."""
    corner = np.array([world.half_width, world.half_height])
    x, y = np.clip(position, -corner, corner).T
    nothing = np.zeros_like(x)
    ways = [(world.half_width - x, nothing), (nothing, world.half_height - y)]
    ways += [(-world.half_width - x, nothing), (nothing, -world.half_height - y)]
    return np.moveaxis(np.array(ways), -1, 0)


def _memory(run: Run, positions: np.ndarray, width: int, rng: np.random.Generator) -> np.ndarray:
    """Draws memories such that policies change over, or do not."""
    rest, count = run.experiment.rest_in_steps, len(positions)
    charge = rng.integers(0, len(run.cascade.policies) + 1, count)
    since = rng.integers(0, 2 * rest.window, count)
    changes = rest.switch_tolerance * rng.uniform(0, 2, (count, width - 2))
    # The objective of the step before lies near the present one, by itself the first of these changes.
    before = programs.objective(run, positions) - changes[:, 0]
    return np.column_stack([charge, since, before, changes[:, 1:]])


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keeps the converter's notes on its own work to itself."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(before)
