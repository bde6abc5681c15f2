"""Many worlds as one Gymnasium vector environment: a batch under one jit, not one environment after another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Bool, Float, UInt8

from murmurate.errors import InputError, check_choice, check_number
from murmurate.interop.camera import FPS, Camera
from murmurate.interop.episodes import Episodes
from murmurate.interop.gathering import ActionScale, make_gathering
from murmurate.interop.gymnasium.spaces import (
    OPTIONS,
    Observations,
    action_space,
    check_options,
    look_for,
    observation_space,
)
from murmurate.world import Start

__all__ = ["GatheringVectorEnv"]

MOST_ENVS = 2**20

Batch = Float[np.ndarray, " envs"]
Flags = Bool[np.ndarray, " envs"]


class GatheringVectorEnv(VectorEnv[Any, Float[np.ndarray, "envs robots 2"], np.ndarray]):
    """Many swarms under central control, each as `GatheringEnv` has it, the environment first in every array.

    What happens to an episode that has ended is `autoreset_mode`: a fresh start at the next step, whose action is then
    not used (NEXT_STEP, Gymnasium's default); a fresh start within the same step, which hands out the end as
    `final_obs` and `final_info` (SAME_STEP); or nothing, until `reset(options={"reset_mask": ...})` (DISABLED).
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": FPS}  # noqa: RUF012
    # Gymnasium closes what is deleted: until it is built, there is nothing to close.
    closed = True

    def __init__(
        self,
        num_envs: int = 1,
        robots: int = 10,
        objective: str = "C1",
        *,
        start: Start | str = "random",
        weights: Mapping[str, float] | None = None,
        horizon: int = 400,
        observations: Observations = "positions",
        action_scale: ActionScale = "unit",
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **world: Any,
    ) -> None:
        """Builds the environment.

        Args:
            num_envs: Number of worlds.
            robots: Number of robots in each.
            objective: As of `GatheringEnv`, like whatever else is not explained here.
            start: Where episodes begin.
            weights: Weights of the signals.
            horizon: Steps after which an episode is truncated.
            observations: positions or sensing.
            action_scale: unit or world.
            autoreset_mode: Gymnasium's `AutoresetMode`, or its value: NextStep, SameStep or Disabled.
            render_mode: None or rgb_array.
            **world: Fields of `WorldConfig`.

        Raises:
            InputError: There is no such field, or a value is not allowed.
        """
        check_number("num_envs", num_envs, 1, MOST_ENVS, integer=True)
        if not isinstance(autoreset_mode, AutoresetMode):
            check_choice("autoreset_mode", autoreset_mode, [mode.value for mode in AutoresetMode])
        look = look_for(observations)
        self._mode = AutoresetMode(autoreset_mode)
        self._gathering = make_gathering(robots, objective, start, weights, horizon, action_scale, world)
        self._camera = Camera(self._gathering, render_mode, self.metadata["render_modes"])
        self._episodes = Episodes(self._gathering.world, look, num_envs)
        self.metadata = {**self.metadata, "autoreset_mode": self._mode}
        self.render_mode = render_mode
        self.num_envs = num_envs
        self.single_observation_space = observation_space(self._gathering, observations)
        self.single_action_space = action_space(self._gathering)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.closed = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begins episodes.

        Args:
            seed: Seed of this and all following starts, of all worlds; by default they go on as they were.
            options: `positions`, `(num_envs, robots, 2)`: begins there. `reset_mask`, `(num_envs,)`: begins only these.

        Returns:
            The observations and the infos.

        Raises:
            InputError: The given positions are not possible starts, or the mask is none.
            ResetNeeded: A mask was given, but the others have not begun either.
        """
        check_options(options, (*OPTIONS, "reset_mask"))
        which = self._mask(options)
        positions = self._gathering.positions(options, np.ones(self.num_envs, bool) if which is None else which)
        super().reset(seed=seed)
        self._episodes.begin(self.np_random, which, positions)
        return self._episodes.observation, self._infos(np.ones(self.num_envs, bool) if which is None else which)

    def step(self, actions: Float[np.ndarray, "envs robots 2"]) -> tuple[Any, Batch, Flags, Flags, dict[str, Any]]:
        """Moves every robot of every world for one step.

        Args:
            actions: Velocities; beyond the bounds of `action_space`, they are clipped.

        Returns:
            The observations, the rewards, which episodes terminated, which were truncated, and the infos.

        Raises:
            InputError: The actions are no array of finite numbers of that shape.
            ResetNeeded: An episode is not under way.
        """
        before = self._episodes.over
        if not self._episodes.begun or (self._mode is AutoresetMode.DISABLED and before.any()):
            raise ResetNeeded("not all episodes are under way: call reset() before step()")
        velocities = self._gathering.velocities(actions, (self.num_envs, self._gathering.config.robots, 2))
        reward, terminated, truncated, _ = self._episodes.step(velocities)
        final: dict[str, Any] = {}
        if self._mode is AutoresetMode.NEXT_STEP and before.any():
            # The step that these took from where they had ended is not one: they begin instead.
            self._episodes.begin(self.np_random, before)
            reward[before], terminated[before], truncated[before] = 0, False, False
        elif self._mode is AutoresetMode.SAME_STEP and self._episodes.over.any():
            ended = self._episodes.over
            final = self._final(ended)
            self._episodes.begin(self.np_random, ended)
        infos = self._infos(np.ones(self.num_envs, bool)) | final
        return self._episodes.observation, reward, terminated, truncated, infos

    def render(self) -> tuple[UInt8[np.ndarray, "height width 3"], ...] | None:
        """Returns a picture of every world, in mode rgb_array.

        Raises:
            ResetNeeded: No episode has begun.
        """
        if not self._episodes.begun:
            raise ResetNeeded("no episode has begun: call reset() before render()")
        if self.render_mode is None:
            gymnasium.logger.warn("there is nothing to render: make the environment with a render_mode")
            return None
        frames = (self._camera.frame(positions) for positions in self._episodes.positions)
        return tuple(frame for frame in frames if frame is not None)

    def close_extras(self, **kwargs: Any) -> None:
        """Lets go of the figure."""
        self._camera.close()

    def _mask(self, options: dict[str, Any] | None) -> Flags | None:
        given = (options or {}).get("reset_mask")
        if given is None:
            return None
        mask = np.array(given)
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise InputError("reset_mask", given, f"a boolean array of shape ({self.num_envs},), not all False")
        if not self._episodes.begun:
            raise ResetNeeded("no episode has begun: call reset() without a mask first")
        return mask

    def _infos(self, which: Flags) -> dict[str, Any]:
        """The signals by name, each with the mask of the worlds that it is given for, as Gymnasium has it."""
        found: dict[str, Any] = {}
        for name, value in self._episodes.signals.items():
            found |= {name: np.where(which, value, 0.0), f"_{name}": which.copy()}
        return found

    def _final(self, ended: Flags) -> dict[str, Any]:
        """What there was to observe and to know where episodes ended."""
        shown, observations = self._episodes.observation, np.full(self.num_envs, None, object)
        for index in np.flatnonzero(ended):
            one = {name: each[index] for name, each in shown.items()} if isinstance(shown, dict) else shown[index]
            observations[index] = one
        return {
            "final_obs": observations,
            "_final_obs": ended.copy(),
            "final_info": self._infos(ended),
            "_final_info": ended.copy(),
        }
