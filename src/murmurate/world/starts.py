"""Distributions of initial configurations: the paper's layouts, random ones, files, and mixtures of starts.

A start is never in contact and never outside the world. Staying inside is exact: each coordinate's uniform noise is
drawn from the part of its range that lies inside, which is what redrawing until it does would give. Overlaps are
redrawn: a robot that touches a robot of lower number is drawn again, until none does.
"""

from __future__ import annotations

import functools
import math
import operator
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate import prng
from murmurate.errors import MAX_INTEGER, InputError, check_number, check_type
from murmurate.geometry import _batch_last
from murmurate.registry import Strategy
from murmurate.world.config import MAX_PAIRS, WorldConfig, check_world, with_array_leaves
from murmurate.world.start_files import check_configurations, read_named_starts

__all__ = [
    "DistributedStart",
    "FileStart",
    "JitteredStart",
    "LayoutStart",
    "MixtureStart",
    "PackedStart",
    "ScatteredStart",
    "Start",
    "UniformStart",
    "block",
    "bounds_of",
    "check_start",
    "does_not_fit",
    "draw_starts",
    "episodes_at_once",
    "redraw_overlaps",
    "redraw_overlaps_batch_last",
]

MAX_REDRAWS = 10_000
"""Redraws after which overlaps stay: a start that needs more is refused when it is checked."""

MAX_REDRAW_PAIRS = 1 << 30
"""Pairs of robots compared in all redraws of a batch, about: they take seconds, in which nothing interrupts."""

MAX_PARTIAL_REDRAWS = 50
"""Redraws after which a configuration that still overlaps is drawn anew as a whole."""

BATCH_PAIRS = 1 << 13
"""Pairs of robots in the episodes that are drawn or executed at once: they fit in a core's cache."""

BATCH_EPISODES = 64
"""Episodes that are drawn or executed at once, at most."""

TRIALS = 16
"""Configurations drawn to check a start."""


class Start(Strategy):
    """A distribution of initial configurations.

    A subclass implements `sample`; `redraw_overlaps` keeps its robots apart.
    """

    section: ClassVar[str] = "start"

    file_fields: ClassVar[tuple[str, ...]] = ()
    """The fields that name files: a path in a TOML file is relative to it, and a run keeps copies of the files."""

    @abstractmethod
    def sample(self, key: PRNGKeyArray, batch: int, world: WorldConfig) -> Float[Array, "batch robots 2"]:
        """Draws configurations, none in contact, all inside the world.

        Args:
            key: Randomness.
            batch: How many to draw.
            world: Sizes of the world and its robots; under a jit its numbers are traced.

        Returns:
            Centres, world units.
        """

    def prepare(self, world: WorldConfig) -> Start:
        """Returns the start with everything done that needs no randomness, such as reading files.

        Called once, outside of any jit, with the numbers of the world known. A start of a few given configurations
        returns a `JitteredStart` of them: training then begins at each of them equally often.

        Raises:
            InputError: The start is not possible in this world.
        """
        return self

    def fits_any_size(self) -> bool:
        """Returns whether the same start serves swarms of any size."""
        return True


class JitteredStart(Start):
    """One of some given configurations, with equal chances, each coordinate plus uniform noise (paper, equation 11).

    Attributes:
        points: The configurations, world units.
        noise: Half-width of the noise, in robot radii.
    """

    points: Float[Array, "layouts robots 2"]
    noise: Any = 0.0

    def sample(self, key: PRNGKeyArray, batch: int, world: WorldConfig) -> Float[Array, "batch robots 2"]:
        """Draws configurations and adds noise U(-noise R, noise R) to every coordinate."""
        choose, draw = jax.random.split(key)
        chosen = self.points[jax.random.randint(choose, (batch,), 0, self.points.shape[0], jnp.int32)]
        center = jnp.moveaxis(chosen, 0, -1)
        bounds, noise = bounds_of(world), self.noise * world.radius
        low = jnp.maximum(center - noise, -bounds)
        high = jnp.minimum(center + noise, bounds)

        def propose(key: PRNGKeyArray) -> Float[Array, "robots 2 batch"]:
            return low + (high - low) * jax.random.uniform(key, center.shape, jnp.float32)

        return jnp.moveaxis(redraw_overlaps_batch_last(draw, propose, world.radius), -1, 0)


class LayoutStart(Start):
    """A start of this package that places robots exactly and adds noise: a base class of some."""

    noise: float = 2.0

    def __check_init__(self) -> None:
        check_number("noise", self.noise, 0, MAX_INTEGER)

    @abstractmethod
    def layouts(self, world: WorldConfig) -> Float[np.ndarray, "layouts robots 2"]:
        """Returns the configurations without noise, world units.

        Raises:
            InputError: So many robots do not fit.
        """

    def prepare(self, world: WorldConfig) -> JitteredStart:
        """Returns the start with its robots placed."""
        return JitteredStart(jnp.asarray(self.layouts(world), jnp.float32), self.noise)

    def sample(self, key: PRNGKeyArray, batch: int, world: WorldConfig) -> Float[Array, "batch robots 2"]:
        """Draws layouts and adds noise; `prepare` must be possible, so not under a jit that traces the world."""
        return self.prepare(world).sample(key, batch, world)

    def _fitting(self, points: np.ndarray, world: WorldConfig) -> Float[np.ndarray, "1 robots 2"]:
        outside = (np.abs(points.astype(np.float32)) > world.bounds).any()
        if outside or (_batch_last.clearances(points, world.radius) <= 0).any():
            raise does_not_fit(world, f"the {self.name} start")
        return points[None]


@Start.register("scattered")
class ScatteredStart(LayoutStart):
    """The paper's Scattered: evenly on a circle of radius min(X, Y), plus noise.

    Attributes:
        noise: Half-width of the uniform noise on each coordinate, in robot radii; the paper's experiments use 2.
    """

    def layouts(self, world: WorldConfig) -> Float[np.ndarray, "1 robots 2"]:
        """Returns the regular polygon."""
        angle = 2 * np.pi * np.arange(world.robots) / world.robots
        circle = min(world.half_width, world.half_height)
        return self._fitting(circle * np.stack([np.cos(angle), np.sin(angle)], axis=1), world)


@Start.register("distributed")
class DistributedStart(LayoutStart):
    """The paper's Distributed: half of the robots, on a grid, near each of two opposite corners, plus noise.

    Attributes:
        noise: Half-width of the uniform noise on each coordinate, in robot radii; the paper's experiments use 2.
        spacing: Distance between neighbours of the grid, in robot radii.
    """

    spacing: float = 6.0

    def __check_init__(self) -> None:
        check_number("spacing", self.spacing, 2, MAX_INTEGER, exclusive_low=True)

    def layouts(self, world: WorldConfig) -> Float[np.ndarray, "1 robots 2"]:
        """Returns the two grids."""
        first, spacing = (world.robots + 1) // 2, self.spacing * world.radius
        points = block(first, math.ceil(math.sqrt(first)), spacing) + spacing / 2
        corner = np.array([world.half_width, world.half_height])
        return self._fitting(np.concatenate([points - corner, corner - points[: world.robots - first]]), world)


@Start.register("packed")
class PackedStart(LayoutStart):
    """The paper's Packed: one line, or several, half-way between the gathering point and the lower edge, plus noise.

    Attributes:
        noise: Half-width of the uniform noise on each coordinate, in robot radii; the paper's experiments use 2.
        spacing: Distance between neighbours of a line, and between lines, in robot radii.
        lines: Number of lines.
    """

    spacing: float = 6.0
    lines: int = eqx.field(default=1, static=True)

    def __check_init__(self) -> None:
        check_number("spacing", self.spacing, 2, MAX_INTEGER, exclusive_low=True)
        check_number("lines", self.lines, 1, MAX_INTEGER, integer=True)

    def layouts(self, world: WorldConfig) -> Float[np.ndarray, "1 robots 2"]:
        """Returns the lines."""
        points = block(world.robots, math.ceil(world.robots / self.lines), self.spacing * world.radius)
        points = points - (points.max(axis=0) + points.min(axis=0)) / 2
        return self._fitting(points - np.array([0.0, world.half_height / 2]), world)


@Start.register("file")
class FileStart(LayoutStart):
    """The configurations of a file, with equal chances, plus noise.

    Attributes:
        noise: Half-width of the uniform noise on each coordinate, in robot radii.
        file: CSV file of starts with the header start,x,y.
    """

    file_fields: ClassVar[tuple[str, ...]] = ("file",)

    file: str = eqx.field(default="", static=True)

    def layouts(self, world: WorldConfig) -> Float[np.ndarray, "layouts robots 2"]:
        """Reads the file and checks its configurations."""
        # Not sooner: a start without a file has to exist for the command line to ask it for its fields.
        if not self.file:
            raise InputError("start.file", self.file, "the name of a CSV file of starts")
        starts = read_named_starts(self.file, world.robots)
        points = np.array(list(starts.values()))
        check_configurations(points, world, self.file, list(starts))
        return points

    def fits_any_size(self) -> bool:
        """Returns False: a file holds starts of one size."""
        return False


@Start.register("random")
class UniformStart(Start):
    """Anywhere in the world without overlap; with `min_window` below 1, in two randomly placed windows.

    Windows are placed anywhere and pushed inside, so small ones often lie along a wall or in a corner; how the robots
    divide between the two is random as well, all in one window included.

    Attributes:
        min_window: Each window takes at least this share of the world's sides; 1: the whole world.
    """

    min_window: float = 1.0

    def __check_init__(self) -> None:
        check_number("min_window", self.min_window, 0, 1, exclusive_low=True)

    def sample(self, key: PRNGKeyArray, batch: int, world: WorldConfig) -> Float[Array, "batch robots 2"]:
        """Draws every robot uniformly in its window, whose sides are a share from `min_window` to 1 of the world's.

        Shares are uniform in their logarithm: tight crowds are as common as loose ones. No window is so small that the
        discs around N - 1 centres, which the last one must avoid, could fill it.
        """
        robots, bounds = world.robots, bounds_of(world)
        size_key, position_key, divide, draw = jax.random.split(key, 4)
        room = world.radius * jnp.sqrt(jnp.pi * (robots - 1) / (world.half_width * world.half_height))
        least = jnp.minimum(jnp.maximum(self.min_window, room), 1.0)
        share = least ** jax.random.uniform(size_key, (2, 2, batch), jnp.float32)
        position = jax.random.uniform(position_key, (2, 2, batch), jnp.float32, -1.0, 1.0)
        center = bounds * jnp.clip(position, share - 1, 1 - share)
        first = jax.random.uniform(divide, (batch,), jnp.float32)

        def propose(key: PRNGKeyArray) -> Float[Array, "robots 2 batch"]:
            window, inside = jax.random.split(key)
            unit = jax.random.uniform(inside, (robots, 2, batch), jnp.float32, -1.0, 1.0)
            in_first = (jax.random.uniform(window, (robots, batch), jnp.float32) < first)[:, None]
            return jnp.where(in_first, center[0] + bounds * share[0] * unit, center[1] + bounds * share[1] * unit)

        return jnp.moveaxis(redraw_overlaps_batch_last(draw, propose, world.radius), -1, 0)


@Start.register("mixture")
class MixtureStart(Start):
    """The second start with probability `share`, else the first; each may be a mixture again.

    Attributes:
        first: A start.
        second: Another start.
        share: Probability of the second.
    """

    first: Start = eqx.field(default_factory=ScatteredStart)
    second: Start = eqx.field(default_factory=UniformStart)
    share: float = 0.5

    def __check_init__(self) -> None:
        check_number("share", self.share, 0, 1)

    def sample(self, key: PRNGKeyArray, batch: int, world: WorldConfig) -> Float[Array, "batch robots 2"]:
        """Draws from both and keeps one for each member of the batch."""
        coin, first, second = jax.random.split(key, 3)
        from_second = (jax.random.uniform(coin, (batch,), jnp.float32) < self.share)[:, None, None]
        return jnp.where(from_second, self.second.sample(second, batch, world), self.first.sample(first, batch, world))

    def prepare(self, world: WorldConfig) -> Start:
        """Prepares both starts."""
        # Not by its constructor, which takes no share that is an array already.
        parts = self.first.prepare(world), self.second.prepare(world)
        return eqx.tree_at(lambda start: (start.first, start.second), self, parts)

    def fits_any_size(self) -> bool:
        """Returns whether both starts serve swarms of any size."""
        return self.first.fits_any_size() and self.second.fits_any_size()


def redraw_overlaps(
    key: PRNGKeyArray, propose: Callable[[PRNGKeyArray], Float[Array, "batch robots 2"]], radius: Any
) -> Float[Array, "batch robots 2"]:
    """Draws configurations and draws again the robots that touch a robot of lower number, until none does.

    Args:
        key: Randomness.
        propose: Draws a batch of configurations.
        radius: The robots' radius, world units.
    """

    def propose_batch_last(key: PRNGKeyArray) -> Float[Array, "robots 2 batch"]:
        return jnp.moveaxis(propose(key), 0, -1)

    return jnp.moveaxis(redraw_overlaps_batch_last(key, propose_batch_last, radius), -1, 0)


def redraw_overlaps_batch_last(
    key: PRNGKeyArray, propose: Callable[[PRNGKeyArray], Any], radius: Any
) -> Float[Array, "robots 2 batch"]:
    """Computes `redraw_overlaps` with the batch last."""

    def pending(carry: tuple[Any, Any, Any, Any]) -> Any:
        _, _, overlapping, turn = carry
        return jnp.any(overlapping) & (turn < turns)

    def redraw(carry: tuple[Any, Any, Any, Any]) -> tuple[Any, Any, Any, Any]:
        key, positions, overlapping, turn = carry
        key, draw = jax.random.split(key)
        # The robots that were placed can leave no room for one more, however often that one is drawn again.
        stuck = jnp.any(overlapping, axis=0) & (turn % MAX_PARTIAL_REDRAWS == MAX_PARTIAL_REDRAWS - 1)
        positions = jnp.where((overlapping | stuck)[:, None], propose(draw), positions)
        return key, positions, _touch_earlier(positions, radius), turn + 1

    key, draw = jax.random.split(key)
    positions = propose(draw)
    # In large batches of large swarms a redraw takes long, and nothing interrupts the loop.
    turns = min(MAX_REDRAWS, max(MAX_REDRAW_PAIRS // max(positions.size * len(positions), 1), 2 * MAX_PARTIAL_REDRAWS))
    carry = (key, positions, _touch_earlier(positions, radius), 0)
    return jax.lax.while_loop(pending, redraw, carry)[1]


def _touch_earlier(positions: Float[Array, "robots 2 batch"], radius: Any) -> Any:
    """Returns which robots touch one of lower number."""
    robots = positions.shape[0]
    earlier = jnp.tril(jnp.ones((robots, robots), bool), -1)[:, :, None]
    return _batch_last.fold(operator.or_, (_batch_last.clearances(positions, radius) <= 0) & earlier, axis=1)


@prng.reproducible()
def draw_starts(
    start: Start, key: PRNGKeyArray, count: int, world: WorldConfig
) -> Float[np.ndarray, "starts robots 2"]:
    """Draws configurations, world units, from a prepared start.

    They are drawn in batches of a fixed size. So those that are drawn first are the same whatever the count, one
    compiled program serves any count, and Ctrl-C ends a long search between two batches.
    """
    check_type("start", start, Start, "a start, such as UniformStart()")
    check_number("count", count, 1, integer=True)
    check_world(world)
    start_arrays, world_arrays, size = (
        with_array_leaves(start),
        with_array_leaves(world),
        episodes_at_once(world.robots),
    )
    keys = [jax.random.fold_in(key, first) for first in range(0, count, size)]
    return np.concatenate([np.asarray(_draw(start_arrays, key, size, world_arrays)) for key in keys])[:count]


def episodes_at_once(robots: int) -> int:
    """Returns how many episodes of a swarm of this size are drawn or executed at once, a power of two.

    It is the same for any number of episodes. So each of them is computed alike whatever the others are, to the last
    bit, and a program that was compiled for some episodes serves any number.
    """
    fitting = max(BATCH_PAIRS // robots**2, 1)
    return min(BATCH_EPISODES, 1 << (fitting.bit_length() - 1))


# Outside of a jit, the loop that redraws overlaps would be compiled anew at every call.
@eqx.filter_jit
def _draw(start: Start, key: PRNGKeyArray, count: int, world: WorldConfig) -> Float[Array, "starts robots 2"]:
    return start.sample(key, count, world)


def check_start(start: Start, world: WorldConfig) -> Start:
    """Prepares a start and draws a few configurations from it, so that an impossible one fails before any training.

    Returns:
        The prepared start.

    Raises:
        InputError: The start returns another shape or type, or numbers that are not finite, or its robots do not fit.
    """
    check_type("start", start, Start, "a start, such as UniformStart()")
    check_world(world)
    if TRIALS * world.robots**2 > MAX_PAIRS:
        limit = math.isqrt(MAX_PAIRS // TRIALS)
        raise InputError("world.robots", world.robots, f"at most {limit}: memory holds no more pairs of them")
    prepared = start.prepare(world)
    try:
        _try_once(prepared, world)
    except TypeError:  # a start that holds arrays, which have no hash
        _try(prepared, world)
    return prepared


def _try(start: Start, world: WorldConfig) -> None:
    """Draws from a prepared start; see `check_start`."""
    try:
        # The key is made inside: nothing is computed for a start that surely fits, and JAX is not started.
        sampled = eqx.filter_eval_shape(lambda: start.sample(prng.key(0), TRIALS, world))
    except InputError:
        raise
    except Exception as error:  # a user's start may raise anything
        raise InputError("start", start.name, f"a start that can be drawn ({type(error).__name__}: {error})") from None
    wanted = (TRIALS, world.robots, 2)
    shape, dtype = getattr(sampled, "shape", None), getattr(sampled, "dtype", None)
    if (shape, dtype) != (wanted, jnp.float32):
        returned = f"{dtype}{list(shape)}" if shape is not None else type(sampled).__name__
        raise InputError("start", start.name, f"a start whose sample returns float32{list(wanted)}, not {returned}")
    if _surely_fits(start, world):
        return
    for count in (1, TRIALS):  # one first: where none fits, the search for each of them takes long
        points = draw_starts(start, prng.key(0), count, world)
        if not np.isfinite(points).all():
            raise InputError("start", start.name, "a start of finite numbers")
        if (np.abs(points) > world.bounds).any():
            raise InputError("start", start.name, f"inside |x| <= {world.half_width:g}, |y| <= {world.half_height:g}")
        if (_batch_last.clearances(np.moveaxis(points, 0, -1), world.radius) <= 0).any():
            raise does_not_fit(world, f"the {start.name} start without overlap")


# A process that opens many runs, or trains many seeds, meets the same starts in the same worlds again and again.
_try_once = functools.lru_cache(maxsize=256)(_try)


def does_not_fit(world: WorldConfig, what: str) -> InputError:
    """Returns the error of a start that has no room; any of the sizes may be the one that is not as it was meant."""
    return InputError(
        "world.robots",
        world.robots,
        f"few enough to fit {what} (or make world.half_width = {world.half_width:g} or "
        f"world.half_height = {world.half_height:g} larger, or world.radius = {world.radius:g} smaller)",
    )


SPARSE = 0.05
"""Share of the world that discs may cover to be sure to fit anywhere at random: they jam at eleven times as much."""


def _surely_fits(start: Start, world: WorldConfig) -> bool:
    discs = world.robots * np.pi * world.radius**2
    return type(start) is UniformStart and discs < SPARSE * 4 * world.half_width * world.half_height


def block(count: int, columns: int, spacing: float) -> Float[np.ndarray, "count 2"]:
    """Returns the points of a square grid, row by row from the origin on."""
    index = np.arange(count)
    return spacing * np.stack([index % columns, index // columns], axis=1).astype(float)


def bounds_of(world: WorldConfig) -> Float[Array, "2 1"]:
    """Returns the world's half-sides as an array, under a jit as well."""
    return jnp.stack([jnp.asarray(world.half_width, jnp.float32), jnp.asarray(world.half_height, jnp.float32)])[:, None]
