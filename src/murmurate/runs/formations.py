"""What a run's policy remembers: its distinct formations, and the same run with another formation to form."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from murmurate.analysis import Catalogue, Finding, PatternClass
from murmurate.analysis.optimum.best_known import best_known
from murmurate.analysis.optimum.formation import Target
from murmurate.discovery import build_cascade
from murmurate.discovery.validity import bound_steps, check_validity, is_valid_pattern, replaced_conditions
from murmurate.errors import BeyondTrainingWarning, InputError, RunError
from murmurate.geometry import distances
from murmurate.geometry.similarity import configuration, distance
from murmurate.policies.formation import FormationNetwork
from murmurate.representation import short_repr
from murmurate.runs.catalogues import read_findings
from murmurate.runs.table import gap
from murmurate.types import Trajectories
from murmurate.world import Configuration, Objective, WorldConfig, read_starts

if TYPE_CHECKING:
    from murmurate.runs.run import Run

__all__ = [
    "FORMED",
    "FORMED_HEADER",
    "Formed",
    "form_each",
    "forming",
    "pattern",
    "reached",
    "read_target",
    "remembered",
]

FORMED = 0.1
"""Root mean square distance in radii within which a formation counts as formed."""


def remembered(run: Run) -> Catalogue:
    """Returns the valid patterns among the formations that a run's last policy remembers, sorted into classes.

    Raises:
        InputError: The policy remembers no formations.
        RunError: None of them is a valid pattern.
    """
    config, world = run.experiment, run.experiment.world
    formations = np.moveaxis(np.asarray(_network(run).goals(), float), -1, 0)
    valid = is_valid_pattern(formations, world, config.thresholds)
    if not valid.any():
        raise RunError(f"{run.folder}: none of the {len(valid)} formations of its policy is a valid pattern")
    objective = Objective(config.objective_signals)
    values = objective(objective.measure(Configuration(np.moveaxis(formations, 0, -1), world)))
    # Only for the paper's objectives, with its own weights, best-known patterns are kept.
    known = best_known(Target(world, config.objective)) if config.has_paper_objective else None
    findings = [
        Finding(
            positions=formations[index],
            radius=world.radius,
            safe_distance=world.safe_distance,
            scan_radius=world.scan_radius,
            objective=config.objective if config.has_paper_objective else "custom",
            value=float(values[index]),
            gap=None if known is None else known - float(values[index]),
            experiment=config.name,
            policy=config.policy.name,
            start="remembered",
            seed=config.seed,
            run=hashlib.sha256(formations.tobytes()).hexdigest()[:16],
            episode=int(index),
        )
        for index in np.flatnonzero(valid)
    ]
    return Catalogue.from_findings(findings)


def pattern(run: Run, number: Any) -> Float[np.ndarray, "robots 2"]:
    """Returns the best formation of a class of those that a run's policy remembers, world units.

    Args:
        run: The run.
        number: 1 for the best class, as `murmurate catalogue --remembered` numbers them.

    Raises:
        InputError: There is no such class, or the policy remembers no formations.
        RunError: None of them is a valid pattern.
    """
    return _numbered(remembered(run).classes, number, "the policy remembers").representative.positions


def forming(run: Run, formation: Any) -> Run:
    """Returns the run with a policy that forms another formation: one that it remembers, or any other.

    Args:
        run: A run whose last policy remembers formations.
        formation: The number of a class (see `pattern`), or the places of all robots, world units; around the gathering
            point where it is known. With more or fewer robots than the run's, the swarm has as many.

    Raises:
        InputError: There is no such class; robots would overlap, be nearer than the safe distance or outside the world;
            the start is of another size; or the policy remembers no formations.
    """
    network = _network(run)
    places = pattern(run, formation) if np.ndim(formation) == 0 else configuration(formation)
    run = _of_size(run, len(places))
    world = run.experiment.world
    if network.freedom == "moved":
        places = places - places.mean(axis=0)
    apart = distances(places)[~np.eye(len(places), dtype=bool)]
    # A least value of safety in a valid pattern stands in place of the safe distance.
    is_safe = "safe" not in replaced_conditions(run.experiment.thresholds)
    name, least = ("safe_distance", world.safe_distance) if is_safe else ("2 * radius", 2 * world.radius)
    if apart.size and apart.min() < least:
        raise InputError("formation", f"two robots {apart.min():.6g} apart", f"at least {name} = {least:g}")
    if network.freedom == "fixed":
        reach, allowed = np.abs(places), "inside the world"
    else:
        reach, allowed = np.linalg.norm(places, axis=1), "inside the world however it is turned"
    reach, side = reach.max() + world.radius, world.limits.min()
    if world.bounded and reach > side:
        raise InputError(
            "formation", f"one that reaches {reach:.6g} from its centre", f"at most {side:g}, so that it is {allowed}"
        )
    other = network.with_first(jnp.asarray(places, jnp.float32)).of_size(len(places))
    # What a folder of this run holds: the formations of one size, and of a size that was not trained this one alone.
    policy = replace(run.experiment.policy, formations=len(other.places))
    experiment = replace(run.experiment, sizes=(), policy=policy)
    return replace(run, experiment=experiment, cascade=build_cascade(experiment, (*run.cascade.policies[:-1], other)))


def _of_size(run: Run, robots: int) -> Run:
    """Returns a run for swarms of a size, for which its policy need not remember any formation.

    Warns of a size beyond those that the policies were trained among.
    """
    experiment = run.experiment
    trained = experiment.sizes or (experiment.world.robots,)
    if robots == experiment.world.robots:
        return run
    if not experiment.start.fits_any_size():
        allowed = f"of {experiment.world.robots}, as the start has"
        raise InputError("formation", f"{robots} robots", allowed)
    if not min(trained) <= robots <= max(trained):
        sizes = " to ".join(map(str, sorted({min(trained), max(trained)})))
        text = f"a formation of {robots} robots: trained were swarms of {sizes}"
        warnings.warn(f"{text}; others may do worse", BeyondTrainingWarning, stacklevel=4)
    return replace(run, experiment=experiment.of_size(robots))


@dataclass(frozen=True)
class Formed:
    """How a run forms one pattern.

    Attributes:
        pattern: The class of the pattern.
        episodes: How many starts there were.
        formed: In how many of them the swarm came to rest within `FORMED` radii of it, as a root mean square.
        valid: In how many of them it formed a valid pattern.
        failed: In how many of them there was a contact or an exit.
        steps: Formation steps, mean.
        bound: The kinematic bound, mean.
    """

    pattern: PatternClass
    episodes: int
    formed: int
    valid: int
    failed: int
    steps: float
    bound: float

    __repr__ = short_repr

    def row(self) -> tuple[str, ...]:
        """Returns the texts of a table's row, under `FORMED_HEADER`."""
        pattern = self.pattern
        known = None if pattern.gap is None else pattern.gap + pattern.value
        return (
            *(pattern.name, pattern.symmetry.name, "+".join(map(str, pattern.layers)), f"{pattern.value:.4f}"),
            *(gap({"gap": pattern.gap, "best_known": known}), str(self.episodes), str(self.formed), str(self.valid)),
            *(str(self.failed), f"{self.steps:.1f}", f"{self.bound:.1f}"),
        )


FORMED_HEADER = (
    *("pattern", "symmetry", "layers", "objective", "gap", "starts", "formed", "valid", "failed", "steps", "bound"),
)


def form_each(
    run: Run,
    patterns: Sequence[PatternClass],
    episodes: int = 50,
    key: int = 0,
    on_progress: Callable[..., None] | None = None,
) -> list[Formed]:
    """Lets swarms form patterns, each from the same fresh starts.

    Args:
        run: A run whose last policy remembers formations: these patterns, or others.
        patterns: Of each, the swarms form the representative.
        episodes: Starts for each.
        key: Seed of the starts.
        on_progress: Called as `on_progress(work, done, total)` before and after each pattern.

    Raises:
        InputError: A pattern does not fit the swarm and its world, or the policy remembers no formations.
    """
    results, world = [], run.experiment.world
    for done, pattern in enumerate(patterns):
        if on_progress is not None:
            on_progress("patterns formed", done, len(patterns))
        other = forming(run, pattern.representative.positions)
        trajectories = other.rollout(episodes, key)
        validity = check_validity(trajectories, world, run.experiment.thresholds)
        pairs = zip(trajectories.positions[:, 0], trajectories.final, strict=True)
        results.append(
            Formed(
                pattern=pattern,
                episodes=episodes,
                formed=int(reached(other, trajectories).sum()),
                valid=int(validity.valid.sum()),
                failed=int((~(validity.contact_free & validity.inside)).sum()),
                steps=float(trajectories.lengths.mean()),
                bound=float(np.mean([bound_steps(start, final, world.max_speed) for start, final in pairs])),
            )
        )
    if on_progress is not None:
        on_progress("patterns formed", len(patterns), len(patterns))
    return results


def reached(run: Run, trajectories: Trajectories) -> Bool[np.ndarray, " episodes"]:
    """Returns which swarms came to rest within `FORMED` radii of what a run's policy forms, as a root mean square.

    The distance is that of the best superposition: moved, turned and relabelled, but neither scaled nor mirrored.

    Args:
        run: A run whose last policy remembers formations.
        trajectories: Its episodes.

    Raises:
        InputError: The policy remembers no formations.
    """
    formed = np.asarray(_network(run).goals(), float)[..., 0]
    ends = np.asarray(trajectories.final, float)
    apart = np.array([distance(points, formed, scaling=False, reflection=False) for points in ends])
    return trajectories.at_rest & (apart <= FORMED * run.experiment.world.radius)


def read_target(path: str | Path, world: WorldConfig, number: int | None = None) -> Float[np.ndarray, "robots 2"]:
    """Reads a formation: a table start,x,y as files of starts have it, with one start, or a pattern of a catalogue.

    Args:
        path: The table, or the folder of a catalogue.
        world: The world that it is for: a catalogue's patterns are scaled to robots as large.
        number: Which class of the catalogue, 1 for the best, which it is without a number.

    Raises:
        InputError: The table is unreadable, or is of several starts; a table is given a number, or the catalogue has no
            such class.
        RunError: There is no catalogue in a folder, or it is damaged.
    """
    if Path(path).is_dir():
        findings = Catalogue.from_findings(read_findings(path)).classes
        best = _numbered(findings, 1 if number is None else number, f"{path} has").representative
        return best.positions * (world.radius / best.radius)
    if number is not None:
        raise InputError("pattern", number, f"left out: {path} has one formation, and only a catalogue has several")
    formations = read_starts(path, None)
    if len(formations) != 1:
        raise InputError(str(path), f"{len(formations)} starts", "one start, which is the formation")
    return formations[0]


def _numbered(classes: Sequence[PatternClass], number: Any, owner: str) -> PatternClass:
    """Returns the class of a number, from 1."""
    if isinstance(number, bool) or not isinstance(number, int | np.integer) or not 1 <= number <= len(classes):
        raise InputError("pattern", number, f"a number from 1 to {len(classes)}: {owner} so many distinct patterns")
    return classes[number - 1]


def _network(run: Run) -> FormationNetwork:
    network = run.cascade.policies[-1]
    if not isinstance(network, FormationNetwork):
        allowed = f"formation: {run.experiment.policy.name} remembers no formations"
        raise InputError("policy.use", run.experiment.policy.name, allowed)
    return network
