"""What an agent in charge of all robots observes, and what it may do."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
from gymnasium import spaces

from murmurate.errors import InputError, check_choice
from murmurate.geometry import _batch_last
from murmurate.interop.episodes import Look
from murmurate.interop.gathering import Gathering
from murmurate.world import State, World

__all__ = ["OPTIONS", "Observations", "action_space", "check_options", "look_for", "observation_space"]

Observations = Literal["positions", "sensing"]

OPTIONS = ("positions",)
"""What the options of a reset may name."""


def observation_space(gathering: Gathering, observations: Observations) -> spaces.Space[Any]:
    """Returns the space of one world's observations: positions, or also who neighbours and who sees whom."""
    robots, reach = gathering.config.robots, np.tile(gathering.reach, (gathering.config.robots, 1))
    positions = spaces.Box(-reach, reach, dtype=np.float32)
    if observations == "positions":
        return positions
    pairs = (robots, robots)
    return spaces.Dict(
        {"positions": positions, "neighbors": spaces.MultiBinary(pairs), "visible": spaces.MultiBinary(pairs)}
    )


def action_space(gathering: Gathering) -> spaces.Box:
    """Returns the space of one world's actions: a velocity for each robot."""
    return spaces.Box(-gathering.limit, gathering.limit, (gathering.config.robots, 2), np.float32)


def look_for(observations: Observations) -> Look:
    """Returns what shows the agent a state of the world.

    Raises:
        InputError: There are no such observations.
    """
    check_choice("observations", observations, get_args(Observations))
    return World.observe if observations == "positions" else _sensing


def _sensing(world: World, state: State) -> dict[str, Any]:
    near, seen = _batch_last.neighbors_and_visible(state.positions, world.config.radius, world.config.scan_radius)
    return {"positions": state.positions, "neighbors": near.astype(np.int8), "visible": seen.astype(np.int8)}


def check_options(options: dict[str, Any] | None, known: tuple[str, ...] = OPTIONS) -> None:
    """Checks the names of a reset's options.

    Raises:
        InputError: There is no such option.
    """
    for name, value in (options or {}).items():
        if name not in known:
            raise InputError(f"options[{name!r}]", value, f"left out: options are {', '.join(known)}")
