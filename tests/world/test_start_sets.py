"""Named sets of starts: the same for everyone, and noticed where they are not."""

from __future__ import annotations

import numpy as np
import pytest

import murmurate
from murmurate.errors import InputError, StartSetWarning
from murmurate.world import check_configurations, scaled_to, start_sets
from murmurate.world.start_sets import COUNT, FAMILIES, SIZES, checksum, checksums, draw_set, set_name, set_world

NAMES = [(family, robots) for family in FAMILIES for robots in SIZES if family != "rings" or robots >= 4]


def test_every_family_and_size_has_a_checksum():
    assert list(checksums()) == [set_name(family, robots) for family, robots in NAMES]
    assert len(set(checksums().values())) == len(NAMES)


@pytest.mark.parametrize("family", FAMILIES)
def test_a_set_is_what_the_package_says_and_clean(family):
    points = draw_set(family, set_world(4), COUNT)
    assert points.shape == (COUNT, 4, 2)
    assert points.dtype == np.float32
    check_configurations(points, set_world(4), family)
    assert checksum(points) == checksums()[f"murmurate-1/{family}/N4"]


@pytest.mark.nightly
@pytest.mark.parametrize(("family", "robots"), NAMES)
def test_every_set_is_what_the_package_says_and_clean(family, robots):
    points = draw_set(family, set_world(robots), COUNT)
    check_configurations(points, set_world(robots), family)
    assert checksum(points) == checksums()[set_name(family, robots)]


def test_the_first_starts_of_a_set_are_the_same_whatever_the_count():
    many = murmurate.start_set("cluster", robots=8)
    assert many.shape == (1000, 8, 2)
    for count in (1, 65, 1001):
        np.testing.assert_array_equal(murmurate.start_set("cluster", robots=8, count=count)[:1000], many[:count])


def test_other_sizes_have_no_checksum_but_starts():
    points = murmurate.start_set("corner", robots=20, count=2)
    assert points.shape == (2, 20, 2)
    check_configurations(points, set_world(20), "corner")


def test_the_world_of_the_sets_is_the_papers_scaled():
    world = scaled_to(set_world(8), 5)
    assert (world.half_width, world.half_height, world.radius) == (32.5, 32.5, 1)
    np.testing.assert_array_equal(draw_set("wall", world, 3), murmurate.start_set("wall", robots=5, count=3))


def test_a_set_that_differs_is_noticed(monkeypatch):
    other = dict.fromkeys(checksums(), "0" * 64)
    monkeypatch.setattr(start_sets, "checksums", lambda: other)
    with pytest.warns(StartSetWarning, match="the starts murmurate-1/line/N3 differ on this machine"):
        murmurate.start_set("line", robots=3, count=1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("star", 8), "family = 'star': must be one of random, cluster"),
        (("hard", 8), "family = 'hard': must be one of random, cluster"),
        (("cluster", 1), "robots = 1: must be an integer"),
        (("cluster", 8, 0), "count = 0: must be an integer"),
        (("rings", 3), "robots = 3: must be at least 4"),
    ],
)
def test_no_such_set(arguments, message):
    with pytest.raises(InputError, match=message):
        murmurate.start_set(*arguments)
