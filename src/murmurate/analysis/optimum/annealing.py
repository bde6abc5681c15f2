"""Simulated annealing over configurations, in many chains at once: a rough, global search.

It searches configurations alone, without policies or motion. `polish` makes its results exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate.errors import MAX_MAGNITUDE, InputError, check_number
from murmurate.geometry import _batch_last
from murmurate.representation import short_repr
from murmurate.world import WorldConfig

__all__ = ["AnnealingConfig", "anneal"]

Score = Callable[[Float[Array, "robots 2 chains"]], Float[Array, " chains"]]

MAX_CHAINS, MAX_MOVES_PER_ROBOT = 100_000, 1_000_000
"""Limits within which all chains fit in memory and moves can be counted in 32 bits."""


@dataclass(frozen=True)
class AnnealingConfig:
    """The numbers of simulated annealing.

    Attributes:
        chains: Number of independent searches that run side by side.
        moves_per_robot: Moves that each chain tries for each robot.
        t_start: Temperature at the beginning, in units of the objective.
        t_end: Temperature at the end.
        step_start: Standard deviation of a move at the beginning, in safe distances.
        step_end: Standard deviation of a move at the end, in safe distances.
        teleport_fraction: Fraction of moves that put a robot at a random place near the swarm.
    """

    chains: int = 256
    moves_per_robot: int = 1500
    t_start: float = 3e-3
    t_end: float = 2e-6
    step_start: float = 1.0
    step_end: float = 2e-3
    teleport_fraction: float = 0.02

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_number("chains", self.chains, 1, MAX_CHAINS, integer=True)
        check_number("moves_per_robot", self.moves_per_robot, 1, MAX_MOVES_PER_ROBOT, integer=True)
        for name in ("t_start", "t_end", "step_start", "step_end"):
            check_number(name, getattr(self, name), 0, MAX_MAGNITUDE, exclusive_low=True)
        check_number("teleport_fraction", self.teleport_fraction, 0, 1)
        for high, low in (("t_start", "t_end"), ("step_start", "step_end")):
            if getattr(self, low) > getattr(self, high):
                raise InputError(low, getattr(self, low), f"at most {high} = {getattr(self, high):g}")


class _Chains(eqx.Module):
    positions: Float[Array, "robots 2 chains"]
    score: Float[Array, " chains"]


def anneal(
    score: Score,
    world: WorldConfig,
    *,
    seed: int,
    config: AnnealingConfig,
) -> Float[np.ndarray, "chains robots 2"]:
    """Returns configurations of high score, found by simulated annealing.

    Args:
        score: Returns the score of each configuration of a batch; the batch is last.
        world: Sizes of the world, which no robot leaves, and of its robots, which never overlap. Its safe distance is
            the unit of length of the moves.
        seed: Seed of the search.
        config: The numbers of simulated annealing.

    Returns:
        The last configuration of each chain, best first.
    """
    chains = _anneal(score, world, jax.random.key(seed), config)
    order = np.argsort(-np.asarray(chains.score), kind="stable")
    return np.moveaxis(np.asarray(chains.positions, float), -1, 0)[order]


@eqx.filter_jit
def _anneal(score: Score, world: WorldConfig, key: PRNGKeyArray, config: AnnealingConfig) -> _Chains:
    robots, safe_distance = world.robots, world.safe_distance
    begin, draws = jax.random.split(key)
    moves = config.moves_per_robot * robots
    edge = jnp.asarray((world.half_width, world.half_height))[None, :, None]
    # Teleported robots land in a square a little wider than a triangular lattice of as many robots.
    room = jnp.minimum(safe_distance * math.sqrt(robots), edge)
    pairs = ~jnp.eye(robots, dtype=bool)[..., None]

    def fits(positions: Array) -> Array:
        apart = jnp.all((_batch_last.distances(positions) > 2 * world.radius) | ~pairs, axis=(0, 1))
        return apart & jnp.all(jnp.abs(positions) <= edge, axis=(0, 1))

    def move(index: Array, chains: _Chains) -> _Chains:
        done = index / moves
        temperature = config.t_start * (config.t_end / config.t_start) ** done
        size = safe_distance * config.step_start * (config.step_end / config.step_start) ** done
        who, shift, jump, where, luck = jax.random.split(jax.random.fold_in(draws, index), 5)
        chosen = jnp.arange(robots)[:, None, None] == jax.random.randint(who, (1, 1, config.chains), 0, robots)
        shifted = chains.positions + size * jax.random.normal(shift, (1, 2, config.chains))
        placed = jax.random.uniform(where, (1, 2, config.chains), minval=-1.0, maxval=1.0) * room
        jumps = jax.random.uniform(jump, (1, 1, config.chains)) < config.teleport_fraction
        tried = jnp.where(chosen, jnp.where(jumps, placed, shifted), chains.positions)
        value = score(tried)
        lucky = jnp.log(jax.random.uniform(luck, (config.chains,))) * temperature < value - chains.score
        accepted = fits(tried) & lucky
        return _Chains(
            positions=jnp.where(accepted[None, None], tried, chains.positions),
            score=jnp.where(accepted, value, chains.score),
        )

    # Chains begin on a wide circle, on which no discs overlap and all robots see each other.
    wide = jnp.minimum(safe_distance * robots / 2, edge.min())
    turn = 2 * jnp.pi * jax.random.uniform(begin, (1, config.chains))
    angles = 2 * jnp.pi * jnp.arange(robots)[:, None] / robots + turn
    positions = wide * jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1)
    return jax.lax.fori_loop(0, moves, move, _Chains(positions, score(positions)))
