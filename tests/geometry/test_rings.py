"""The smallest regular rings, beside shadows as polygons."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest

from murmurate.analysis.optimum.formation import Target
from murmurate.errors import InputError
from murmurate.geometry.rings import smallest_ring, smallest_ring_radius, visible_ring_radius
from murmurate.world import WorldConfig
from oracles import visibility


def regular(robots, radius):
    angles = 2 * np.pi * np.arange(robots) / robots
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


@pytest.mark.parametrize("robots", range(3, 40))
@pytest.mark.parametrize("radius", [0.4, 1.0])
def test_on_the_smallest_ring_everyone_just_sees_everyone(robots, radius):
    smallest = visible_ring_radius(robots, radius)
    gaps = visibility.shadow_clearance(regular(robots, smallest * (1 + 1e-6)), radius)
    assert gaps.min() == pytest.approx(0, abs=1e-3 * radius)
    assert gaps.min() > 0
    # The oracle needs disjoint robots: on a ring of three the discs touch before they hide each other.
    if robots > 3:
        assert visibility.shadow_clearance(regular(robots, smallest * (1 - 1e-6)), radius).min() < 0


def test_three_robots_hide_each_other_when_they_touch():
    assert visible_ring_radius(3, 1.0) == pytest.approx(2 / math.sqrt(3))
    assert visible_ring_radius(2, 1.0) == 1.0


@pytest.mark.parametrize("robots", [2, 3, 8, 10, 16, 30])
def test_a_ring_is_safe_and_visible_and_no_smaller_one_is(robots):
    target = Target(WorldConfig(robots=robots, half_width=90, half_height=90, scan_radius=300), "C1")
    circle = smallest_ring(robots, 1.0, 5.0)
    assert target.is_valid(circle.positions)
    assert not target.is_valid(circle.positions * (1 - 1e-9))
    assert circle.radius == pytest.approx(max(circle.visible, circle.safe))


@pytest.mark.parametrize("robots", range(2, 30))
def test_a_ring_has_the_closed_forms_that_the_docs_state(robots):
    circle = smallest_ring(robots, 1.0, 5.0)
    apart = np.hypot(*(circle.positions[:, None] - circle.positions[None]).T)
    mean = apart.sum() / (robots * (robots - 1))
    assert mean == pytest.approx(2 * circle.radius / math.tan(math.pi / (2 * robots)) / (robots - 1))
    assert np.hypot(*circle.positions.T) == pytest.approx(circle.radius)


def test_arrays_of_numbers_of_robots():
    robots = np.array([0, 1, 2, 3, 5, 8, 12, 40])
    expected = [smallest_ring(max(n, 2), 1.0, 5.0).radius for n in robots.tolist()]
    np.testing.assert_allclose(smallest_ring_radius(robots, 1.0, 5.0), expected, rtol=1e-11)
    radii = smallest_ring_radius(jnp.asarray(robots, jnp.float32), 1.0, 5.0)
    assert radii.dtype == jnp.float32
    np.testing.assert_allclose(radii, expected, rtol=1e-5)


@pytest.mark.parametrize(("field", "values"), [("robots", (1, 1.0, 5.0)), ("radius", (5, 0.0, 5.0))])
def test_no_such_ring(field, values):
    with pytest.raises(InputError, match=rf"^{field} = "):
        smallest_ring(*values)
