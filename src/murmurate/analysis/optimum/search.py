"""Global search for the best formations: over configurations alone, without policies or motion.

Annealing (`annealing`) and rings with a few robots inside give the starting points. A local search under the exact
constraints (`polish`) leads from each to its local optimum. SciPy's basin hopping, which shares only the local search,
checks the result (`hop`).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from scipy.optimize import OptimizeResult, basinhopping

from murmurate.analysis.optimum.annealing import AnnealingConfig, anneal
from murmurate.analysis.optimum.formation import Target
from murmurate.analysis.optimum.polish import polish
from murmurate.errors import MAX_INTEGER, MAX_MAGNITUDE, check_choice, check_number
from murmurate.geometry import _batch_last, similarity
from murmurate.geometry.rings import smallest_ring
from murmurate.representation import short_repr
from murmurate.world import WorldConfig, check_pairs

__all__ = ["Formation", "OptimumConfig", "annealed", "distinct", "hop", "search"]

VALIDITY_WEIGHT = 100.0
"""Weight, relative to gathering, of what a valid pattern requires: so high that no chain trades any of it."""

DUPLICATE_TOLERANCE = 1e-4
"""Local optima nearer to each other than this, in safe distances, count as the same."""


@dataclass(frozen=True)
class OptimumConfig:
    """The configuration of a search for the best formations.

    Attributes:
        world: Sizes of the world and its robots.
        objective: C1 (gathering at the origin) or C2 (at no predefined point).
        weights: Weights of the objective's signals.
        annealing: The numbers of simulated annealing.
        only_valid: Search for valid patterns only; otherwise the objective alone decides, which may trade the
            visibility of a pair for nearness.
        polished: How many of the best chains are polished; 0: no annealing, only rings.
        hops: Rounds of basin hopping, which checks the result by another method; 0: no check.
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

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_choice("objective", self.objective, ("C1", "C2"))
        for name, weight in self.weights.items():
            check_number(f"weights.{name}", weight, 0, MAX_MAGNITUDE)
        check_number("polished", self.polished, 0, MAX_INTEGER, integer=True)
        check_number("hops", self.hops, 0, 1_000_000, integer=True)
        check_number("seed", self.seed, 0, MAX_INTEGER, integer=True)
        check_pairs("annealing.chains", self.annealing.chains, self.world.robots)

    @property
    def target(self) -> Target:
        """The objective that formations are compared by."""
        return Target(self.world, self.objective, self.weights)


@dataclass(frozen=True, eq=False)
class Formation:
    """A configuration that a search ended in.

    Attributes:
        positions: Centres, world units.
        value: Its objective.
        valid: Whether it is a valid pattern.
    """

    positions: Float[np.ndarray, "robots 2"]
    value: float
    valid: bool

    __repr__ = short_repr

    @classmethod
    def from_positions(cls, positions: Float[np.ndarray, "robots 2"], target: Target) -> Formation:
        """Returns a configuration with its objective and validity."""
        return cls(positions, target.value(positions), target.is_valid(positions))


def search(config: OptimumConfig, on_progress: Callable[..., None] | None = None) -> list[Formation]:
    """Returns the best formations that annealing and polishing find.

    Args:
        config: The search.
        on_progress: Called as `on_progress(work, done, total)` before and after each part of the work.

    Returns:
        Distinct local optima, best first; with `only_valid`, those that are not valid patterns come last.
    """
    target = config.target
    wide = _without_limits(target)
    layouts, rings, report = list(nested_rings(wide)), [], on_progress or (lambda *_: None)
    report("rings", 0, len(layouts))
    for positions in layouts:
        rings.append(Formation.from_positions(polish(polish(positions, wide), target), target))
        report("rings", len(rings), len(layouts))
    formations = rings + annealed(config, report)
    return distinct(formations, config.world.safe_distance, config.only_valid)


def annealed(config: OptimumConfig, on_progress: Callable[..., None] | None = None) -> list[Formation]:
    """Returns the formations that annealing alone finds, without rings as starting points.

    Args:
        config: The search.
        on_progress: See `search`.

    Returns:
        The polished ends of the best chains, as many as `config.polished`, with duplicates.
    """
    target, world = config.target, config.world
    if not config.polished:
        return []
    report = on_progress or (lambda *_: None)
    report("annealing, chains", 0, config.annealing.chains)
    chains = anneal(_score(target, config.only_valid), world, seed=config.seed, config=config.annealing)
    report("annealing, chains", config.annealing.chains, config.annealing.chains)
    best, formations = chains[: config.polished], []
    for positions in best:
        formations.append(Formation.from_positions(polish(positions, target), target))
        report("polishing", len(formations), len(best))
    return formations


def nested_rings(target: Target) -> Iterator[Float[np.ndarray, "robots 2"]]:
    """Yields rings with none to four robots inside, wide enough to be valid patterns.

    Rings have all places taken, or one empty: around a robot in the middle, all robots see each other on a ring with an
    odd number of places, but not on one with an even number.
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


def hop(config: OptimumConfig, on_progress: Callable[..., None] | None = None) -> Formation:
    """Returns the best formation that SciPy's basin hopping from the regular ring finds: a check of `search`.

    Each of `config.hops` rounds puts one robot elsewhere, displaces all a little, moves them apart until they are a
    valid pattern again, and polishes the result. Metropolis' rule decides whether it is accepted.

    Args:
        config: The search.
        on_progress: See `search`.
    """
    rounds = itertools.count()  # SciPy reports the polished start as well
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
        loss = (VALIDITY_WEIGHT if lost else 0.0) - target.value(polished)
        return OptimizeResult(x=polished.ravel(), fun=loss, success=True)

    solution = basinhopping(
        lambda flat: -target.value(flat.reshape(shape)),
        smallest_ring(world.robots, world.radius, world.safe_distance).positions.ravel(),
        niter=config.hops,
        T=0.01,
        callback=lambda *_: None if on_progress is None else on_progress("basin hopping", next(rounds), config.hops),
        take_step=displace,
        minimizer_kwargs={"method": descend},
        rng=rng,
    )
    return Formation.from_positions(solution.x.reshape(shape), target)


def distinct(formations: Sequence[Formation], unit: float, only_valid: bool = True) -> list[Formation]:
    """Returns formations, best first, without those nearer than `DUPLICATE_TOLERANCE` to a better one."""
    ordered = sorted(formations, key=lambda formation: (only_valid and not formation.valid, -formation.value))
    unique: list[Formation] = []
    for formation in ordered:
        near = (other.positions for other in unique if abs(other.value - formation.value) < DUPLICATE_TOLERANCE)
        distances = (similarity.distance(formation.positions, other, scaling=False) for other in near)
        if all(distance > DUPLICATE_TOLERANCE * unit for distance in distances):
            unique.append(formation)
    return unique


def _score(target: Target, only_valid: bool) -> Any:
    """Returns the score of annealing: the objective, or gathering with heavy penalties for what is not valid."""
    world = target.world
    if not only_valid:
        return target.score_batch_last
    weights = {"gathering": 1.0, "safety": VALIDITY_WEIGHT, "neighbors": 0.0, "visible": VALIDITY_WEIGHT}
    required = replace(target, weights=weights)

    def score(positions: Any) -> Any:
        # The distance beyond the scan radius, not the number of pairs: the signal itself has no slope.
        beyond = _batch_last.distances(positions) - world.scan_radius
        far = (beyond * (beyond > 0)).sum(axis=(0, 1)) / (world.safe_distance * world.robots)
        return required.score_batch_last(positions) - VALIDITY_WEIGHT * far

    return score


def _without_limits(target: Target) -> Target:
    """Returns the target in a world so large that neither its edge nor the scan radius limits anything."""
    far = {name: 10 * getattr(target.world, name) for name in ("scan_radius", "half_width", "half_height")}
    return replace(target, world=replace(target.world, **far))


def _apart(positions: Float[np.ndarray, "robots 2"], target: Target) -> Float[np.ndarray, "robots 2"]:
    """Returns the configuration scaled up until it is a valid pattern, or by a factor of 18 if it never is."""
    for _ in range(60):
        if target.is_valid(positions):
            break
        positions = 1.05 * positions
    return positions
