"""Symmetric starts are what they say, and fit."""

from __future__ import annotations

import numpy as np
import pytest

from murmurate.errors import InputError
from murmurate.geometry import distances
from murmurate.world import WorldConfig, family, scaled_to, symmetric_starts


def is_kept_by(points, matrix):
    """Whether a linear map takes a configuration onto itself, robots being alike."""
    moved = points @ np.array(matrix, float)
    return bool((np.linalg.norm(moved[:, None] - points[None], axis=2).min(axis=1) < 1e-9).all())


def turn(angle):
    return [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]


@pytest.mark.parametrize("robots", [4, 5, 9, 12, 16])
def test_every_family_has_its_symmetry(robots):
    flip = np.diag([1.0, -1.0])
    polygon, line, grid, rings = (family(name, robots) for name in ("polygon", "line", "grid", "rings"))
    assert is_kept_by(polygon, turn(2 * np.pi / robots))
    assert is_kept_by(line, turn(np.pi))
    assert is_kept_by(line, flip)
    assert is_kept_by(grid, np.diag([-1.0, 1.0]))
    assert is_kept_by(rings, turn(2 * np.pi / (robots // 2)))
    for points in (polygon, line, grid, rings):
        assert points.shape == (robots, 2)
        assert distances(points)[~np.eye(robots, dtype=bool)].min() == pytest.approx(1)


@pytest.mark.parametrize("name", ["polygon", "line", "grid", "rings"])
@pytest.mark.parametrize("robots", [4, 7, 16])
def test_starts_fit_and_differ_in_size_and_direction(name, robots):
    world = scaled_to(WorldConfig(), robots)
    starts = symmetric_starts(name, world, 50, seed=1)
    assert starts.shape == (50, robots, 2)
    assert (np.abs(starts) <= 0.81 * world.half_width).all()
    apart = distances(np.moveaxis(starts, 0, -1))[~np.eye(robots, dtype=bool)].min(axis=0)
    assert (apart >= 3 - 1e-9).all()
    assert len(np.unique(apart.round(6))) == 50
    # The shape is the family's: all distances in the same proportion.
    shape = distances(family(name, robots))
    np.testing.assert_allclose(distances(starts[3]) / apart[3], shape, atol=1e-9)
    np.testing.assert_array_equal(starts, symmetric_starts(name, world, 50, seed=1))


@pytest.mark.parametrize(
    ("name", "robots", "line"),
    [
        ("star", 5, "family = 'star': must be one of polygon, line, grid, rings"),
        ("rings", 3, "robots = 3: must be at least 4 for the start rings"),
        ("line", 60, "robots = 60: must be few enough to fit the start line"),
    ],
)
def test_what_cannot_be_is_refused(name, robots, line):
    with pytest.raises(InputError) as caught:
        symmetric_starts(name, WorldConfig(robots=robots), 1)
    assert str(caught.value) == line
