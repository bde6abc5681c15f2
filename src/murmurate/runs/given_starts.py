"""Where an evaluation begins, if not at fresh starts of its experiment: a set, a start, a file or an array."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import jax
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from murmurate import prng
from murmurate.errors import InputError, check_number
from murmurate.runs import config_io
from murmurate.world import (
    Family,
    Start,
    WorldConfig,
    check_configurations,
    check_pairs,
    check_start,
    checked_starts,
    draw_starts,
    read_named_starts,
    start_sets,
)

__all__ = ["HELD_OUT", "GivenStarts", "find_start", "given_starts", "start_names", "starts_key"]

# Training folds a policy's place in the list into its seed; no list is so long that it ever draws the same numbers.
HELD_OUT = 2**31

NEEDY = ("file", "mixture")
"""Starts that are nothing without their fields."""


@dataclass(frozen=True, eq=False)
class GivenStarts:
    """Configurations that episodes begin at.

    Attributes:
        points: The configurations, world units.
        source: Where they are from, as evaluation.json has it; see `folder.describe_starts`.
    """

    points: Float[np.ndarray, "episodes robots 2"]
    source: dict[str, str]


def start_names() -> tuple[str, ...]:
    """Returns the names that stand for starts: families of sets, and registered starts."""
    families = ("random", *get_args(Family), *start_sets.FAMILIES)
    return tuple(dict.fromkeys((*families, *(name for name in Start.registered() if name not in NEEDY))))


def find_start(word: str, field: str = "starts") -> Start:
    """Returns the start that a user's word stands for, with the defaults of its fields.

    Args:
        word: A name of `start_names`, or "module:Class", importable from the working folder or the Python path.
        field: What the word is for, for messages.

    Raises:
        InputError: There is no such start, or a field of it has no default.
    """
    family = start_sets.FAMILIES.get(word)
    return config_io.named(Start, word, start_names(), field) if family is None else family


@prng.reproducible()
def given_starts(
    starts: Any, world: WorldConfig, key: int | PRNGKeyArray, default: int, episodes: int | None = None
) -> GivenStarts:
    """Returns the configurations that a word, a path, a start or an array stands for.

    A family of sets, such as "cluster", stands for the first starts of its set, whatever the key. In another world than
    that of the sets, they are drawn in the same way there.

    Args:
        starts: A name of `start_names`, "module:Class", a CSV file of starts, a start, or configurations.
        world: Sizes of the world and its robots.
        key: A seed or a key of `jax.random`, for starts that are drawn.
        default: How many starts to draw if `episodes` is None.
        episodes: How many to draw, or how many of given ones to take; None: all.

    Raises:
        InputError: It is none of these, its robots touch or are outside or do not fit, or there are fewer starts.
    """
    if isinstance(starts, Start):
        return _drawn(starts, world, starts_key(key), episodes or default)
    if isinstance(starts, str) and starts in start_sets.FAMILIES:
        return _of_family(starts, world, episodes or default)
    if isinstance(starts, str) and (starts in start_names() or config_io.is_class_name(starts)):
        return _drawn(find_start(starts), world, starts_key(key), episodes or default)
    if isinstance(starts, str | Path):
        points, source = _of_file(starts, world), {"kind": "file", "name": Path(starts).name}
    else:
        points, source = checked_starts("starts", starts, world.robots), {"kind": "given"}
        check_configurations(points, world, "starts")
    if (episodes or 0) > len(points):
        where = starts if source["kind"] == "file" else "the array"
        raise InputError("episodes", episodes, f"at most the {len(points)} starts of {where}")
    return GivenStarts(points[:episodes], source)


def starts_key(key: int | PRNGKeyArray) -> PRNGKeyArray:
    """Returns the key of the starts of a rollout; that of a seed is never one of a training."""
    return jax.random.fold_in(prng.key(int(key)), HELD_OUT) if isinstance(key, int | np.integer) else key


def _drawn(start: Start, world: WorldConfig, key: PRNGKeyArray, count: int) -> GivenStarts:
    check_number("episodes", count, 1, integer=True)
    check_pairs("episodes", count, world.robots)
    points = draw_starts(check_start(start, world), key, count, world)
    return GivenStarts(points, {"kind": "drawn", "name": start.name})


def _of_family(family: str, world: WorldConfig, count: int) -> GivenStarts:
    check_number("episodes", count, 1, integer=True)
    check_pairs("episodes", count, world.robots)
    sizes = start_sets.set_world(world.robots)
    if all(getattr(world, name) == getattr(sizes, name) for name in ("half_width", "half_height", "radius")):
        name = start_sets.set_name(family, world.robots)
        return GivenStarts(start_sets.start_set(family, world.robots, count), {"kind": "set", "name": name})
    return GivenStarts(start_sets.draw_set(family, world, count), {"kind": "drawn", "name": family})


def _of_file(path: str | Path, world: WorldConfig) -> Float[np.ndarray, "starts robots 2"]:
    # A word without a folder and an ending is a name that is misspelled, rather than a file that is missing.
    if isinstance(path, str) and Path(path).name == path and not Path(path).suffix and not Path(path).exists():
        config_io.find_named(Start, path, start_names(), "starts", "a CSV file")
    named = read_named_starts(path, world.robots)
    points = np.array(list(named.values()))
    check_configurations(points, world, str(path), list(named))
    return points
