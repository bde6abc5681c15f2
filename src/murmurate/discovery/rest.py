"""When a swarm is at rest, and when a policy of the list ends: one rule, for cascades and for what is exported."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Num

from murmurate.errors import MAX_INTEGER, MAX_MAGNITUDE, InputError, check_number

__all__ = ["RestLimits", "RestRule", "all_still", "has_ended"]


@dataclass(frozen=True)
class RestRule:
    """When a policy has brought the swarm to rest, and what robots do for it.

    The robots of the last policy stop without being told. A policy that another one follows hands over as
    soon as the objective changes no more, which only somebody who looks at the whole swarm can know.

    Attributes:
        window: Steps for which robots must be still, and over which the mean change of the objective is taken.
        stillness: A robot is still in a step in which it moves no farther than so many radii (the last policy).
        switch_tolerance: A policy that another one follows ends where the mean |change of the objective| is below this,
            with the signals' own weights: it need not settle what the next one moves again.
        dead_zone: A robot that wants to move slower than this share of the speed limit stands still, in training as in
            execution.
        damping: Share that the shortest moves lose, so that robots do not overshoot; none from half of the speed limit
            on.
        sidestep: Share of the speed limit at which a robot that would stand still between two others that it sees,
            occluding one from the other, steps aside instead, off the line and away from walls; 0: it stands still.
            With it, a robot that would stand still nearer to another one than the safe distance moves away, too.
        max_steps: Steps after which a policy that does not come to rest is cut off.
    """

    window: int = 5
    stillness: float = 1e-3
    switch_tolerance: float = 1.5e-3
    dead_zone: float = 0.1
    damping: float = 0.0
    sidestep: float = 0.0
    max_steps: int = 300

    def __post_init__(self) -> None:
        for name in ("window", "max_steps"):
            check_number(name, getattr(self, name), 1, MAX_INTEGER, integer=True)
        check_number("stillness", self.stillness, 0, MAX_MAGNITUDE)
        check_number("switch_tolerance", self.switch_tolerance, 0, MAX_MAGNITUDE, exclusive_low=True)
        check_number("dead_zone", self.dead_zone)
        if not 0 <= self.dead_zone < 1:
            allowed = "a number >= 0 and less than 1: at 1 no robot would ever move along an axis"
            raise InputError("dead_zone", self.dead_zone, allowed)
        check_number("damping", self.damping)
        if not 0 <= self.damping < 1:
            raise InputError("damping", self.damping, "a number >= 0 and less than 1")
        if self.damping and not self.dead_zone:
            raise InputError("damping", self.damping, "0 where dead_zone is 0: robots would creep and never stop")
        check_number("sidestep", self.sidestep, 0, 1)
        if self.sidestep and not 0 < self.dead_zone <= self.sidestep:
            allowed = f"0, or at least dead_zone ({self.dead_zone:g}), which must not be 0: no robot would stand still"
            raise InputError("sidestep", self.sidestep, allowed)


class RestLimits(NamedTuple):
    """The numbers of a `RestRule` that decide when a policy ends; they may be traced.

    Attributes:
        window: See `RestRule`.
        switch_tolerance: See `RestRule`.
        max_steps: See `RestRule`.
    """

    window: Any
    switch_tolerance: Any
    max_steps: Any

    @classmethod
    def from_rule(cls, rule: RestRule) -> RestLimits:
        """Returns the limits of a rule."""
        return cls(rule.window, rule.switch_tolerance, rule.max_steps)


def all_still(moves: Float[Array, "robots 2 batch"], stillness: Any, radius: Any) -> Bool[Array, " batch"]:
    """Returns in which episodes every robot is still.

    Args:
        moves: How far each robot moves in a step, world units.
        stillness: A robot is still that moves no farther than so many radii.
        radius: The paper's R_bot.
    """
    return jnp.all(jnp.sum(moves**2, axis=1) <= (stillness * radius) ** 2, axis=0)


def has_ended(
    is_last: Bool[Array, " batch"],
    still_steps: Num[Array, " batch"],
    mean_change: Float[Array, " batch"],
    steps_active: Num[Array, " batch"],
    limits: RestLimits,
) -> tuple[Bool[Array, " batch"], Bool[Array, " batch"]]:
    """Returns in which episodes the active policy has brought the swarm to rest, and in which it ends.

    Robots of the last policy stop without being told. The others end by what only the whole swarm shows.

    Args:
        is_last: Whether the active policy is the last one.
        still_steps: Steps in a row in which every robot was still.
        mean_change: Mean |change of the objective| over the last `window` steps; ignored until the policy has acted for
            so many.
        steps_active: Steps for which the policy has acted.
        limits: The limits of the rule.

    Returns:
        Whether the swarm is at rest, and whether the policy ends: at rest, or cut off.
    """
    unchanged = (steps_active >= limits.window) & (mean_change < limits.switch_tolerance)
    at_rest = (is_last & (still_steps >= limits.window)) | (~is_last & unchanged)
    return at_rest, at_rest | (steps_active >= limits.max_steps)
