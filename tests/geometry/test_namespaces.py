"""The kernels as arrays see them: whatever they are given, NumPy's or JAX's, and however many batch axes stand last."""

from __future__ import annotations

import doctest
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from murmurate import geometry
from oracles.configurations import disjoint

RADIUS, SCAN = 1.0, 8.0
KERNELS = {
    "neighbors": lambda p: geometry.neighbors(p, SCAN),
    "occluded": lambda p: geometry.occluded(p, RADIUS),
    "visible": lambda p: geometry.visible(p, RADIUS, SCAN),
    "neighbors_and_visible": lambda p: geometry.neighbors_and_visible(p, RADIUS, SCAN),
    "counts": lambda p: geometry.counts(p, RADIUS, SCAN),
    "distances": geometry.distances,
    "clearances": lambda p: geometry.clearances(p, RADIUS),
    "closest_approach": lambda p: geometry.closest_approach(p, p),
    "collides": lambda p: geometry.collides(p, p, RADIUS),
    "hides": lambda p: geometry.hides(p, RADIUS, SCAN),
    "contacts": lambda p: geometry.contacts(p, p, RADIUS),
    "touches": lambda p: geometry.touches(p, p, RADIUS),
    "outside": lambda p: geometry.outside(p, 4.0, 4.0),
    "leaves": lambda p: geometry.leaves(p, 4.0, 4.0),
}
every_kernel = pytest.mark.parametrize("kernel", KERNELS.values(), ids=KERNELS)


def same(actual, expected):
    jax.tree.map(np.testing.assert_array_equal, actual, expected)


def test_every_kernel_is_here():
    # A shadow is drawn, one at a time, in NumPy.
    assert set(KERNELS) == set(geometry.__all__) - {"Counts", "shadow"}


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


def test_sizes_may_be_traced():
    positions = jnp.array([[0.0, 0.0], [4.0, 0.0], [8.0, 0.0]])
    seen = jax.jit(geometry.visible)(positions, RADIUS, SCAN)
    same(seen, geometry.visible(np.asarray(positions), RADIUS, SCAN))


def test_the_example_of_the_package():
    failed, attempted = doctest.testmod(geometry)
    assert (failed, attempted > 0) == (0, True)


def test_geometry_does_without_jax():
    code = (
        "import murmurate.geometry, sys; print(*sorted({'jax', 'equinox', 'optax', 'matplotlib'} & set(sys.modules)))"
    )
    finished = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert finished.stdout.split() == []
