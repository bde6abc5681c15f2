"""Valid patterns and the kinematic bound, on configurations made by hand."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from murmurate.discovery import Trajectories, bound_steps, check_validity
from murmurate.discovery.validity import REPLACED, check_pattern
from murmurate.errors import InputError
from murmurate.world import Signal, UniformStart, World, WorldConfig, scaled_to, with_array_leaves
from murmurate.world.signals import Neighbors, Safety, Visible
from murmurate.world.start_files import check_configurations

WORLD = WorldConfig(robots=6, half_width=35.0, half_height=35.0, scan_radius=30.0, safe_distance=5.0)
FLAGS = ("contact_free", "inside", "mutually_visible", "gathered", "safe", "at_rest")
"""What must hold for a pattern to form; whether it stays is another matter."""


def ring(radius=8.0, angles=tuple(range(0, 360, 60))):
    angle = np.deg2rad(angles)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def with_robot(number, position, configuration=None):
    configuration = (ring() if configuration is None else configuration).copy()
    configuration[number] = position
    return configuration


def validity(*configurations, at_rest=True, after=()):
    """Checks one episode that goes through the given configurations, and after rest through others."""
    positions = np.stack(configurations)
    return check_validity(episodes(positions[None], at_rest=[at_rest], after=np.reshape(after, (1, -1, 6, 2))), WORLD)


def episodes(positions, at_rest, after=None):
    """Returns episodes of which only the positions and the rest are of interest; by default nobody moves after rest."""
    count, steps, robots, _ = positions.shape
    lengths = np.full(count, steps - 1)
    after = np.zeros((count, 0, robots, 2)) if after is None else after
    return Trajectories(
        positions.astype(np.float32),
        lengths,
        np.zeros((count, 0), int),
        np.asarray(at_rest),
        np.zeros(count, bool),
        {},
        lengths,
        after_rest=after.astype(np.float32),
    )


def assert_fails(judged, *failing):
    assert {flag for flag in FLAGS if not getattr(judged, flag)[0]} == set(failing)
    assert judged.formed[0] == judged.stationary[0] == judged.valid[0] == (not failing)


def test_a_ring_is_valid():
    assert_fails(validity(1.1 * ring(), ring(), ring()))


def test_one_pair_too_near():
    assert_fails(validity(ring(angles=(0, 28.9, 120, 180, 240, 300))), "safe")
    assert_fails(validity(ring(angles=(0, 36.5, 120, 180, 240, 300))))


def test_one_robot_in_the_way():
    """From the middle of a ring, one robot hides the two pairs that are left opposite each other."""
    assert_fails(validity(with_robot(0, (0, 0))), "mutually_visible")


def test_one_robot_out_of_reach():
    assert_fails(validity(ring(radius=15.1)), "gathered", "mutually_visible")
    assert_fails(validity(ring(radius=14.9)))


def test_not_at_rest():
    assert_fails(validity(ring(), at_rest=False), "at_rest")


def assert_formed_and_lost(judged):
    assert (judged.formed[0], judged.stationary[0], judged.valid[0]) == (True, False, False)


def test_a_pattern_that_stays_is_stationary():
    assert_fails(validity(ring(), after=[ring(), ring()]))
    assert_fails(validity(ring(), after=[with_robot(0, (8.1, 0)), ring(8.1)]))


def test_a_robot_that_drifts_farther_than_a_quarter_of_its_radius():
    assert_fails(validity(ring(), after=[ring(8.125), ring(8.249)]))
    assert_formed_and_lost(validity(ring(), after=[ring(8.125), ring(8.251)]))
    # Where it ends counts: it may have been farther away, as long as the pattern is valid there.
    assert_fails(validity(ring(), after=[with_robot(0, (9, 0)), ring()]))


def test_every_step_after_rest_must_be_valid():
    """A robot touches another, leaves, hides others or is too near or too far for one step, and returns."""
    for angle in (28.9, 47):
        assert_formed_and_lost(validity(ring(), after=[ring(angles=(angle, 60, 120, 180, 240, 300)), ring()]))
    assert_formed_and_lost(validity(ring(), after=[ring()[[3, 1, 2, 0, 4, 5]], ring()]))
    for position in ((35.1, 0), (0, 0), (25, 0)):
        assert_formed_and_lost(validity(ring(), after=[with_robot(0, position), ring()]))


def test_what_nobody_saw_after_rest_is_not_known_to_stay():
    seen = episodes(ring()[None, None], [True])
    assert check_validity(seen, WORLD).valid.all()
    assert_formed_and_lost(check_validity(replace(seen, after_rest=None), WORLD))


def test_no_pattern_no_stationary_one():
    assert_fails(validity(with_robot(0, (0, 0)), after=[ring(), ring()]), "mutually_visible")
    assert_fails(validity(ring(), at_rest=False, after=[ring()]), "at_rest")


def test_two_robots_swap_through_each_other():
    """Both end points are the same valid ring."""
    assert_fails(validity(ring(), ring()[[3, 1, 2, 0, 4, 5]]), "contact_free")
    assert_fails(validity(ring(), ring()[[3, 1, 2, 0, 4, 5]], ring()), "contact_free")


def test_a_robot_was_outside_for_a_moment():
    assert_fails(validity(ring(), with_robot(0, (35.5, 0)), ring()), "inside")
    assert_fails(validity(ring(), with_robot(0, (35.0, 0)), ring()))


@pytest.mark.parametrize("robots", [22, 24])
def test_a_robot_that_stays_on_a_wall_is_inside(robots):
    """The world steps in float32, in which a side of these worlds is shorter (22) or longer (24) than in float64."""
    world = scaled_to(WorldConfig(robots=8, half_width=40.0, half_height=40.0, scan_radius=1000.0), robots)
    sides = np.float32(world.half_width)
    assert (float(sides) > world.half_width) == (robots == 24)
    assert float(sides) != world.half_width
    line = np.linspace(-world.half_width, world.half_width, robots)
    step = jax.jit(lambda world, positions: world.step(world.state(positions), jnp.zeros((robots, 2))))
    stepping = with_array_leaves(World.create(world, UniformStart()))
    on_walls = np.stack([line, np.where(np.arange(robots) % 2, world.half_height, -world.half_height)], axis=1)
    for beyond in (False, True):
        positions = on_walls.astype(np.float32)
        if beyond:
            positions[0, 0] = np.nextafter(-sides, np.float32(-np.inf))
        steps, rest = np.zeros(1, int), np.ones(1, bool)
        trajectories = Trajectories(
            np.stack([positions] * 2)[None], steps, np.zeros((1, 0), int), rest, ~rest, {}, steps
        )
        _, transition = step(stepping, jnp.asarray(positions))
        assert check_validity(trajectories, world).inside[0] == (not beyond)
        assert bool(transition.terminated) == beyond
        if beyond:
            with pytest.raises(InputError, match="a robot outside"):
                check_configurations(positions[None], world, "starts")
        else:
            check_configurations(positions[None], world, "starts")


@pytest.mark.unchecked
def test_another_worlds_trajectories_are_refused_in_one_line():
    steps, rest = np.zeros(1, int), np.ones(1, bool)
    none = np.zeros((1, 0), int)
    for shape in [(1, 2, 5, 2), (1, 2, 7, 2), (1, 2, 6, 3), (1, 0, 6, 2), (2, 6, 2)]:
        trajectories = Trajectories(np.zeros(shape, np.float32), steps, none, rest, ~rest, {}, steps)
        with pytest.raises(InputError, match=r"^trajectories.positions = .*\(episodes, steps \+ 1, 6, 2\)") as error:
            check_validity(trajectories, WORLD)
        assert "\n" not in str(error.value)
    positions = np.stack([ring(), ring()])[None].astype(np.float32)
    trajectories = Trajectories(positions, steps, none, np.ones(2, bool), ~rest, {}, steps)
    with pytest.raises(InputError, match=r"^trajectories.at_rest = .*\(1,\)"):
        check_validity(trajectories, WORLD)
    for shape in [(2, 3, 6, 2), (1, 3, 5, 2), (1, 6, 2)]:
        trajectories = replace(episodes(positions, [True]), after_rest=np.zeros(shape, np.float32))
        with pytest.raises(InputError, match=r"^trajectories.after_rest = .*\(1, steps, 6, 2\)"):
            check_validity(trajectories, WORLD)


def test_two_robots_touched_on_the_way():
    assert_fails(validity(ring(), with_robot(0, (6.0, 0), with_robot(1, (6.0, 2.0))), ring()), "contact_free")
    assert_fails(validity(ring(), with_robot(0, (6.0, 0), with_robot(1, (6.0, 2.1))), ring()))


def test_every_episode_is_judged_for_itself():
    finals = [ring(), with_robot(0, (0, 0)), ring(radius=15.1), ring(angles=(0, 28.9, 120, 180, 240, 300)), ring()]
    positions = np.stack(finals)[:, None].astype(np.float32)
    rest = np.array([True, True, True, True, False])
    judged = check_validity(episodes(positions, rest), WORLD)
    np.testing.assert_array_equal(judged.valid, [True, False, False, False, False])
    np.testing.assert_array_equal(judged.mutually_visible, [True, False, False, True, True])
    np.testing.assert_array_equal(judged.gathered, [True, True, False, True, True])
    np.testing.assert_array_equal(judged.safe, [True, True, True, False, True])
    np.testing.assert_array_equal(judged.at_rest, rest)
    assert judged.contact_free.all()
    assert judged.inside.all()


class Wide(Signal):
    """Distance of the robots from the origin: a signal of a user's own."""

    def __call__(self, configuration):
        return np.sqrt((configuration.positions**2).sum(axis=1))


def test_signals_of_ones_own_may_have_to_reach_a_value():
    positions = np.stack([ring(), ring(9.0), ring(8.6)])[:, None]
    after = np.stack([ring(9.0), ring(9.0), ring(8.45)])[:, None]
    judged = check_validity(episodes(positions, np.ones(3, bool), after), WORLD, {"wide": (Wide(), 8.5)})
    np.testing.assert_array_equal(judged.signals["wide"], [False, True, True])
    np.testing.assert_array_equal(judged.formed, [False, True, True])
    np.testing.assert_array_equal(judged.valid, [False, True, False], err_msg="the last one loses its width after rest")


def beside(distance):
    """Returns a ring whose first robot is at a distance from the second one."""
    angle = np.deg2rad(60) - 2 * np.arcsin(distance / 16)
    return with_robot(0, (8 * np.cos(angle), 8 * np.sin(angle)))


def test_a_threshold_of_a_signal_of_the_paper_replaces_its_condition():
    """Robot 0 stands in the middle, where it hides two pairs; out of reach of three; nearer than the safe distance."""
    world = replace(WORLD, scan_radius=20.0)
    positions = np.stack([ring(), with_robot(0, (0.0, 0.0)), with_robot(0, (19.0, 0.0)), beside(4.0)])
    conditions = check_pattern(positions, world)
    assert conditions["mutually_visible"].tolist() == [True, False, False, True]
    assert conditions["gathered"].tolist() == [True, True, False, True]
    assert conditions["safe"].tolist() == [True, True, True, False]

    def formed(**least):
        signals = {"visible": Visible(), "neighbors": Neighbors(), "safety": Safety()}
        thresholds = {name: (signals[name], value) for name, value in least.items()}
        judged = check_validity(episodes(positions[:, None], np.ones(4, bool)), world, thresholds)
        assert judged.replaced == {REPLACED[name] for name in least}
        np.testing.assert_array_equal(judged.mutually_visible, conditions["mutually_visible"])
        return judged.formed.tolist()

    assert formed() == formed(visible=1.0) == [True, False, False, False]
    assert formed(visible=13 / 15) == [True, True, False, False]
    assert formed(visible=0.87) == [True, False, False, False]
    assert formed(visible=0.0, neighbors=0.0) == [True, True, True, False]
    assert formed(visible=0.0, neighbors=1.0) == [True, True, False, False]
    assert formed(safety=0.5) == [True, False, False, True]


def test_a_condition_that_is_replaced_need_not_stay():
    recorded = episodes(beside(5.05)[None, None], np.ones(1, bool), beside(4.95)[None, None])
    assert check_validity(recorded, WORLD).formed.all()
    assert not check_validity(recorded, WORLD).stationary.any()
    assert check_validity(recorded, WORLD, {"safety": (Safety(), 0.9)}).stationary.all()


@given(seed=st.integers(0, 2**32 - 1), robots=st.integers(2, 6), whole=st.booleans())
@settings(max_examples=60)
def test_the_bound_is_the_best_of_all_assignments(seed, robots, whole):
    rng = np.random.default_rng(seed)
    start, final = rng.uniform(-10, 10, (2, robots, 2))
    if whole:  # many distances are then equal
        start, final = start.round(), final.round()
    bound = min(np.abs(start - final[list(order)]).max() for order in permutations(range(robots))) / 0.4
    np.testing.assert_allclose(bound_steps(start, final, 0.4), bound, rtol=1e-12)


@pytest.mark.parametrize("robots", [2, 10, 40])
def test_a_pattern_reached_by_relabelling_needs_no_step(robots):
    start = np.random.default_rng(0).uniform(-40, 40, (robots, 2))
    assert bound_steps(start, start[::-1], 1.0) == 0
    np.testing.assert_allclose(bound_steps(start, start[::-1] + np.array([3.0, -7.0]), 0.5), 14, rtol=1e-12)
