"""PettingZoo: one agent for each robot, which sees what it perceives and sets its own velocity, in its own frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, cast, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from murmurate.interop.extras import missing

try:
    import gymnasium
    from gymnasium import spaces
    from gymnasium.error import ResetNeeded
    from gymnasium.utils import seeding
    from pettingzoo import ParallelEnv
except ModuleNotFoundError as error:
    raise missing("pettingzoo") from error

from murmurate.errors import InputError, check_choice
from murmurate.interop.camera import FPS, Camera
from murmurate.interop.episodes import Episodes
from murmurate.interop.gathering import ActionScale, make_gathering
from murmurate.world import LocalObservation, ObservedState, Sensing, Start

__all__ = ["GatheringParallelEnv", "Reward", "parallel_env"]

Reward = Literal["shared", "robots"]

Velocity = Float[np.ndarray, "2"]
Rows = Float[np.ndarray, "rows 3"]

FARTHEST_NOISE = 6.0
"""Standard deviations beyond which float32 normal noise never falls."""


class GatheringParallelEnv(ParallelEnv[str, Rows, Velocity]):
    """A swarm of fat, opaque robots, each an agent of its own: `robot_0`, `robot_1` and so on.

    An observation is what the robot perceives, in its own frame, centred on itself, and its own unit of length. Its
    rows are `x, y, 1` for each robot it perceives, the nearest first, and zeros for the rest: `(robots - 1, 3)`. One
    more row `x, y, 1` follows for the gathering point where there is one and a landmark shows it (C1), four for the
    nearest points of the walls where they are perceived (`sensing.walls`), opposite walls two rows apart, and one more,
    `radius, 0, 1`, where units differ (`sensing.unit_ratio`), by which a robot tells how long its unit is.

    An action is the robot's own velocity in its own frame. In the world's, each component is limited once more.

    Episodes end for all agents together. Every agent's info holds the signals of the whole swarm by name.
    """

    metadata = {  # noqa: RUF012
        "name": "murmurate_gathering_v0",
        "render_modes": ["rgb_array", "human"],
        "render_fps": FPS,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        robots: int = 10,
        objective: str = "C1",
        *,
        sensing: Sensing | str = "visible",
        reward: Reward = "shared",
        start: Start | str = "random",
        weights: Mapping[str, float] | None = None,
        horizon: int = 400,
        action_scale: ActionScale = "unit",
        render_mode: str | None = None,
        **world: Any,
    ) -> None:
        """Builds the environment.

        Args:
            robots: Number of robots.
            objective: C1 (gathering at the origin) or C2 (at no predefined point).
            sensing: What robots perceive, in which frames: its configuration, or the name of its kind.
            reward: shared (the world's, to everyone) or robots (to each the change of its own share of the objective;
                the penalty falls on whoever collided or left).
            start: Where episodes begin: its configuration, or the name of its kind.
            weights: Weights of the signals, by default all 1.
            horizon: Steps after which an episode is truncated.
            action_scale: unit (1 is the greatest speed) or world (world units per step).
            render_mode: None, rgb_array or human.
            **world: Fields of `WorldConfig`; those that are missing grow with the swarm.

        Raises:
            InputError: There is no such field, or a value is not allowed.
        """
        check_choice("reward", reward, get_args(Reward))
        if not isinstance(sensing, Sensing):
            check_choice("sensing", sensing, tuple(Sensing.registered()))
            sensing = cast(Sensing, Sensing.registered()[sensing]())
        by_robot = reward == "robots"
        self._gathering = make_gathering(robots, objective, start, weights, horizon, action_scale, world, by_robot)
        self._camera = Camera(self._gathering, render_mode, self.metadata["render_modes"])
        env = LocalObservation(self._gathering.world, sensing, self._gathering.config)
        self._episodes = Episodes(env, _look, 1)
        self._rng = seeding.np_random()[0]
        self.render_mode = render_mode
        self.possible_agents = [f"robot_{index}" for index in range(robots)]
        self.agents: list[str] = []
        low, high = self._bounds(sensing)
        limit = self._gathering.limit
        self.observation_spaces = {name: spaces.Box(low, high, dtype=np.float32) for name in self.possible_agents}
        self.action_spaces = {name: spaces.Box(-limit, limit, (2,), np.float32) for name in self.possible_agents}
        reach = np.tile(self._gathering.reach, (robots, 1))
        self.state_space = spaces.Box(-reach, reach, dtype=np.float32)

    def observation_space(self, agent: str) -> spaces.Space[Rows]:
        """Returns the space of an agent's observations, the same object at every call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Velocity]:
        """Returns the space of an agent's actions, the same object at every call."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Rows], dict[str, dict[str, Any]]]:
        """Begins an episode, with all agents.

        Args:
            seed: Seed of this and all following starts, frames and noise; by default they go on as they were.
            options: `positions`, `(robots, 2)`: begins there. Others are for other environments, and not used.

        Returns:
            Every agent's observation and info.

        Raises:
            InputError: The given positions are not a possible start.
        """
        positions = self._gathering.positions(options, np.array(True))
        if seed is not None:
            self._rng = seeding.np_random(seed)[0]
        self._episodes.begin(self._rng, positions=None if positions is None else positions[None])
        self.agents = list(self.possible_agents)
        self._watch()
        return self._observations(), self._infos()

    def step(
        self, actions: Mapping[str, Velocity]
    ) -> tuple[dict[str, Rows], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Moves every robot by its own velocity for one step.

        Args:
            actions: A velocity for each agent; beyond the bounds of its `action_space`, it is clipped.

        Returns:
            Every agent's observation, reward, whether the episode terminated, whether it was truncated, and its info.

        Raises:
            InputError: An agent has no action, an action belongs to nobody, or is no pair of finite numbers.
            ResetNeeded: No episode is under way.
        """
        if not self.agents:
            raise ResetNeeded("no episode is under way: call reset() before step()")
        if actions.keys() != set(self.agents):
            raise InputError("actions", list(actions), f"one for each of {', '.join(self.agents)}")
        # A robot's action is checked by itself, so that the message speaks of its shape.
        velocities = np.stack([self._gathering.velocities(actions[name], (2,)) for name in self.possible_agents])
        outcome = self._episodes.step(velocities[None])
        self._watch()
        # The credit is the reward itself unless credit is given robot by robot.
        rewards = np.broadcast_to(outcome.credit[0], len(self.possible_agents)).tolist()
        terminated, truncated = bool(outcome.terminated[0]), bool(outcome.truncated[0])
        self.agents = [] if terminated or truncated else self.agents
        return (
            self._observations(),
            dict(zip(self.possible_agents, rewards, strict=True)),
            dict.fromkeys(self.possible_agents, terminated),
            dict.fromkeys(self.possible_agents, truncated),
            self._infos(),
        )

    def state(self) -> Float[np.ndarray, "robots 2"]:
        """Returns all centres, world units, for centralised training; an element of `state_space`.

        Raises:
            ResetNeeded: No episode has begun.
        """
        self._check_begun("state()")
        return self._episodes.positions[0]

    def render(self) -> UInt8[np.ndarray, "height width 3"] | None:
        """Draws the robots to scale, their safe distances and sight lines.

        Returns:
            The picture in mode rgb_array; None in mode human, which draws at every step anyway.

        Raises:
            ResetNeeded: No episode has begun.
        """
        self._check_begun("render()")
        if self.render_mode is None:
            gymnasium.logger.warn("there is nothing to render: make the environment with a render_mode")
            return None
        return self._camera.frame(self._episodes.positions[0])

    def close(self) -> None:
        """Closes the window, if there is one."""
        self._camera.close()

    def _check_begun(self, call: str) -> None:
        if not self._episodes.begun:
            raise ResetNeeded(f"no episode has begun: call reset() before {call}")

    def _watch(self) -> None:
        if self.render_mode == "human":
            self.render()

    def _bounds(self, sensing: Sensing) -> tuple[Rows, Rows]:
        """How small and how great the numbers of an observation can get."""
        across = 2 * float(np.hypot(*self._gathering.reach)) * (1 + FARTHEST_NOISE * sensing.range_noise)
        longest = max(across, self._gathering.config.radius) * sensing.unit_ratio
        rows = self._gathering.config.robots - 1 + _extra_rows(self._gathering.world.objective.names, sensing)
        longest *= 1.001  # for what rounding adds
        low, high = np.array([[-longest, -longest, 0.0], [longest, longest, 1.0]], np.float32)
        return np.tile(low, (rows, 1)), np.tile(high, (rows, 1))

    def _observations(self) -> dict[str, Rows]:
        return {
            name: rows.copy() for name, rows in zip(self.possible_agents, self._episodes.observation[0], strict=True)
        }

    def _infos(self) -> dict[str, dict[str, Any]]:
        signals = {name: float(value[0]) for name, value in self._episodes.signals.items()}
        return {name: dict(signals) for name in self.possible_agents}


parallel_env = GatheringParallelEnv
"""What PettingZoo calls the maker of an environment."""


def _has_landmark(names: tuple[str, ...], sensing: Sensing) -> bool:
    return "close" in names and sensing.landmark


def _extra_rows(names: tuple[str, ...], sensing: Sensing) -> int:
    return _has_landmark(names, sensing) + 4 * sensing.walls + (sensing.unit_ratio > 1)


def _look(env: LocalObservation, state: ObservedState) -> Float[Array, "robots rows 3 batch"]:
    """What every robot perceives, as its agent is shown it."""
    view = env.observe(state).view
    seen = view.seen.astype(view.x.dtype)
    # Whoever is not perceived counts as farthest, and the robot itself does: one of them, a row of zeros, is left out.
    order = jnp.argsort(jnp.where(view.seen, view.x**2 + view.y**2, jnp.inf), axis=1)[:, :-1]
    rows = jnp.take_along_axis(jnp.stack([view.x, view.y, seen], axis=2), order[:, :, None], axis=1)
    one, zero = jnp.ones_like(view.radius), jnp.zeros_like(view.radius)
    extra = []
    if _has_landmark(env.unwrapped.objective.names, env.sensing):
        extra.append(jnp.stack([view.landmark_x, view.landmark_y, one], axis=1))
    if view.walls is not None:
        extra += [jnp.stack([*jnp.unstack(wall, axis=1), one], axis=1) for wall in jnp.unstack(view.walls, axis=1)]
    if env.sensing.unit_ratio > 1:
        extra.append(jnp.stack([view.radius, zero, one], axis=1))
    return jnp.concatenate([rows, *(row[:, None] for row in extra)], axis=1)
