"""In symmetric swarms many robots tie: turning, moving and renumbering them changes velocities by rounding only."""

from __future__ import annotations

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import murmurate
from murmurate.policies import EquivariantPolicy
from murmurate.policies.features import TIE, pair_and_robot_features
from murmurate.policies.hull import hull
from murmurate.world import GlobalSensing, Observation, VisibleSensing, WorldConfig
from oracles.features import shadows

ANGLES = (0.0, 0.3, 0.7, np.pi / 4, np.pi / 2, 2.2)
SHIFTS = ((0.0, 0.0), (13.0, -7.0))
WORLD = WorldConfig(robots=8, half_width=500.0, half_height=500.0, scan_radius=1000.0)
LIMIT = 1e-5 * WORLD.max_speed
SIZES = [2, 8, *(pytest.param(size, marks=pytest.mark.nightly) for size in (5, 16, 32))]


def polygon(robots, radius):
    angle = 2 * np.pi * np.arange(robots) / robots
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def grid(columns, rows, spacing=5.0):
    x, y = np.meshgrid(np.arange(columns) - (columns - 1) / 2, np.arange(rows) - (rows - 1) / 2)
    return spacing * np.stack([x.ravel(), y.ravel()], axis=1)


SWARMS = {
    2: [grid(2, 1)],
    5: [polygon(5, 6.0), grid(5, 1), np.vstack([polygon(4, 8.0), [[0.0, 0.0]]])],
    8: [polygon(8, 8.0), grid(4, 2), grid(8, 1), np.vstack([polygon(4, 5.0), polygon(4, 12.0)])],
    16: [
        polygon(16, 20.0),
        grid(4, 4),
        grid(16, 1),
        np.vstack([polygon(8, 8.0), polygon(8, 18.0)]),
        np.vstack([polygon(15, 20.0), [[0.0, 0.0]]]),
    ],
    32: [polygon(32, 80.0), grid(8, 4), np.vstack([polygon(16, 18.0), polygon(16, 40.0)])],
}


@functools.cache
def placed(robots, landmark):
    """Returns all swarms of a size, turned, moved and renumbered, and how: the first of each is as it is."""
    rng = np.random.default_rng(0)
    positions, changes = [], []
    for swarm in SWARMS[robots]:
        for angle in ANGLES:
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            for shift in SHIFTS[: 1 if landmark else None]:
                first = len(changes) - len(changes) % (len(ANGLES) * (1 if landmark else len(SHIFTS)))
                order = np.arange(robots) if first == len(changes) else rng.permutation(robots)
                positions.append((swarm @ turn.T + shift)[order])
                changes.append((first, turn, order))
    return jnp.asarray(np.moveaxis(np.stack(positions), 0, -1), jnp.float32), changes


@eqx.filter_jit
def act(policy, sensing, positions):
    if sensing is None:
        return policy(positions), None
    keys = jax.random.split(jax.random.key(0), positions.shape[-1])
    view = sensing.view(positions, sensing.draw_frames(keys, len(positions)), keys, WORLD)
    return policy(Observation(view, positions, jnp.zeros_like(positions[:, 0]))), view.seen


def assert_equivariant(policy, sensing, robots, landmark):
    positions, changes = placed(robots, landmark)
    velocities, seen = act(policy, sensing, positions)
    velocities = np.moveaxis(np.asarray(velocities), -1, 0)
    assert np.abs(velocities).max() > 0.05
    for velocity, (first, turn, order) in zip(velocities, changes, strict=True):
        np.testing.assert_allclose(velocity, (velocities[first] @ turn.T)[order], rtol=0, atol=LIMIT)
    if seen is not None:  # Who is seen is no matter of rounding in these swarms.
        for now, (first, _, order) in zip(np.moveaxis(np.asarray(seen), -1, 0), changes, strict=True):
            np.testing.assert_array_equal(now, np.asarray(seen)[..., first][np.ix_(order, order)])


def random_weights(policy, seed=0):
    """As training would leave them: no coefficient is small."""
    rng = np.random.default_rng(seed)
    return jax.tree.map(
        lambda x: jnp.asarray(rng.normal(size=x.shape) / np.sqrt(x.shape[-1] if x.ndim > 1 else 4), jnp.float32), policy
    )


@pytest.mark.parametrize("robots", SWARMS)
@pytest.mark.parametrize("landmark", [False, True], ids=["C2", "C1"])
def test_robots_that_see_all_positions(landmark, robots):
    policy, _ = EquivariantPolicy(hidden=(32, 16)).networks(WORLD, landmark, jax.random.key(0))
    for seed in range(2):
        assert_equivariant(random_weights(policy, seed), None, robots, landmark)


@functools.cache
def pretrained(objective, sensing):
    return murmurate.pretrained(objective, sensing).cascade.policies[0]


@pytest.mark.parametrize("robots", SIZES)
@pytest.mark.parametrize("sensing", [GlobalSensing(), VisibleSensing()], ids=["global", "visible"])
@pytest.mark.parametrize("objective", ["C1", "C2"])
def test_robots_with_their_own_eyes(objective, sensing, robots):
    policy = pretrained(objective, sensing.name)
    for weights in (policy, random_weights(policy)):
        assert_equivariant(weights, sensing, robots, objective == "C1")


_features, _hull = eqx.filter_jit(pair_and_robot_features), eqx.filter_jit(hull)


def around(positions):
    """Returns unit vectors, distances and the shadows' features of one configuration in float64."""
    with jax.enable_x64(True):
        dx, dy = (jnp.asarray(positions[None, :, a] - positions[:, None, a]) for a in (0, 1))
        zero = jnp.zeros(len(positions))
        seen = _features(dx, dy, dx**2 + dy**2 > 0, zero, zero, 8, WORLD, False)
        return np.asarray(seen.pair[-6:])


@pytest.mark.parametrize("seed", range(4))
def test_shadows_are_those_of_plain_loops(seed):
    rng = np.random.default_rng(seed)
    for positions in (rng.uniform(-12, 12, (7, 2)), grid(3, 3) + rng.uniform(-0.1, 0.1, (9, 2))):
        np.testing.assert_allclose(around(positions), shadows(positions, WORLD.radius, TIE), rtol=1e-9, atol=1e-12)


def test_a_tie_is_half_of_either():
    """Robots 1 and 2 are equally far from 0: each casts half of its shadow on the other."""
    angle = 0.4
    positions = np.array([[0.0, 0.0], [10.0, 0.0], [10 * np.cos(angle), 10 * np.sin(angle)]])
    nearer, _, farther, *_ = around(positions)
    np.testing.assert_allclose(nearer[0, 1:], farther[0, 1:], rtol=1e-9)
    bell = (1 + (np.sin(angle) / 0.2) ** 2) ** -2
    np.testing.assert_allclose(nearer[0, 1], bell / 2, rtol=1e-9)


def test_no_comparison_is_a_jump():
    """A robot passes, in small steps, the distance of another, a right angle, and the line between two others."""
    with jax.enable_x64(True):
        share = np.linspace(-1, 1, 4001)
        for path in ("distance", "angle", "line"):
            positions = np.tile(np.array([[0.0, 0.0], [6.0, 0.0], [5.0, 3.5]])[..., None], len(share))
            if path == "distance":
                positions[2] *= (6.0 + 0.5 * share) / np.hypot(5.0, 3.5)
            elif path == "angle":
                positions[2] = 3 * np.stack([-np.sin(0.1 * share), np.cos(0.1 * share)])
            else:
                positions[2] = np.stack([np.full_like(share, -7.0), 0.02 * share])
            positions = jnp.asarray(positions)
            dx, dy = (positions[None, :, a] - positions[:, None, a] for a in (0, 1))
            seen, zero = dx**2 + dy**2 > 0, jnp.zeros_like(dx[0])
            around = _features(dx, dy, seen, zero, zero, 8, WORLD, False, scale_free=True)
            outline = _hull(around.ux, around.uy, jnp.sqrt(jnp.where(seen, dx**2 + dy**2, 1.0)), seen)
            for part in (around.pair, around.robot, outline.pair, outline.robot):
                steps = np.abs(np.diff(np.asarray(part), axis=-1))
                assert steps.max() < 0.03, path
