"""Local search from a good configuration to the nearest local optimum, under the exact constraints, in float64.

Visible pairs, neighbours and safe pairs are kept as inequalities. The rest of the objective is smooth: sequential
quadratic programming (SciPy's SLSQP) improves it inside a trust region. Every step is checked against all constraints,
also those that were far away when the step was computed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import minimize, nnls

from murmurate.analysis.optimum.formation import Target
from murmurate.geometry import _batch_last

__all__ = ["polish"]

Points = Float[np.ndarray, "robots 2"]
Slack = Float[np.ndarray, " constraints"]
Jacobian = Float[np.ndarray, "constraints coordinates"]

SAFE_TOLERANCE = 0.02
"""Pairs nearer than the safe distance by less than this share of it count as safe, and are moved apart to it."""

MARGIN = 1e-10
"""By how much every inequality must hold (lengths in safe distances, angles in radians), so that rounding cannot
break it."""

PENALTY = 10.0
"""Weight of violated constraints in the merit function; both terms are in safe distances. The penalty is exact for any
weight above all multipliers, which are about 1 over the number of robots."""

MAX_TRUST, MIN_TRUST, MAX_ROUNDS = 0.1, 1e-11, 200
"""Greatest move of a coordinate in one round, in safe distances; the least one, at which the search ends; and the
greatest number of rounds."""

SMOOTHING = (1e-2, 1e-4, 1e-6, 1e-9)
"""Lengths within which the distance to the origin is smoothed, in turn, in safe distances: robots often end at the
origin, where the distance has no gradient."""

MAX_REPAIR_STEPS = 20
"""Greatest number of steps back inside the constraints; two or three are enough unless they contradict each other."""

MIN_GAIN = 1e-14
"""The search ends when a round gains less than this, or than a coarser limit while the distance is smoothed."""


def polish(positions: Points, target: Target) -> Points:
    """Returns the local optimum of the objective nearest to a configuration.

    Args:
        positions: The configuration, world units; robots do not overlap.
        target: The objective, in its world.

    Returns:
        A configuration that is no worse: it has at least the same visible pairs, neighbours and safe pairs.
    """
    unit = target.world.safe_distance
    points = np.asarray(positions, float)
    problem = _Problem.from_target(points, target)
    for smoothing in SMOOTHING if target.gathering == "close" else SMOOTHING[-1:]:
        points = _minimise(points / unit, problem, smoothing) * unit
    points = _repair(points / unit, problem) * unit
    holds = problem.constraints(points / unit).slack(points / unit).min(initial=0) > -MARGIN
    return points if holds and target.value(points) >= target.value(positions) else np.asarray(positions, float)


@dataclass(frozen=True, eq=False)
class _Problem:
    """The constraints and the cost of one local search; lengths are in safe distances.

    Attributes:
        radius: The paper's R_bot.
        scan: The paper's R_scan.
        edge: X and Y of the world.
        centred: Whether the objective gathers at the origin.
        gathering: Weight of the mean distance to the origin, or of the mean distance of a pair.
        safety: Weight of the safety signal.
        shell: Whether the safety signal has the reading `shell`.
        safe: Which pairs are at least the safe distance apart.
        near: Which robots are neighbours.
        seen: Which robots (column) are visible from which (row).
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
        near, seen = _batch_last.neighbors_and_visible(points, world.radius, world.scan_radius)
        reach = math.hypot(world.half_width, world.half_height) / unit
        centred = target.gathering == "close"
        # The cost is in safe distances of gathering, so that the solver's numbers are near 1.
        weight = target.weight("gathering") or 1.0
        scale = reach * (1 if centred else 2) / weight
        return cls(
            radius=world.radius / unit,
            scan=world.scan_radius / unit,
            edge=world.bounds.astype(float) / unit,
            centred=centred,
            gathering=target.weight("gathering") / weight,
            safety=target.weight("safety") * scale,
            shell=world.safety == "shell",
            safe=_batch_last.distances(points) >= unit * (1 - SAFE_TOLERANCE),
            near=near,
            seen=seen,
        )

    def cost(self, points: Points, smoothing: float) -> tuple[float, Float[np.ndarray, " coordinates"]]:
        """Returns the cost, to be minimised, and its gradient."""
        robots = len(points)
        pairs = np.stack(np.triu_indices(robots, 1), axis=1)
        apart, slopes = _distances(points, pairs)
        if self.centred:
            far = np.sqrt(np.sum(points**2, axis=1) + smoothing**2)
            gathered, slope = far.mean(), (points / far[:, None]).ravel() / robots
        else:
            gathered, slope = apart.mean(), slopes.mean(axis=0)
        lost, lost_slope = self._unsafe(apart, self.safe[*pairs.T], robots)
        return (
            float(self.gathering * gathered + self.safety * lost.sum()),
            self.gathering * slope + self.safety * lost_slope @ slopes,
        )

    def _unsafe(self, apart: Any, safe: Any, robots: int) -> tuple[Any, Any]:
        """Returns what each pair costs in the safety signal, and the derivative of that by the pair's distance."""
        if self.shell:
            scale = -2 / (robots * (robots - 1) * math.sqrt(1 + self.radius))
            inside = np.where(safe, np.maximum(2 + self.radius - apart, 0), 0)
            return scale * np.sqrt(inside), -scale / 2 / np.sqrt(np.maximum(inside, 1e-12)) * (inside > 0)
        inside = np.where(safe, 0, np.maximum(1 - apart, 0))
        root = np.sqrt(inside)
        return 2 / robots * root, -1 / robots / np.maximum(root, 1e-6) * (inside > 0)

    def constraints(self, points: Points, within: float = math.inf) -> _Constraints:
        """Returns the inequalities that hold by less than `within`."""
        robots = len(points)
        apart = _batch_last.distances(points)
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
        least: The least distance of each of them.
        together: Pairs that remain neighbours.
        most: Greatest distance of neighbours.
        sight: Triples of an observer, a nearer robot, and a robot that the observer sees beside it.
        radius: The paper's R_bot.
    """

    apart: Int[np.ndarray, "pairs 2"]
    least: Float[np.ndarray, " pairs"]
    together: Int[np.ndarray, "pairs 2"]
    most: float
    sight: Int[np.ndarray, "triples 3"]
    radius: float

    def slack(self, points: Points) -> Slack:
        """Returns all slacks."""
        return self.linearized(points, slopes=False)[0]

    def linearized(self, points: Points, slopes: bool = True) -> tuple[Slack, Jacobian | Any]:
        """Returns all slacks and their Jacobian; without slopes the latter is None."""
        apart, apart_slopes = _distances(points, self.apart)
        together, together_slopes = _distances(points, self.together)
        gaps, gap_slopes = _gaps(points, self.sight, self.radius, slopes)
        slack = np.concatenate([apart - self.least, self.most - together, gaps - MARGIN])
        return slack, np.concatenate([apart_slopes, -together_slopes, gap_slopes]) if slopes else None


def _minimise(points: Points, problem: _Problem, smoothing: float) -> Points:
    """Minimises the cost in rounds, each inside a trust region and under the constraints near it."""
    shape, trust, least = points.shape, MAX_TRUST, max(MIN_TRUST, (smoothing - SMOOTHING[-1]) * 1e-2)

    def merit(candidate: Points) -> float:
        slack = problem.constraints(candidate).slack(candidate)
        return problem.cost(candidate, smoothing)[0] + PENALTY * float(np.maximum(-slack, 0).sum())

    value = merit(points)
    for _ in range(MAX_ROUNDS):
        active = problem.constraints(points, within=8 * trust)
        flat = points.ravel()
        # A robot outside the world may stay there, but moves no farther out.
        edge = np.maximum(np.broadcast_to(problem.edge, shape).ravel(), np.abs(flat))
        solution = minimize(
            lambda x: problem.cost(x.reshape(shape), smoothing),
            flat,
            jac=True,
            method="SLSQP",
            bounds=np.stack([np.maximum(flat - trust, -edge), np.minimum(flat + trust, edge)], axis=1),
            constraints={
                "type": "ineq",
                "fun": lambda x, active=active: active.slack(x.reshape(shape)),
                "jac": lambda x, active=active: active.linearized(x.reshape(shape))[1],
            }
            if len(active.apart) + len(active.together) + len(active.sight)
            else (),
            options={"maxiter": 60, "ftol": 1e-15},
        )
        candidate = solution.x.reshape(shape)
        gained = value - merit(candidate) if np.isfinite(candidate).all() else -math.inf
        if gained > 0:
            points, value = candidate, value - gained
            trust = min(2 * trust, MAX_TRUST)
        else:
            trust /= 4
        stationary = solution.status == 0 and solution.nit <= 1
        if stationary or trust < least or 0 < gained < max(MIN_GAIN, (smoothing - SMOOTHING[-1]) * 1e-3):
            break
    return points


def _repair(points: Points, problem: _Problem) -> Points:
    """Returns the nearest points inside the constraints: where many meet, the search can end slightly outside.

    Each step is the shortest that meets all constraints to first order: a least-distance problem, solved as one of
    nonnegative least squares (Lawson and Hanson, Solving Least Squares Problems, chapter 23).
    """
    for _ in range(MAX_REPAIR_STEPS):
        slack, slopes = problem.constraints(points, within=MAX_TRUST).linearized(points)
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
    legs = [points[robot] - points[observer] for robot in (first, second)]
    apart = [np.maximum(np.hypot(*leg.T), radius * (1 + 1e-9)) for leg in legs]
    cross, dot = legs[0][:, 0] * legs[1][:, 1] - legs[0][:, 1] * legs[1][:, 0], np.sum(legs[0] * legs[1], axis=1)
    gaps = np.arctan2(np.abs(cross), dot) - np.arcsin(radius / apart[0]) - np.arcsin(radius / apart[1])
    jacobian = np.zeros((len(triples), *points.shape))
    if slopes:
        row, side = np.arange(len(triples)), np.where(cross >= 0, 1.0, -1.0)
        for leg, far, robot, sign in zip(legs, apart, (first, second), (-side, side), strict=True):
            turning = np.stack([-leg[:, 1], leg[:, 0]], axis=1) * (sign / far**2)[:, None]
            shrinking = leg * (radius / (far**2 * np.sqrt(far**2 - radius**2)))[:, None]
            slope = turning + shrinking
            jacobian[row, robot] += slope
            jacobian[row, observer] -= slope
    return gaps, jacobian.reshape(len(triples), points.size)
