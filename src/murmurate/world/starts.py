"""Distributions of initial configurations: the paper's layouts, random and symmetric ones, files, and mixtures of them.

A start is never in contact and never outside the world. Staying inside is exact: each coordinate's uniform noise is
drawn from the part of its range that lies inside, which is what redrawing until it does would give. Overlaps are
redrawn: a robot that touches a robot of lower number is drawn again, until none does.
"""

from __future__ import annotations

import csv
import io
import math
import operator
from abc import abstractmethod
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from murmurate import prng, untrusted
from murmurate.errors import MAX_INTEGER, InputError, check_choice, check_number, check_path, check_type
from murmurate.geometry import _batch_last
from murmurate.registry import Strategy
from murmurate.world.config import MAX_PAIRS, WorldConfig, check_world, with_array_leaves

__all__ = [
    "DistributedStart",
    "Family",
    "FileStart",
    "JitteredStart",
    "LayoutStart",
    "MixtureStart",
    "PackedStart",
    "ScatteredStart",
    "Start",
    "SymmetricStart",
    "UniformStart",
    "check_configurations",
    "check_start",
    "checked_starts",
    "draw_starts",
    "read_named_starts",
    "read_starts",
    "redraw_overlaps",
    "symmetric_layout",
]

MAX_REDRAWS = 10_000
"""Redraws after which overlaps stay: a start that needs more is refused when it is checked."""

MAX_REDRAW_PAIRS = 1 << 34
"""Pairs of robots compared in all redraws of a batch, about: they take a minute."""

PART_PAIRS = 1 << 28
"""Pairs of robots compared in the redraws of a batch that nothing interrupts, about: they take a second."""

MAX_PARTIAL_REDRAWS = 50
"""Redraws after which a configuration that still overlaps is drawn anew as a whole."""

MAX_STARTS_BYTES = 1 << 26
"""Size of a file of starts, at most."""

TRIALS = 16
"""Configurations drawn to check a start."""


class Start(Strategy):
    """A distribution of initial configurations.

    A subclass implements `sample`; `redraw_overlaps` keeps its robots apart.
    """

    section: ClassVar[str] = "start"

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

        Called once, outside of any jit, with the numbers of the world known.

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
        bounds, noise = _bounds(world), self.noise * world.radius
        low = jnp.maximum(center - noise, -bounds)
        high = jnp.minimum(center + noise, bounds)

        def propose(key: PRNGKeyArray) -> Float[Array, "robots 2 batch"]:
            return low + (high - low) * jax.random.uniform(key, center.shape, jnp.float32)

        return jnp.moveaxis(_redraw_overlaps_batch_last(draw, propose, world.radius), -1, 0)


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
            raise _does_not_fit(world, f"the {self.name} start")
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
        points = _block(first, math.ceil(math.sqrt(first)), spacing) + spacing / 2
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
        points = _block(world.robots, math.ceil(world.robots / self.lines), self.spacing * world.radius)
        points = points - (points.max(axis=0) + points.min(axis=0)) / 2
        return self._fitting(points - np.array([0.0, world.half_height / 2]), world)


@Start.register("file")
class FileStart(LayoutStart):
    """The configurations of a file, with equal chances, plus noise.

    Attributes:
        noise: Half-width of the uniform noise on each coordinate, in robot radii.
        file: CSV file of starts with the header start,x,y.
    """

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
        robots, bounds = world.robots, _bounds(world)
        size_key, place_key, divide, draw = jax.random.split(key, 4)
        room = world.radius * jnp.sqrt(jnp.pi * (robots - 1) / (world.half_width * world.half_height))
        least = jnp.minimum(jnp.maximum(self.min_window, room), 1.0)
        share = least ** jax.random.uniform(size_key, (2, 2, batch), jnp.float32)
        place = jax.random.uniform(place_key, (2, 2, batch), jnp.float32, -1.0, 1.0)
        center = bounds * jnp.clip(place, share - 1, 1 - share)
        first = jax.random.uniform(divide, (batch,), jnp.float32)

        def propose(key: PRNGKeyArray) -> Float[Array, "robots 2 batch"]:
            window, inside = jax.random.split(key)
            unit = jax.random.uniform(inside, (robots, 2, batch), jnp.float32, -1.0, 1.0)
            in_first = (jax.random.uniform(window, (robots, batch), jnp.float32) < first)[:, None]
            return jnp.where(in_first, center[0] + bounds * share[0] * unit, center[1] + bounds * share[1] * unit)

        return jnp.moveaxis(_redraw_overlaps_batch_last(draw, propose, world.radius), -1, 0)


Family = Literal["polygon", "line", "grid", "rings"]

MIN_SPACING, MAX_EXTENT = 1.5, 0.8
"""Symmetric neighbours begin at least so many diameters apart, and no robot farther out than this share of the way to
the wall."""


@Start.register("symmetric")
class SymmetricStart(Start):
    """Exactly symmetric configurations around the origin, each of a random width and direction.

    They are the hardest for robots that are all alike: a deterministic policy that depends only on what is seen keeps
    every symmetry that all robots share. Rounding, noise, a scheduler that moves some robots and not others, or frames
    without a common handedness break it.

    Attributes:
        family: polygon (a regular one), line (evenly spaced), grid (as square as it can be, full rows but for the last,
            which is centred), rings (two regular polygons, one inside the other, and one robot in the middle where the
            number is odd), or any of them with equal chances.
    """

    family: Literal["any", "polygon", "line", "grid", "rings"] = eqx.field(default="any", static=True)

    def __check_init__(self) -> None:
        check_choice("family", self.family, ("any", *get_args(Family)))

    def sample(self, key: PRNGKeyArray, batch: int, world: WorldConfig) -> Float[Array, "batch robots 2"]:
        """Draws widths between the least without contact and the greatest that stays off the walls, and directions."""
        family_key, size_key, angle_key = jax.random.split(key, 3)
        layouts = np.stack([symmetric_layout(family, world.robots) for family in self._families(world.robots)])
        low, high = self._sizes(layouts, world)
        family = jax.random.randint(family_key, (batch,), 0, len(layouts), jnp.int32)
        high = jnp.asarray(high, jnp.float32)[family]
        size = low + (high - low) * jax.random.uniform(size_key, (batch,), jnp.float32)
        angle = jax.random.uniform(angle_key, (batch,), jnp.float32, maxval=2 * jnp.pi)
        cos, sin = jnp.cos(angle)[:, None], jnp.sin(angle)[:, None]
        points = size[:, None, None] * jnp.asarray(layouts, jnp.float32)[family]
        x, y = points[..., 0], points[..., 1]
        return jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)

    def prepare(self, world: WorldConfig) -> Start:
        """Checks that there is room for every family."""
        for family in self._families(world.robots):
            low, high = self._sizes(symmetric_layout(family, world.robots)[None], world)
            if low > high[0]:
                raise _does_not_fit(world, f"the start {family}")
        return self

    def _families(self, robots: int) -> tuple[Family, ...]:
        if self.family != "any":
            return (self.family,)
        return tuple(family for family in get_args(Family) if family != "rings" or robots >= 4)

    def _sizes(self, layouts: np.ndarray, world: WorldConfig) -> tuple[Any, Any]:
        """Returns the least distance of nearest neighbours, and the greatest for each layout."""
        extent = np.linalg.norm(layouts, axis=2).max(axis=1)
        minimum = jnp.minimum if isinstance(world.half_width, jax.Array) else min
        half_side = minimum(world.half_width, world.half_height)
        return MIN_SPACING * 2 * world.radius, MAX_EXTENT * half_side / extent


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
        return replace(self, first=self.first.prepare(world), second=self.second.prepare(world))

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

    return jnp.moveaxis(_redraw_overlaps_batch_last(key, propose_batch_last, radius), -1, 0)


def _redraw_overlaps_batch_last(
    key: PRNGKeyArray, propose: Callable[[PRNGKeyArray], Any], radius: Any
) -> Float[Array, "robots 2 batch"]:
    def pending(carry: tuple[Any, Any, Any, Any]) -> Any:
        _, _, overlapping, turn = carry
        return jnp.any(overlapping) & (turn < end)

    def redraw(carry: tuple[Any, Any, Any, Any]) -> tuple[Any, Any, Any, Any]:
        key, positions, overlapping, turn = carry
        key, draw = jax.random.split(key)
        # The robots that were placed can leave no room for one more, however often that one is drawn again.
        stuck = jnp.any(overlapping, axis=0) & (turn % MAX_PARTIAL_REDRAWS == MAX_PARTIAL_REDRAWS - 1)
        positions = jnp.where((overlapping | stuck)[:, None], propose(draw), positions)
        return key, positions, _touch_earlier(positions, radius), turn + 1

    first = _first_redraw.get()
    if isinstance(first, jax.Array):
        key = jax.lax.fori_loop(0, first, lambda _, key: jax.random.split(key)[0], key)
    key, draw = jax.random.split(key)
    positions = propose(draw)
    robots, _, batch = positions.shape
    begin, end = 0, _max_redraws(batch, robots)
    if first is not None:
        begin, end = first, jnp.minimum(first + _part_redraws(batch, robots), end)
    carry = (key, positions, _touch_earlier(positions, radius), begin)
    return jax.lax.while_loop(pending, redraw, carry)[1]


def _max_redraws(batch: int, robots: int) -> int:
    """Returns after how many redraws overlaps stay: in large batches of large swarms each takes long."""
    return min(MAX_REDRAWS, max(MAX_REDRAW_PAIRS // (2 * batch * robots**2), 2 * MAX_PARTIAL_REDRAWS))


def _part_redraws(batch: int, robots: int) -> int:
    """Returns how many redraws `draw_starts` executes at a time: a multiple of `MAX_PARTIAL_REDRAWS`."""
    return max(PART_PAIRS // (2 * batch * robots**2 * MAX_PARTIAL_REDRAWS), 1) * MAX_PARTIAL_REDRAWS


_first_redraw: ContextVar[int | Array | None] = ContextVar("first_redraw", default=None)
"""While a program of `draw_starts` is traced, the redraw that its part of them begins with; None: it has all of them.

After every `MAX_PARTIAL_REDRAWS` redraws, each configuration that still overlaps is drawn anew as a whole. So a later
part, which begins after a multiple of that, goes on without what the parts before it have drawn.
"""


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

    Overlaps are redrawn in parts of about a second, between which Ctrl-C ends it.
    """
    check_type("start", start, Start, "a start, such as UniformStart()")
    check_number("count", count, 1, integer=True)
    check_world(world)
    arguments = (with_array_leaves(start), key, count, with_array_leaves(world))
    points, overlapping = jax.device_get(_draw_part(*arguments, 0))
    if not overlapping.any():
        return points
    part = _part_redraws(count, world.robots)
    for first in range(part, _max_redraws(count, world.robots), part):
        _, still = jax.device_get(_draw_part(*arguments, jnp.int32(first)))
        overlapping = overlapping & still
        if not overlapping.any():
            break
    else:
        return points
    # One program, as a training draws them: a start of the user's own may have done more than to redraw overlaps.
    return np.asarray(_draw(*arguments))


# Outside of a jit, the loop that redraws overlaps would be compiled anew at every call.
@eqx.filter_jit
def _draw(start: Start, key: PRNGKeyArray, count: int, world: WorldConfig) -> Float[Array, "starts robots 2"]:
    return start.sample(key, count, world)


@eqx.filter_jit
def _draw_part(
    start: Start, key: PRNGKeyArray, count: int, world: WorldConfig, first: Any
) -> tuple[Float[Array, "starts robots 2"], Bool[Array, " starts"]]:
    """Draws configurations with a part of the redraws, from `first` on, and returns which still overlap."""
    token = _first_redraw.set(first)
    try:
        points = start.sample(key, count, world)
    finally:
        _first_redraw.reset(token)
    return points, jnp.any(_touch_earlier(jnp.moveaxis(points, 0, -1), world.radius), axis=0)


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
        most = math.isqrt(MAX_PAIRS // TRIALS)
        raise InputError("world.robots", world.robots, f"at most {most}: memory holds no more pairs of them")
    prepared = start.prepare(world)
    try:
        # The key is made inside: nothing is computed for a start that surely fits, and JAX is not started.
        sampled = eqx.filter_eval_shape(lambda: prepared.sample(prng.key(0), TRIALS, world))
    except InputError:
        raise
    except Exception as error:  # a user's start may raise anything
        raise InputError("start", start.name, f"a start that can be drawn ({type(error).__name__}: {error})") from None
    wanted = (TRIALS, world.robots, 2)
    shape, dtype = getattr(sampled, "shape", None), getattr(sampled, "dtype", None)
    if shape != wanted or dtype is None or not jnp.issubdtype(dtype, jnp.floating):
        what = f"{dtype}{list(shape)}" if shape is not None else type(sampled).__name__
        raise InputError("start", start.name, f"a start whose sample returns float32{list(wanted)}, not {what}")
    if _surely_fits(prepared, world):
        return prepared
    points = draw_starts(prepared, prng.key(0), TRIALS, world)
    if not np.isfinite(points).all():
        raise InputError("start", start.name, "a start of finite numbers")
    if (np.abs(points) > world.bounds).any():
        raise InputError("start", start.name, f"inside |x| <= {world.half_width:g}, |y| <= {world.half_height:g}")
    if (_batch_last.clearances(np.moveaxis(points, 0, -1), world.radius) <= 0).any():
        raise _does_not_fit(world, f"the {start.name} start without overlap")
    return prepared


def _does_not_fit(world: WorldConfig, what: str) -> InputError:
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


def symmetric_layout(family: Family, robots: int) -> Float[np.ndarray, "robots 2"]:
    """Places robots symmetrically, the middle at the origin and nearest neighbours 1 apart.

    Args:
        family: polygon, line, grid or rings; see `SymmetricStart`.
        robots: Number of robots.

    Raises:
        InputError: There is no such family, or too few robots for it.
    """
    check_choice("family", family, get_args(Family))
    if robots < 2 or (family == "rings" and robots < 4):
        raise InputError("robots", robots, f"at least {4 if family == 'rings' else 2} for the start {family}")
    if family == "line":
        points = np.stack([np.arange(robots, dtype=float), np.zeros(robots)], axis=1)
    elif family == "grid":
        across = math.ceil(math.sqrt(robots))
        rows = [min(across, robots - first) for first in range(0, robots, across)]
        points = np.array([[i - (n - 1) / 2, row] for row, n in enumerate(rows) for i in range(n)])
    elif family == "rings":
        inner = _polygon(robots // 2)
        points = np.concatenate([inner, 2 * inner, np.zeros((robots % 2, 2))])
    else:
        points = _polygon(robots)
    points = points - (points.max(axis=0) + points.min(axis=0)) / 2 if family in ("line", "grid") else points
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    return points / apart[~np.eye(robots, dtype=bool)].min()


def _polygon(corners: int) -> Float[np.ndarray, "corners 2"]:
    angle = 2 * np.pi * np.arange(corners) / corners
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _block(count: int, columns: int, spacing: float) -> np.ndarray:
    index = np.arange(count)
    return spacing * np.stack([index % columns, index // columns], axis=1).astype(float)


def _bounds(world: WorldConfig) -> Float[Array, "2 1"]:
    return jnp.stack([jnp.asarray(world.half_width, jnp.float32), jnp.asarray(world.half_height, jnp.float32)])[:, None]


def read_starts(path: str | Path, robots: int) -> Float[np.ndarray, "starts robots 2"]:
    """Reads a CSV file of starts: the header `start,x,y`, then one row for each robot of each start.

    Args:
        path: The file.
        robots: How many robots each start must have.

    Returns:
        The starts in the order of their first rows.

    Raises:
        InputError: See `read_named_starts`.
    """
    return np.array(list(read_named_starts(path, robots).values()))


def read_named_starts(path: str | Path, robots: int) -> dict[str, Float[np.ndarray, "robots 2"]]:
    """Reads a CSV file of starts as `read_starts` does, by what its column `start` calls them.

    Raises:
        InputError: A column is missing or there twice, a row has too many cells, a value is no finite number, or a
            start has another number of robots.
    """
    check_path("path", path)
    check_number("robots", robots, 1, integer=True)
    source = str(path)
    try:
        # Spreadsheets begin files with a byte-order mark.
        text = untrusted.read(path, MAX_STARTS_BYTES, follow=True).decode("utf-8-sig")
        reader = csv.DictReader(io.StringIO(text, newline=""))
        header = list(reader.fieldnames or ())
        if {"start", "x", "y"} - set(header):
            raise InputError(source, "another header", "a table with the header start,x,y")
        twice = [name for name in ("start", "x", "y") if header.count(name) > 1]
        if twice:
            where = f"{source} line {reader.line_num}: header"
            raise InputError(where, ",".join(header), f"without a second column {twice[0]}")
        starts: dict[str, list[tuple[float, float]]] = {}
        for row in reader:
            extra: Any = row.pop(None, None)  # type: ignore[call-overload]
            if extra:
                # Numbers with decimal commas make such rows: their halves would be read as other numbers.
                allowed = f"of {len(header)} cells, as the header is; decimals are written with a point"
                raise InputError(f"{source} line {reader.line_num}: row", ",".join([*row.values(), *extra]), allowed)
            point = (_coordinate(source, reader.line_num, row, "x"), _coordinate(source, reader.line_num, row, "y"))
            starts.setdefault(str(row["start"]), []).append(point)
    except (OSError, ValueError, csv.Error) as error:
        if isinstance(error, InputError):
            raise
        reason = getattr(error, "strerror", None) or "it is not text"
        raise InputError("starts", source, f"a readable CSV file ({reason})") from None
    if not starts:
        raise InputError(source, "no rows", "at least one start")
    for name, points in starts.items():
        if len(points) != robots:
            raise InputError(f"{source}: start {name}", f"{len(points)} robots", f"{robots} robots")
    return {name: np.array(points) for name, points in starts.items()}


def _coordinate(source: str, line: int, row: dict[str, str | None], column: str) -> float:
    text = row[column]
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{source} line {line}: {column}", text, "a finite number")
    return value


def checked_starts(field: str, points: Any, robots: int) -> Any:
    """Returns configurations as an array, after checking that it is one of numbers of the right shape.

    Args:
        field: What they are called in an error.
        points: The configurations.
        robots: Number of robots.

    Raises:
        InputError: It is none.
    """
    allowed = f"finite numbers of shape (episodes, {robots}, 2)"
    try:
        array = np.asarray(points, float)
    except (TypeError, ValueError):
        raise InputError(field, points, allowed) from None
    if array.ndim != 3 or array.shape[1:] != (robots, 2) or not len(array):
        raise InputError(field, f"an array {array.shape}", allowed)
    return array


def check_configurations(
    points: Float[np.ndarray, "starts robots 2"], world: WorldConfig, source: str, names: Sequence[str] | None = None
) -> None:
    """Checks that no given configuration is in contact or outside the world.

    Args:
        points: The configurations, world units.
        world: Sizes of the world and its robots.
        source: Where they are from, for error messages.
        names: What their source calls them; by default their numbers, from 0 on.

    Raises:
        InputError: One is; the message names which.
    """
    check_world(world)
    points = checked_starts(source, points, world.robots)
    # Runs compute with float32, so the rounded positions are what must be free of contact.
    with np.errstate(over="ignore"):
        points = points.astype(np.float32).astype(float)
    for name, configuration in zip(names or range(len(points)), points, strict=True):
        if not (np.abs(configuration) <= world.bounds).all():
            allowed = f"inside |x| <= {world.half_width:g}, |y| <= {world.half_height:g}"
            raise InputError(f"{source}: start {name}", "a robot outside", allowed)
        if (_batch_last.clearances(configuration, world.radius) <= 0).any():
            raise InputError(f"{source}: start {name}", "overlapping robots", f"more than {2 * world.radius:g} apart")
