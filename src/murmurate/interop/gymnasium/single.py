"""One world as a Gymnasium environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from jaxtyping import Float, UInt8

from murmurate.interop.camera import FPS, Camera
from murmurate.interop.episodes import Episodes
from murmurate.interop.gathering import ActionScale, make_gathering
from murmurate.interop.gymnasium.spaces import (
    Observations,
    action_space,
    check_options,
    look_for,
    observation_space,
)
from murmurate.world import Start

__all__ = ["GatheringEnv"]


class GatheringEnv(gymnasium.Env[Any, Float[np.ndarray, "robots 2"]]):
    """A swarm of fat, opaque robots, under central control: an action is the velocity of every robot.

    Observations are the centres, world units, `(robots, 2)`; with `observations="sensing"`, a dictionary of them
    (`positions`) and of 0 or 1 for each pair: `neighbors`, and `visible` (row sees column), `(robots, robots)`.
    The reward is the change of the objective; a collision or leaving the world ends the episode with a penalty.
    Every `info` holds the signals by name.
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": FPS}  # noqa: RUF012

    def __init__(
        self,
        robots: int = 10,
        objective: str = "C1",
        *,
        start: Start | str = "random",
        weights: Mapping[str, float] | None = None,
        horizon: int = 400,
        observations: Observations = "positions",
        action_scale: ActionScale = "unit",
        render_mode: str | None = None,
        **world: Any,
    ) -> None:
        """Builds the environment.

        Args:
            robots: Number of robots.
            objective: C1 (gathering at the origin) or C2 (at no predefined point).
            start: Where episodes begin: its configuration, or the name of its kind.
            weights: Weights of the signals, by default all 1.
            horizon: Steps after which an episode is truncated.
            observations: positions or sensing.
            action_scale: unit (1 is the greatest speed) or world (world units per step).
            render_mode: None, rgb_array or human.
            **world: Fields of `WorldConfig`; those that are missing grow with the swarm.

        Raises:
            InputError: There is no such field, or a value is not allowed.
        """
        look = look_for(observations)
        self._gathering = make_gathering(robots, objective, start, weights, horizon, action_scale, world)
        self._camera = Camera(self._gathering, render_mode, self.metadata["render_modes"])
        self._episodes = Episodes(self._gathering.world, look, 1)
        # A copy: Gymnasium's own vector environments write into it.
        self.metadata = dict(self.metadata)
        self.render_mode = render_mode
        self.observation_space = observation_space(self._gathering, observations)
        self.action_space = action_space(self._gathering)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begins an episode.

        Args:
            seed: Seed of this and all following starts; by default they go on as they were.
            options: `positions`, `(robots, 2)`: begins there.

        Returns:
            The observation and the info.

        Raises:
            InputError: The given positions are not a possible start.
        """
        check_options(options)
        positions = self._gathering.positions(options, np.array(True))
        super().reset(seed=seed)
        self._episodes.begin(self.np_random, positions=None if positions is None else positions[None])
        self._watch()
        return self._observation(), self._info()

    def step(self, action: Float[np.ndarray, "robots 2"]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Moves every robot for one step.

        Args:
            action: Velocities; beyond the bounds of `action_space`, they are clipped.

        Returns:
            The observation, the reward, whether the episode terminated, whether it was truncated, and the info.

        Raises:
            InputError: The action is no array of finite numbers of that shape.
            ResetNeeded: No episode is under way.
        """
        if not self._episodes.begun or self._episodes.over[0]:
            raise ResetNeeded("no episode is under way: call reset() before step()")
        velocities = self._gathering.velocities(action, (self._gathering.config.robots, 2))
        outcome = self._episodes.step(velocities[None])
        self._watch()
        ended = bool(outcome.terminated[0]), bool(outcome.truncated[0])
        return self._observation(), float(outcome.reward[0]), *ended, self._info()

    def render(self) -> UInt8[np.ndarray, "height width 3"] | None:
        """Draws the robots to scale, their safe distances and sight lines.

        Returns:
            The picture in mode rgb_array; None in mode human, which draws at every step anyway.

        Raises:
            ResetNeeded: No episode has begun.
        """
        if not self._episodes.begun:
            raise ResetNeeded("no episode has begun: call reset() before render()")
        if self.render_mode is None:
            gymnasium.logger.warn("there is nothing to render: make the environment with a render_mode")
            return None
        return self._camera.frame(self._episodes.positions[0])

    def close(self) -> None:
        """Closes the window, if there is one."""
        self._camera.close()

    def _watch(self) -> None:
        if self.render_mode == "human":
            self.render()

    def _observation(self) -> Any:
        shown = self._episodes.observation
        return {name: each[0] for name, each in shown.items()} if isinstance(shown, dict) else shown[0]

    def _info(self) -> dict[str, Any]:
        return {name: float(value[0]) for name, value in self._episodes.signals.items()}
