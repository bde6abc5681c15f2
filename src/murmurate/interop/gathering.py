"""The keywords that every adapter understands, and what is made of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Literal, cast, get_args

import numpy as np
from jaxtyping import Bool, Float

from murmurate import compilation_cache
from murmurate.errors import MOST, InputError, check_choice, check_number, suggestion
from murmurate.world import (
    OBJECTIVES,
    Start,
    World,
    WorldConfig,
    check_configurations,
    check_start,
    scaled_to,
)

__all__ = ["ActionScale", "Gathering", "make_gathering", "numbers"]

ActionScale = Literal["unit", "world"]

STARTS = ("scattered", "distributed", "packed", "random", "symmetric")
"""Starts that need no more than their name."""

NUMERIC = "fiub"
"""Kinds of NumPy arrays that hold real numbers."""


@dataclass(frozen=True)
class Gathering:
    """A swarm that gathers: the world, and how it is offered to an agent.

    Attributes:
        config: Sizes of the world and its robots.
        world: The decision process.
        objective: C1 (at the origin) or C2 (at no predefined point).
        action_scale: unit (an action of 1 is the greatest speed) or world (world units per step).
    """

    config: WorldConfig
    world: World
    objective: str
    action_scale: ActionScale

    @cached_property
    def reach(self) -> Float[np.ndarray, "2"]:
        """How far from the origin a robot can be, by coordinate: a robot that leaves the world is one step outside."""
        sides = np.array([self.config.half_width, self.config.half_height], np.float32)
        return sides + np.float32(self.config.max_speed)

    @property
    def limit(self) -> np.float32:
        """Greatest magnitude of an action's component."""
        return np.float32(1 if self.action_scale == "unit" else self.config.max_speed)

    def velocities(self, action: Any, shape: tuple[int, ...]) -> Float[np.ndarray, "*shape"]:
        """Returns the velocities that an action means, world units per step; beyond its bounds, it is clipped.

        Raises:
            InputError: The action is no array of finite numbers of that shape.
        """
        clipped = np.clip(numbers("action", action, shape), -self.limit, self.limit).astype(np.float32)
        return clipped * np.float32(self.config.max_speed) if self.action_scale == "unit" else clipped

    def positions(
        self, options: dict[str, Any] | None, begun: Bool[np.ndarray, "*batch"]
    ) -> Float[np.ndarray, "*batch robots 2"] | None:
        """Returns the configurations that `options["positions"]` asks episodes to begin at, if it does.

        Args:
            options: Of a reset.
            begun: Which episodes begin: what is given for the others does not matter.

        Raises:
            InputError: They have another shape, are not finite, outside the world or in collision.
        """
        if not options or options.get("positions") is None:
            return None
        given = numbers("positions", options["positions"], (*begun.shape, self.config.robots, 2), begun)
        # Picking by a mask without axes adds one: a single configuration is checked as a batch of one.
        check_configurations(given[begun], self.config, "positions")
        return np.where(begun[..., None, None], given, 0.0).astype(np.float32)


def make_gathering(
    robots: int,
    objective: str,
    start: Start | str,
    weights: Mapping[str, float] | None,
    horizon: int,
    action_scale: ActionScale,
    sizes: dict[str, Any],
    by_robot: bool = False,
) -> Gathering:
    """Makes a swarm of what an adapter was given.

    Args:
        robots: Number of robots.
        objective: C1 or C2.
        start: Where episodes begin: its configuration, or the name of its kind.
        weights: Weights of the signals, by default all 1.
        horizon: Steps after which an episode is truncated.
        action_scale: unit or world.
        sizes: Other fields of `WorldConfig`; those that are missing grow with the swarm, as `world.grown` has it.
        by_robot: Whether credit is given robot by robot.

    Raises:
        InputError: There is no such field, or a value is not allowed.
    """
    compilation_cache.configure()
    known = [field.name for field in fields(WorldConfig)]
    for name, value in sizes.items():
        if name not in known:
            raise InputError(name, value, f"left out: fields are {', '.join(known)}{suggestion(name, known)}")
    check_choice("objective", objective, tuple(OBJECTIVES))
    check_choice("action_scale", action_scale, get_args(ActionScale))
    check_number("horizon", horizon, 1, MOST, integer=True)
    if not isinstance(start, Start):
        check_choice("start", start, STARTS)
        start = cast(Start, Start.registered()[start]())
    if not isinstance(weights, Mapping | None):
        raise InputError("weights", weights, "a mapping from signal names to numbers")
    config = replace(scaled_to(WorldConfig(), robots), **sizes)
    world = World.create(config, check_start(start, config), objective, weights, horizon, by_robot)
    return Gathering(config, world, objective, action_scale)


def numbers(
    name: str, value: Any, shape: tuple[int, ...], which: Bool[np.ndarray, "*batch"] | None = None
) -> Float[np.ndarray, "*shape"]:
    """Returns a value as an array of finite numbers of a shape; checks only the members that `which` picks, if given.

    Raises:
        InputError: It is not.
    """
    try:
        array = np.asarray(value)
    except ValueError:
        raise InputError(name, "a ragged list", f"an array of shape {shape}") from None
    if array.shape != shape:
        raise InputError(name, f"an array of shape {array.shape}", f"of shape {shape}")
    if array.dtype.kind not in NUMERIC:
        raise InputError(name, f"an array of {array.dtype}", "an array of real numbers")
    if not np.isfinite(array if which is None else array[which]).all():
        raise InputError(name, "an array with NaN or infinity", "finite")
    return array.astype(float)
