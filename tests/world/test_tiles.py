"""Large batches in tiles: the same numbers as the whole batch at once, to the last bit."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from murmurate.world import (
    LocalObservation,
    ScatteredStart,
    SchedulerWrapper,
    SsyncScheduler,
    UniformStart,
    VisibleSensing,
    World,
    WorldConfig,
    tiles,
)

CONFIG = WorldConfig(robots=4, half_width=20.0, half_height=15.0, scan_radius=12.0)


@pytest.fixture
def small_tiles(monkeypatch):
    """Makes tiles of 32 episodes, whatever the swarm."""
    monkeypatch.setattr(tiles, "OBSERVER_BYTES", 0)
    monkeypatch.setattr(tiles, "LEAST", 32)


def episodes(env, batch):
    """Everything that a batch of episodes goes through in three steps, some with collisions."""

    def step(state, velocities):
        state, transition = env.step(state, velocities)
        return state, (state, transition, env.observe(state))

    def run(key):
        state = env.reset_batch(key, batch)
        moves = 2 * jax.random.normal(jax.random.key(7), (3, env.config.robots, 2, batch), jnp.float32)
        return state, jax.lax.scan(step, state, moves)[1]

    # Without optimisation a program may round otherwise in tiles.
    key = jax.random.key(3)
    return jax.jit(run).lower(key).compile({"xla_backend_optimization_level": 1})(key)


def assert_same(first, second):
    jax.tree.map(np.testing.assert_array_equal, first, second)
    assert jax.tree.map(lambda x: x.dtype, first) == jax.tree.map(lambda x: x.dtype, second)


def whole(monkeypatch, *arguments):
    with monkeypatch.context() as patch:
        patch.setattr(tiles, "tile_size", lambda robots, batch: batch)
        return episodes(*arguments)


def test_perceived_and_scheduled_episodes_are_the_same(small_tiles, monkeypatch):
    """With noise, frames and schedulers that draw from every episode's own key; 75 is no multiple of a tile."""
    world = World.create(CONFIG, UniformStart(), horizon=2, per_robot_credit=True)
    sensing = VisibleSensing(rotation=True, reflection=True, range_noise=0.1, miss_probability=0.2, walls=True)
    env = LocalObservation(SchedulerWrapper(world, SsyncScheduler()), sensing, CONFIG)
    assert tiles.tile_size(CONFIG.robots, 75) == 32
    assert_same(episodes(env, 75), whole(monkeypatch, env, 75))


def test_ten_robots_are_the_same_in_tiles_of_the_usual_size(monkeypatch):
    world = World.create(WorldConfig(robots=10), ScatteredStart())
    results = episodes(world, 300)
    assert tiles.tile_size(10, 300) == 128
    assert_same(results, whole(monkeypatch, world, 300))
    ended = results[1][1].terminated
    assert 0 < ended.sum() < ended.size


@pytest.mark.parametrize("batch", [0, 1, 31, 32, 33, 96, 100])
def test_every_episode_is_computed_by_itself(small_tiles, batch):
    seen = []

    def function(pair, number):
        seen.append(pair.shape)
        return {"sum": pair.sum(axis=(0, 1)) + number, "pair": pair, "even": number % 2 == 0}

    pair = jnp.arange(4.0 * batch).reshape(2, 2, batch)
    number = jnp.arange(batch)
    compute = jax.jit(lambda *arguments: tiles.in_tiles(function, 2, *arguments))
    assert_same(compute(pair, number), function(pair, number))
    assert seen[0] == (2, 2, min(batch, 32))
    both = jax.jit(jax.vmap(lambda *arguments: tiles.in_tiles(function, 2, *arguments)))
    assert_same(both(jnp.stack([pair, -pair]), jnp.stack([number] * 2))["sum"][1], -pair.sum(axis=(0, 1)) + number)


def test_a_batch_stays_whole_where_it_has_to(small_tiles, monkeypatch):
    pair = jnp.ones((2, 2, 100))

    def shape_of(x):
        return jnp.full(x.shape[-1:], x.shape[-1])

    def compute(function=shape_of):
        return jax.jit(lambda x: tiles.in_tiles(function, 2, x))(pair)

    assert (compute() == 32).all()
    assert (tiles.in_tiles(shape_of, 2, pair) == 100).all(), "outside of a jit a loop would be compiled at every call"
    assert compute(lambda x: jnp.float32(x.shape[-1])) == 100, "the result does not depend on the episode"
    with monkeypatch.context() as patch:
        patch.setattr(jax, "device_count", lambda: 2)
        assert (compute() == 100).all()
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert (compute() == 100).all()


def test_tiles_are_of_nearly_equal_size_and_fit_the_cache():
    batches = (0, 1, 128, 129, 256, 257, 300, 1024, 4096)
    assert [tiles.tile_size(10, batch) for batch in batches] == [0, 1, 128, 96, 128, 96, 128, 128, 128]
    assert [tiles.tile_size(robots, 1 << 16) for robots in (5, 9, 12, 19, 20, 4096)] == [256, 256, 128, 128, 64, 64]
