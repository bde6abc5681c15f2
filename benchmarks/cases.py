"""The timed cases: the world and the training of every policy, the machine's ceilings, and other projects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import pieces
from benchmarks.machine import Extent, ceiling_cases
from benchmarks.measure import Case, compiler_cost
from benchmarks.peers import peer_cases
from murmurate import prng
from murmurate.discovery import Search, build_world
from murmurate.learning import Chunk, step_with_autoreset, train_chunk
from murmurate.runs import presets
from murmurate.world import (
    LocalObservation,
    ScatteredStart,
    UniformStart,
    VisibleSensing,
    World,
    scaled_to,
    with_array_leaves,
)

__all__ = [
    "RESTARTS",
    "SENSING",
    "SIZED",
    "STEP",
    "TRAINING",
    "Size",
    "all_cases",
    "batches",
    "costs",
]

EXPERIMENT = "C"
STEP = "world step, all signals"
RESTARTS = f"{STEP}, ended episodes begun anew"
SENSING = "sensing: who is visible, in each robot's own frame"
SIZED = "world"
TRAINING = "training"
KINDS = ("equivariant", "central", "local")
MAX_COUNTED = 256
"""Number of parallel worlds in which the operations of a step are counted, unless fewer are timed."""

SPEED = 0.2
"""Bound on the random velocities of the timed steps, relative to the speed limit: the swarm stays in the world."""

LARGE = 128
"""Number of robots from which a swarm is also timed in as many worlds as `Size.pairs` allows."""


@dataclass(frozen=True)
class Size:
    """The amount of work that is timed.

    Attributes:
        robots: Swarm sizes.
        worlds: Numbers of parallel worlds, as far as `pairs` allows.
        pairs: Largest number of pairs of robots in all worlds together; one world alone is always timed.
        run: Pairs in all steps of a run, within the bounds of `steps`.
        steps: Smallest and largest number of steps of a run.
        side_by_side: Numbers of worlds in which ten robots are compared with other projects.
        training: Fields of `PPOConfig` to replace in the timed training.
        updates: Updates of a timed training.
        extent: Sizes of the machine's ceilings.
    """

    robots: Sequence[int] = (4, 8, 10, 16, 32, 64, 128, 256, 1024)
    worlds: Sequence[int] = (1, 16, 256, 1024, 4096)
    pairs: int = 1 << 20
    run: int = 1 << 23
    steps: tuple[int, int] = (2, 400)
    side_by_side: Sequence[int] = (256, 1024, 4096)
    training: dict[str, int] = field(default_factory=dict)
    updates: int = 2
    extent: Extent = field(default_factory=Extent)

    def steps_of(self, robots: int, worlds: int) -> int:
        """Returns the steps of a run."""
        return int(np.clip(self.run // (robots**2 * worlds), *self.steps))


def all_cases(size: Size) -> list[Case]:
    """Returns every case; those of other projects only if they are installed."""
    cases = ceiling_cases(size.extent) + world_cases(size)
    for worlds in size.side_by_side:
        cases.append(stepping(10, worlds, size, restart=True))
    cases += peer_cases(size.side_by_side, size.steps[1])
    for kind in KINDS:
        cases += [training(kind, size), *pieces.piece_cases(kind, lambda kind=kind: chunk(kind, size))]
    return cases


def world_cases(size: Size) -> list[Case]:
    """Returns the cases of swarms of all sizes: steps in batches of worlds, and sensing in the largest of them."""
    cases = []
    for robots in size.robots:
        counts = batches(robots, size)
        cases += [stepping(robots, worlds, size) for worlds in counts]
        cases.append(sensing(robots, counts[-1], size))
    return cases


def batches(robots: int, size: Size) -> list[int]:
    """Returns the numbers of worlds that a swarm is timed in, in increasing order."""
    most = max(size.pairs // robots**2, 1)
    counts = {1} | {worlds for worlds in size.worlds if worlds <= most}
    return sorted(counts | {most} if robots >= LARGE else counts)


def sized(robots: int) -> World:
    """Returns the world of the experiment scaled to a swarm; its starts are never drawn."""
    world = World.create(scaled_to(presets.preset(EXPERIMENT).world, robots), UniformStart())
    return with_array_leaves(eqx.tree_at(lambda w: w.horizon, world, jnp.asarray(world.horizon, jnp.int32)))


def scattered(robots: int, worlds: int) -> jax.Array:
    """Returns swarms near the edge of the world, each a little different."""
    config = scaled_to(presets.preset(EXPERIMENT).world, robots)
    points = ScatteredStart().layouts(config)[0].astype(np.float32)[..., None]
    noise = np.random.default_rng(0).uniform(-1, 1, (robots, 2, worlds)).astype(np.float32)
    return jnp.asarray(0.8 * points + config.radius * noise)


def stepping(robots: int, worlds: int, size: Size, restart: bool = False) -> Case:
    """Returns the case of a world step with all signals, with or without resets of ended episodes."""
    steps = size.steps_of(robots, worlds)

    def prepare() -> Callable[[], Any]:
        world = build_world(presets.preset(EXPERIMENT)) if restart else sized(robots)
        state = jax.jit(lambda world, positions: world.state(positions))(world, scattered(robots, worlds))
        # Episodes of all ages, so that some of them end at every step.
        ages = jax.random.randint(prng.key(1), (worlds,), 0, world.horizon, jnp.int32)
        state = eqx.tree_at(lambda s: s.step, state, ages)
        bound = SPEED * world.config.max_speed
        shape = (steps, *state.positions.shape)
        velocities = jax.random.uniform(prng.key(2), shape, jnp.float32, -bound, bound)
        keys = jax.random.split(prng.key(3), steps)

        def step(world: Any, state: Any, velocities: Any, key: Any) -> tuple[Any, Any]:
            return step_with_autoreset(world, state, velocities, key)[:2] if restart else world.step(state, velocities)

        @jax.jit
        def run(world: Any, state: Any, velocities: Any, keys: Any) -> Any:
            return jax.lax.scan(lambda state, xs: step(world, state, *xs), state, (velocities, keys))

        return lambda: run(world, state, velocities, keys)

    return Case(SIZED, RESTARTS if restart else STEP, worlds * steps, prepare, robots, worlds)


def sensing(robots: int, worlds: int, size: Size) -> Case:
    """Returns the case of what opaque robots with their own frames observe; every step overwrites the last view."""
    steps = size.steps_of(robots, worlds)

    def prepare() -> Callable[[], Any]:
        sensing = VisibleSensing(rotation=True, reflection=True)
        world = sized(robots)
        env = LocalObservation(world, sensing, world.config)
        state = eqx.filter_jit(lambda env, positions: env.state(positions))(env, scattered(robots, worlds))

        @eqx.filter_jit
        def run(env: Any, state: Any) -> Any:
            def view(positions: Any) -> Any:
                return env.view(eqx.tree_at(lambda s: s.unwrapped.positions, state, positions))

            def step(carry: tuple[Any, Any], _: None) -> tuple[Any, None]:
                positions, seen = carry
                # Depends on the view, so that the compiler leaves no step out.
                positions = positions + 0.01 * jnp.sum(seen.x, axis=1)[:, None] / robots
                return (positions, view(positions)), None

            positions = state.positions
            return jax.lax.scan(step, (positions, view(positions)), None, length=steps)[0]

        return lambda: run(env, state)

    return Case(SIZED, SENSING, worlds * (steps + 1), prepare, robots, worlds)


def chunk(kind: str, size: Size) -> Chunk:
    """Returns the first updates of the base policy's training, as `murmurate discover` runs them."""
    fields: dict[str, Any] = {"policy": {"use": kind}, "base": {"ppo": size.training}}
    if kind == "local":
        fields["sensing"] = {"use": "visible", "rotation": True, "reflection": True}
    search = Search(presets.resolve(EXPERIMENT, fields))
    snapshot = search.begin()
    return replace(search.stage(snapshot).next_chunk(search.training(snapshot)), updates=size.updates)


def costs(size: Size) -> list[dict[str, Any]]:
    """Returns what the compiler counts in a step of ten robots, of one world, and in an update of every policy."""
    worlds = max(worlds for worlds in size.worlds if worlds <= MAX_COUNTED)
    world, positions = sized(10), scattered(10, worlds)
    state = jax.jit(lambda world, positions: world.state(positions))(world, positions)
    counts = compiler_cost(lambda world, state, v: world.step(state, v), world, state, jnp.zeros_like(positions))
    row = {"part": SIZED, "name": f"{STEP}, {worlds:,} worlds", "robots": 10, "worlds": worlds}
    rows = [{**row, **{name: count / worlds for name, count in counts.items()}}]
    for kind in KINDS:
        row = {"part": TRAINING, "name": f"update, {kind} policy", "kind": kind, "robots": 10}
        rows.append({**row, **pieces.update_cost(kind, chunk(kind, size))})
    return rows


def training(kind: str, size: Size) -> Case:
    """Returns the case of whole updates of one policy: collecting, advantages, all epochs of both networks, metrics."""
    stage = presets.resolve(EXPERIMENT, {"policy": {"use": kind}, "base": {"ppo": size.training}}).base

    def prepare() -> Callable[[], Any]:
        whole = chunk(kind, size)
        return lambda: train_chunk(whole.state, whole.env, whole.hyper, whole.shape, whole.updates)

    pace = f", an action every {stage.repeat} steps" if stage.repeat > 1 else ""
    work = size.updates * stage.steps_per_update(0)
    return Case(TRAINING, f"{kind} policy{pace}", work, prepare, worlds=stage.ppo.worlds)
