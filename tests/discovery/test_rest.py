"""The rule of rest: who is still, and when a policy ends."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from murmurate.discovery import RestRule
from murmurate.discovery.rest import RestLimits, all_still, has_ended

RULE = RestRule(window=5, stillness=0.25, switch_tolerance=0.5, max_steps=20)


def test_a_swarm_is_still_where_no_robot_moves_farther_than_its_share_of_a_radius():
    moves = jnp.asarray([[[0.5, 0.0], [0.0, 0.0]], [[0.3, 0.4], [0.4, 0.4]]])  # two episodes, batch first
    still = all_still(jnp.moveaxis(moves, 0, -1), RULE.stillness, 2.0)
    assert still.tolist() == [True, False]


@pytest.mark.parametrize(
    ("is_last", "still_steps", "mean_change", "steps_active", "expected"),
    [
        (True, 5, 9.0, 7, (True, True)),
        (True, 4, 0.0, 7, (False, False)),
        (False, 0, 0.4, 5, (True, True)),
        (False, 0, 0.5, 5, (False, False)),
        (False, 4, 0.4, 4, (False, False)),
        (False, 9, 0.6, 9, (False, False)),
        (True, 0, 0.0, 20, (False, True)),
        (False, 0, 9.0, 20, (False, True)),
        (False, 0, 9.0, 19, (False, False)),
        (True, 5, 9.0, 20, (True, True)),
    ],
)
def test_the_last_policy_ends_by_what_robots_do_and_others_by_the_objective(
    is_last, still_steps, mean_change, steps_active, expected
):
    numbers = jnp.asarray([still_steps]), jnp.asarray([mean_change]), jnp.asarray([steps_active])
    at_rest, ended = has_ended(jnp.asarray([is_last]), *numbers, RestLimits.from_rule(RULE))
    assert (at_rest.item(), ended.item()) == expected


def test_limits_may_be_arrays():
    limits = RestLimits(*(jnp.asarray(number, jnp.float32) for number in RestLimits.from_rule(RULE)))
    numbers = jnp.asarray([5.0, 4.0]), jnp.zeros(2), jnp.asarray([7.0, 7.0])
    at_rest, ended = has_ended(jnp.asarray([True, True]), *numbers, limits)
    np.testing.assert_array_equal([at_rest, ended], [[True, False], [True, False]])
