"""Makes a good configuration exact: a local search under the constraints themselves, in float64.

Whom everybody sees, who neighbours whom and which pairs are safe is kept as it is, as inequalities. What is left of the
objective is smooth: it is improved by sequential quadratic programming (SciPy's SLSQP) inside a trust region, and every
step is checked against all constraints, also those that were far away when it was computed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import minimize, nnls

from murmurate.analysis.optimum.formation import Target
from murmurate.geometry import distances, neighbors_and_visible

__all__ = ["polish"]

Points = Float[np.ndarray, "robots 2"]
Slack = Float[np.ndarray, " constraints"]
Jacobian = Float[np.ndarray, "constraints coordinates"]

LOOSE = 0.02
"""A pair that is nearer than the safe distance by less than this share of it is pushed out to it."""

MARGIN = 1e-10
"""How far inside every inequality the result lies (lengths in safe distances, angles in radians), so that rounding
cannot break it."""

PENALTY = 10.0
"""Weight of broken constraints against the objective; both in safe distances. Exact for any weight above all
multipliers, which are about 1 over the number of robots."""

MAX_TRUST, MIN_TRUST, MAX_ROUNDS = 0.1, 1e-11, 200
"""How far a coordinate moves in one round, in safe distances: at first, and when the search ends."""

ROUNDED = (1e-2, 1e-4, 1e-6, 1e-9)
"""The distance to the origin has no gradient there, where a robot often ends: rounded off within these, in turn."""

MAX_REPAIR_STEPS = 20
"""Steps back inside the constraints; two or three are enough unless they contradict each other."""

GAIN = 1e-14
"""The search ends when a round gains less; while the objective is still rounded off, it need not be as exact."""


def polish(positions: Points, target: Target) -> Points:
    """Climbs from a configuration to the nearest local optimum of the objective.

    Args:
        positions: Where to begin, world units; robots do not overlap.
        target: What is sought.

    Returns:
        A configuration that is no worse: it has the same visible pairs, neighbours and safe pairs, or more.
    """
    unit = target.world.safe_distance
    points = np.asarray(positions, float)
    problem = _Problem.from_target(points, target)
    for rounded in ROUNDED if target.gathering == "close" else ROUNDED[-1:]:
        points = _climb(points / unit, problem, rounded) * unit
    points = _repaired(points / unit, problem) * unit
    kept = problem.constraints(points / unit).slack(points / unit, slopes=False)[0].min(initial=0) > -MARGIN
    return points if kept and target.value(points) >= target.value(positions) else np.asarray(positions, float)


@dataclass(frozen=True, eq=False)
class _Problem:
    """What is to be kept, and what is to be improved. Lengths are in safe distances from here on.

    Attributes:
        radius: The paper's R_bot.
        scan: The paper's R_scan.
        edge: X and Y of the world.
        centred: Whether gathering is at the origin.
        gathering: Weight of gathering: of the mean distance to the origin, or of the mean distance of a pair.
        safety: Weight of safety, and its reading.
        safe: Pairs at least the safe distance apart.
        near: Neighbours.
        seen: Observer (row) sees observed (column).
    """

    radius: float
    scan: float
    edge: Float[np.ndarray, " 2"]
    centred: bool
    gathering: float
    safety: float
    shell: bool
    safe: Bool[np.ndarray, "robots robots"]
    near: Bool[np.ndarray, "robots robots"]
    seen: Bool[np.ndarray, "robots robots"]

    @classmethod
    def from_target(cls, points: Points, target: Target) -> _Problem:
        world, unit = target.world, target.world.safe_distance
        near, seen = neighbors_and_visible(points, world.radius, world.scan_radius)
        reach = math.hypot(world.half_width, world.half_height) / unit
        centred = target.gathering == "close"
        # Everything is measured in mean safe distances of gathering, so that the solver's numbers are near 1.
        weight = target.weight("gathering") or 1.0
        scale = reach * (1 if centred else 2) / weight
        return cls(
            radius=world.radius / unit,
            scan=world.scan_radius / unit,
            edge=np.array([world.half_width, world.half_height]) / unit,
            centred=centred,
            gathering=target.weight("gathering") / weight,
            safety=target.weight("safety") * scale,
            shell=world.safety == "shell",
            safe=distances(points) >= unit * (1 - LOOSE),
            near=near,
            seen=seen,
        )

    def cost(self, points: Points, rounded: float) -> tuple[float, Float[np.ndarray, " coordinates"]]:
        """Returns what is to be made small, and its gradient."""
        robots = len(points)
        pairs = np.stack(np.triu_indices(robots, 1), axis=1)
        apart, slopes = _distances(points, pairs)
        if self.centred:
            far = np.sqrt(np.sum(points**2, axis=1) + rounded**2)
            gathered, slope = far.mean(), (points / far[:, None]).ravel() / robots
        else:
            gathered, slope = apart.mean(), slopes.mean(axis=0)
        lost, lost_slope = self._unsafe(apart, self.safe[*pairs.T], robots)
        return (
            float(self.gathering * gathered + self.safety * lost.sum()),
            self.gathering * slope + self.safety * lost_slope @ slopes,
        )

    def _unsafe(self, apart: Any, safe: Any, robots: int) -> tuple[Any, Any]:
        """Returns what each pair takes from the safety signal, and the slope of that in the pair's distance."""
        if self.shell:
            scale = -2 / (robots * (robots - 1) * math.sqrt(1 + self.radius))
            inside = np.where(safe, np.maximum(2 + self.radius - apart, 0), 0)
            return scale * np.sqrt(inside), -scale / 2 / np.sqrt(np.maximum(inside, 1e-12)) * (inside > 0)
        inside = np.where(safe, 0, np.maximum(1 - apart, 0))
        root = np.sqrt(inside)
        return 2 / robots * root, -1 / robots / np.maximum(root, 1e-6) * (inside > 0)

    def constraints(self, points: Points, within: float = math.inf) -> _Constraints:
        """Collects the inequalities that hold by less than `within`."""
        robots = len(points)
        apart = distances(points)
        pairs = np.stack(np.triu_indices(robots, 1), axis=1)
        between, safe = apart[*pairs.T], self.safe[*pairs.T]
        least = np.where(safe, 1.0, 2 * self.radius) + MARGIN
        k, j, i = np.indices((robots,) * 3).reshape(3, -1)
        hides = (k != j) & (j != i) & (k != i) & self.seen[k, i] & (apart[k, j] < apart[k, i])
        sight = np.stack([k, j, i], axis=1)[hides]
        close = between < least + within
        return _Constraints(
            apart=pairs[close],
            least=least[close],
            together=pairs[self.near[*pairs.T] & (between > self.scan - within)],
            most=self.scan - MARGIN,
            sight=sight[_gaps(points, sight, self.radius, slopes=False)[0] < within],
            radius=self.radius,
        )


class _Constraints(NamedTuple):
    """Inequalities: each is a slack that must not be negative.

    Attributes:
        apart: Pairs with a least distance.
        least: That distance.
        together: Pairs that remain neighbours.
        most: The greatest distance of neighbours.
        sight: Observer, a nearer robot, and whom the observer sees beside it.
        radius: The paper's R_bot.
    """

    apart: Int[np.ndarray, "pairs 2"]
    least: Float[np.ndarray, " pairs"]
    together: Int[np.ndarray, "pairs 2"]
    most: float
    sight: Int[np.ndarray, "triples 3"]
    radius: float

    def slack(self, points: Points, slopes: bool = True) -> tuple[Slack, Jacobian]:
        """Returns all slacks and their Jacobian."""
        apart, apart_slopes = _distances(points, self.apart)
        together, together_slopes = _distances(points, self.together)
        gaps, gap_slopes = _gaps(points, self.sight, self.radius, slopes)
        slack = np.concatenate([apart - self.least, self.most - together, gaps - MARGIN])
        return slack, np.concatenate([apart_slopes, -together_slopes, gap_slopes]) if slopes else gap_slopes


def _climb(points: Points, problem: _Problem, rounded: float) -> Points:
    """Goes downhill in rounds, each inside a trust region and with the constraints near it."""
    shape, trust, least = points.shape, MAX_TRUST, max(MIN_TRUST, (rounded - ROUNDED[-1]) * 1e-2)

    def merit(candidate: Points) -> float:
        slack, _ = problem.constraints(candidate).slack(candidate, slopes=False)
        return problem.cost(candidate, rounded)[0] + PENALTY * float(np.maximum(-slack, 0).sum())

    value = merit(points)
    for _ in range(MAX_ROUNDS):
        kept = problem.constraints(points, within=8 * trust)
        flat = points.ravel()
        # Whoever is outside the world may stay there, but goes no farther.
        edge = np.maximum(np.broadcast_to(problem.edge, shape).ravel(), np.abs(flat))
        found = minimize(
            lambda x: problem.cost(x.reshape(shape), rounded),
            flat,
            jac=True,
            method="SLSQP",
            bounds=np.stack([np.maximum(flat - trust, -edge), np.minimum(flat + trust, edge)], axis=1),
            constraints={
                "type": "ineq",
                "fun": lambda x, kept=kept: kept.slack(x.reshape(shape), slopes=False)[0],
                "jac": lambda x, kept=kept: kept.slack(x.reshape(shape))[1],
            }
            if len(kept.apart) + len(kept.together) + len(kept.sight)
            else (),
            options={"maxiter": 60, "ftol": 1e-15},
        )
        candidate = found.x.reshape(shape)
        gained = value - merit(candidate) if np.isfinite(candidate).all() else -math.inf
        if gained > 0:
            points, value = candidate, value - gained
            trust = min(2 * trust, MAX_TRUST)
        else:
            trust /= 4
        stationary = found.status == 0 and found.nit <= 1
        if stationary or trust < least or 0 < gained < max(GAIN, (rounded - ROUNDED[-1]) * 1e-3):
            break
    return points


def _repaired(points: Points, problem: _Problem) -> Points:
    """Steps back inside the constraints, as near as can be: where many meet, a climb can end outside by a little.

    Each step is the shortest that meets all constraints to first order: a least-distance problem, solved as one of
    nonnegative least squares (Lawson and Hanson, Solving Least Squares Problems, chapter 23).
    """
    for _ in range(MAX_REPAIR_STEPS):
        slack, slopes = problem.constraints(points, within=MAX_TRUST).slack(points)
        if slack.min(initial=0) > -MARGIN / 2:
            break
        system = np.concatenate([slopes.T, -slack[None]])
        wanted = np.zeros(len(system))
        wanted[-1] = 1
        left = system @ nnls(system, wanted)[0] - wanted
        if left[-1] == 0:
            break
        points = points - (left[:-1] / left[-1]).reshape(points.shape)
    return points


def _distances(points: Points, pairs: Int[np.ndarray, "pairs 2"]) -> tuple[Slack, Jacobian]:
    """Returns the distances of pairs and their gradients."""
    between = points[pairs[:, 0]] - points[pairs[:, 1]]
    apart = np.hypot(*between.T)
    slopes = np.zeros((len(pairs), *points.shape))
    row, along = np.arange(len(pairs)), between / np.maximum(apart, 1e-12)[:, None]
    slopes[row, pairs[:, 0]], slopes[row, pairs[:, 1]] = along, -along
    return apart, slopes.reshape(len(pairs), points.size)


def _gaps(points: Points, triples: Int[np.ndarray, "triples 3"], radius: float, slopes: bool) -> tuple[Slack, Jacobian]:
    """Returns the angles that each observer sees between the edges of two robots, and their gradients, radians."""
    observer, first, second = triples.T
    legs = [points[one] - points[observer] for one in (first, second)]
    apart = [np.maximum(np.hypot(*leg.T), radius * (1 + 1e-9)) for leg in legs]
    cross, dot = legs[0][:, 0] * legs[1][:, 1] - legs[0][:, 1] * legs[1][:, 0], np.sum(legs[0] * legs[1], axis=1)
    gaps = np.arctan2(np.abs(cross), dot) - np.arcsin(radius / apart[0]) - np.arcsin(radius / apart[1])
    jacobian = np.zeros((len(triples), *points.shape))
    if slopes:
        row, side = np.arange(len(triples)), np.where(cross >= 0, 1.0, -1.0)
        for leg, far, one, sign in zip(legs, apart, (first, second), (-side, side), strict=True):
            turning = np.stack([-leg[:, 1], leg[:, 0]], axis=1) * (sign / far**2)[:, None]
            shrinking = leg * (radius / (far**2 * np.sqrt(far**2 - radius**2)))[:, None]
            slope = turning + shrinking
            jacobian[row, one] += slope
            jacobian[row, observer] -= slope
    return gaps, jacobian.reshape(len(triples), points.size)
