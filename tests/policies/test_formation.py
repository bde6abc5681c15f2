"""The policy that remembers formations: assignment, superposition, what it does with them, and how it is trained."""

from __future__ import annotations

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from murmurate import prng
from murmurate.discovery import build_cascade
from murmurate.discovery.search import Search
from murmurate.discovery.stage import _score
from murmurate.errors import InputError
from murmurate.geometry.assignment import assignment
from murmurate.geometry.rings import smallest_ring
from murmurate.geometry.similarity import align
from murmurate.policies import FormationPolicy
from murmurate.policies.formation import SCALE_MARGIN, WALL_DISTANCE, ArrivalReward, places_of
from murmurate.runs.presets import preset, resolve
from murmurate.world import UniformStart, World, WorldConfig

WORLD = WorldConfig(robots=6, half_width=40.0, half_height=30.0, scan_radius=60.0, safe_distance=5.0)


def points(robots, batch=None, seed=0, spread=10.0):
    shape = (robots, 2) if batch is None else (robots, 2, batch)
    return spread * jax.random.normal(jax.random.key(seed), shape)


def network(formation, world=WORLD, landmark=False):
    """A policy network that remembers one formation, and whose weights lead nobody around anybody."""
    made, _ = FormationPolicy(formations=1, hidden=(8, 4)).networks(world, landmark, prng.key(0))
    unit = float(made.goals().max() / made.places.max())
    layers = lambda n: (n.places, n.head.weight, n.head.bias, n.to_place.weight, n.to_place.bias)  # noqa: E731
    zeros = [jnp.zeros_like(x) for x in layers(made)[1:]]
    return eqx.tree_at(layers, made, (jnp.asarray(formation, jnp.float32)[None] / unit, *zeros))


# Assignment


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 12), st.integers(0, 2**31), st.sampled_from((1.0, 1e-3, 1e6)))
def test_an_assignment_costs_what_the_best_costs(size, seed, scale):
    cost = np.random.default_rng(seed).normal(size=(size, size, 7)).astype(np.float32) * scale
    chosen = np.asarray(assignment(jnp.asarray(cost)))
    for problem in range(cost.shape[-1]):
        assert sorted(chosen[:, problem]) == list(range(size))
        rows, columns = linear_sum_assignment(cost[..., problem])
        best = cost[rows, columns, problem].sum(dtype=float)
        have = cost[np.arange(size), chosen[:, problem], problem].sum(dtype=float)
        assert have == pytest.approx(best, abs=1e-5 * size * float(np.abs(cost).max()))


def test_an_assignment_among_equals_is_one():
    for cost in (np.zeros((5, 5, 2)), np.ones((5, 5, 2)), np.eye(5)[..., None]):
        chosen = np.asarray(assignment(jnp.asarray(cost, jnp.float32)))
        assert (np.sort(chosen, axis=0) == np.arange(5)[:, None]).all()


def test_an_assignment_of_what_is_not_finite_comes_to_an_end():
    cost = jnp.full((4, 4, 3), jnp.nan).at[:, :, 1].set(jnp.inf).at[:, :, 2].set(jnp.ones((4, 4)) - jnp.eye(4))
    chosen = np.asarray(assignment(cost))
    assert (np.sort(chosen, axis=0) == np.arange(4)[:, None]).all()
    assert (chosen[:, 2] == np.arange(4)).all()


# Superposition


@settings(max_examples=30, deadline=None)
@given(st.sampled_from((2, 3, 10)), st.integers(0, 2**31), st.floats(0, 6.28))
def test_places_are_the_formation_turned_and_moved(robots, seed, turn):
    world = WorldConfig(robots=robots, half_width=400.0, half_height=400.0, scan_radius=800.0)
    formation, swarms = points(robots, seed=seed), points(robots, 5, seed + 1, spread=30.0)
    places = np.asarray(places_of(swarms, formation, world, "moved"))
    for index in range(5):
        match = align(places[..., index], np.asarray(formation, float), scaling=False, reflection=False)
        assert match.distance < 1e-3
        assert places[..., index].mean(axis=0) == pytest.approx(np.asarray(swarms[..., index]).mean(axis=0), abs=1e-3)
    # A swarm that is turned gets turned places: both are as far.
    cos, sin = math.cos(turn), math.sin(turn)
    turned = jnp.einsum("ab,rbk->rak", jnp.asarray([[cos, -sin], [sin, cos]]), swarms)
    again = np.asarray(places_of(turned, formation, world, "moved"))
    before, after = (np.sqrt(((a - b) ** 2).sum(axis=(0, 1))) for a, b in ((places, swarms), (again, turned)))
    assert after == pytest.approx(before, rel=0.1, abs=1e-2)


def test_places_are_almost_always_the_nearest_by_the_exact_distance_of_patterns():
    formation, swarms = points(8, seed=3), points(8, 200, 4, spread=25.0)
    world = WorldConfig(robots=8, half_width=400.0, half_height=400.0, scan_radius=800.0)
    places = np.asarray(places_of(swarms, formation, world, "moved"))
    have = np.sqrt(((places - np.asarray(swarms)) ** 2).sum(axis=1).mean(axis=0))
    exact = [
        align(np.asarray(swarms[..., k], float), np.asarray(formation, float), scaling=False, reflection=False).distance
        for k in range(200)
    ]
    assert (have >= np.asarray(exact) - 1e-3).all()
    assert (have <= np.asarray(exact) * (1 + 1e-4)).mean() >= 0.95


def test_robots_that_go_straight_keep_their_places():
    formation, swarms = points(7, seed=5), points(7, 40, 6, spread=30.0)
    world = WorldConfig(robots=7, half_width=400.0, half_height=400.0, scan_radius=800.0)
    places = places_of(swarms, formation, world, "turned")
    for share in (0.1, 0.5, 0.9, 1.0):
        again = places_of(swarms + share * (places - swarms), formation, world, "turned")
        assert np.abs(np.asarray(again - places)).max() < 1e-2


def test_with_a_gathering_point_a_formation_is_turned_around_it_alone():
    formation = jnp.asarray(smallest_ring(6, 1.0, 5.0).positions, jnp.float32)
    places = np.asarray(places_of(points(6, 9, 1) + 15.0, formation, WORLD, "turned"))
    assert np.linalg.norm(places, axis=1) == pytest.approx(float(jnp.linalg.norm(formation[0])), rel=1e-5)


def test_places_stay_inside_the_world():
    formation = jnp.asarray(smallest_ring(6, 1.0, 5.0).positions, jnp.float32)
    corner = jnp.asarray(WORLD.bounds)[None, :, None] - 1.0 - jnp.abs(points(6, 9, 2, spread=2.0))
    places = np.asarray(places_of(corner, formation, WORLD, "moved"))
    assert (np.abs(places) <= np.asarray(WORLD.bounds)[:, None] - WALL_DISTANCE + 1e-4).all()
    for index in range(9):
        assert align(places[..., index], np.asarray(formation, float), scaling=False).distance < 1e-3


# The policy


def test_a_swarm_goes_straight_and_arrives_together():
    formation = smallest_ring(6, 1.0, 5.0).positions
    policy, swarm = network(formation), points(6, 3, 8, spread=20.0)
    places = places_of(swarm, jnp.asarray(formation, jnp.float32), WORLD, "moved")
    farthest = np.abs(np.asarray(places - swarm)).max(axis=(0, 1))
    moves = np.asarray(policy(swarm))
    assert np.abs(moves).max(axis=(0, 1)) == pytest.approx(WORLD.max_speed, rel=1e-4)
    assert moves == pytest.approx(np.asarray(places - swarm) / farthest * WORLD.max_speed, abs=1e-4)
    # What is left is less than a step: robots arrive, and stay.
    near = places + 0.3 * (swarm - places) / jnp.asarray(farthest)
    assert np.asarray(near + policy(near)) == pytest.approx(np.asarray(places), abs=1e-3)
    assert np.asarray(policy(places)) == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("shape", [(), (4,), (2, 3)])
def test_velocities_have_the_shape_of_positions_and_the_speed_limit(shape):
    policy, value = FormationPolicy(formations=3, hidden=(8, 4)).networks(WORLD, True, prng.key(1))
    policy = eqx.tree_at(lambda n: n.head.weight, policy, replace_fn=lambda w: 1e3 * w)
    swarm = 10.0 * jax.random.normal(jax.random.key(2), (6, 2, *shape))
    moves = policy(swarm)
    assert moves.shape == swarm.shape
    assert np.abs(np.asarray(moves)).max() <= WORLD.max_speed * (1 + 1e-6)
    assert value(swarm).shape == (6, *shape)


def test_robots_have_no_numbers():
    policy, _ = FormationPolicy(formations=3, hidden=(8, 4)).networks(WORLD, False, prng.key(1))
    swarm, order = points(6, 5, 3), jnp.asarray([3, 0, 5, 1, 4, 2])
    assert np.asarray(policy(swarm[order])) == pytest.approx(np.asarray(policy(swarm)[order]), abs=1e-4)


def test_robots_at_one_place_or_none_give_no_nan_to_others():
    policy, _ = FormationPolicy(formations=3, hidden=(8, 4)).networks(WORLD, False, prng.key(1))
    swarm = jnp.stack([jnp.zeros((6, 2)), points(6, seed=1), points(6, seed=1).at[0].set(jnp.nan)], axis=-1)
    moves = np.asarray(policy(swarm))
    assert np.isfinite(moves[..., :2]).all()
    formation = jnp.asarray(policy.goals())[..., :1]  # robots on their places have no direction to go
    configurations = jnp.concatenate([swarm[..., :2], formation], axis=-1)
    gradient = jax.jit(jax.grad(lambda x: jnp.sum(policy(x))))(configurations)
    assert np.isfinite(np.asarray(gradient)).all()


# Training


def test_settling_finds_the_least_valid_scale_and_the_best_first():
    ring = smallest_ring(6, 1.0, 5.0).positions
    other = np.concatenate([1.05 * smallest_ring(5, 1.0, 5.0).positions, [[0.0, 0.0]]])
    made, _ = FormationPolicy(formations=3, hidden=(8, 4)).networks(WORLD, True, prng.key(0))
    unit = float(made.goals().max() / made.places.max())
    formations = np.stack([np.zeros((6, 2)), 1.04 * other, 0.97 * ring])
    made = eqx.tree_at(lambda n: n.places, made, jnp.asarray(formations / unit, jnp.float32))

    def score(formations):
        """How narrow a formation is where no pair is nearer than 5; where one is, it is none."""
        pairs = np.linalg.norm(formations[:, :, None] - formations[:, None], axis=-1)
        nearest = (pairs + 1e9 * np.eye(6)).min(axis=(1, 2))
        return np.where(nearest >= 5.0, -np.linalg.norm(formations, axis=-1).mean(axis=1), -np.inf)

    settled = np.moveaxis(np.asarray(made.scaled_and_sorted(score).goals(), float), -1, 0)
    # Five around one are narrower than six around nobody; all at one place are no formation at any scale.
    assert np.linalg.norm(settled[0], axis=1) == pytest.approx([*[5.0 * (1 + SCALE_MARGIN)] * 5, 0.0], abs=1e-4)
    assert settled[1] == pytest.approx(ring * (1 + SCALE_MARGIN), abs=1e-4)
    assert np.isneginf(score(settled[2:])).all()


def small(learner_fields=None, **overlay):
    """Experiment D with few updates."""
    base = {"goals": {"updates": 1200}, "gradients": {"updates": 4, "worlds": 8, "steps": 4, "minibatches": 2}}
    fields = {
        "base": {**base, **(learner_fields or {})},
        "policy": {"formations": 24, "hidden": [8, 4]},
        "discovery": {"chunk": 200, "episodes": 16, "sigma": 16},
    }
    return resolve("D", fields, overlay, learner="formation")


@pytest.fixture(scope="module")
def searched():
    """A search whose formations have been found and whose way has not been learned."""
    search = Search(small())
    snapshot = search.begin()
    while snapshot.unrefined is None:
        snapshot, rows = search.advance(snapshot)
        assert all(np.isfinite(row["reward"]) for row in rows)
    return search, snapshot


def test_the_search_finds_a_valid_pattern_without_a_step_of_the_world(searched):
    _, snapshot = searched
    goals = np.moveaxis(np.asarray(snapshot.unrefined.goals(), float), -1, 0)
    worth = _score(small(), goals)
    assert np.isfinite(worth[0])
    assert worth[0] == worth.max()


def test_refinement_moves_weights_and_leaves_formations(searched):
    search, snapshot = searched
    before = snapshot.unrefined
    while not snapshot.finished:
        snapshot, rows = search.advance(snapshot)
        assert all(row["gradient"] > 0 for row in rows)
    assert snapshot.valid >= 0.9
    after = snapshot.policies[0]
    assert (np.asarray(after.places) == np.asarray(before.places)).all()
    assert (np.asarray(after.pair.weight) != np.asarray(before.pair.weight)).any()


def test_the_cost_of_a_step_is_how_far_the_formation_is():
    formation = smallest_ring(6, 1.0, 5.0).positions
    env = World.create(WORLD, UniformStart(), "C2")
    env = ArrivalReward(env, jnp.asarray(formation, jnp.float32), "moved", dict(env.objective.signals))
    there = jnp.asarray(formation, jnp.float32)[..., None]
    far = there.at[0].add(jnp.asarray([[12.0], [0.0]]))
    for swarm, nothing in ((there, jnp.zeros((6, 2, 1))), (far, jnp.zeros((6, 2, 1)))):
        _, transition = env.step(env.state(swarm), nothing)
        places = np.asarray(places_of(swarm, jnp.asarray(formation, jnp.float32), WORLD, "moved"), float)
        apart = np.linalg.norm(places - np.asarray(swarm, float), axis=1) / WORLD.max_speed
        assert float(transition.reward[0]) == pytest.approx(-(apart.max() + apart.mean()) / 2, abs=2e-3)
        assert np.asarray(transition.credit) == pytest.approx(np.asarray(transition.reward)[None])


def test_a_swarm_forms_what_its_policy_remembers_from_a_start_elsewhere():
    experiment = preset("E", "formation")
    ring = smallest_ring(8, 1.0, 5.0).positions * (1 + SCALE_MARGIN)
    swarm = np.clip(np.moveaxis(np.asarray(points(8, 6, 5, spread=25.0)), -1, 0), -38, 38)
    trajectories = build_cascade(experiment, [network(ring, experiment.world)]).rollout(swarm)
    assert trajectories.at_rest.all()
    for final in trajectories.final:
        assert align(final, ring, scaling=False).distance < 1e-2


# What is refused


@pytest.mark.parametrize(
    ("overlay", "words"),
    [
        ({"policy": {"formations": 0}}, "policy.formations"),
        ({"policy": {"credit": "swarm"}}, "policy.credit"),
        ({"base": {"goals": {"updates": 0}}}, "base.goals.updates"),
        ({"base": {"goals": {"rate": 0.0}}}, "base.goals.rate"),
        ({"base": {"goals": {"softness": 0.0}}}, "base.goals.softness"),
        ({"base": {"goals": {"weights": {"smooth_visible": -1.0}}}}, "base.goals.weights.smooth_visible"),
        ({"sizes": [4, 8], "start": {"use": "random"}}, r"world\.robots = 6: must be one of sizes \(4, 8\)"),
    ],
)
def test_what_cannot_be_is_refused_by_its_field(overlay, words):
    with pytest.raises(InputError, match=words):
        resolve("D", overlay, learner="formation")


def test_a_policy_without_goals_cannot_search_them():
    with pytest.raises(InputError, match=r"base\.learner.*goals.*has no goals"):
        resolve("D", {"policy": "equivariant", "base": {"learner": "goals"}})


def test_goals_need_signals_with_gradients():
    from murmurate.discovery.build import check_parts

    with pytest.raises(InputError, match=r"base\.goals\.weights\.visible"):
        check_parts(small({"goals": {"updates": 4, "weights": {"visible": 1.0}}}))
