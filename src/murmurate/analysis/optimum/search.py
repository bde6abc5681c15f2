"""How good can a formation be? A global search over configurations: no robots, no motion, only the objective.

Annealing finds the right neighbourhoods (`annealing`), as do rings with a few robots inside, and a local search under
the exact constraints ends in their optima (`polish`). SciPy's basin hopping, which shares only the local search, checks
the result (`hop`).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from scipy.optimize import OptimizeResult, basinhopping

from murmurate.analysis.optimum.annealing import AnnealingConfig, anneal
from murmurate.analysis.optimum.formation import Target
from murmurate.analysis.optimum.polish import polish
from murmurate.errors import GREATEST, MOST, check_choice, check_number
from murmurate.geometry import _batch_last, similarity
from murmurate.geometry.rings import smallest_ring
from murmurate.world import WorldConfig

__all__ = ["Formation", "OptimumConfig", "annealed", "distinct", "hop", "search"]

REQUIRED = 100.0
"""Weight of what a valid pattern needs, against gathering: then no chain ever gives any of it up."""

SAME = 1e-4
"""Local optima nearer than this, in safe distances, are one and the same."""


@dataclass(frozen=True)
class OptimumConfig:
    """What to search for, and how.

    Attributes:
        world: Sizes.
        objective: C1 (gathering at the origin) or C2 (at no predefined point).
        weights: Weights of the objective's signals.
        annealing: Numbers of the annealing.
        only_valid: Whether only valid patterns are of interest; otherwise the objective alone decides, which may give
            up the sight of a pair for nearness.
        polished: How many of the best chains are polished; 0: no annealing, only rings with robots inside.
        hops: Rounds of basin hopping, which check the result by another method; 0: no check.
        seed: Seed of the search.
    """

    world: WorldConfig
    objective: Literal["C1", "C2"]
    weights: Mapping[str, float] = field(default_factory=dict)
    annealing: AnnealingConfig = field(default_factory=AnnealingConfig)
    only_valid: bool = True
    polished: int = 32
    hops: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        check_choice("objective", self.objective, ("C1", "C2"))
        for name, weight in self.weights.items():
            check_number(f"weights.{name}", weight, 0, GREATEST)
        check_number("polished", self.polished, 0, MOST, integer=True)
        check_number("hops", self.hops, 0, 1_000_000, integer=True)
        check_number("seed", self.seed, 0, MOST, integer=True)

    @property
    def target(self) -> Target:
        """By what formations are compared."""
        return Target(self.world, self.objective, self.weights)


@dataclass(frozen=True, eq=False)
class Formation:
    """One configuration that a search ended in.

    Attributes:
        positions: Centres, world units.
        value: The target's objective.
        valid: Whether it would be a valid pattern.
    """

    positions: Float[np.ndarray, "robots 2"]
    value: float
    valid: bool

    @classmethod
    def from_positions(cls, positions: Float[np.ndarray, "robots 2"], target: Target) -> Formation:
        """Measures a configuration."""
        return cls(positions, target.value(positions), target.is_valid(positions))


def search(config: OptimumConfig) -> list[Formation]:
    """Searches for the best formations by annealing and polishing.

    Returns:
        Distinct local optima, best first; with `only_valid`, those that are no valid patterns come last.
    """
    target = config.target
    wide = _without_limits(target)
    rings = [polish(polish(positions, wide), target) for positions in nested_rings(wide)]
    found = [Formation.from_positions(positions, target) for positions in rings] + annealed(config)
    return distinct(found, config.world.safe_distance, config.only_valid)


def annealed(config: OptimumConfig) -> list[Formation]:
    """Searches by annealing alone, without any start that is made by hand.

    Returns:
        The polished ends of the best chains, as many as `config.polished`, alike ones among them.
    """
    target, world = config.target, config.world
    if not config.polished:
        return []
    chains = anneal(
        _score(target, config.only_valid),
        robots=world.robots,
        radius=world.radius,
        safe_distance=world.safe_distance,
        bounds=(world.half_width, world.half_height),
        seed=config.seed,
        config=config.annealing,
    )
    return [Formation.from_positions(polish(positions, target), target) for positions in chains[: config.polished]]


def nested_rings(target: Target) -> Iterator[Float[np.ndarray, "robots 2"]]:
    """Yields rings with none, one, two, three or four robots inside, wide enough to be valid patterns.

    Also rings with one place left empty: around one robot in the middle, an odd number of places leaves everyone in
    sight where an even one does not.
    """
    robots = target.world.robots
    for inside, empty in itertools.product(range(min(5, robots - 2)), (0, 1)):
        places = robots - inside + empty
        sizes = [(places, 2.0), (inside, 1.0)]
        circles = [
            radius * (count > 1) * target.world.safe_distance * np.exp(2j * np.pi * (np.arange(count) + 0.5) / count)
            for count, radius in sizes
            if count
        ]
        z = np.concatenate(circles)[empty:]
        yield _apart(np.stack([z.real, z.imag], axis=1), target)


def hop(config: OptimumConfig) -> Formation:
    """Searches by SciPy's basin hopping from the regular ring: a check of `search` by another method.

    One robot is put elsewhere, everybody is displaced a little, all are moved apart until they are a valid pattern
    again, and that is polished; Metropolis' rule decides whether it stays. So it goes `config.hops` times.

    Returns:
        The best formation met.
    """
    target, world = config.target, config.world
    shape, rng = (world.robots, 2), np.random.default_rng(config.seed)
    wide = _without_limits(target)

    def displace(flat: Float[np.ndarray, " coordinates"]) -> Float[np.ndarray, " coordinates"]:
        positions = flat.reshape(shape) + rng.normal(scale=world.safe_distance / 10, size=shape)
        extent = np.abs(positions).max()
        positions[rng.integers(world.robots)] = rng.uniform(-extent, extent, 2)
        return positions.ravel()

    def descend(_: Any, flat: Float[np.ndarray, " coordinates"], **__: Any) -> OptimizeResult:
        polished = polish(_apart(flat.reshape(shape), wide), wide)
        lost = config.only_valid and not target.is_valid(polished)
        loss = (REQUIRED if lost else 0.0) - target.value(polished)
        return OptimizeResult(x=polished.ravel(), fun=loss, success=True)

    found = basinhopping(
        lambda flat: -target.value(flat.reshape(shape)),
        smallest_ring(world.robots, world.radius, world.safe_distance).positions.ravel(),
        niter=config.hops,
        T=0.01,
        take_step=displace,
        minimizer_kwargs={"method": descend},
        rng=rng,
    )
    return Formation.from_positions(found.x.reshape(shape), target)


def distinct(formations: Sequence[Formation], unit: float, only_valid: bool = True) -> list[Formation]:
    """Orders formations, best first, and keeps one of each that differ by more than `SAME`."""
    ordered = sorted(formations, key=lambda one: (only_valid and not one.valid, -one.value))
    kept: list[Formation] = []
    for one in ordered:
        near = (other for other in kept if abs(other.value - one.value) < SAME)
        if all(similarity.distance(one.positions, other.positions, scaling=False) > SAME * unit for other in near):
            kept.append(one)
    return kept


def _score(target: Target, only_valid: bool) -> Any:
    """Returns what the annealing climbs: the objective, or gathering above all that a valid pattern needs."""
    world = target.world
    if not only_valid:
        return target.score_batch_last
    weights = {"gathering": 1.0, "safety": REQUIRED, "neighbors": 0.0, "visible": REQUIRED}
    required = replace(target, weights=weights)

    def score(positions: Any) -> Any:
        # How far beyond scanning distance, instead of how many: the signal alone would not say which way is better.
        beyond = _batch_last.distances(positions) - world.scan_radius
        far = (beyond * (beyond > 0)).sum(axis=(0, 1)) / (world.safe_distance * world.robots)
        return required.score_batch_last(positions) - REQUIRED * far

    return score


def _without_limits(target: Target) -> Target:
    """Returns the target in a world where nobody minds distance: neither the scan radius nor the edge of the world."""
    far = {name: 10 * getattr(target.world, name) for name in ("scan_radius", "half_width", "half_height")}
    return replace(target, world=replace(target.world, **far))


def _apart(positions: Float[np.ndarray, "robots 2"], target: Target) -> Float[np.ndarray, "robots 2"]:
    """Moves everybody apart until they are a valid pattern; gives up where that takes too much room."""
    for _ in range(60):
        if target.is_valid(positions):
            break
        positions = 1.05 * positions
    return positions
