"""What fits in memory and time, said before anything is computed.

A configuration may ask for any number of robots, worlds and steps: one from a stranger, or one with a slip of the
finger. Whatever holds a number for each pair of robots, or each step of an episode, is bounded here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from murmurate import prng
from murmurate.discovery.build import build_networks
from murmurate.discovery.cascade import MAX_RECORD_BYTES, Cascade
from murmurate.discovery.problem import Problem
from murmurate.discovery.rest import RestRule
from murmurate.discovery.stage import policy_name
from murmurate.errors import InputError, RunError, check_type
from murmurate.types import Trajectories
from murmurate.world import check_pairs, checked_starts, episodes_at_once

__all__ = ["MAX_RECORD_BYTES", "MAX_REST_STEPS", "check_training", "rollout"]

MAX_REST_STEPS = 10_000_000
"""Steps after which a policy is cut off, at most: several times as many as a swarm of 1,000 robots has."""

MAX_STORED_PAIRS = 1 << 30
"""Pairs of robots in all steps between two updates, at most: what each robot sees of each other takes some GiB."""


MAX_WEIGHTS = 1 << 27
"""Weights of the networks, at most: Adam's two moments and the gradients besides, in float32, take 2 GiB."""

MAX_WINDOW_BYTES = 1 << 30
"""Memory of the changes of the objective that decide about rest, at most."""


def check_training(problem: Problem) -> None:
    """Checks that a training fits in memory: all of its worlds at once, and the steps between two updates.

    Raises:
        InputError: It does not; the message names the field.
    """
    robots = problem.world.robots
    for index in range(min(2, problem.discovery.max_policies)):
        stage = problem.stage(index)
        for phase, learner in enumerate(stage.learners):
            numbers, name = stage.learning(phase), f"{policy_name(index)}.{learner}"
            check_pairs(f"{name}.worlds", numbers.worlds, robots)
            stored = numbers.worlds * robots**2
            if stored * numbers.steps > MAX_STORED_PAIRS:
                allowed = f"at most {max(MAX_STORED_PAIRS // stored, 1)} with {numbers.worlds} worlds of {robots}"
                raise InputError(f"{name}.steps", numbers.steps, allowed)
    check_pairs("discovery.sigma", problem.discovery.sigma, robots)
    check_pairs("discovery.episodes", problem.discovery.episodes, robots)
    _check_window(problem.rest_in_steps, robots, problem.scheduler.period)
    _check_networks(problem)


@prng.reproducible()
def _check_networks(problem: Problem) -> None:
    """Checks that the weights of the networks fit in memory, without making any.

    A policy from outside the package is left to `check_parts`, which names it in what it raises.
    """
    if problem.policy.is_foreign():
        return
    networks = eqx.filter_eval_shape(build_networks, problem, jax.eval_shape(lambda: prng.key(0)))
    weights = sum(leaf.size for leaf in jax.tree.leaves(networks) if isinstance(leaf, jax.ShapeDtypeStruct))
    if weights > MAX_WEIGHTS:
        allowed = f"small enough: memory holds {MAX_WEIGHTS:,} weights, and these networks have {weights:,}"
        raise InputError("policy.hidden", getattr(problem.policy, "hidden", problem.policy), allowed)


def _check_window(rest: RestRule, robots: int, period: int = 1) -> None:
    """Checks that the last changes of the objective fit in memory, one for each episode of a batch and step.

    Args:
        rest: When a policy has come to rest, in steps.
        robots: Number of robots.
        period: Steps in a cycle of the scheduler, where the window was given in cycles.
    """
    episodes = episodes_at_once(robots)
    most = MAX_WINDOW_BYTES // (4 * episodes)
    if rest.window > most:
        raise InputError("rest.window", rest.window // period, f"at most {most // period} with {robots} robots")


def rollout(
    cascade: Cascade,
    starts: Float[np.ndarray, "episodes robots 2"],
    seed: int = 0,
    on_chunk: Callable[[int, int, int], None] | None = None,
) -> Trajectories:
    """Executes a cascade as `Cascade.rollout` does, as long as the record of it fits in memory.

    Most episodes come to rest long before they would be cut off. So it is not refused for what it might take: where
    memory would not hold it, it is cut off earlier, and refused if an episode needed more.

    Args:
        cascade: The cascade.
        starts: One configuration for each episode.
        seed: See `Cascade.rollout`.
        on_chunk: See `Cascade.rollout`.

    Raises:
        InputError: So many episodes of so many robots do not fit at once.
        RunError: An episode went on until memory was full.
    """
    check_type("cascade", cascade, Cascade, "a cascade, such as run.cascade")
    starts = checked_starts("starts", starts, cascade.world.config.robots)
    episodes, robots, _ = starts.shape
    check_pairs("episodes", episodes, robots)
    rest, policies = cascade.rest, len(cascade.policies)
    _check_window(rest, robots)
    most = max(MAX_RECORD_BYTES // (starts.size * 4 * policies), 1)
    if rest.max_steps <= most:
        return cascade.rollout(starts, seed, on_chunk)
    capped = Cascade(cascade.policies, cascade.env, replace(rest, max_steps=most))
    trajectories = capped.rollout(starts, seed, on_chunk)
    if (~trajectories.at_rest & ~trajectories.terminated).any():
        raise RunError(
            f"{episodes} episodes of {robots} robots did not come to rest in {most} steps, more than memory holds: try "
            "fewer episodes, or a smaller rest.max_steps"
        )
    return trajectories
