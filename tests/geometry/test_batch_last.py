"""The kernels take NumPy's or JAX's arrays, with any number of batch axes last, and check nothing."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from murmurate.geometry import _batch_last
from oracles.configurations import disjoint

RADIUS, SCAN = 1.0, 8.0


def beside(positions):
    """Two discs and a wall, the same in every episode of the positions' batch."""
    ones = (1,) * (np.ndim(positions) - 2)
    discs, wall = [[4.0, 1.0, 2.0], [-3.0, 2.0, 0.5]], [[-5.0, -5.0, 2.0, -4.0]]
    return [np.array(rows, np.float32).reshape((*np.shape(rows), *ones)) for rows in (discs, wall)]


KERNELS = {
    "neighbors": lambda p: _batch_last.neighbors(p, SCAN),
    "occluded": lambda p: _batch_last.occluded(p, RADIUS),
    "visible": lambda p: _batch_last.visible(p, RADIUS, SCAN),
    "neighbors_and_visible": lambda p: _batch_last.neighbors_and_visible(p, RADIUS, SCAN),
    "distances": _batch_last.distances,
    "clearances": lambda p: _batch_last.clearances(p, RADIUS),
    "closest_approach": lambda p: _batch_last.closest_approach(p, p),
    "any_contact": lambda p: _batch_last.any_contact(p, p, RADIUS),
    "sole_occluder_counts": lambda p: _batch_last.sole_occluder_counts(p, RADIUS, SCAN),
    "on_hull": _batch_last.on_hull,
    "contact_matrix": lambda p: _batch_last.contact_matrix(p, p, RADIUS),
    "in_contact": lambda p: _batch_last.in_contact(p, p, RADIUS),
    "outside": lambda p: _batch_last.outside(p, 4.0, 4.0),
    "any_outside": lambda p: _batch_last.any_outside(p, 4.0, 4.0),
    "obstacle_clearances": lambda p: _batch_last.obstacle_clearances(p, RADIUS, *beside(p)),
    "obstacle_approach": lambda p: _batch_last.obstacle_approach(
        p, np.ones(np.shape(p), np.float32), RADIUS, *beside(p)
    ),
    "occluded_by_obstacles": lambda p: _batch_last.occluded_by_obstacles(p, RADIUS, *beside(p)),
    "nearest_points": lambda p: _batch_last.nearest_points(p, *beside(p)),
    "distances_to_walls": lambda p: _batch_last.distances_to_walls(p, beside(p)[1]),
}
every_kernel = pytest.mark.parametrize("kernel", KERNELS.values(), ids=KERNELS)


def same(actual, expected):
    jax.tree.map(np.testing.assert_array_equal, actual, expected)


def test_every_kernel_is_here():
    tools = {
        "as_floating", "fold", "hull_neighbors", "hull_shares", "other_robots", "sum_over_third_robots", "sum_terms",
    }  # fmt: skip
    of_views, of_walls = {"stands_between"}, {"distances_between_walls"}
    assert set(KERNELS) == set(_batch_last.__all__) - tools - of_views - of_walls


@pytest.mark.unchecked
@every_kernel
def test_integers_and_lists_are_numbers_too(kernel):
    whole = [[0, 0], [3, 0], [7, 1], [-2, 5]]
    expected = kernel(np.array(whole, float))
    same(kernel(whole), expected)
    same(kernel(np.array(whole)), expected)
    same(kernel(tuple(map(tuple, whole))), expected)
    same(kernel(jnp.array(whole)), kernel(jnp.array(whole, jnp.float32)))


@every_kernel
@pytest.mark.parametrize("xp", [np, jnp], ids=["numpy", "jax"])
def test_what_goes_in_comes_out(kernel, xp):
    positions = xp.asarray([[0, 0], [3, 0], [7, 1]], dtype=xp.float32)
    for leaf in jax.tree.leaves(kernel(positions)):
        assert isinstance(leaf, np.ndarray | np.generic if xp is np else jax.Array)
        assert leaf.dtype in (np.bool_, np.float32) or np.issubdtype(leaf.dtype, np.integer)
    np.testing.assert_array_equal(positions, [[0, 0], [3, 0], [7, 1]])


@every_kernel
def test_batch_axes_stand_last(kernel):
    positions = disjoint(np.random.default_rng(0), 12, 5, RADIUS, side=12.0).astype(float)
    flat = np.moveaxis(positions, 0, -1)
    expected = jax.tree.map(lambda *leaves: np.stack(leaves, -1), *map(kernel, positions))
    same(kernel(flat), expected)
    same(kernel(flat.reshape(5, 2, 3, 4)), jax.tree.map(lambda a: a.reshape(*a.shape[:-1], 3, 4), expected))


@every_kernel
def test_compiled_as_well_as_not(kernel):
    positions = disjoint(np.random.default_rng(1), 12, 5, RADIUS, side=12.0)
    compiled = jax.jit(kernel)(np.moveaxis(positions, 0, -1))
    mapped = jax.vmap(kernel, in_axes=0, out_axes=-1)(jnp.asarray(positions))
    expected = kernel(np.moveaxis(positions, 0, -1).astype(float))
    for answer in (compiled, mapped):
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-5), answer, expected)
