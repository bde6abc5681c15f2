"""What the environments for Gymnasium and PettingZoo share: their keywords, their episodes and their pictures.

All arrays that go in and out are NumPy arrays with the batch first. A single environment is a batch of one, so it runs
the same compiled program as the vector environment.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeVar, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree, UInt8, UInt32

from murmurate import forks, prng
from murmurate.discovery import DiscoveryConfig, Problem, RestRule, StageConfig, build_environment, check_parts
from murmurate.errors import MAX_INTEGER, InputError, check_choice, check_number, suggestion
from murmurate.policies import CentralPolicy, LocalPolicy, Shield
from murmurate.registry import Importer, Strategy
from murmurate.representation import short_repr
from murmurate.runs import config_io
from murmurate.world import (
    OBJECTIVES,
    GlobalSensing,
    Scheduler,
    Sensing,
    Signal,
    Start,
    UniformStart,
    World,
    WorldConfig,
    Wrapper,
    check_configurations,
    check_start,
    scaled_to,
)

if TYPE_CHECKING:
    from murmurate.plots import SwarmArtist

__all__ = [
    "FPS",
    "ActionScale",
    "Camera",
    "Episodes",
    "Gathering",
    "Observe",
    "Options",
    "StepResult",
    "check_options",
    "make_gathering",
    "numbers",
]

S = TypeVar("S", bound=Strategy)

ActionScale = Literal["unit", "world"]

Observe = Callable[[Any, Any], PyTree]
"""What agents observe in a state of an environment; the batch is last."""

NUMERIC = "fiub"
"""Kinds of NumPy arrays that hold real numbers."""

FPS = 20
"""Frames per second at which an episode should be shown."""

MAX_PATH = 400
"""Steps of path that a frame shows at most."""

FRAME_INCHES, DPI, MARGIN = 4.8, 100, 1.04
"""The longer side of a frame in inches, its pixels per inch, and the width of the view in widths of the world."""


@dataclass(frozen=True)
class Gathering:
    """A swarm that gathers: the world, and the scale of its actions.

    Attributes:
        config: Sizes of the world and its robots.
        world: The decision process.
        problem: The sensing, the scheduler and the shield around it.
        action_scale: unit (an action of 1 is the speed limit) or world (world units per step).
    """

    config: WorldConfig
    world: World
    problem: Problem
    action_scale: ActionScale

    __repr__ = short_repr

    @property
    def sensing(self) -> Sensing:
        """What robots perceive, where each is an agent of its own."""
        return self.problem.sensing

    def environment(self, per_robot_credit: bool = False, own_views: bool = False) -> World | Wrapper:
        """Returns the world with its scheduler and its shield.

        Args:
            per_robot_credit: Whether credit is given robot by robot.
            own_views: Whether each robot observes what it perceives alone.
        """
        policy = LocalPolicy() if own_views else CentralPolicy()
        world = replace(self.world, per_robot_credit=per_robot_credit)
        return build_environment(replace(self.problem, policy=policy), world)

    @property
    def has_landmark(self) -> bool:
        """Whether the objective gathers the robots at a given point, the origin."""
        return self.world.objective.needs_landmark

    @property
    def position_bounds(self) -> Float[np.ndarray, "2"]:
        """Greatest |x| and |y| of a centre: a robot that leaves the world is at most one step outside."""
        return self.config.limits + np.float32(self.config.max_speed)

    @property
    def action_bound(self) -> np.float32:
        """Greatest magnitude of an action's component."""
        return np.float32(1 if self.action_scale == "unit" else self.config.max_speed)

    def velocities(self, action: Any, shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
        """Returns the velocities that an action stands for, world units per step; actions out of bounds are clipped.

        Raises:
            InputError: The action is not an array of finite numbers of that shape.
        """
        bound = self.action_bound
        clipped = np.clip(numbers("action", action, shape), -bound, bound).astype(np.float32)
        return clipped * np.float32(self.config.max_speed) if self.action_scale == "unit" else clipped

    def positions(
        self, options: Mapping[str, Any] | None, mask: Bool[np.ndarray, "*batch"]
    ) -> Float[np.ndarray, "*batch robots 2"] | None:
        """Returns the configurations that `options["positions"]` gives to begin at; None where it gives none.

        Args:
            options: The options of a reset.
            mask: Which episodes begin; the configurations of the others are ignored.

        Raises:
            InputError: They have another shape, are not finite, in contact, or outside the world.
        """
        check_options(options)
        if not options or options.get("positions") is None:
            return None
        given = numbers("positions", options["positions"], (*mask.shape, self.config.robots, 2), mask)
        # A mask without axes adds one when it selects: a single configuration is checked as a batch of one.
        check_configurations(given[mask], self.config, "positions")
        return np.where(mask[..., None, None], given, 0.0).astype(np.float32)


@dataclass(frozen=True)
class Options:
    """The keywords that all environments have in common; the fields of `WorldConfig` come on top.

    A strategy (a start, a signal) is given as a registered name, as "module:Class", as a mapping of its fields with its
    name under `use` (as in TOML), or as an object.

    Attributes:
        robots: Number of robots.
        objective: C1 (gathering at the origin), C2 (at no predefined point), or custom (the given signals alone).
        start: Where episodes begin.
        signals: Further signals of the objective by name; one with the name of a signal of the objective replaces it.
        weights: Weights that replace the signals' own, by name.
        horizon: Steps after which an episode is truncated.
        action_scale: unit (an action of 1 is the speed limit) or world (world units per step).
        scheduler: When robots look and move; a robot that may not look now goes on with its last move.
        shield: What shortens the robots' moves.
    """

    robots: Any = 10
    objective: Any = "C1"
    start: Any = "random"
    signals: Any = None
    weights: Any = None
    horizon: Any = 400
    action_scale: Any = "unit"
    scheduler: Any = "fsync"
    shield: Any = "none"

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_number("robots", self.robots, 2, integer=True)
        check_choice("objective", self.objective, tuple(OBJECTIVES))
        check_choice("action_scale", self.action_scale, get_args(ActionScale))
        check_number("horizon", self.horizon, 1, MAX_INTEGER, integer=True)
        for name in ("signals", "weights"):
            value = getattr(self, name)
            if not isinstance(value, Mapping | None):
                raise InputError(name, value, f"a mapping from the names of signals to {name}")


def make_gathering(keywords: Mapping[str, Any], sensing: Any = None) -> Gathering:
    """Builds a swarm from the keywords of an environment.

    Args:
        keywords: Fields of `Options`, and of `WorldConfig`; the sizes that are not given scale with the swarm
            (`world.scaled_to`).
        sensing: What robots perceive, where each is an agent of its own: like a strategy in `Options`.

    Raises:
        InputError: A keyword is unknown, a value is not allowed, or a class cannot be imported or does not return what
            it should.
    """
    shared, sizes = ({field.name for field in fields(cls)} for cls in (Options, WorldConfig))
    for name, value in keywords.items():
        if name not in shared | sizes:
            known = sorted(shared | sizes)
            raise InputError(name, value, f"left out: keywords are {', '.join(known)}{suggestion(name, known)}")
    options = Options(**{name: value for name, value in keywords.items() if name in shared})
    world = {name: value for name, value in keywords.items() if name in sizes - shared}
    signals = (options.signals or {}).items()
    problem = Problem(
        world=replace(scaled_to(WorldConfig(), options.robots), **world),
        objective=options.objective,
        start=_strategy(Start, options.start, "start"),
        signals={name: _strategy(Signal, signal, f"signals.{name}") for name, signal in signals},
        sensing=GlobalSensing() if sensing is None else _strategy(Sensing, sensing, "sensing"),
        scheduler=_strategy(Scheduler, options.scheduler, "scheduler"),
        shield=_strategy(Shield, options.shield, "shield"),
        # Only what is above is used: nothing is trained.
        policy=LocalPolicy(),
        base=StageConfig(),
        auxiliary=StageConfig(),
        discovery=DiscoveryConfig(),
        # What another learner decides is executed as it is.
        rest=RestRule(dead_zone=0.0),
        seed=0,
    )
    start, objective = UniformStart(), problem.objective_signals
    # Where JAX cannot compute, spaces are all that there is: the first reset says so. A vector environment that forks
    # has made, and checked, an environment before.
    if forks.can_compute():
        start = check_start(problem.start, problem.world)
        parts = (*objective.values(), problem.sensing, problem.scheduler, problem.shield)
        if any(part.is_foreign() for part in parts):
            check_parts(problem)
    process = World.create(problem.world, start, objective, options.weights, options.horizon)
    return Gathering(problem.world, process, problem, options.action_scale)


def _strategy(kind: type[S], value: Any, field: str) -> S:
    """Returns the strategy that a keyword gives: an object, a name, "module:Class", or a mapping of fields."""
    if isinstance(value, kind):
        return value
    if isinstance(value, str):
        value = {config_io.USE: Importer().find(kind, value, field).spelling()}
    if not isinstance(value, Mapping):
        names = ", ".join(kind.registered())
        raise InputError(field, value, f'one of {names}, "module:Class", a mapping of fields, or a {kind.__name__}')
    return config_io.from_dict(kind, value, field)


def numbers(
    name: str, value: Any, shape: tuple[int, ...], mask: Bool[np.ndarray, "*batch"] | None = None
) -> Float[np.ndarray, "..."]:
    """Returns a value as an array of finite numbers of a shape.

    Args:
        name: What the value is, for messages.
        value: The value.
        shape: Its shape.
        mask: Which members of the batch must be finite; None: all.

    Raises:
        InputError: The value is not such an array.
    """
    try:
        array = np.asarray(value)
    except ValueError:
        raise InputError(name, "a ragged list", f"an array of shape {shape}") from None
    if array.shape != shape:
        raise InputError(name, f"an array of shape {array.shape}", f"of shape {shape}")
    if array.dtype.kind not in NUMERIC:
        raise InputError(name, f"an array of {array.dtype}", "an array of real numbers")
    if not np.isfinite(array if mask is None else array[mask]).all():
        raise InputError(name, "an array with NaN or infinity", "finite")
    return array.astype(float)


def check_options(options: object) -> None:
    """Checks the options of a reset.

    Raises:
        InputError: They are neither a mapping nor None.
    """
    if not isinstance(options, Mapping | None):
        raise InputError("options", options, "a mapping from the names of options to their values, or None")


class StepResult(NamedTuple):
    """The outcome of one step of each episode.

    Attributes:
        reward: Reward of the step.
        terminated: Whether the episode ended in contact or outside the world.
        truncated: Whether the time limit was reached.
        credit: The reward that each action learns from: the swarm's, or each robot's.
    """

    reward: Float[np.ndarray, " batch"]
    terminated: Bool[np.ndarray, " batch"]
    truncated: Bool[np.ndarray, " batch"]
    credit: Float[np.ndarray, "batch actions"]

    __repr__ = short_repr


class Episodes:
    """A batch of episodes in an environment; none has begun before `begin`.

    Attributes:
        started: Whether there are episodes.
        ended: Which of them have ended.
    """

    def __init__(self, env: Any, observe: Observe, batch: int) -> None:
        """Prepares the episodes without beginning them.

        Args:
            env: A `World`, or a wrapper around one.
            observe: What agents observe.
            batch: Number of episodes.
        """
        self._env, self._observe = env, observe
        self.started = False
        self.ended = np.zeros(batch, bool)

    @functools.cached_property
    def _compiled(self) -> tuple[_Program, Any]:
        """What is compiled, and its numbers; made at the first reset, because an array starts JAX."""
        arrays, constants = eqx.partition(self._env, eqx.is_array_like)
        leaves, structure = jax.tree.flatten(constants)
        # Arrays on the device: Python numbers would be transferred anew at every step.
        return _Program(self._observe, structure, tuple(leaves)), jax.tree.map(jnp.asarray, arrays)

    def __getstate__(self) -> dict[str, Any]:
        # The structure of a tree cannot be pickled: a copy makes it anew.
        return {name: value for name, value in vars(self).items() if name != "_compiled"}

    @prng.reproducible()
    def begin(
        self,
        rng: np.random.Generator | Sequence[np.random.Generator],
        mask: Bool[np.ndarray, " batch"] | None = None,
        positions: Float[np.ndarray, "batch robots 2"] | None = None,
    ) -> None:
        """Begins new episodes.

        Args:
            rng: Randomness of the starts, of the robots' frames and of noise; of all episodes, or of each.
            mask: Which episodes are replaced; None: all.
            positions: Where they begin; None: at fresh starts.
        """
        batch = len(self.ended)
        if isinstance(rng, np.random.Generator):
            draw, (start_seed, seed) = _draw, _two_seeds(rng)
        else:
            # Who does not begin draws nothing: each world's starts depend on its own generator alone.
            begun = np.flatnonzero(np.ones(batch) if mask is None else mask).tolist()
            seeds = np.zeros((batch, 2), np.uint32)
            seeds[begun] = [_two_seeds(rng[index]) for index in begun]
            draw, start_seed, seed = _draw_each, seeds[:, 0], seeds[:, 1]
        if positions is None:
            positions = draw(*self._compiled, start_seed, batch)
        state, observed = _begin(*self._compiled, positions, seed)
        if mask is None:
            self._state, self._observed, self.ended = state, observed, np.zeros_like(self.ended)
        else:
            self._state = _replace(mask, state, self._state)
            self._observed = jax.tree.map(
                lambda new, old: np.where(mask.reshape(mask.shape + (1,) * (new.ndim - 1)), new, old),
                observed,
                self._observed,
            )
            self.ended = self.ended & ~mask
        self.started = True

    @prng.reproducible()
    def step(self, velocities: Float[np.ndarray, "batch robots 2"]) -> StepResult:
        """Moves every robot of every episode for one step, in ended episodes too."""
        self._state, self._observed, outcome = _advance(*self._compiled, self._state, velocities)
        reward, terminated, truncated, credit = (np.array(values) for values in outcome)
        self.ended = terminated | truncated
        # Rewards are float64, as in Gymnasium's own environments.
        return StepResult(reward.astype(float), terminated, truncated, credit.astype(float))

    @property
    def observation(self) -> PyTree[np.ndarray]:
        """What agents observe now, the batch first; new arrays at every access."""
        return jax.tree.map(np.array, self._observed[0])

    @property
    def signals(self) -> dict[str, Float[np.ndarray, " batch"]]:
        """The signals by name; new arrays at every access."""
        return {name: np.array(value, float) for name, value in self._observed[1].items()}

    @property
    def positions(self) -> Float[np.ndarray, "batch robots 2"]:
        """Centres, world units; a new array at every access."""
        return np.moveaxis(np.array(self._state.positions), -1, 0)


class _Program(NamedTuple):
    """What the compiled functions below are compiled for: everything about an environment but its numbers.

    Attributes:
        observe: What agents observe.
        structure: The tree of the environment's fields that are no numbers.
        leaves: Those fields, such as a text in a user's start.
    """

    observe: Observe
    structure: Any
    leaves: tuple[Any, ...]

    def env(self, arrays: Any) -> Any:
        """Returns the environment."""
        return eqx.combine(arrays, jax.tree.unflatten(self.structure, self.leaves))


def _two_seeds(rng: np.random.Generator) -> UInt32[np.ndarray, "2"]:
    """Draws the seeds of a start, and of the robots' frames and noise."""
    return rng.integers(2**32, size=2, dtype=np.uint32)


def _batch_first(tree: PyTree[Array]) -> PyTree[Array]:
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), tree)


@functools.partial(jax.jit, static_argnums=(0, 3))
def _draw(program: _Program, arrays: Any, seed: UInt32[Array, ""], batch: int) -> Float[Array, "batch robots 2"]:
    env = program.env(arrays)
    return env.start.sample(prng.key(seed), batch, env.config)


@functools.partial(jax.jit, static_argnums=(0, 3))
def _draw_each(
    program: _Program, arrays: Any, seeds: UInt32[Array, " batch"], batch: int
) -> Float[Array, "batch robots 2"]:
    """Draws each start from a seed of its own, the one that `_draw` draws from it alone."""
    del batch
    env = program.env(arrays)
    return jax.vmap(lambda seed: env.start.sample(prng.key(seed), 1, env.config)[0])(seeds)


@functools.partial(jax.jit, static_argnums=0)
def _begin(
    program: _Program, arrays: Any, positions: Float[Array, "batch robots 2"], seed: UInt32[Array, "*batch"]
) -> tuple[Any, Any]:
    env = program.env(arrays)
    # In float32, as the observation spaces say, whatever precision a start is drawn in.
    positions = jnp.moveaxis(positions, 0, -1).astype(jnp.float32)
    if seed.ndim and not isinstance(env, World):
        # Each from a seed of its own, as a single one begins with it.
        begin = jax.vmap(lambda positions, seed: env.state(positions[..., None], seed), (-1, 0), -1)
        state = jax.tree.map(lambda leaf: leaf[..., 0, :], begin(positions, seed))
    else:
        state = env.state(positions, seed)
    return state, _batch_first((program.observe(env, state), env.signals(state.positions)))


@functools.partial(jax.jit, static_argnums=0)
def _advance(
    program: _Program, arrays: Any, state: Any, velocities: Float[Array, "batch robots 2"]
) -> tuple[Any, Any, Any]:
    env = program.env(arrays)
    state, transition = env.step(state, jnp.moveaxis(velocities, 0, -1))
    observed = _batch_first((program.observe(env, state), transition.signals))
    outcome = (transition.reward, transition.terminated, transition.truncated, transition.credit)
    return state, observed, _batch_first(outcome)


@jax.jit
def _replace(mask: Bool[Array, " batch"], new: Any, old: Any) -> Any:
    return jax.tree.map(lambda after, before: jnp.where(mask, after, before), new, old)


class Camera:
    """Draws frames of a swarm, as arrays of pixels or in a window. Matplotlib is loaded with the first frame.

    A frame shows the paths since the start of the episode, so the camera follows every step.
    """

    def __init__(self, gathering: Gathering, mode: str | None, modes: Sequence[str]) -> None:
        """Prepares to draw.

        Args:
            gathering: What is drawn.
            mode: rgb_array or human; None: nothing will be drawn.
            modes: The modes that the environment has.

        Raises:
            InputError: The environment has no such mode.
        """
        if mode is not None:
            check_choice("render_mode", mode, modes)
        self._gathering = gathering
        self._mode = mode
        self._in_window = mode == "human"
        self._paths: list[list[Float[np.ndarray, "robots 2"]]] = []
        self._steps: list[int] = []
        self._close()

    def __getstate__(self) -> dict[str, Any]:
        # A copy opens a figure of its own.
        return {**vars(self), "_figure": None, "_swarm": None, "_drawn": None, "_text": None}

    def follow(self, episodes: Episodes, begun: Bool[np.ndarray, " batch"] | None = None) -> None:
        """Remembers where the robots are, if anything will be drawn.

        Args:
            episodes: The episodes, after a step or after some have begun.
            begun: Which have begun; None: all have made a step.
        """
        if self._mode is None:
            return
        positions = episodes.positions
        if not self._paths:
            self._paths, self._steps = [[] for _ in positions], [0] * len(positions)
        for index, configuration in enumerate(positions):
            if begun is None:
                self._paths[index] = [*self._paths[index][-MAX_PATH:], configuration]
                self._steps[index] += 1
            elif begun[index]:
                self._paths[index], self._steps[index] = [configuration], 0

    def frame(self, index: int = 0) -> UInt8[np.ndarray, "height width 3"] | None:
        """Draws an episode as far as it has come.

        Args:
            index: Its place in the batch.

        Returns:
            The pixels, or None where a window shows them. A window that the user has closed stays closed.
        """
        path = np.stack(self._paths[index])
        if self._swarm is None:
            self._swarm = self._open(path[-1])
        if not self._is_closed():
            self._draw(path, self._steps[index])
        canvas = self._figure.canvas
        if not self._in_window:
            canvas.draw()
            return np.array(canvas.buffer_rgba())[..., :3].copy()
        if not self._is_closed():
            canvas.draw()
            # Without a display there is no event loop, and nothing is shown.
            if canvas.required_interactive_framework:
                self._figure.show()
                canvas.start_event_loop(1 / FPS)
        return None

    def close(self) -> None:
        """Closes the window, if there is one; the next frame opens another."""
        if self._in_window and self._figure is not None:
            from matplotlib import pyplot

            pyplot.close(self._figure)
        self._close()

    def _close(self) -> None:
        self._figure: Any = None
        self._swarm: SwarmArtist | None = None
        self._drawn: Any = None
        self._text: Any = None

    def _draw(self, path: Float[np.ndarray, "configurations robots 2"], step: int) -> None:
        """Moves everything on the figure to the end of a path."""
        from murmurate.plots.swarm import draw_paths

        assert self._swarm is not None
        self._swarm.update(path[-1])
        if self._drawn is not None:
            self._drawn.remove()
        self._drawn = draw_paths(self._figure.axes[0], path, np.zeros(len(path) - 1, int))
        self._text.set_text(f"step {step}")

    def _open(self, positions: Float[np.ndarray, "robots 2"]) -> SwarmArtist:
        from murmurate.plots import SwarmArtist
        from murmurate.plots.style import MUTED
        from murmurate.plots.swarm import draw_world

        world = self._gathering.config
        half = np.array([world.half_width, world.half_height])
        size = tuple(FRAME_INCHES * half / half.max())
        if self._in_window:
            from matplotlib import pyplot  # only here: it chooses how windows are made

            self._figure = pyplot.figure(figsize=size, dpi=DPI)
        else:
            from matplotlib.backends.backend_agg import FigureCanvasAgg
            from matplotlib.figure import Figure

            self._figure = Figure(figsize=size, dpi=DPI)
            FigureCanvasAgg(self._figure)
        ax = self._figure.add_axes((0, 0, 1, 1))
        draw_world(ax, world, clip=False)
        swarm = SwarmArtist(ax, positions, world, gathering_point=self._gathering.has_landmark)
        ax.set(xlim=MARGIN * half[0] * np.array([-1, 1]), ylim=MARGIN * half[1] * np.array([-1, 1]))
        ax.set_axis_off()
        self._text = ax.text(0.035, 0.965, "", transform=ax.transAxes, va="top", fontsize=8, color=MUTED)
        return swarm

    def _is_closed(self) -> bool:
        if not self._in_window:
            return False
        from matplotlib import pyplot

        return not pyplot.fignum_exists(self._figure.number)
