"""Initial configurations that are hard for a controller: crowded, at the walls and in the corners.

They are placed rather than searched for: robots keep the gaps of a pattern, whose jitter is too small to close one, and
the pattern is moved to where it is inside. Only `walls` redraws overlaps. Patterns are turned without a sine or cosine,
so that NumPy's double precision, which the sets of starts are computed in, gives the same digits on every machine.
"""

from __future__ import annotations

import functools
import math
import random
from abc import abstractmethod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate.errors import MAX_INTEGER, check_number
from murmurate.world.config import WorldConfig
from murmurate.world.starts import (
    MixtureStart,
    Start,
    UniformStart,
    block,
    bounds_of,
    does_not_fit,
    redraw_overlaps_batch_last,
)
from murmurate.world.symmetric_starts import ComputedStart, SymmetricStart, namespace

__all__ = ["ClusterStart", "CornerStart", "HardStart", "SurroundedStart", "TightGridStart", "WallStart", "WallsStart"]

EPSILON = float(np.finfo(np.float32).eps)

CLEARANCE = 1e-3
"""Neighbours keep at least this share of a diameter between them, whatever their jitter."""

PATTERNS = 64
"""Different shapes of clusters."""

COVERED = 0.5
"""Share of the walls' length that robots at random places may cover: they jam at three quarters."""


class PlacedStart(ComputedStart):
    """A start that keeps neighbours apart by the spacing of a pattern: a base class.

    Attributes:
        min_spacing: Least distance between the centres of neighbours before jitter, in robot diameters.
        max_spacing: Greatest such distance, in robot diameters, where the world is wide enough. Tight configurations
            are more common than loose ones.
    """

    min_spacing: float = 1.02
    max_spacing: float = 2.0

    def __check_init__(self) -> None:
        check_number("min_spacing", self.min_spacing, 1 + CLEARANCE, MAX_INTEGER)
        check_number("max_spacing", self.max_spacing, self.min_spacing, MAX_INTEGER)

    def uniforms(self, key: PRNGKeyArray, batch: int, robots: int) -> tuple[Array, ...]:
        """Draws ten numbers from 0 to 1 for each configuration, and two more for each robot."""
        shared, each = jax.random.split(key)
        return (
            jax.random.uniform(shared, (10, batch), jnp.float32),
            jax.random.uniform(each, (batch, robots, 2), jnp.float32),
        )

    def _least(self, world: WorldConfig) -> Any:
        """Returns the least distance of neighbours before jitter, world units."""
        return self.min_spacing * 2 * world.radius

    def _spacing(self, number: Any, room: Any, world: WorldConfig) -> Any:
        """Returns distances from the least to the greatest there is room for, half of them in the first quarter."""
        xp, least = namespace(number), self._least(world)
        most = xp.maximum(xp.minimum(self.max_spacing * 2 * world.radius, room), least)
        return least + (most - least) * number**2


class BlockStart(PlacedStart):
    """Robots at neighbouring points of a lattice, turned and moved as one: a base class."""

    @abstractmethod
    def patterns(self, robots: int) -> Float[np.ndarray, "patterns robots 2"]:
        """Returns the configurations that it turns, jitters and moves, nearest neighbours 1 apart."""

    def prepare(self, world: WorldConfig) -> Start:
        """Checks that there is room for every pattern in every direction."""
        span = np.linalg.norm(self.patterns(world.robots), axis=2).max() * 2 + math.sqrt(0.5)
        if self._least(world) * span - _apart(world) * math.sqrt(0.5) > 2 * min(world.half_width, world.half_height):
            raise does_not_fit(world, f"the {self.name} start")
        return self

    def place(self, numbers: tuple[Any, ...], world: WorldConfig) -> Any:
        """Places a pattern of random spacing, direction and jitter."""
        shared, each = numbers
        xp, bounds = namespace(shared), _bounds(shared, world)
        which, turn, quarter, space, loose, aligned = shared[:6]
        patterns = xp.asarray(self.patterns(world.robots), shared.dtype)
        unit = patterns[_index(which, len(patterns))]
        points = _turned(unit, xp.where(self._is_aligned(aligned), 0.5, turn), _index(quarter, 4))
        extent = (points.max(axis=1) - points.min(axis=1)).max(axis=1)
        # Jitter reaches out at both ends of the pattern, by less the tighter it is.
        apart, reach = _apart(world), math.sqrt(0.5)
        room = (2 * bounds.min() + apart * reach) / (extent + reach)
        spacing = self._spacing(space, room, world)
        jitter = self._jitter(loose, world) * xp.maximum(spacing - apart, 0) * reach / 2
        points = spacing[:, None, None] * points + jitter[:, None, None] * (2 * each - 1)
        return xp.clip(self._moved(points, shared[6:], bounds, world), -bounds, bounds)

    def _is_aligned(self, number: Any) -> Any:
        """Returns which patterns are parallel to the walls."""
        return number < 0

    def _jitter(self, number: Any, world: WorldConfig) -> Any:
        """Returns the jitter, as a share of what keeps neighbours apart."""
        return number

    def _moved(self, points: Any, numbers: Any, bounds: Any, world: WorldConfig) -> Any:
        """Moves each configuration to where it is inside: by default, with equal chances anywhere."""
        xp = namespace(points)
        low, high = -bounds - points.min(axis=1), bounds - points.max(axis=1)
        return points + (low + (high - low) * xp.stack([numbers[0], numbers[1]], axis=1))[:, None]


@Start.register("cluster")
class ClusterStart(BlockStart):
    """A crowd, tightly packed, anywhere in the world.

    The robots take neighbouring points of a triangular lattice of random direction, each moved at random by as much as
    its neighbours allow, or by less.

    Attributes:
        min_spacing: Least distance between the centres of neighbours before they are moved, in robot diameters.
        max_spacing: Greatest such distance, in robot diameters, where the world is wide enough. Tight crowds are more
            common than loose ones.
    """

    min_spacing: float = 1.02
    max_spacing: float = 1.8

    def patterns(self, robots: int) -> Float[np.ndarray, "patterns robots 2"]:
        """Returns the points of the lattice nearest to random places, by a distance that is partly random."""
        return _clusters(robots, False)


@Start.register("corner")
class CornerStart(BlockStart):
    """A crowd, tightly packed, in one of the four corners, with robots at both walls.

    Attributes:
        min_spacing: Least distance between the centres of neighbours before they are moved, in robot diameters.
        max_spacing: Greatest such distance, in robot diameters, where the world is wide enough.
        max_gap: Greatest distance from each of the two walls to the robot nearest to it, in robot radii; half of the
            time that robot is exactly at the wall.
    """

    min_spacing: float = 1.02
    max_spacing: float = 1.8
    max_gap: float = 2.0

    def __check_init__(self) -> None:
        check_number("max_gap", self.max_gap, 0, MAX_INTEGER)

    def patterns(self, robots: int) -> Float[np.ndarray, "patterns robots 2"]:
        """Returns square crowds."""
        return _clusters(robots, True)

    def _is_aligned(self, number: Any) -> Any:
        # The patterns are squares parallel to the walls, of lattices in all directions.
        return number >= 0

    def _moved(self, points: Any, numbers: Any, bounds: Any, world: WorldConfig) -> Any:
        xp, size = namespace(points), points.max(axis=1) - points.min(axis=1)
        drawn = xp.maximum(2 * xp.stack([numbers[0], numbers[1]], axis=1) - 1, 0) * self.max_gap * world.radius
        gap = xp.minimum(drawn, xp.maximum(2 * bounds - size, 0))
        side = xp.where(xp.stack([numbers[2], numbers[3]], axis=1) < 0.5, -1, 1)[:, None]
        return side * (bounds - (points - points.min(axis=1)[:, None] + gap[:, None]))


@Start.register("tight-grid")
class TightGridStart(BlockStart):
    """A tight square grid, as square as it can be, anywhere in the world: parallel to the walls or turned.

    It is exact half of the time, else its robots are moved at random by up to a tenth of what their gaps allow.

    Attributes:
        min_spacing: Least distance between the centres of neighbours, in robot diameters.
        max_spacing: Greatest such distance, in robot diameters, where the world is wide enough. Tight grids are more
            common than loose ones.
    """

    min_spacing: float = 1.05
    max_spacing: float = 2.0

    def patterns(self, robots: int) -> Float[np.ndarray, "1 robots 2"]:
        """Returns the grid: full rows but for the last."""
        points = block(robots, math.ceil(math.sqrt(robots)), 1.0)
        return (points - (points.max(axis=0) + points.min(axis=0)) / 2)[None]

    def _is_aligned(self, number: Any) -> Any:
        return number < 0.5

    def _jitter(self, number: Any, world: WorldConfig) -> Any:
        return 0.1 * namespace(number).maximum(2 * number - 1, 0)


@Start.register("wall")
class WallStart(PlacedStart):
    """A line along one of the four walls; several lines where one cannot hold all robots.

    The gaps of a line are all alike half of the time, else drawn one by one.

    Attributes:
        min_spacing: Least distance between the centres of neighbours, and of lines, in robot diameters.
        max_spacing: Greatest such distance, in robot diameters, where the wall is long enough.
        max_gap: Greatest distance from the wall to the centres of the line next to it, in robot radii; half of the time
            they are exactly at the wall.
    """

    min_spacing: float = 1.02
    max_spacing: float = 3.0
    max_gap: float = 2.0

    def __check_init__(self) -> None:
        check_number("max_gap", self.max_gap, 0, MAX_INTEGER)

    def prepare(self, world: WorldConfig) -> Start:
        """Checks that so many lines along each of the walls lie inside."""
        least = self._least(world)
        for along, across in ((world.half_width, world.half_height), (world.half_height, world.half_width)):
            rows = math.ceil(world.robots / (2 * along // least + 1))
            if (rows - 1) * least > 2 * across:
                raise does_not_fit(world, f"the {self.name} start")
        return self

    def place(self, numbers: tuple[Any, ...], world: WorldConfig) -> Any:
        """Places lines of random spacing at a random place of a random wall."""
        shared, each = numbers
        xp, bounds, robots = namespace(shared), _bounds(shared, world), world.robots
        wall, side, space, regular, gap, shift = shared[:6]
        least, upright = self._least(world), wall < 0.5
        along = xp.where(upright, bounds[1], bounds[0])
        across = xp.where(upright, bounds[0], bounds[1])
        rows = xp.ceil(robots / (xp.floor(2 * along / least) + 1))
        columns = xp.ceil(robots / rows)
        spacing = self._spacing(space, 2 * along / xp.maximum(columns - 1, 1), world)[:, None]
        gaps = xp.where((regular < 0.5)[:, None], spacing, least + (spacing - least) * each[..., 0])
        total = xp.cumsum(gaps, axis=1)
        row = xp.floor((xp.arange(robots) + 0.5).astype(shared.dtype) / columns[:, None])
        first = (row * columns[:, None]).astype(np.int32)
        coordinate = total - xp.take_along_axis(total, first, axis=1)
        room = xp.maximum(2 * along - coordinate.max(axis=1), 0)
        coordinate = coordinate + (shift * room - along)[:, None]
        apart = xp.minimum(spacing[:, 0], 2 * across / xp.maximum(rows - 1, 1))
        drawn = xp.maximum(2 * gap - 1, 0) * self.max_gap * world.radius
        depth = xp.minimum(drawn, xp.maximum(2 * across - apart * (rows - 1), 0))
        sign = xp.where(side < 0.5, -1, 1)[:, None]
        distance = sign * (across[:, None] - (depth[:, None] + row * apart[:, None]))
        upright = upright[:, None]
        points = xp.stack([xp.where(upright, distance, coordinate), xp.where(upright, coordinate, distance)], axis=-1)
        return xp.clip(points, -bounds, bounds)


@Start.register("walls")
class WallsStart(Start):
    """Every robot at a random place of a random wall.

    Attributes:
        max_gap: Greatest distance from the wall to the centre of a robot, in robot radii; half of the robots are
            exactly at the wall.
    """

    max_gap: float = 1.0

    def __check_init__(self) -> None:
        check_number("max_gap", self.max_gap, 0, MAX_INTEGER)

    def prepare(self, world: WorldConfig) -> Start:
        """Checks that there is room along the walls, and that no robot is nearer to the wall on the other side."""
        length = 4 * (world.half_width + world.half_height)
        narrow = self.max_gap * world.radius > min(world.half_width, world.half_height)
        if narrow or world.robots * 2 * world.radius > COVERED * length:
            raise does_not_fit(world, f"the {self.name} start")
        return self

    def sample(self, key: PRNGKeyArray, batch: int, world: WorldConfig) -> Float[Array, "batch robots 2"]:
        """Draws walls by their length, and places along them."""
        robots, (width, height) = world.robots, bounds_of(world)

        def propose(key: PRNGKeyArray) -> Float[Array, "robots 2 batch"]:
            wall, along, gap = jax.random.uniform(key, (3, robots, batch), jnp.float32)
            depth = jnp.maximum(2 * gap - 1, 0) * (self.max_gap * world.radius)
            # Each pair of opposite walls takes its share of the unit interval, each wall half of that share.
            scaled = wall * (width + height)
            upright = scaled < height
            part = jnp.where(upright, scaled / height, (scaled - height) / width)
            sign, along = jnp.where(part < 0.5, -1.0, 1.0), 2 * along - 1
            x = jnp.where(upright, sign * (width - depth), width * along)
            y = jnp.where(upright, height * along, sign * (height - depth))
            return jnp.stack([x, y], axis=1)

        return jnp.moveaxis(redraw_overlaps_batch_last(key, propose, world.radius), -1, 0)


@Start.register("surrounded")
class SurroundedStart(ComputedStart):
    """A ring of robots around one robot or a few, anywhere in the world.

    A robot in the middle of a ring hides robots on opposite sides of it from each other. It has to find the way out
    between two of them. One robot is inside in 65% of the configurations, two are in 25%, and a quarter of all robots
    in 10%; one where there is no room for more. The robots inside are at the middle or anywhere else inside. The ring
    is regular, or its robots are moved at random. Tight rings are more frequent than wide ones.

    Attributes:
        min_spacing: Least distance between the centres of neighbours, in robot diameters.
        max_spacing: Greatest distance between neighbours on the ring, in robot diameters, where the world is wide
            enough.
    """

    min_spacing: float = 1.1
    max_spacing: float = 8.0

    def __check_init__(self) -> None:
        check_number("min_spacing", self.min_spacing, 1 + CLEARANCE, MAX_INTEGER)
        check_number("max_spacing", self.max_spacing, self.min_spacing, MAX_INTEGER)

    def prepare(self, world: WorldConfig) -> Start:
        """Checks that there is room for the tightest ring around one robot."""
        least = self.min_spacing * 2 * world.radius
        if max(_ring_radius(least, world.robots - 1, np), least) > min(world.half_width, world.half_height):
            raise does_not_fit(world, f"the {self.name} start")
        return self

    def uniforms(self, key: PRNGKeyArray, batch: int, robots: int) -> tuple[Array, ...]:
        """Draws ten numbers from 0 to 1 for each configuration, and two more for each robot."""
        shared, each = jax.random.split(key)
        return (
            jax.random.uniform(shared, (10, batch), jnp.float32),
            jax.random.uniform(each, (batch, robots, 2), jnp.float32),
        )

    def place(self, numbers: tuple[Any, ...], world: WorldConfig) -> Any:
        """Places some robots on a ring, the others on a smaller one anywhere inside of it."""
        shared, each = numbers
        xp, bounds, robots = namespace(shared), _bounds(shared, world), world.robots
        several, space, turn, inner_turn, loose, off, towards, centred = shared[:8]
        least = self.min_spacing * 2 * world.radius
        spacing = least + (self.max_spacing - self.min_spacing) * 2 * world.radius * space**2

        wanted = xp.where(several < 0.65, 1, xp.where(several < 0.9, 2, max(robots // 4, 1)))
        widest = xp.minimum(_ring_radius(spacing, robots - wanted, xp), bounds.min())
        fits = (robots - wanted >= 3) & (widest > least + _ring_radius(least, wanted, xp))
        inside = xp.where(fits, wanted, 1)
        outside = robots - inside
        radius = xp.minimum(_ring_radius(spacing, outside, xp), bounds.min())
        radius = xp.maximum(xp.maximum(radius, _ring_radius(least, outside, xp)), least)
        inner_radius = xp.where(inside > 1, _ring_radius(least, inside, xp), 0.0)

        # The moves of those on the ring and of those inside share what keeps them apart.
        touch = (1 + CLEARANCE) * 2 * world.radius
        within = xp.minimum(radius - touch, radius * xp.cos(math.pi / xp.maximum(outside, 2)))
        room = xp.maximum(within - inner_radius, 0)
        along = xp.where(outside > 1, 2 * radius * xp.sin(math.pi / outside) - touch, room)
        most = xp.minimum(xp.minimum(room, along), 4 * world.radius)
        jitter = 0.35 * loose * xp.maximum(xp.minimum(most, bounds.min() - radius), 0)
        distance = (room - jitter) * xp.sqrt(off) * xp.where(centred < 0.3, 0.15, 1.0)

        index, is_inside = xp.arange(robots), xp.arange(robots) < inside[:, None]
        share = xp.where(is_inside, index / inside[:, None], (index - inside[:, None]) / outside[:, None])
        angle = 2 * math.pi * (share + xp.where(is_inside, inner_turn[:, None], turn[:, None]))
        points = xp.where(is_inside, inner_radius[:, None], radius[:, None])[..., None] * _unit(angle)
        moved = xp.where(
            is_inside[..., None],
            distance[:, None, None] * _unit(2 * math.pi * towards)[:, None],
            math.sqrt(0.5) * jitter[:, None, None] * (2 * each - 1),
        )
        points = points + moved
        low, high = -bounds - points.min(axis=1), bounds - points.max(axis=1)
        points = points + (low + (high - low) * xp.stack([shared[8], shared[9]], axis=1))[:, None]
        return xp.clip(points, -bounds, bounds)


def _ring_radius(spacing: Any, robots: Any, xp: Any) -> Any:
    """Returns the radius of a ring of robots with a spacing; of one robot alone, the spacing."""
    return spacing / xp.where(robots > 1, 2 * xp.sin(math.pi / xp.maximum(robots, 2)), 1.0)


def _unit(angle: Any) -> Any:
    xp = namespace(angle)
    return xp.stack([xp.cos(angle), xp.sin(angle)], axis=-1)


@Start.register("hard")
class HardStart(Start):
    """Any of the starts that are hard, with equal chances.

    They are `random`, `cluster`, `corner`, `wall`, `walls`, `tight-grid` and `symmetric`, each with its default fields.
    """

    def sample(self, key: PRNGKeyArray, batch: int, world: WorldConfig) -> Float[Array, "batch robots 2"]:
        """Draws from all of them and keeps one for each member of the batch."""
        return self.mixture().sample(key, batch, world)

    def prepare(self, world: WorldConfig) -> Start:
        """Checks that there is room for each of them."""
        self.mixture().prepare(world)
        return self

    @staticmethod
    def mixture() -> MixtureStart:
        """Returns them as a mixture of mixtures."""
        first, *others = (
            UniformStart(),
            ClusterStart(),
            CornerStart(),
            WallStart(),
            WallsStart(),
            TightGridStart(),
            SymmetricStart(),
        )
        mixture: Any = first
        for count, other in enumerate(others, start=2):
            mixture = MixtureStart(mixture, other, 1 / count)
        return mixture


@functools.lru_cache(maxsize=64)
def _clusters(robots: int, square: bool) -> Float[np.ndarray, "patterns robots 2"]:
    """Returns crowds of points of triangular lattices, neighbours 1 apart, the middles of their sides at the origin."""
    # Not NumPy's generators: their streams may change from one version to the next.
    generator = random.Random(robots)
    reach = math.ceil(math.sqrt(robots)) + 3
    column, row = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1))
    lattice = np.stack([column + row / 2, row * math.sqrt(0.75)], axis=-1).reshape(-1, 2)
    patterns = []
    for number in range(PATTERNS):
        # Half of the squares have rows along their sides: where they are at a wall, many of their robots are.
        is_straight = square and number % 2 == 0
        cosine, sine = (1.0, 0.0) if is_straight else _direction(generator.random() - 0.5)
        points = lattice @ np.array([[cosine, sine], [-sine, cosine]])
        points = points - np.array([generator.random(), generator.random()])
        distance = np.abs(points).max(axis=1) if square else np.sqrt((points**2).sum(axis=1))
        ragged = generator.random()
        distance = distance + ragged * np.array([generator.random() for _ in points])
        # Rounded: a tie must not be decided by the last digit.
        chosen = points[np.argsort(distance.round(9), kind="stable")[:robots]]
        patterns.append(chosen - (chosen.max(axis=0) + chosen.min(axis=0)) / 2)
    return np.array(patterns)


def _turned(points: Any, turn: Any, quarters: Any) -> Any:
    """Turns configurations by an angle within 45 degrees, for turn from 0 to 1, and by quarters of a turn."""
    xp = namespace(points)
    cosine, sine = _direction(turn - 0.5)
    odd, half = quarters % 2 == 1, quarters >= 2
    cosine, sine = xp.where(odd, -sine, cosine), xp.where(odd, cosine, sine)
    cosine, sine = xp.where(half, -cosine, cosine)[:, None], xp.where(half, -sine, sine)[:, None]
    x, y = points[..., 0], points[..., 1]
    return xp.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


def _direction(quarters: Any) -> tuple[Any, Any]:
    """Returns the cosine and sine of an angle, from -0.5 to 0.5 quarters of a turn, by arithmetic alone.

    The tangent of half the angle is a polynomial, near enough to have directions equally likely to 1 in 1000; the two
    are rational functions of it, and the sum of their squares is 1 whatever it is.
    """
    half = quarters * (math.pi / 4)
    squared = half * half
    tangent = half * (1 + squared * (1 / 3 + squared * (2 / 15 + squared * (17 / 315))))
    scale = 1 + tangent * tangent
    return (1 - tangent * tangent) / scale, 2 * tangent / scale


def _apart(world: WorldConfig) -> Any:
    """Returns how far apart centres must be for robots not to touch after rounding, world units."""
    return 2 * world.radius * (1 + CLEARANCE) + 4 * EPSILON * (world.half_width + world.half_height)


def _index(number: Any, count: int) -> Any:
    """Returns whole numbers below `count` from numbers from 0 to 1."""
    return (number * count).astype(np.int32).clip(0, count - 1)


def _bounds(numbers: Any, world: WorldConfig) -> Any:
    """Returns the world's half-sides in the namespace and precision of the numbers, as a run has them."""
    if isinstance(numbers, np.ndarray):
        return world.bounds.astype(numbers.dtype)
    return bounds_of(world)[:, 0]
