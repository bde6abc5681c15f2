"""The world stepped by hand, beside which the adapters are put; and the small swarm that they are tested with."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from murmurate.world import UniformStart, World, WorldConfig, with_array_leaves

SIZES = {"half_width": 12.0, "half_height": 10.0, "scan_radius": 9.0, "safe_distance": 4.0, "max_speed": 0.5}
CONFIG = WorldConfig(robots=3, **SIZES)
SWARM = {"robots": 3, **SIZES}
TRIANGLE = np.array([[-4.0, -2.0], [4.0, -2.5], [0.5, 4.0]], np.float32)

step = jax.jit(World.step)
state_of = jax.jit(World.state)
signals_of = jax.jit(World.signals)


def world(objective="C1", horizon=400, per_robot_credit=False):
    return with_array_leaves(World.create(CONFIG, UniformStart(), objective, None, horizon, per_robot_credit))


def played(world, positions, velocities):
    """Returns the positions after each step, and the transitions, from a configuration."""
    state, seen, transitions = state_of(world, jnp.array(positions)), [], []
    for velocity in velocities:
        state, transition = step(world, state, jnp.asarray(velocity, jnp.float32))
        seen.append(np.asarray(state.positions))
        transitions.append(transition)
    return seen, transitions


def close(actual, desired):
    """Checks that numbers are the same up to the rounding of another program."""
    np.testing.assert_allclose(actual, desired, rtol=1e-5, atol=2e-6)
