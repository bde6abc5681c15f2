"""Named sets of starts, the same for everyone: methods that begin at the same ones can be compared.

A set has a name, such as `murmurate-1/cluster/N8`: the version of the sets, the family of its starts and the swarm
size. The name seeds the numbers that the starts are computed from. The generator computes with integers, so these are
the same on every machine. What is computed from them is rounded to single precision only at the end, from NumPy's
double precision; `random` and `walls`, which redraw overlaps, need one rounded product or difference for a coordinate.
The package has the checksum of each set, by which a set that differs on some machine is noticed.
"""

from __future__ import annotations

import functools
import hashlib
import json
import warnings
from importlib import resources

import jax
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from murmurate import prng
from murmurate.errors import StartSetWarning, check_choice, check_number
from murmurate.world.config import MAX_ROBOTS, WorldConfig, check_pairs, check_world, scaled_to
from murmurate.world.hard_starts import ClusterStart, CornerStart, TightGridStart, WallsStart, WallStart
from murmurate.world.starts import Start, UniformStart, draw_starts
from murmurate.world.symmetric_starts import ComputedStart, SymmetricStart

__all__ = ["COUNT", "FAMILIES", "SIZES", "checksum", "checksums", "draw_set", "set_name", "set_world", "start_set"]

VERSION = "murmurate-1"

FAMILIES: dict[str, Start] = {
    "random": UniformStart(),
    "cluster": ClusterStart(),
    "corner": CornerStart(),
    "wall": WallStart(),
    "walls": WallsStart(),
    "tight-grid": TightGridStart(),
    "polygon": SymmetricStart("polygon"),
    "line": SymmetricStart("line"),
    "grid": SymmetricStart("grid"),
    "rings": SymmetricStart("rings"),
}
"""The starts of each family of sets."""

SIZES = (*range(3, 17), 24, 32, 64, 128)
"""Swarm sizes whose sets have a checksum."""

COUNT = 1000
"""Starts that a checksum is of: the first of the set, which goes on for ever."""

BATCH = 64
"""Starts computed at once; what they are depends on it."""


def set_name(family: str, robots: int) -> str:
    """Returns the name of a set."""
    return f"{VERSION}/{family}/N{robots}"


def set_world(robots: int) -> WorldConfig:
    """Returns the world of the sets for a swarm size: the paper's, scaled."""
    return scaled_to(WorldConfig(), robots)


def start_set(family: str, robots: int, count: int = COUNT) -> Float[np.ndarray, "count robots 2"]:
    """Returns the first starts of a named set, in the paper's world scaled to the swarm size.

    Warns if they are not, to the last bit, those that the package has the checksum of.

    Args:
        family: random, cluster, corner, wall, walls, tight-grid (see `Start`), polygon, line, grid or rings (see
            `SymmetricStart`).
        robots: Swarm size. Sets for 3 to 16, 24, 32, 64 and 128 robots have a checksum.
        count: How many starts; the first ones are the same whatever the count.

    Raises:
        InputError: There is no such family, or none for so few robots, or too many starts are asked for.
    """
    check_number("robots", robots, 2, MAX_ROBOTS, integer=True)
    check_number("count", count, 1, integer=True)
    check_pairs("count", count, robots)
    check_choice("family", family, tuple(FAMILIES))
    name, known = set_name(family, robots), checksums()
    if name not in known:
        return draw_set(family, set_world(robots), count)
    points = draw_set(family, set_world(robots), max(count, COUNT))
    if checksum(points) != known[name]:
        text = f"the starts {name} differ on this machine from those of others: compare no results by them"
        warnings.warn(text, StartSetWarning, stacklevel=2)
    return points[:count]


@prng.reproducible()
def draw_set(family: str, world: WorldConfig, count: int) -> Float[np.ndarray, "count robots 2"]:
    """Draws starts as those of a set are drawn, in any world.

    Raises:
        InputError: There is no such family, or its robots do not fit.
    """
    check_choice("family", family, tuple(FAMILIES))
    check_world(world)
    start = FAMILIES[family].prepare(world)
    seed = hashlib.sha256(set_name(family, world.robots).encode()).digest()[:4]
    key = prng.key(int.from_bytes(seed, "big"))
    if not isinstance(start, ComputedStart):
        return draw_starts(start, key, count, world)
    batches = [_computed(start, jax.random.fold_in(key, first), world) for first in range(0, count, BATCH)]
    return np.concatenate(batches)[:count]


def _computed(start: ComputedStart, key: PRNGKeyArray, world: WorldConfig) -> Float[np.ndarray, "batch robots 2"]:
    numbers = map(np.asarray, start.uniforms(key, BATCH, world.robots))
    doubles = tuple(array if array.dtype.kind == "i" else array.astype(float) for array in numbers)
    return start.place(doubles, world).astype(np.float32)


def checksum(points: Float[np.ndarray, "starts robots 2"]) -> str:
    """Returns the SHA-256 of the first thousand starts of a set, as little-endian float32."""
    return hashlib.sha256(np.ascontiguousarray(points[:COUNT], "<f4").tobytes()).hexdigest()


@functools.cache
def checksums() -> dict[str, str]:
    """Returns the checksums that the package has, by the names of the sets."""
    return json.loads(resources.files("murmurate.world").joinpath("start_sets.json").read_text("utf-8"))
