"""Gymnasium: one agent sets the velocities of all robots, in one world or in many at once.

Importing this module registers `murmurate/Gathering-v0` for `gymnasium.make` and `gymnasium.make_vec`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Bool, Float, UInt8

from murmurate.interop import missing_extra

try:
    import gymnasium
    from gymnasium import spaces
    from gymnasium.error import ResetNeeded
    from gymnasium.utils import seeding
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ModuleNotFoundError as error:
    raise missing_extra("gymnasium") from error

from murmurate.errors import InputError, check_choice, check_number
from murmurate.geometry import _batch_last
from murmurate.interop.gathering import FPS, Camera, Episodes, Gathering, Observe, check_options, make_gathering
from murmurate.world import State, World

__all__ = ["ENV_ID", "GatheringEnv", "GatheringVectorEnv", "register"]

ENV_ID = "murmurate/Gathering-v0"

MAX_ENVS = 2**20

OPTIONS = ("positions",)
"""Names of the options of a reset."""

Observations = Literal["positions", "sensing"]

Batch = Float[np.ndarray, " envs"]
Flags = Bool[np.ndarray, " envs"]


class GatheringEnv(gymnasium.Env[Any, Float[np.ndarray, "robots 2"]]):
    """A swarm of fat, opaque robots under central control: an action is the velocity of every robot.

    Observations are the centres, world units, `(robots, 2)`. With `observations="sensing"` they are a dictionary of the
    centres (`positions`) and of 0 or 1 for each pair, `(robots, robots)`: `neighbors`, and `visible` (the robot of the
    row sees the robot of the column). The reward is the change of the objective. Contact, or leaving the world, ends
    the episode with a penalty. Every `info` holds the signals by name.
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": FPS}  # noqa: RUF012

    def __init__(
        self,
        robots: int = 10,
        objective: str = "C1",
        *,
        observations: Observations = "positions",
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        """Builds the environment.

        Args:
            robots: Number of robots.
            objective: C1 (gathering at the origin), C2 (at no predefined point), or custom (the given signals alone).
            observations: positions or sensing.
            render_mode: None, rgb_array or human.
            **options: Further fields of `interop.gathering.Options` (start, signals, weights, horizon, action_scale,
                scheduler, shield) and of `WorldConfig`.

        Raises:
            InputError: A keyword is unknown, or a value is not allowed.
        """
        observe = _observe(observations)
        self._gathering = make_gathering({"robots": robots, "objective": objective, **options})
        self._camera = Camera(self._gathering, render_mode, self.metadata["render_modes"])
        self._episodes = Episodes(self._gathering.environment(), observe, 1)
        # A copy: Gymnasium's own vector environments write into it.
        self.metadata = dict(self.metadata)
        self.render_mode = render_mode
        self.observation_space = _observation_space(self._gathering, observations)
        self.action_space = _action_space(self._gathering)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begins an episode.

        Args:
            seed: Seed of this and all following starts; None: they continue as they were.
            options: `positions`, `(robots, 2)`: begins there.

        Returns:
            The observation and the info.

        Raises:
            InputError: The given positions are not a possible start.
        """
        _check_options(options, OPTIONS)
        positions = self._gathering.positions(options, np.array(True))
        super().reset(seed=seed)
        self._episodes.begin(self.np_random, positions=None if positions is None else positions[None])
        self._camera.follow(self._episodes, np.ones(1, bool))
        self._show()
        return self._observation(), self._info()

    def step(self, action: Float[np.ndarray, "robots 2"]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Moves every robot for one step.

        Args:
            action: Velocities; beyond the bounds of `action_space` they are clipped.

        Returns:
            The observation, the reward, whether the episode terminated, whether it was truncated, and the info.

        Raises:
            InputError: The action is not an array of finite numbers of that shape.
            ResetNeeded: No episode is under way.
        """
        if not self._episodes.started or self._episodes.ended[0]:
            raise ResetNeeded("no episode is under way: call reset() before step()")
        velocities = self._gathering.velocities(action, (self._gathering.config.robots, 2))
        result = self._episodes.step(velocities[None])
        self._camera.follow(self._episodes)
        self._show()
        ended = bool(result.terminated[0]), bool(result.truncated[0])
        return self._observation(), float(result.reward[0]), *ended, self._info()

    def render(self) -> UInt8[np.ndarray, "height width 3"] | None:
        """Draws the robots to scale, their safe distances, sight lines and paths, and writes the step.

        Returns:
            The picture in mode rgb_array; None in mode human, which draws at every step.

        Raises:
            ResetNeeded: No episode has begun.
        """
        if not self._episodes.started:
            raise ResetNeeded("no episode has begun: call reset() before render()")
        if self.render_mode is None:
            gymnasium.logger.warn("there is nothing to render: make the environment with a render_mode")
            return None
        return self._camera.frame()

    def close(self) -> None:
        """Closes the window, if there is one."""
        self._camera.close()

    def _show(self) -> None:
        if self.render_mode == "human":
            self.render()

    def _observation(self) -> Any:
        return _member(self._episodes.observation, 0)

    def _info(self) -> dict[str, Any]:
        return {name: float(value[0]) for name, value in self._episodes.signals.items()}


class GatheringVectorEnv(VectorEnv[Any, Float[np.ndarray, "envs robots 2"], np.ndarray]):
    """Many swarms under central control, each as in `GatheringEnv`; the environment is the first axis of every array.

    All worlds are one compiled program. `autoreset_mode` says what happens to an episode that has ended: a fresh start
    at the next step, whose action is not used (NEXT_STEP, Gymnasium's default); a fresh start within the same step,
    which returns the end as `final_obs` and `final_info` (SAME_STEP); or nothing until
    `reset(options={"reset_mask": ...})` (DISABLED).
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": FPS}  # noqa: RUF012
    # Gymnasium closes an environment that is deleted: until it is built, there is nothing to close.
    closed = True

    def __init__(
        self,
        num_envs: int = 1,
        robots: int = 10,
        objective: str = "C1",
        *,
        observations: Observations = "positions",
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        """Builds the environment.

        Args:
            num_envs: Number of worlds.
            robots: Number of robots in each.
            objective: As in `GatheringEnv`.
            observations: positions or sensing.
            autoreset_mode: Gymnasium's `AutoresetMode`, or its value: NextStep, SameStep or Disabled.
            render_mode: None or rgb_array.
            **options: As in `GatheringEnv`.

        Raises:
            InputError: A keyword is unknown, or a value is not allowed.
        """
        check_number("num_envs", num_envs, 1, MAX_ENVS, integer=True)
        if not isinstance(autoreset_mode, AutoresetMode):
            check_choice("autoreset_mode", autoreset_mode, [mode.value for mode in AutoresetMode])
        observe = _observe(observations)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self._gathering = make_gathering({"robots": robots, "objective": objective, **options})
        self._camera = Camera(self._gathering, render_mode, self.metadata["render_modes"])
        self._episodes = Episodes(self._gathering.environment(), observe, num_envs)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode = render_mode
        self.num_envs = num_envs
        self._rngs: list[np.random.Generator] | None = None
        self.single_observation_space = _observation_space(self._gathering, observations)
        self.single_action_space = _action_space(self._gathering)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.closed = False

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begins episodes.

        Args:
            seed: Seed of this and all following starts, of all worlds or of each: a world with a seed of its own begins
                as `GatheringEnv` does with it. None: they continue as they were.
            options: `positions`, `(num_envs, robots, 2)`: begins there. `reset_mask`, `(num_envs,)`: begins only these.

        Returns:
            The observations and the infos.

        Raises:
            InputError: The given positions are not possible starts, the seeds are not one integer for each world, or
                the mask is not a boolean array.
            ResetNeeded: A mask was given, but the other episodes have not begun either.
        """
        _check_options(options, (*OPTIONS, "reset_mask"))
        mask = self._mask(options)
        begun = np.ones(self.num_envs, bool) if mask is None else mask
        positions = self._gathering.positions(options, begun)
        if seed is None or isinstance(seed, int | np.integer):
            super().reset(seed=None if seed is None else int(seed))
            self._rngs = self._rngs if seed is None else None
        else:
            self._rngs = self._seeded(seed, begun)
        self._episodes.begin(self._randomness, mask, positions)
        self._camera.follow(self._episodes, begun)
        return self._episodes.observation, self._infos(begun)

    def step(self, actions: Float[np.ndarray, "envs robots 2"]) -> tuple[Any, Batch, Flags, Flags, dict[str, Any]]:
        """Moves every robot of every world for one step.

        Args:
            actions: Velocities; beyond the bounds of `action_space` they are clipped.

        Returns:
            The observations, the rewards, which episodes terminated, which were truncated, and the infos.

        Raises:
            InputError: The actions are not an array of finite numbers of that shape.
            ResetNeeded: An episode is not under way.
        """
        before = self._episodes.ended
        if not self._episodes.started or (self.autoreset_mode is AutoresetMode.DISABLED and before.any()):
            raise ResetNeeded("not all episodes are under way: call reset() before step()")
        velocities = self._gathering.velocities(actions, (self.num_envs, self._gathering.config.robots, 2))
        reward, terminated, truncated, _ = self._episodes.step(velocities)
        self._camera.follow(self._episodes)
        final: dict[str, Any] = {}
        if self.autoreset_mode is AutoresetMode.NEXT_STEP and before.any():
            # These episodes had ended: their step is discarded, and they begin anew.
            self._episodes.begin(self._randomness, before)
            self._camera.follow(self._episodes, before)
            reward[before], terminated[before], truncated[before] = 0, False, False
        elif self.autoreset_mode is AutoresetMode.SAME_STEP and self._episodes.ended.any():
            ended = self._episodes.ended
            final = self._final(ended)
            self._episodes.begin(self._randomness, ended)
            self._camera.follow(self._episodes, ended)
        infos = self._infos(np.ones(self.num_envs, bool)) | final
        return self._episodes.observation, reward, terminated, truncated, infos

    def render(self) -> tuple[UInt8[np.ndarray, "height width 3"], ...] | None:
        """Returns a picture of every world, in mode rgb_array.

        Raises:
            ResetNeeded: No episode has begun.
        """
        if not self._episodes.started:
            raise ResetNeeded("no episode has begun: call reset() before render()")
        if self.render_mode is None:
            gymnasium.logger.warn("there is nothing to render: make the environment with a render_mode")
            return None
        frames = map(self._camera.frame, range(self.num_envs))
        return tuple(frame for frame in frames if frame is not None)

    def close_extras(self, **kwargs: Any) -> None:
        """Releases the figure."""
        self._camera.close()

    @property
    def _randomness(self) -> np.random.Generator | list[np.random.Generator]:
        """The randomness of all worlds, or of each where they were given seeds of their own."""
        return self.np_random if self._rngs is None else self._rngs

    def _seeded(self, seeds: Any, begun: Flags) -> list[np.random.Generator]:
        """Returns each world's randomness: from its seed where it begins with one, as it was for the others."""
        allowed = f"an integer, or {self.num_envs} of them, one for each world, or None"
        if not isinstance(seeds, Sequence | np.ndarray) or isinstance(seeds, str) or len(seeds) != self.num_envs:
            raise InputError("seed", seeds, allowed)
        for index, seed in enumerate(seeds):
            if seed is not None:
                check_number(f"seed[{index}]", seed, 0, integer=True)
        before = self._rngs
        if before is None:
            # They had one generator together, which goes on in each of them.
            before = [np.random.default_rng(self.np_random.integers(2**63)) for _ in seeds]
        return [
            seeding.np_random(int(seed))[0] if begins and seed is not None else rng
            for seed, begins, rng in zip(seeds, begun, before, strict=True)
        ]

    def _mask(self, options: dict[str, Any] | None) -> Flags | None:
        given = (options or {}).get("reset_mask")
        if given is None:
            return None
        mask = np.array(given)
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise InputError("reset_mask", given, f"a boolean array of shape ({self.num_envs},), not all False")
        if not self._episodes.started:
            raise ResetNeeded("no episode has begun: call reset() without a mask first")
        return mask

    def _infos(self, mask: Flags) -> dict[str, Any]:
        """Returns the signals by name, each with the mask of the worlds that have it, as Gymnasium wants it."""
        infos: dict[str, Any] = {}
        for name, value in self._episodes.signals.items():
            infos |= {name: np.where(mask, value, 0.0), f"_{name}": mask.copy()}
        return infos

    def _final(self, ended: Flags) -> dict[str, Any]:
        """Returns the observations and infos of the episodes that have ended."""
        observed, observations = self._episodes.observation, np.full(self.num_envs, None, object)
        for index in np.flatnonzero(ended).tolist():
            observations[index] = _member(observed, index)
        return {
            "final_obs": observations,
            "_final_obs": ended.copy(),
            "final_info": self._infos(ended),
            "_final_info": ended.copy(),
        }


def register() -> None:
    """Registers `murmurate/Gathering-v0` with Gymnasium, unless it is registered already."""
    if ENV_ID not in gymnasium.registry:
        gymnasium.register(
            ENV_ID, entry_point=f"{__name__}:GatheringEnv", vector_entry_point=f"{__name__}:GatheringVectorEnv"
        )


def _observation_space(gathering: Gathering, observations: Observations) -> spaces.Space[Any]:
    robots = gathering.config.robots
    bounds = np.tile(gathering.position_bounds, (robots, 1))
    positions = spaces.Box(-bounds, bounds, dtype=np.float32)
    if observations == "positions":
        return positions
    pairs = (robots, robots)
    return spaces.Dict(
        {"positions": positions, "neighbors": spaces.MultiBinary(pairs), "visible": spaces.MultiBinary(pairs)}
    )


def _action_space(gathering: Gathering) -> spaces.Box:
    bound = gathering.action_bound
    return spaces.Box(-bound, bound, (gathering.config.robots, 2), np.float32)


def _observe(observations: Any) -> Observe:
    """Returns the function that computes the observation of a state; its arrays have the batch last."""
    check_choice("observations", observations, get_args(Observations))
    return World.observe if observations == "positions" else _positions_and_pairs


def _positions_and_pairs(world: World, state: State) -> dict[str, Any]:
    config = world.config
    near, seen = _batch_last.neighbors_and_visible(state.positions, config.radius, config.scan_radius)
    return {"positions": state.positions, "neighbors": near.astype(np.int8), "visible": seen.astype(np.int8)}


def _member(observation: Any, index: int) -> Any:
    """Returns the observation of one world of a batch."""
    if isinstance(observation, dict):
        return {name: values[index] for name, values in observation.items()}
    return observation[index]


def _check_options(options: dict[str, Any] | None, known: tuple[str, ...]) -> None:
    """Checks a reset's options: what they are, and their names."""
    check_options(options)
    for name, value in (options or {}).items():
        if name not in known:
            raise InputError(f"options[{name!r}]", value, f"left out: options are {', '.join(known)}")


register()
