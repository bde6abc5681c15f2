"""The public functions: batch axes first, the answers of the kernels, and one line for bad input."""

from __future__ import annotations

import doctest
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from murmurate import geometry
from murmurate.errors import InputError
from murmurate.geometry import _batch_last
from oracles.configurations import disjoint

RADIUS, SCAN = 1.0, 8.0
ARGUMENTS = {
    "neighbors": (SCAN,),
    "occluded": (RADIUS,),
    "visible": (RADIUS, SCAN),
    "neighbors_and_visible": (RADIUS, SCAN),
    "sole_occluder_counts": (RADIUS, SCAN),
    "distances": (),
    "clearances": (RADIUS,),
    "closest_approach": (None,),
    "contact_matrix": (None, RADIUS),
    "in_contact": (None, RADIUS),
    "any_contact": (None, RADIUS),
    "outside": (4.0, 5.0),
    "any_outside": (4.0, 5.0),
    "on_hull": (),
}
"""The arguments after the positions; None stands for velocities, for which the positions are taken."""

every_function = pytest.mark.parametrize("name", ARGUMENTS)


def call(name, positions, package=geometry):
    arguments = (positions if argument is None else argument for argument in ARGUMENTS[name])
    return getattr(package, name)(positions, *arguments)


@every_function
@pytest.mark.parametrize("xp", [np, jnp], ids=["numpy", "jax"])
def test_the_batch_is_first_and_the_answers_are_the_kernels(name, xp):
    positions = xp.asarray(disjoint(np.random.default_rng(0), 12, 5, RADIUS, side=12.0))
    kernel = call(name, xp.moveaxis(positions, 0, -1), _batch_last)
    batched = call(name, positions.reshape(3, 4, 5, 2))
    for whole, expected in zip(jax.tree.leaves(batched), jax.tree.leaves(kernel), strict=True):
        assert isinstance(whole, np.ndarray if xp is np else jax.Array)
        axes = tuple(range(expected.ndim))
        first = np.transpose(np.asarray(expected), (axes[-1], *axes[:-1]))
        np.testing.assert_array_equal(whole, first.reshape(3, 4, *first.shape[1:]))


@pytest.mark.unchecked
@every_function
def test_one_configuration_and_lists_of_integers(name):
    whole = [[0, 0], [3, 0], [7, 1], [-2, 5]]
    for answer in (call(name, whole), call(name, np.array(whole)), call(name, np.array(whole, float))):
        jax.tree.map(np.testing.assert_array_equal, answer, call(name, np.array(whole, float), _batch_last))


@every_function
def test_under_jit_and_vmap_as_eagerly(name):
    positions = jnp.asarray(disjoint(np.random.default_rng(1), 12, 5, RADIUS, side=12.0))
    expected = call(name, positions)
    for answer in (jax.jit(lambda p: call(name, p))(positions), jax.vmap(lambda p: call(name, p))(positions)):
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-5), answer, expected)


def test_lengths_may_be_traced_or_arrays():
    positions = np.array([[0.0, 0.0], [4.0, 0.0], [8.0, 0.0]], np.float32)
    expected = geometry.visible(positions, RADIUS, SCAN)
    np.testing.assert_array_equal(jax.jit(geometry.visible)(positions, RADIUS, SCAN), expected)
    np.testing.assert_array_equal(geometry.visible(positions, np.float32(1), jnp.float32(8)), expected)
    assert geometry.neighbors(positions, np.inf).sum() == 6


@pytest.mark.unchecked
@every_function
@pytest.mark.parametrize("trace", [False, True], ids=["eager", "jit"])
@pytest.mark.parametrize("shape", [(5, 3), (2, 5), (5,), (), (0, 2), (4, 2, 5)], ids=str)
def test_wrong_shapes_are_refused(name, shape, trace):
    program = jax.jit(lambda p: call(name, p)) if trace else lambda p: call(name, p)
    with pytest.raises(InputError, match=r"^positions = \(.*must be finite numbers of shape \(\.\.\., robots, 2\)"):
        program(np.zeros(shape))


@every_function
@pytest.mark.parametrize("number", [np.nan, np.inf])
@pytest.mark.parametrize("xp", [np, jnp], ids=["numpy", "jax"])
def test_nan_and_infinity_are_refused(name, number, xp):
    positions = np.zeros((3, 4, 2))
    positions[1, 2, 0] = number
    with pytest.raises(InputError, match=rf"^positions = \[{number}, 0\.0\]: must be finite"):
        call(name, xp.asarray(positions))


@every_function
@pytest.mark.parametrize(("dtype", "most"), [(np.float32, 1e19), (np.float64, 1e154)])
@pytest.mark.parametrize("xp", [np, jnp], ids=["numpy", "jax"])
def test_coordinates_whose_squares_overflow_are_refused(name, xp, dtype, most):
    with jax.enable_x64(True):
        positions = np.zeros((2, 3, 2), dtype)
        positions[:, :, 0] = np.arange(3) * 4.0
        positions[1] += most
        with pytest.raises(InputError, match=r"^positions = .* must be .* of magnitude up to") as error:
            call(name, xp.asarray(positions))
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_as_far_as_coordinates_may_go_contacts_are_found(dtype):
    """Two robots that fly towards each other from either end of what is allowed meet in the middle."""
    far = np.sqrt(np.finfo(dtype).max) / 4 * (1 - 1e-3)
    positions = np.array([[-far, -far], [far, far], [far, -far]], dtype)
    velocities = np.array([[far, far], [-far, -far], [0, 0]], dtype)
    np.testing.assert_array_equal(geometry.in_contact(positions, velocities, float(far) / 1e3), [True, True, False])
    assert np.isfinite(geometry.distances(positions)).all()
    with pytest.raises(InputError, match=r"^velocities = "):
        geometry.in_contact(positions, 2 * velocities, RADIUS)


@pytest.mark.parametrize("positions", [[["a", "b"]], [[True, False]], [[1j, 0]], [[1, 2], [3]], None, "positions"])
def test_what_is_not_numbers_is_refused(positions):
    with pytest.raises(InputError, match="positions"):
        geometry.distances(positions)


@pytest.mark.unchecked
@pytest.mark.parametrize("bad", [0, -1.0, np.nan, "1", True, None, [1.0, 2.0], np.inf], ids=repr)
def test_lengths_that_are_not_positive_are_refused(bad):
    positions = np.zeros((3, 2))
    with pytest.raises(InputError, match=r"radius = .*must be a finite number > 0"):
        geometry.occluded(positions, bad)
    if bad == np.inf:
        return
    with pytest.raises(InputError, match="scan_radius"):
        geometry.visible(positions, RADIUS, bad)
    with pytest.raises(InputError, match="half_width"):
        geometry.outside(positions, bad, 1.0)


def test_velocities_of_another_shape_are_refused():
    with pytest.raises(InputError, match=r"velocities = \(3, 2\): must be of the positions' shape, \(4, 3, 2\)"):
        geometry.any_contact(np.zeros((4, 3, 2)), np.zeros((3, 2)), RADIUS)


def test_the_final_configurations_of_a_rollout():
    """The call that used to answer nonsense: (episodes, robots, 2)."""
    final = np.random.default_rng(0).uniform(-9, 9, (7, 5, 2)).astype(np.float32)
    seen = geometry.visible(final, RADIUS, SCAN)
    assert seen.shape == (7, 5, 5)
    np.testing.assert_array_equal(seen, [geometry.visible(each, RADIUS, SCAN) for each in final])


def test_the_example_of_the_package():
    failed, attempted = doctest.testmod(geometry)
    assert (failed, attempted > 0) == (0, True)


def test_geometry_does_without_jax():
    code = (
        "import numpy, murmurate.geometry as g, sys; g.visible(numpy.eye(2), 0.1, 1); "
        "print(*sorted({'jax', 'equinox', 'optax', 'matplotlib'} & set(sys.modules)))"
    )
    finished = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert finished.stdout.split() == []
