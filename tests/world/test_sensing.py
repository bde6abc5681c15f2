"""What robots perceive: against the oracle of visibility, and in frames that change nothing but coordinates."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from murmurate.errors import InputError
from murmurate.world import (
    LocalObservation,
    ScatteredStart,
    Sensing,
    World,
    WorldConfig,
)
from oracles import visibility

R, SCAN = 1.0, 20.0
X, Y = 14.0, 12.5
OTHER = ~np.eye(6, dtype=bool)


def configurations(seed=0, batch=20, robots=6, size=12.0):
    """Configurations without contact, batch last."""
    rng, result = np.random.default_rng(seed), []
    while len(result) < batch:
        points = rng.uniform(-size, size, (robots, 2))
        if visibility.pairwise_distances(points)[~np.eye(robots, dtype=bool)].min() > 2 * R:
            result.append(points)
    return jnp.asarray(np.stack(result, axis=-1), jnp.float32)


def sensing_of(use="global", **fields):
    return Sensing.registered()[use](**fields)


def look(positions, seed=0, **fields):
    sensing = sensing_of(**fields)
    world = WorldConfig(robots=positions.shape[0], half_width=X, half_height=Y, radius=R, scan_radius=SCAN)
    keys = jax.random.split(jax.random.key(seed), positions.shape[-1])
    return _look(sensing, positions, keys, world)


@eqx.filter_jit
def _look(sensing, positions, keys, world):
    frames = sensing.draw_frames(keys, positions.shape[0])
    return frames, sensing.view(positions, frames, keys, world)


def test_what_is_seen_is_what_the_oracle_sees():
    positions = configurations()
    seen = {use: np.asarray(look(positions, use=use)[1].seen) for use in ("global", "scan", "visible")}
    for episode in range(positions.shape[-1]):
        points = np.asarray(positions[..., episode], float)
        near = (visibility.pairwise_distances(points) <= SCAN) & OTHER
        clear = visibility.shadow_clearance(points, R)
        assert (seen["global"][..., episode] == OTHER).all()
        assert (seen["scan"][..., episode] == near).all()
        expected = near & (clear >= 0)
        assert (seen["visible"][..., episode] == expected)[np.abs(clear) > 1e-4].all()
    assert seen["visible"].sum() < seen["scan"].sum() < seen["global"].sum()


def test_without_a_frame_of_its_own_a_robot_sees_the_worlds_coordinates():
    positions = configurations()
    _, view = look(positions)
    np.testing.assert_array_equal(view.x, positions[None, :, 0] - positions[:, None, 0])
    np.testing.assert_array_equal(view.y, positions[None, :, 1] - positions[:, None, 1])
    np.testing.assert_array_equal(view.landmark_x, -positions[:, 0])
    assert (np.asarray(view.radius) == R).all()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000), st.booleans(), st.booleans(), st.sampled_from([1.0, 4.0]))
def test_a_frame_changes_coordinates_only(seed, rotation, reflection, unit):
    positions = configurations(seed, batch=3)
    frames, view = look(positions, seed, rotation=rotation, reflection=reflection, unit_ratio=unit)
    sizes = np.asarray(frames.unit)
    assert (sizes <= unit * 1.001).all()
    assert (sizes >= 0.999 / unit).all()
    apart = np.hypot(view.x, view.y) * sizes[:, None]
    points = np.moveaxis(np.asarray(positions, float), -1, 0)
    expected = np.stack([visibility.pairwise_distances(p) for p in points], axis=-1)
    np.testing.assert_allclose(apart, expected, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(view.radius * sizes, np.full_like(sizes, R), rtol=1e-5)
    # What a robot perceives to lie ahead, it moves towards.
    offsets = jnp.stack([view.x[:, 0], view.y[:, 0]], axis=1) * frames.unit[:, None]
    np.testing.assert_allclose(frames.to_world(offsets), positions[:1] - positions, rtol=1e-4, atol=1e-3)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000), st.booleans(), st.booleans(), st.sampled_from([1.0, 4.0]))
def test_walls_are_perceived_where_they_are(seed, rotation, reflection, unit):
    positions = configurations(seed, batch=3)
    frames, view = look(positions, seed, rotation=rotation, reflection=reflection, unit_ratio=unit, walls=True)
    x, y = np.asarray(positions[:, 0], float), np.asarray(positions[:, 1], float)
    feet = [(np.full_like(x, X), y), (x, np.full_like(y, Y)), (np.full_like(x, -X), y), (x, np.full_like(y, -Y))]
    for wall, foot in enumerate(feet):
        perceived = positions + frames.to_world(view.walls[:, wall] * frames.unit[:, None])
        np.testing.assert_allclose(perceived, np.stack(foot, axis=1), atol=1e-4)
    assert look(positions, seed)[1].walls is None


def test_half_of_the_robots_see_a_mirror_image():
    positions = configurations(batch=100)
    frames, view = look(positions, rotation=True, reflection=True)
    share = float((np.asarray(frames.chirality) < 0).mean())
    assert 0.4 < share < 0.6
    turn = view.x[0, 1] * view.y[0, 2] - view.y[0, 1] * view.x[0, 2]
    a, b = positions[1] - positions[0], positions[2] - positions[0]
    assert (np.sign(turn) == np.sign(a[0] * b[1] - a[1] * b[0]) * np.asarray(frames.chirality[0])).all()


def test_noise_has_its_size_and_missed_robots_are_absent():
    positions = configurations(batch=400)
    _, exact = look(positions)
    _, blurred = look(positions, range_noise=0.05, bearing_noise=0.1)
    seen = np.asarray(exact.seen)
    far, true = (np.hypot(v.x, v.y)[seen] for v in (blurred, exact))
    assert np.std(far / true - 1) == pytest.approx(0.05, rel=0.05)
    angle = np.arctan2(blurred.y, blurred.x)[seen] - np.arctan2(exact.y, exact.x)[seen]
    assert np.std(np.angle(np.exp(1j * angle))) == pytest.approx(0.1, rel=0.05)
    _, missing = look(positions, miss_probability=0.3)
    lost = seen & ~np.asarray(missing.seen)
    assert lost.sum() / seen.sum() == pytest.approx(0.3, rel=0.05)
    assert (np.asarray(missing.x)[lost] == 0).all()
    assert not (np.asarray(missing.seen) & ~seen).any()


SMALL = WorldConfig(robots=6, half_width=40.0, half_height=40.0)


def seen_world(**sensing):
    world = World.create(SMALL, ScatteredStart())
    return world, LocalObservation(world, sensing_of(**sensing), SMALL)


def test_robots_move_as_they_mean_to():
    world, eyes = seen_world(use="visible", rotation=True, reflection=True, unit_ratio=2.0)
    state = eqx.filter_jit(eyes.reset_batch)(jax.random.key(0), 4)
    action = jax.random.normal(jax.random.key(1), (6, 2, 4)) * 0.3
    after, transition = eqx.filter_jit(eyes.step)(state, action)
    plain, expected = eqx.filter_jit(lambda: world.step(state.inner, state.frames.to_world(action)))()
    np.testing.assert_array_equal(after.positions, plain.positions)
    np.testing.assert_array_equal(transition.reward, expected.reward)
    np.testing.assert_array_equal(after.objective, plain.objective)
    np.testing.assert_allclose(
        np.hypot(*np.moveaxis(np.asarray(state.frames.to_world(action)), 1, 0)),
        np.hypot(action[:, 0], action[:, 1]),
        rtol=1e-5,
    )


def test_frames_last_an_episode_or_a_step_and_noise_is_always_new():
    for resampled in (False, True):
        _, eyes = seen_world(rotation=True, resample_frames=resampled, range_noise=0.1)
        state = eqx.filter_jit(eyes.reset_batch)(jax.random.key(0), 3)
        after, _ = eqx.filter_jit(eyes.step)(state, jnp.zeros((6, 2, 3)))
        assert np.array_equal(after.frames.cos, state.frames.cos) is not resampled
        first, second = (eqx.filter_jit(eyes.observe)(each) for each in (state, after))
        assert np.array_equal(first.positions, second.positions)
        assert not np.allclose(np.hypot(first.view.x, first.view.y), np.hypot(second.view.x, second.view.y))
    angles = np.asarray(state.frames.cos)
    assert len(np.unique(angles)) == angles.size


def test_one_configuration_and_a_batch_are_perceived_alike():
    _, eyes = seen_world(use="visible", rotation=True)
    positions = configurations(batch=1)
    view = eqx.filter_jit(lambda positions: eyes.observe(eyes.state(positions)).view)
    alone, batched = view(positions[..., 0]), view(positions)
    assert alone.x.shape == (6, 6)
    np.testing.assert_array_equal(alone.seen, batched.seen[..., 0])
    np.testing.assert_allclose(np.hypot(alone.x, alone.y), np.hypot(batched.x, batched.y)[..., 0], rtol=1e-5)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("unit_ratio", 0.5),
        ("unit_ratio", float("nan")),
        ("miss_probability", 1.0),
        ("miss_probability", -0.1),
        ("range_noise", 2.0),
    ],
)
def test_bad_sensing_is_refused(field, value):
    with pytest.raises(InputError, match=field):
        sensing_of(**{field: value})
