"""Trained policies and cascades as ONNX models, for robots without JAX; the extra `onnx`.

`murmurate export RUN --onnx` does it from the command line. A model is compared with the run before it is written.
"""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import export as jax_export
from jax.extend.core import jaxpr_as_fun
from jaxtyping import Array, Float

from murmurate import prng
from murmurate.errors import InputError, check_number, check_type
from murmurate.interop import missing_extra
from murmurate.interop.onnx import programs
from murmurate.interop.onnx.programs import Program
from murmurate.runs.run import Run
from murmurate.types import Observation, View
from murmurate.world import apply_dead_zone

try:
    import jax2onnx
    import onnxruntime
    from onnx import ModelProto
    from onnx.helper import OP_SET_ID_VERSION_MAP, make_attribute
except ModuleNotFoundError as error:
    raise missing_extra("onnx") from error

__all__ = ["CONFIGURATIONS", "OPSET", "OPSETS", "TOLERANCE", "Model", "export"]

CONFIGURATIONS = 1000
"""Configurations on which a model is compared with the run."""

TOLERANCE = 1e-5
"""Greatest accepted difference of velocities, world units per step."""

OPSETS = (17, 23)
"""The oldest and the newest version of ONNX's operators that a model can be written in."""

OPSET = 23
"""The version that it is written in by default."""

OTHER_SIZES = (2, 3, 5, 12)
"""Further swarm sizes on which a model for any number of robots is compared."""

EPISODES = 8
"""Episodes of the run whose configurations are among those."""

SEEN = 0.7
"""Share of the others that a robot sees in a random view."""

PROBES = 4
"""Configurations on which a program is evaluated before it is converted."""


@dataclass(frozen=True)
class Model:
    """An ONNX model.

    Attributes:
        data: The contents of the file.
        program: The function that it was made of.
    """

    data: bytes
    program: Program

    def session(self) -> Any:
        """Opens the model with onnxruntime."""
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 3  # no warnings of unused constants
        return onnxruntime.InferenceSession(self.data, options, providers=["CPUExecutionProvider"])

    def difference(self, run: Run, configurations: int = CONFIGURATIONS, seed: int = 0) -> float:
        """Returns the greatest difference between the outputs of the model and those of the run.

        In swarms of the run's own size, a single policy is compared with what it does in the run's world, on random
        configurations, on those that the run's episodes pass, and on degenerate ones: symmetric, in line, with robots
        at one place. Where robots tie, two computations that round differently part most easily. Cascades, and swarms
        of two to twelve robots where the model takes any number, are compared with the function that was exported.

        Args:
            run: The run that was exported.
            configurations: How many, about equally many of each swarm size.
            seed: Seed of the configurations.

        Returns:
            The difference; infinity where one of the two is not finite.
        """
        session, differences = self.session(), [0.0]
        for inputs, expected in _samples(run, self.program, configurations, seed):
            for actual, wanted in zip(session.run(None, inputs), expected, strict=True):
                differences.append(float(np.abs(actual - np.asarray(wanted)).max()))
        greatest = float(np.max(differences))
        return greatest if np.isfinite(greatest) else float("inf")


def export(run: Run, index: int | None = None, opset: int = OPSET) -> Model:
    """Makes an ONNX model of a run's cascade, or of one of its policies.

    Args:
        run: The run.
        index: Place of the policy; None for the whole cascade.
        opset: Version of ONNX's operators. The file's format is the oldest that has them, for older runtimes.

    Raises:
        InputError: There is no policy at that place or no such version, the cascade cannot be executed by robots on
            their own, or a class of the user's own computes something that ONNX does not have, or uses more than a
            robot's own view.
    """
    check_type("run", run, Run, "a run, such as murmurate.load(folder)")
    check_number("--opset", opset, *OPSETS, integer=True)
    program = programs.cascade_program(run) if index is None else programs.policy_program(run, index)
    with _naming(program):
        specs = _specs(program)
        # jax2onnx replaces functions of jax.numpy by its own while it traces, and those do not support symbolic shapes:
        # it is given the program in JAX's own primitives.
        traced = jax.make_jaxpr(program.function)(*specs)
        _check_outputs(run, program)
        with _without_notes():
            proto = jax2onnx.to_onnx(
                lambda *inputs: tuple(jaxpr_as_fun(traced)(*inputs)),
                inputs=specs,
                model_name="murmurate",
                input_names=list(program.inputs),
                output_names=list(program.outputs),
                opset=opset,
            )
    assert isinstance(proto, ModelProto)
    proto.ir_version = min(proto.ir_version, OP_SET_ID_VERSION_MAP["ai.onnx", opset])
    _take_zeros_at_their_word(proto)
    _name_swarm_sizes(proto)
    for name, text in program.metadata.items():
        proto.metadata_props.add(key=name, value=text)
    return Model(proto.SerializeToString(), program)


def _take_zeros_at_their_word(proto: ModelProto) -> None:
    """Lets arrays be empty: unless told so, ONNX takes a length of 0 in a new shape for the length that was there."""
    for node in proto.graph.node:
        if node.op_type == "Reshape" and not any(attribute.name == "allowzero" for attribute in node.attribute):
            node.attribute.append(make_attribute("allowzero", 1))


def _name_swarm_sizes(proto: ModelProto) -> None:
    """States the smallest and the largest swarm, where there are bounds: as metadata, and in the name of what fails.

    A runtime's error says nothing but which operation failed, and the name of that one.
    """
    looked_up = {tensor.name for tensor in proto.graph.initializer if tuple(tensor.dims) == programs.TABLE_SHAPE}
    for node in proto.graph.node:
        if looked_up.isdisjoint(node.input):
            continue
        if node.op_type == "Squeeze":
            node.name = f"{programs.MIN_ROBOTS}_to_{programs.MAX_ROBOTS}_robots"
            proto.metadata_props.add(key="smallest_swarm", value=str(programs.MIN_ROBOTS))
            proto.metadata_props.add(key="largest_swarm", value=str(programs.MAX_ROBOTS))
            return
        looked_up.update(node.output)


@contextlib.contextmanager
def _naming(program: Program) -> Iterator[None]:
    """Turns an error in a program that contains classes of the user's own into one that names them."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # a user's class may raise anything
        if not program.foreign:
            raise
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        raise _refusal(program, f"made of operations that can be exported to ONNX ({reason})") from None


def _refusal(program: Program, allowed: str) -> InputError:
    fields, names = ", ".join(program.foreign), ", ".join(part.name for part in program.foreign.values())
    return InputError(fields, names, allowed)


def _check_outputs(run: Run, program: Program) -> None:
    """Checks that outputs that classes of the user's own compute are finite."""
    if not program.foreign:
        return
    inputs = _random_inputs(run, program, run.experiment.world.robots, PROBES, np.random.default_rng(0))
    outputs = program.function(*map(jnp.asarray, inputs.values()))
    if not all(np.isfinite(np.asarray(output)).all() for output in outputs):
        reason = ": a robot's model knows nothing but its own view" if run.experiment.policy.perceives else ""
        raise _refusal(program, f"finite on what a model is given{reason}")


def _specs(program: Program) -> list[jax.ShapeDtypeStruct]:
    """Returns the inputs' shapes, with a symbol for each axis of any length."""
    names = sorted({axis for shape in program.inputs.values() for axis in shape if isinstance(axis, str)})
    symbols: dict[int | str, Any] = dict(zip(names, jax_export.symbolic_shape(", ".join(names)), strict=True))
    shapes = [tuple(symbols.get(axis, axis) for axis in shape) for shape in program.inputs.values()]
    return [jax.ShapeDtypeStruct(shape, jnp.float32) for shape in shapes]


def _samples(
    run: Run, program: Program, configurations: int, seed: int
) -> Iterator[tuple[dict[str, np.ndarray], tuple[Any, ...]]]:
    """Yields inputs and the outputs that the run gives for them, one batch for each swarm size."""
    rng, robots = np.random.default_rng(seed), run.experiment.world.robots
    any_size = any(axis in ("robots", "others") for shape in program.inputs.values() for axis in shape)
    sizes = [robots, *OTHER_SIZES] if any_size else [robots]
    for size in sizes:
        count = -(-configurations // len(sizes))
        if "others" in program.inputs and size == robots:
            yield _views_and_velocities(run, program, count, rng)
            continue
        inputs = _random_inputs(run, program, size, count, rng)
        outputs = program.jitted(*map(jnp.asarray, inputs.values()))
        if program.policy is not None and size == robots:
            outputs = (_velocities(run, program.policy, inputs["positions"]),)
        yield inputs, outputs


def _velocities(run: Run, index: int, positions: np.ndarray) -> np.ndarray:
    """Returns what a policy that acts on all positions does in the run's world."""
    policy, shield, world = run.cascade.policies[index], run.experiment.prepared_shield, run.experiment.world
    slow = run.experiment.slow_moves
    seen = jnp.moveaxis(jnp.asarray(positions), 0, -1)
    velocities = jax.jit(lambda seen: shield(apply_dead_zone(policy(seen), seen, slow, world), seen, world))(seen)
    return np.moveaxis(np.asarray(velocities), -1, 0).clip(-world.max_speed, world.max_speed)


def _views_and_velocities(
    run: Run, program: Program, count: int, rng: np.random.Generator
) -> tuple[dict[str, np.ndarray], tuple[np.ndarray]]:
    """Returns what each robot perceives in the run's world, as inputs of its model, and what its policy does there."""
    experiment = run.experiment
    world, sensing = experiment.world, experiment.sensing
    policy = run.cascade.policies[program.policy or 0]

    @jax.jit
    def act(positions: Array, keys: Array) -> tuple[View, Array]:
        frames = sensing.draw_frames(keys, world.robots)
        view = sensing.view(positions, frames, keys, world)
        observation = Observation(view, positions, jnp.zeros_like(positions[:, 0]))
        wanted = apply_dead_zone(policy(observation), observation, experiment.slow_moves, world)
        return view, experiment.prepared_shield(wanted, observation, world)

    positions = np.moveaxis(_positions(run, world.robots, count, rng), 0, -1).astype(np.float32)
    keys = jax.random.split(prng.key(rng.integers(2**32)), count)
    view, velocities = jax.tree.map(np.asarray, act(jnp.asarray(positions), keys))
    scale = (world.radius / view.radius)[:, None]
    offsets = np.where(view.seen[:, :, None], np.stack([view.x, view.y], axis=2), 0.0)
    # The robot itself is not among the others.
    others = offsets[~np.eye(world.robots, dtype=bool)].reshape(world.robots, world.robots - 1, 2, -1)
    inputs = {"others": scale[:, None] * others, "point": scale * np.stack([view.landmark_x, view.landmark_y], axis=1)}
    if view.walls is not None:
        inputs["walls"] = scale[:, None] * view.walls
    # A model takes a robot at the observer's own place for no robot, and a shield would hold its observer.
    at_one_place = (view.seen & (view.x == 0) & (view.y == 0)).any(axis=1)
    complete = ~at_one_place.T.ravel() | run.experiment.shield.is_trivial
    given = {name: _robots_as_batch(inputs[name])[complete] for name in program.inputs}
    return given, (_robots_as_batch(velocities)[complete],)


def _robots_as_batch(array: Float[np.ndarray, "robots *axes batch"]) -> Float[np.ndarray, "members *axes"]:
    array = np.moveaxis(array, -1, 0)
    return array.reshape(-1, *array.shape[2:]).astype(np.float32)


def _random_inputs(
    run: Run, program: Program, robots: int, count: int, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Draws inputs of a program for swarms of a size."""
    inputs: dict[str, np.ndarray] = {}
    for name, shape in program.inputs.items():
        if name == "positions":
            inputs[name] = _positions(run, robots, count, rng)
        elif name == "memory":
            inputs[name] = _memory(run, inputs["positions"], int(shape[1]), rng)
        else:
            axes = [robots - 1 if axis == "others" else int(axis) for axis in shape[1:]]
            inputs[name] = run.experiment.world.safe_distance * rng.standard_normal((count, *axes))
            if name == "others":  # some of which are not seen
                inputs[name] *= rng.random((count, axes[0], 1)) < SEEN
                symmetric = _degenerate(run, robots, rng)[:count]
                inputs[name][: len(symmetric)] = symmetric[:, 1:] - symmetric[:, :1]
    return {name: value.astype(np.float32) for name, value in inputs.items()}


def _positions(run: Run, robots: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draws configurations at random; of the run's own size, half are of its episodes."""
    world = run.experiment.world
    side = world.safe_distance * np.sqrt(robots) * rng.uniform(0.5, 2, (count, 1, 1))
    positions = side * rng.uniform(-1, 1, (count, robots, 2))
    if robots == world.robots:
        recorded = run.rollout(EPISODES, int(rng.integers(2**31))).positions.reshape(-1, robots, 2)
        half = count // 2
        positions[:half] = recorded[rng.choice(len(recorded), half)]
    degenerate = _degenerate(run, robots, rng)[:count]
    positions[count - len(degenerate) :] = degenerate
    return positions


def _degenerate(run: Run, robots: int, rng: np.random.Generator) -> Float[np.ndarray, "configurations robots 2"]:
    """Returns symmetric configurations, turned: rings, a ring around a robot, grids, nested rings, lines, coincidences.

    In the middle of nowhere, and at the gathering point.
    """
    number = np.arange(robots)
    columns = math.isqrt(robots - 1) + 1
    halves = np.where(number % 2, 1.0, 2.0) * np.exp(2j * np.pi * (number // 2) / max(-(-robots // 2), 1))
    around = np.append(np.exp(2j * np.pi * number[:-1] / max(robots - 1, 1)), 0.0)
    shapes = [
        robots / 4 * np.exp(2j * np.pi * number / robots),
        robots / 4 * around,
        robots / 6 * halves,
        number % columns - (columns - 1) / 2 + 1j * (number // columns),
        number - (robots - 1) / 2 + 0j,
        np.where(number < 2, 0.0, number + 0j),
        np.where(number < 2, 0.0, 2 * np.exp(2j * np.pi * number / robots)),
        np.zeros(robots, complex),
    ]
    # Not at the safe distance itself: there the penalty's square root makes 3e-4 of a rounded digit.
    spacing = 1.1 * run.experiment.world.safe_distance
    turned = np.concatenate([spacing * np.exp(1j * angle) * np.array(shapes) for angle in (0.0, 0.7, np.pi / 4)])
    points = np.stack([np.real(turned), np.imag(turned)], axis=-1)
    return np.concatenate([points, points + spacing * rng.uniform(-3, 3, (len(points), 1, 2))])


def _memory(run: Run, positions: np.ndarray, width: int, rng: np.random.Generator) -> np.ndarray:
    """Draws memories, some of which make a policy end."""
    rest, count = run.experiment.rest_in_steps, len(positions)
    active_policy = rng.integers(0, len(run.cascade.policies) + 1, count)
    steps_active = rng.integers(0, 2 * rest.window, count)
    still_steps = rng.integers(0, 2 * rest.window, count)
    changes = rest.switch_tolerance * rng.uniform(0, 2, (count, width - 3))
    # The objective of the step before differs from the present one by the first of these changes.
    before = programs.objective(run, positions) - changes[:, 0]
    return np.column_stack([active_policy, steps_active, still_steps, before, changes[:, 1:]])


@contextlib.contextmanager
def _without_notes() -> Iterator[None]:
    """Silences the converter's log messages about its own work."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(before)
