"""The convex hull and its layers: cases by hand, and SciPy's Qhull."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from murmurate.errors import InputError
from murmurate.geometry import convex_layers, on_hull

CENTRE = np.zeros((1, 2))


def ring(robots, radius=1.0):
    angle = 2 * np.pi * np.arange(robots) / robots
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


SQUARE = 2 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
ON_EDGES = np.array([[0.0, -2.0], [2.0, 0.7]])

LAYERS = {
    "one robot": (CENTRE, (1,)),
    "two": (ring(2), (2,)),
    "triangle": (ring(3), (3,)),
    "line": (np.arange(5)[:, None] * [[0.3, 0.7]], (5,)),
    "ring around one": (np.vstack([ring(9), CENTRE]), (9, 1)),
    "three rings": (np.vstack([ring(5, 3.0), ring(4, 1.0), ring(3, 0.2)]), (5, 4, 3)),
    "on the edges": (np.vstack([SQUARE, ON_EDGES]), (6,)),
    "just inside": (np.vstack([SQUARE, 0.999 * ON_EDGES]), (4, 2)),
    "line inside": (np.vstack([SQUARE, [[-0.5, 0.0], [0.0, 0.0], [0.5, 0.0]]]), (4, 3)),
    "all at one place": (np.ones((4, 2)), (4,)),
    "two at one corner": (np.vstack([SQUARE, SQUARE[:1], CENTRE]), (5, 1)),
    "two inside at one place": (np.vstack([SQUARE, CENTRE, CENTRE]), (4, 2)),
}


@pytest.mark.parametrize(("points", "layers"), LAYERS.values(), ids=LAYERS)
@pytest.mark.parametrize("angle", [0.0, 0.4, 2.0])
def test_layers(points, layers, angle):
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    assert convex_layers(points) == layers
    assert convex_layers(7 * points @ turn.T + 5) == layers
    assert convex_layers((7 * points @ turn.T).astype(np.float32)) == layers


@given(st.integers(3, 12), st.integers(0, 1000))
def test_the_hull_is_qhulls(robots, seed):
    left, layers = np.random.default_rng(seed).normal(size=(robots, 2)), []
    counted = convex_layers(left)
    while len(left) > 2:
        vertices = ConvexHull(left).vertices
        layers.append(len(vertices))
        left = np.delete(left, vertices, axis=0)
    assert counted == tuple(layers + [len(left)] * bool(len(left)))


def test_batches_in_numpy_and_jax():
    points = np.random.default_rng(0).normal(size=(3, 4, 9, 2))
    flags = on_hull(points)
    assert flags.shape == (3, 4, 9)
    for index in np.ndindex(3, 4):
        np.testing.assert_array_equal(np.flatnonzero(flags[index]), np.sort(ConvexHull(points[index]).vertices))
    np.testing.assert_array_equal(on_hull(jnp.asarray(points, jnp.float32)), flags)


@pytest.mark.parametrize("bad", [np.zeros(4), np.zeros((0, 2)), np.full((2, 2), np.nan), [[1.0], [1.0, 2.0]]])
def test_no_such_configuration(bad):
    for function in (on_hull, convex_layers):
        with pytest.raises(InputError, match=r"^positions = "):
            function(bad)
