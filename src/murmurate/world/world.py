"""The paper's Markov decision process of a swarm of fat, opaque robots."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from murmurate.geometry import outside, touches
from murmurate.world.config import WorldConfig
from murmurate.world.signals import Objective, WeightsConfig, shares, signals
from murmurate.world.starts import Start

__all__ = ["State", "Transition", "World"]


class State(eqx.Module):
    """Where the robots are.

    Attributes:
        positions: Centres, world units.
        step: Steps since the episode began.
        objective: The objective C of this configuration.
        standing: What each action of a step answers for: C itself, or each robot's share of it.
    """

    positions: Float[Array, "robots 2 *batch"]
    step: Int[Array, "*batch"]
    objective: Float[Array, "*batch"]
    standing: Float[Array, "actions *batch"]


class Transition(eqx.Module):
    """What one step brought.

    Attributes:
        reward: C(next) - C(now); minus the fixed penalty on a step that terminates.
        terminated: The step ended in a collision or outside the world.
        truncated: The time limit was reached without that.
        signals: The signals of the next configuration by name.
        credit: The reward that each action of the step is taught by: the reward itself, or the change of each robot's
            share; the penalty falls on the robots that collided or left.
    """

    reward: Float[Array, "*batch"]
    terminated: Bool[Array, "*batch"]
    truncated: Bool[Array, "*batch"]
    signals: dict[str, Float[Array, "*batch"]]
    credit: Float[Array, "actions *batch"]


class World(eqx.Module):
    """A rectangle with N robots; the state is their positions, the action their velocities.

    Every method takes one configuration or a batch of them on the LAST axis. Numbers are leaves of the PyTree: changing
    one does not recompile what was compiled for another.
    """

    robots: int = eqx.field(static=True)
    safety: str = eqx.field(static=True)
    by_robot: bool = eqx.field(static=True)
    half_width: Any
    half_height: Any
    radius: Any
    scan_radius: Any
    safe_distance: Any
    max_speed: Any
    collision_penalty: Any
    objective: Objective
    start: Start
    horizon: Any

    @classmethod
    def create(
        cls,
        config: WorldConfig,
        start: Start,
        objective: str = "C1",
        weights: WeightsConfig | None = None,
        horizon: int = 400,
        by_robot: bool = False,
    ) -> World:
        """Builds a world.

        Args:
            config: Its sizes.
            start: Where episodes begin.
            objective: C1 (gathering at the origin) or C2 (at no predefined point).
            weights: Weights of the signals, by default all 1.
            horizon: Steps after which an episode is truncated.
            by_robot: Whether credit is given robot by robot, by each one's share of the objective.

        Raises:
            InputError: There is no such objective.
        """
        return cls(
            robots=config.robots,
            safety=config.safety,
            by_robot=by_robot,
            half_width=config.half_width,
            half_height=config.half_height,
            radius=config.radius,
            scan_radius=config.scan_radius,
            safe_distance=config.safe_distance,
            max_speed=config.max_speed,
            collision_penalty=config.collision_penalty,
            objective=Objective.create(objective, weights or WeightsConfig()),
            start=start,
            horizon=horizon,
        )

    def _measures(self) -> dict[str, Any]:
        return {
            "gathering": self.objective.gathering,
            "half_width": self.half_width,
            "half_height": self.half_height,
            "radius": self.radius,
            "scan_radius": self.scan_radius,
            "safe_distance": self.safe_distance,
            "safety": self.safety,
        }

    def signals(self, positions: Float[Array, "robots 2 *batch"]) -> dict[str, Float[Array, "*batch"]]:
        """Returns the signals of configurations by name."""
        return signals(positions, **self._measures())

    def _standing(self, positions: Any, objective: Any) -> Any:
        return self.objective(shares(positions, **self._measures())) if self.by_robot else objective[None]

    def state(self, positions: Float[Array, "robots 2 *batch"], seed: Any = 0) -> State:
        """Returns the state at the beginning of an episode from the given configurations.

        Args:
            positions: The configurations.
            seed: Not used: the world draws nothing. What a world is wrapped in may.
        """
        del seed
        objective = self.objective(self.signals(positions))
        step = jnp.zeros(positions.shape[2:], jnp.int32)
        return State(positions, step, objective, self._standing(positions, objective))

    def reset(self, key: PRNGKeyArray) -> State:
        """Begins one episode at a fresh start."""
        return self.state(self.start.sample(key, 1)[..., 0])

    def reset_batch(self, key: PRNGKeyArray, batch: int) -> State:
        """Begins a batch of episodes, each at a fresh start of its own."""
        return self.state(self.start.sample(key, batch))

    def step(self, state: State, velocities: Float[Array, "robots 2 *batch"]) -> tuple[State, Transition]:
        """Moves every robot for one step; velocities are clipped to the speed limit component by component.

        There is no reset inside: a terminated or truncated episode is the caller's to end.
        """
        velocities = jnp.clip(velocities, -self.max_speed, self.max_speed)
        positions = state.positions + velocities
        measured = self.signals(positions)
        objective = self.objective(measured)
        standing = self._standing(positions, objective)
        touching = touches(state.positions, velocities, self.radius)
        culprits = touching | outside(positions, self.half_width, self.half_height)
        terminated = jnp.any(culprits, axis=0)
        blamed = culprits if self.by_robot else terminated[None]
        credit = jnp.where(terminated, -self.collision_penalty * blamed, standing - state.standing)
        reward = jnp.where(terminated, -self.collision_penalty, objective - state.objective)
        step = state.step + 1
        truncated = (step >= self.horizon) & ~terminated
        after = State(positions, step, objective, standing)
        return after, Transition(reward, terminated, truncated, measured, credit)

    def observe(self, state: State) -> Float[Array, "robots 2 *batch"]:
        """Returns the positions: what to make of them is the policy's business."""
        return state.positions
