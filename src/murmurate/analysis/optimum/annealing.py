"""Simulated annealing over configurations: many chains at once, no robots that move, no way there.

The search is rough and global; `murmurate.analysis.optimum.polish` makes what it finds exact.
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

from murmurate.errors import GREATEST, InputError, check_number
from murmurate.geometry import distances

__all__ = ["AnnealingConfig", "anneal"]

Score = Callable[[Float[Array, "robots 2 chains"]], Float[Array, " chains"]]

MOST_CHAINS, MOST_SWEEPS = 100_000, 1_000_000
"""So that all chains fit in memory, and moves can be counted in 32 bits."""


@dataclass(frozen=True)
class AnnealingConfig:
    """Numbers of the search.

    Attributes:
        chains: How many searches run side by side.
        sweeps: Moves tried of each robot in each of them.
        hot: Temperature at the beginning, in units of the objective.
        cold: Temperature at the end.
        step: Standard deviation of a move at the beginning, in safe distances.
        fine: The same at the end.
        jumps: Share of moves that put the robot anywhere near the swarm.
    """

    chains: int = 256
    sweeps: int = 1500
    hot: float = 3e-3
    cold: float = 2e-6
    step: float = 1.0
    fine: float = 2e-3
    jumps: float = 0.02

    def __post_init__(self) -> None:
        check_number("chains", self.chains, 1, MOST_CHAINS, integer=True)
        check_number("sweeps", self.sweeps, 1, MOST_SWEEPS, integer=True)
        for name in ("hot", "cold", "step", "fine"):
            check_number(name, getattr(self, name), 0, GREATEST, exclusive_low=True)
        check_number("jumps", self.jumps, 0, 1)
        for high, low in (("hot", "cold"), ("step", "fine")):
            if getattr(self, low) > getattr(self, high):
                raise InputError(low, getattr(self, low), f"at most {high} = {getattr(self, high):g}")


class _Chains(eqx.Module):
    positions: Float[Array, "robots 2 chains"]
    score: Float[Array, " chains"]


def anneal(
    score: Score,
    *,
    robots: int,
    radius: float,
    safe_distance: float,
    bounds: tuple[float, float],
    seed: int,
    config: AnnealingConfig,
) -> Float[np.ndarray, "chains robots 2"]:
    """Searches for configurations of high score.

    Args:
        score: What is sought, of a batch of configurations.
        robots: Swarm size.
        radius: The paper's R_bot; robots never overlap.
        safe_distance: The paper's delta_s: the unit of length of the moves.
        bounds: X and Y of the world, which nobody leaves.
        seed: Seed of the search.
        config: Numbers of the search.

    Returns:
        Where each chain ended, best first.
    """
    key = jax.random.key(seed)
    found = _anneal(score, robots, radius, safe_distance, bounds, key, config)
    order = np.argsort(-np.asarray(found.score), kind="stable")
    return np.moveaxis(np.asarray(found.positions, float), -1, 0)[order]


@eqx.filter_jit
def _anneal(
    score: Score,
    robots: int,
    radius: float,
    safe_distance: float,
    bounds: tuple[float, float],
    key: PRNGKeyArray,
    config: AnnealingConfig,
) -> _Chains:
    begin, draws = jax.random.split(key)
    moves = config.sweeps * robots
    edge = jnp.asarray(bounds)[None, :, None]
    # A triangular lattice of that many robots, loosened: the room in which a robot may be put down again.
    room = jnp.minimum(safe_distance * math.sqrt(robots), edge)
    pairs = ~jnp.eye(robots, dtype=bool)[..., None]

    def fits(positions: Array) -> Array:
        apart = jnp.all((distances(positions) > 2 * radius) | ~pairs, axis=(0, 1))
        return apart & jnp.all(jnp.abs(positions) <= edge, axis=(0, 1))

    def move(index: Array, chains: _Chains) -> _Chains:
        done = index / moves
        temperature = config.hot * (config.cold / config.hot) ** done
        size = safe_distance * config.step * (config.fine / config.step) ** done
        who, shift, jump, where, luck = jax.random.split(jax.random.fold_in(draws, index), 5)
        chosen = jnp.arange(robots)[:, None, None] == jax.random.randint(who, (1, 1, config.chains), 0, robots)
        shifted = chains.positions + size * jax.random.normal(shift, (1, 2, config.chains))
        placed = jax.random.uniform(where, (1, 2, config.chains), minval=-1.0, maxval=1.0) * room
        jumps = jax.random.uniform(jump, (1, 1, config.chains)) < config.jumps
        tried = jnp.where(chosen, jnp.where(jumps, placed, shifted), chains.positions)
        value = score(tried)
        lucky = jnp.log(jax.random.uniform(luck, (config.chains,))) * temperature < value - chains.score
        accepted = fits(tried) & lucky
        return _Chains(
            positions=jnp.where(accepted[None, None], tried, chains.positions),
            score=jnp.where(accepted, value, chains.score),
        )

    # On a wide circle nobody overlaps and everyone sees everyone; heat does the rest.
    wide = jnp.minimum(safe_distance * robots / 2, edge.min())
    turn = 2 * jnp.pi * jax.random.uniform(begin, (1, config.chains))
    angles = 2 * jnp.pi * jnp.arange(robots)[:, None] / robots + turn
    positions = wide * jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1)
    return jax.lax.fori_loop(0, moves, move, _Chains(positions, score(positions)))
