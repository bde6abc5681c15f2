"""What proximal policy optimisation estimates, in plain loops over one trajectory, from the definitions."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp

Numbers = Sequence[float]
Flags = Sequence[bool]


def generalized_advantage(
    reward: Numbers,
    value: Numbers,
    next_value: Numbers,
    terminated: Flags,
    truncated: Flags,
    discount: float,
    gae_lambda: float,
) -> list[float]:
    """The exponentially weighted mean of all n-step advantages that the trajectory allows, written out.

    A_n = r_0 + .. + discount^(n-1) r_(n-1) + discount^n V(after) - V(now), where nothing follows termination.
    """
    advantages = []
    for start in range(len(reward)):
        estimates, returned = [], 0.0
        for step in range(start, len(reward)):
            returned += discount ** (step - start) * reward[step]
            bootstrap = 0.0 if terminated[step] else next_value[step]
            estimates.append(returned + discount ** (step - start + 1) * bootstrap - value[start])
            if terminated[step] or truncated[step]:
                break
        weights = [(1 - gae_lambda) * gae_lambda**n for n in range(len(estimates) - 1)]
        weights.append(gae_lambda ** (len(estimates) - 1))
        advantages.append(sum(w * a for w, a in zip(weights, estimates, strict=True)))
    return advantages


def rewards_to_go(reward: Numbers, next_value: Numbers, terminated: Flags, truncated: Flags) -> list[float]:
    """The undiscounted rewards to the episode's end; where it is cut off, plus the value of what would follow."""
    sums = []
    for start in range(len(reward)):
        total = 0.0
        for step in range(start, len(reward)):
            total += reward[step]
            if terminated[step]:
                break
            if truncated[step] or step == len(reward) - 1:
                total += next_value[step]
                break
        sums.append(total)
    return sums


def clipped_objective(
    log_prob: Sequence[Numbers], old_log_prob: Sequence[Numbers], advantage: Numbers, clip: float
) -> float:
    """The mean over steps, and over each step's actions, of min(ratio A, clipped ratio A)."""
    terms = []
    for now, before, a in zip(log_prob, old_log_prob, advantage, strict=True):
        for n, b in zip(now, before, strict=True):
            ratio = exp(n - b)
            terms.append(min(ratio * a, min(max(ratio, 1 - clip), 1 + clip) * a))
    return sum(terms) / len(terms)
