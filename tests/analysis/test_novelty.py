from __future__ import annotations

import numpy as np
import pytest

from murmurate.analysis import Catalogue, Finding, unmatched
from murmurate.geometry.similarity import distance


def ring(robots, radius=1.0):
    angle = 2 * np.pi * np.arange(robots) / robots
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def around(robots):
    return np.vstack([ring(robots - 1, 6.0), [[0.0, 0.0]]])


# No mirror image of it is a turned copy.
CHIRAL = np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 7.0], [-3.0, 11.0], [-9.0, 2.0], [2.0, -6.0]])


def catalogue(*patterns, **how):
    sizes = {"radius": 1.0, "safe_distance": 5.0, "scan_radius": 20.0, "objective": "C1", "gap": None}
    source = {"experiment": "C", "policy": "equivariant", "start": "scattered", "seed": 0, "run": "a run"}
    findings = [
        Finding(pattern, value=4.0 - index / 10, episode=index, **sizes, **source)
        for index, pattern in enumerate(patterns)
    ]
    return Catalogue.from_findings(findings, **how)


def moved(pattern, turn=1.3, scale=2.0, mirror=False):
    z = (pattern[::-1, 0] + 1j * pattern[::-1, 1]) * np.exp(1j * turn) * scale + (3 - 8j)
    return np.stack([z.real, -z.imag if mirror else z.imag], axis=1)


def names(classes):
    return [pattern.name for pattern in classes]


def test_a_pattern_moved_and_relabelled_is_found():
    candidates = catalogue(ring(6), around(6), CHIRAL)
    assert len(candidates.classes) == 3
    assert names(unmatched(candidates, [])) == ["P1", "P2", "P3"]
    assert names(unmatched(candidates, [moved(around(6))])) == ["P1", "P3"]
    assert unmatched(candidates, [moved(CHIRAL, mirror=True), moved(ring(6)), moved(around(6))]) == ()


def test_it_compares_as_the_catalogue_does():
    sized = catalogue(ring(6, 3.0), tolerance=0.1, scaling=False)
    assert names(unmatched(sized, [ring(6, 3.3)])) == ["P1"]
    assert unmatched(sized, [ring(6, 3.05)]) == ()
    handed = catalogue(CHIRAL, reflection=False)
    assert names(unmatched(handed, [moved(CHIRAL, mirror=True)])) == ["P1"]
    assert unmatched(handed, [moved(CHIRAL)]) == ()


@pytest.mark.parametrize("seed", range(5))
def test_the_tolerance_is_the_distance(seed):
    rng = np.random.default_rng(seed)
    pattern, other = rng.normal(size=(2, 5, 2))
    apart = distance(pattern, other)
    assert unmatched(catalogue(pattern, tolerance=apart * 1.001), [other]) == ()
    assert names(unmatched(catalogue(pattern, tolerance=apart * 0.999), [other])) == ["P1"]


@pytest.mark.unchecked
def test_swarms_of_another_size_are_refused():
    with pytest.raises(ValueError, match="robots"):
        unmatched(catalogue(ring(6)), [ring(5)])
