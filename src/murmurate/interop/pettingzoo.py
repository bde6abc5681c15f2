"""PettingZoo: one agent for each robot, which sees what it perceives and sets its own velocity, in its own frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from murmurate.interop import missing_extra

try:
    import gymnasium
    from gymnasium import spaces
    from gymnasium.error import ResetNeeded
    from gymnasium.utils import seeding
    from pettingzoo import ParallelEnv
except ModuleNotFoundError as error:
    raise missing_extra("pettingzoo") from error

from murmurate.errors import InputError, check_choice
from murmurate.interop.gathering import FPS, Camera, Episodes, make_gathering
from murmurate.world import LocalObservation, Sensing, Wrapper

__all__ = ["GatheringParallelEnv", "Reward", "parallel_env"]

Reward = Literal["shared", "robots"]

Velocity = Float[np.ndarray, "2"]
Rows = Float[np.ndarray, "rows 3"]

MAX_DEVIATIONS = 6.0
"""Normal noise in float32 never deviates by more standard deviations."""


class GatheringParallelEnv(ParallelEnv[str, Rows, Velocity]):
    """A swarm of fat, opaque robots, each an agent of its own: `robot_0`, `robot_1` and so on.

    An observation is what the robot perceives, in its own frame, centred on itself, in its own unit of length. Its rows
    are `x, y, 1` for each robot it perceives, the nearest first, and zeros for the rest: `(robots - 1, 3)`. One
    more row `x, y, 1` follows for the gathering point where a signal needs it (C1) and a landmark shows it, four for
    the nearest points of the walls where they are perceived (`sensing.walls`), opposite walls two rows apart, and one
    more, `radius, 0, 1`, where units differ (`sensing.unit_ratio`), by which a robot tells how long its unit is.

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
        sensing: Any = "visible",
        reward: Reward = "shared",
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        """Builds the environment.

        Args:
            robots: Number of robots.
            objective: C1 (gathering at the origin), C2 (at no predefined point), or custom (the given signals alone).
            sensing: What robots perceive, in which frames: a registered name, "module:Class", a mapping of fields, or a
                `Sensing`.
            reward: shared (every agent gets the world's reward) or robots (each gets the change of its own potential;
                the penalty falls on the robots that touched another or left).
            render_mode: None, rgb_array or human.
            **options: Further fields of `interop.gathering.Options` (start, signals, weights, horizon, action_scale,
                scheduler, shield) and of `WorldConfig`.

        Raises:
            InputError: A keyword is unknown, or a value is not allowed.
        """
        check_choice("reward", reward, get_args(Reward))
        self._gathering = make_gathering({"robots": robots, "objective": objective, **options}, sensing)
        self._camera = Camera(self._gathering, render_mode, self.metadata["render_modes"])
        sensing = self._gathering.sensing
        env = self._gathering.environment(per_robot_credit=reward == "robots", own_views=True)
        self._episodes = Episodes(env, _observe, 1)
        self._rng = seeding.np_random()[0]
        self.render_mode = render_mode
        self.possible_agents = [f"robot_{index}" for index in range(robots)]
        self.agents: list[str] = []
        low, high = self._bounds(sensing)
        bound = self._gathering.action_bound
        self.observation_spaces = {name: spaces.Box(low, high, dtype=np.float32) for name in self.possible_agents}
        self.action_spaces = {name: spaces.Box(-bound, bound, (2,), np.float32) for name in self.possible_agents}
        corners = np.tile(self._gathering.position_bounds, (robots, 1))
        self.state_space = spaces.Box(-corners, corners, dtype=np.float32)

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
            seed: Seed of this and all following starts, frames and noise; None: they continue as they were.
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
        self._camera.follow(self._episodes, np.ones(1, bool))
        self.agents = list(self.possible_agents)
        self._show()
        return self._observations(), self._infos()

    def step(
        self, actions: Mapping[str, Velocity]
    ) -> tuple[dict[str, Rows], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Moves every robot by its own velocity for one step.

        Args:
            actions: A velocity for each agent; beyond the bounds of its `action_space` it is clipped.

        Returns:
            Every agent's observation, reward, whether the episode terminated, whether it was truncated, and its info;
            after the end of the episode, when there are no agents, five empty dictionaries.

        Raises:
            InputError: An agent has no action, an action belongs to no agent, or is not a pair of finite numbers.
            ResetNeeded: No episode has begun.
        """
        self._check_started("step()")
        if not self.agents:
            return {}, {}, {}, {}, {}
        if not isinstance(actions, Mapping) or actions.keys() != set(self.agents):
            given = list(actions) if isinstance(actions, Mapping) else actions
            raise InputError("actions", given, f"a mapping with one for each of {', '.join(self.agents)}")
        # Each robot's action is checked alone, so that the message names its shape.
        velocities = np.stack([self._gathering.velocities(actions[name], (2,)) for name in self.possible_agents])
        result = self._episodes.step(velocities[None])
        self._camera.follow(self._episodes)
        self._show()
        # The credit is the reward itself, unless each robot has its own.
        rewards = np.broadcast_to(result.credit[0], len(self.possible_agents)).tolist()
        terminated, truncated = bool(result.terminated[0]), bool(result.truncated[0])
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
        self._check_started("state()")
        return self._episodes.positions[0]

    def render(self) -> UInt8[np.ndarray, "height width 3"] | None:
        """Draws the robots to scale, their safe distances, sight lines and paths, and writes the step.

        Returns:
            The picture in mode rgb_array; None in mode human, which draws at every step.

        Raises:
            ResetNeeded: No episode has begun.
        """
        self._check_started("render()")
        if self.render_mode is None:
            gymnasium.logger.warn("there is nothing to render: make the environment with a render_mode")
            return None
        return self._camera.frame()

    def close(self) -> None:
        """Closes the window, if there is one."""
        self._camera.close()

    def _check_started(self, call: str) -> None:
        if not self._episodes.started:
            raise ResetNeeded(f"no episode has begun: call reset() before {call}")

    def _show(self) -> None:
        if self.render_mode == "human":
            self.render()

    def _bounds(self, sensing: Sensing) -> tuple[Rows, Rows]:
        """Returns the least and the greatest number in each place of an observation."""
        diagonal = 2 * float(np.hypot(*self._gathering.position_bounds)) * (1 + MAX_DEVIATIONS * sensing.range_noise)
        longest = max(diagonal, self._gathering.config.radius) * sensing.unit_ratio
        rows = self._gathering.config.robots - 1 + 4 * sensing.walls + (sensing.unit_ratio > 1)
        rows += self._gathering.has_landmark and sensing.landmark
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
"""PettingZoo's name for what makes an environment."""


def _observe(env: Wrapper, state: Any) -> Float[Array, "robots rows 3 batch"]:
    """Returns what every robot perceives as rows of numbers."""
    view, sensing = env.observe(state).view, _sensing(env)
    seen = view.seen.astype(view.x.dtype)
    # Robots that are not perceived sort as the farthest. The robot itself is one of them: one row of zeros is dropped.
    order = jnp.argsort(jnp.where(view.seen, view.x**2 + view.y**2, jnp.inf), axis=1)[:, :-1]
    rows = jnp.take_along_axis(jnp.stack([view.x, view.y, seen], axis=2), order[:, :, None], axis=1)
    ones, zeros = jnp.ones_like(view.radius), jnp.zeros_like(view.radius)
    extra = []
    if env.unwrapped.objective.needs_landmark and sensing.landmark:
        extra.append(jnp.stack([view.landmark_x, view.landmark_y, ones], axis=1))
    if view.walls is not None:
        extra += [jnp.stack([*jnp.unstack(wall, axis=1), ones], axis=1) for wall in jnp.unstack(view.walls, axis=1)]
    if sensing.unit_ratio > 1:
        extra.append(jnp.stack([view.radius, zeros, ones], axis=1))
    return jnp.concatenate([rows, *(row[:, None] for row in extra)], axis=1)


def _sensing(env: Any) -> Sensing:
    """Returns what robots perceive in an environment, which may have a shield around it."""
    return env.sensing if isinstance(env, LocalObservation) else _sensing(env.env)
