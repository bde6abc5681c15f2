"""Where episodes begin: the paper's layouts, anywhere at random, or given configurations, each plus uniform noise.

A start is never in collision and never outside the world. Staying inside is exact: each coordinate's uniform noise is
drawn from the part of its range that lies inside, which is what redrawing until it does would give. Overlaps are
redrawn: a robot that touches one placed before it is drawn again, until none does.
"""

from __future__ import annotations

import csv
import math
import operator
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate.errors import InputError
from murmurate.geometry import clearances
from murmurate.geometry.visibility import fold
from murmurate.world.config import WorldConfig

__all__ = [
    "JitteredStart",
    "MixtureStart",
    "Start",
    "StartConfig",
    "UniformStart",
    "check_configurations",
    "draw_starts",
    "layout",
    "make_start",
    "read_starts",
]

ROUNDS = 500
"""Redraws after which a request is called impossible when a start is built."""

PATIENCE = 50
"""Redraws after which a configuration that still overlaps is drawn anew as a whole."""


StartKind = Literal["scattered", "distributed", "packed", "random", "file"]


@dataclass(frozen=True)
class StartConfig:
    """Where episodes begin.

    Attributes:
        kind: scattered, distributed and packed are the paper's; random is anywhere without overlap; file reads `file`.
        noise: Half-width of the uniform noise on each coordinate, in robot radii; the paper's experiments use 2.
        spacing: Distance between neighbours of the distributed and packed layouts, in robot radii.
        lines: Number of lines of the packed layout.
        file: CSV file of starts (start,x,y), for kind `file`.
    """

    kind: StartKind = "scattered"
    noise: float = 2.0
    spacing: float = 6.0
    lines: int = 1
    file: str = ""

    def __post_init__(self) -> None:
        if self.kind not in get_args(StartKind):
            raise InputError("kind", self.kind, f"one of {', '.join(get_args(StartKind))}")
        if not (math.isfinite(self.noise) and self.noise >= 0):
            raise InputError("noise", self.noise, "a finite number >= 0")
        if not (math.isfinite(self.spacing) and self.spacing > 2):
            raise InputError("spacing", self.spacing, "a finite number > 2 (robots closer than two radii overlap)")
        if self.lines < 1:
            raise InputError("lines", self.lines, "an integer >= 1")
        if (self.kind == "file") != bool(self.file):
            raise InputError("file", self.file, "given with kind = 'file', and only then")


class Start(eqx.Module):
    """A distribution of initial configurations."""

    @abstractmethod
    def sample(self, key: PRNGKeyArray, batch: int, rounds: int | None = None) -> Float[Array, "robots 2 batch"]:
        """Draws a batch of configurations, none in collision, all inside the world.

        Args:
            key: Randomness.
            batch: How many to draw.
            rounds: Give up redrawing overlaps after so many rounds; by default, never.
        """


class JitteredStart(Start):
    """One of some given configurations, each coordinate plus uniform noise (paper, equation 11)."""

    points: Float[Array, "layouts robots 2"]
    noise: Any
    half_width: Any
    half_height: Any
    radius: Any

    def sample(self, key: PRNGKeyArray, batch: int, rounds: int | None = None) -> Float[Array, "robots 2 batch"]:
        """Draws layouts with equal chances and adds noise U(-noise, noise) to every coordinate."""
        choose, draw = jax.random.split(key)
        chosen = self.points[jax.random.randint(choose, (batch,), 0, self.points.shape[0])]
        center = jnp.moveaxis(chosen, 0, -1)
        bounds = jnp.stack([jnp.asarray(self.half_width), jnp.asarray(self.half_height)])[:, None]
        low = jnp.maximum(center - self.noise, -bounds)
        high = jnp.minimum(center + self.noise, bounds)

        def propose(key: PRNGKeyArray) -> Float[Array, "robots 2 batch"]:
            return low + (high - low) * jax.random.uniform(key, center.shape)

        return _without_overlap(draw, propose, self.radius, rounds)


class UniformStart(Start):
    """UniformStart in the world; with `spread` below 1, in two randomly placed windows, each a random share of it.

    Windows are placed anywhere and pushed inside, so small ones often lie along a wall or in a corner; how the robots
    divide between the two is random as well, all in one included.
    """

    robots: int = eqx.field(static=True)
    half_width: Any
    half_height: Any
    radius: Any
    spread: Any = 1.0

    def sample(self, key: PRNGKeyArray, batch: int, rounds: int | None = None) -> Float[Array, "robots 2 batch"]:
        """Draws every robot uniformly in its window, whose sides are a share from `spread` to 1 of the world's.

        Shares are uniform in their logarithm: tight crowds are as common as loose ones.

        No window is so small that the discs around N - 1 centres, which the last one must avoid, could fill it.
        """
        size_key, place_key, divide, draw = jax.random.split(key, 4)
        bounds = jnp.stack([jnp.asarray(self.half_width), jnp.asarray(self.half_height)])[:, None]
        room = self.radius * jnp.sqrt(jnp.pi * (self.robots - 1) / (self.half_width * self.half_height))
        least = jnp.minimum(jnp.maximum(self.spread, room), 1.0)
        share = least ** jax.random.uniform(size_key, (2, 2, batch))
        place = jax.random.uniform(place_key, (2, 2, batch), minval=-1.0, maxval=1.0)
        center = bounds * jnp.clip(place, share - 1, 1 - share)
        first = jax.random.uniform(divide, (batch,))

        def propose(key: PRNGKeyArray) -> Float[Array, "robots 2 batch"]:
            window, inside = jax.random.split(key)
            unit = jax.random.uniform(inside, (self.robots, 2, batch), minval=-1.0, maxval=1.0)
            mine = (jax.random.uniform(window, (self.robots, batch)) < first)[:, None]
            return jnp.where(mine, center[0] + bounds * share[0] * unit, center[1] + bounds * share[1] * unit)

        return _without_overlap(draw, propose, self.radius, rounds)


class MixtureStart(Start):
    """The second start with probability `share`, else the first."""

    first: Start
    second: Start
    share: Any

    def sample(self, key: PRNGKeyArray, batch: int, rounds: int | None = None) -> Float[Array, "robots 2 batch"]:
        """Draws from both and keeps one for each member of the batch."""
        coin, first, second = jax.random.split(key, 3)
        other = jax.random.uniform(coin, (batch,)) < self.share
        return jnp.where(other, self.second.sample(second, batch, rounds), self.first.sample(first, batch, rounds))


def draw_starts(start: Start, key: PRNGKeyArray, count: int) -> Float[np.ndarray, "starts robots 2"]:
    """Draws configurations, world units, as files and rollouts have them: one after another."""
    return np.moveaxis(np.asarray(_draw(start, key, count)), -1, 0)


# Outside of a jit, the loop that redraws overlaps would be compiled anew at every call.
@eqx.filter_jit
def _draw(start: Start, key: PRNGKeyArray, count: int) -> Float[Array, "robots 2 starts"]:
    return start.sample(key, count)


def _touches_earlier(positions: Float[Array, "robots 2 batch"], radius: Any) -> Any:
    """Says which robots touch one of lower number."""
    robots = positions.shape[0]
    earlier = jnp.tril(jnp.ones((robots, robots), bool), -1)[:, :, None]
    return fold(operator.or_, (clearances(positions, radius) <= 0) & earlier, axis=1)


def _without_overlap(
    key: PRNGKeyArray, propose: Callable[[PRNGKeyArray], Any], radius: Any, rounds: int | None
) -> Float[Array, "robots 2 batch"]:
    def pending(carry: tuple[Any, Any, Any, Any]) -> Any:
        _, _, bad, turn = carry
        return jnp.any(bad) if rounds is None else jnp.any(bad) & (turn < rounds)

    def redraw(carry: tuple[Any, Any, Any, Any]) -> tuple[Any, Any, Any, Any]:
        key, positions, bad, turn = carry
        key, draw = jax.random.split(key)
        # The robots that were placed can leave no room for one more, however often that one is drawn again.
        stuck = jnp.any(bad, axis=0) & (turn % PATIENCE == PATIENCE - 1)
        positions = jnp.where((bad | stuck)[:, None], propose(draw), positions)
        return key, positions, _touches_earlier(positions, radius), turn + 1

    key, draw = jax.random.split(key)
    positions = propose(draw)
    carry = (key, positions, _touches_earlier(positions, radius), 0)
    return jax.lax.while_loop(pending, redraw, carry)[1]


def layout(config: StartConfig, world: WorldConfig) -> Float[np.ndarray, "robots 2"]:
    """Places the robots as one of the paper's initial configurations, without noise.

    Args:
        config: Which one, and its numbers.
        world: Sizes of the world and its robots.

    Returns:
        Centres of the robots, world units.

    Raises:
        InputError: That many robots do not fit there.
    """
    return {"scattered": _scattered, "distributed": _distributed, "packed": _packed}[config.kind](config, world)


def _scattered(config: StartConfig, world: WorldConfig) -> np.ndarray:
    """Evenly on a circle of radius min(X, Y)."""
    angle = 2 * np.pi * np.arange(world.robots) / world.robots
    circle = min(world.half_width, world.half_height)
    return _fitting(circle * np.stack([np.cos(angle), np.sin(angle)], axis=1), config, world)


def _distributed(config: StartConfig, world: WorldConfig) -> np.ndarray:
    """Half of the robots, on a grid, near each of two opposite corners."""
    first = (world.robots + 1) // 2
    points = _block(first, math.ceil(math.sqrt(first)), _spacing(config, world)) + _spacing(config, world) / 2
    corner = np.array([world.half_width, world.half_height])
    both = np.concatenate([points - corner, corner - points[: world.robots - first]])
    return _fitting(both, config, world)


def _packed(config: StartConfig, world: WorldConfig) -> np.ndarray:
    """One line, or several, half-way between the gathering point and the lower edge."""
    spacing = _spacing(config, world)
    columns = math.ceil(world.robots / config.lines)
    points = _block(world.robots, columns, spacing)
    points = points - (points.max(axis=0) + points.min(axis=0)) / 2
    return _fitting(points - np.array([0.0, world.half_height / 2]), config, world)


def _spacing(config: StartConfig, world: WorldConfig) -> float:
    return config.spacing * world.radius


def _block(count: int, columns: int, spacing: float) -> np.ndarray:
    index = np.arange(count)
    return spacing * np.stack([index % columns, index // columns], axis=1).astype(float)


def _fitting(points: np.ndarray, config: StartConfig, world: WorldConfig) -> np.ndarray:
    outside = (np.abs(points) > np.array([world.half_width, world.half_height])).any()
    if outside or (clearances(points, world.radius) <= 0).any():
        raise InputError("world.robots", world.robots, f"few enough to fit the {config.kind} start")
    return points


def read_starts(path: str | Path, robots: int) -> Float[np.ndarray, "starts robots 2"]:
    """Reads a CSV file of starts: the header `start,x,y`, then one row for each robot of each start.

    Args:
        path: The file.
        robots: How many robots each start must have.

    Returns:
        The starts in the order of their first rows.

    Raises:
        InputError: A column is missing, a value is no finite number, or a start has another number of robots.
    """
    source = str(path)
    try:
        with open(path, newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            missing = {"start", "x", "y"} - set(reader.fieldnames or ())
            if missing:
                raise InputError(source, ",".join(reader.fieldnames or ()), "a table with the header start,x,y")
            starts: dict[str, list[tuple[float, float]]] = {}
            for row in reader:
                point = (_coordinate(source, reader.line_num, row, "x"), _coordinate(source, reader.line_num, row, "y"))
                starts.setdefault(str(row["start"]), []).append(point)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or "it is not text"
        raise InputError("starts", source, f"a readable CSV file ({reason})") from None
    if not starts:
        raise InputError(source, "no rows", "at least one start")
    for name, points in starts.items():
        if len(points) != robots:
            raise InputError(f"{source}: start {name}", f"{len(points)} robots", f"{robots} robots")
    return np.array(list(starts.values()))


def _coordinate(source: str, line: int, row: dict[str, str | None], column: str) -> float:
    text = row[column]
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{source} line {line}: {column}", text, "a finite number")
    return value


def check_configurations(points: Float[np.ndarray, "starts robots 2"], world: WorldConfig, source: str) -> None:
    """Checks that no given configuration is in collision or outside the world.

    Raises:
        InputError: One is; the message names which.
    """
    # What a run computes with is float32, so that is what must be free of collision.
    with np.errstate(over="ignore"):
        points = points.astype(np.float32).astype(float)
    bounds = np.array([world.half_width, world.half_height], np.float32)
    for index, configuration in enumerate(points):
        if not (np.abs(configuration) <= bounds).all():
            allowed = f"inside |x| <= {world.half_width:g}, |y| <= {world.half_height:g}"
            raise InputError(f"{source}: start {index}", "a robot outside", allowed)
        if (clearances(configuration, world.radius) <= 0).any():
            raise InputError(f"{source}: start {index}", "overlapping robots", f"more than {2 * world.radius:g} apart")


SPARSE = 0.05
"""Share of the world that discs may cover to be sure to fit anywhere at random: they jam at eleven times as much."""


def make_start(config: StartConfig, world: WorldConfig) -> Start:
    """Builds the start that a configuration describes.

    Raises:
        InputError: It is impossible: too many robots for the place, or a bad file.
    """
    sizes = {"half_width": world.half_width, "half_height": world.half_height, "radius": world.radius}
    if config.kind == "random":
        start: Start = UniformStart(robots=world.robots, **sizes)
    else:
        if config.kind == "file":
            points = read_starts(config.file, world.robots)
            check_configurations(points, world, config.file)
        else:
            points = layout(config, world)[None]
        start = JitteredStart(points=jnp.asarray(points, jnp.float32), noise=config.noise * world.radius, **sizes)
    _check_possible(start, config, world)
    return start


def _check_possible(start: Start, config: StartConfig, world: WorldConfig) -> None:
    """Draws a few starts with a bounded number of redraws, so that an impossible one fails instead of hanging."""
    discs = world.robots * np.pi * world.radius**2
    if config.kind == "random" and discs < SPARSE * 4 * world.half_width * world.half_height:
        return
    # NumPy's: of JAX, each operation would be compiled for each size of swarm.
    trial = np.asarray(_trial(start))
    if (clearances(trial, world.radius) <= 0).any():
        raise InputError("world.robots", world.robots, f"few enough to fit the {config.kind} start without overlap")


@jax.jit
def _trial(start: Start) -> Float[Array, "robots 2 batch"]:
    return start.sample(jax.random.key(0), 16, rounds=ROUNDS)
