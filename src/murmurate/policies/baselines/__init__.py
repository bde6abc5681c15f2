"""Hand-written policies that learned ones are compared with, on the same observations.

Each maps an observation to velocities. Unless it is centralised, it uses nothing but each robot's own view: no memory,
no names, no messages, no common frame. `Baseline.registered()` returns the baselines of the package by name.
"""

from __future__ import annotations

from murmurate.policies.baselines.base import Baseline, Centroid, RandomWalk
from murmurate.policies.baselines.circle import CentralCircle, VisibleCircle
from murmurate.policies.baselines.gradient import GradientAscent
from murmurate.policies.baselines.two_color import TwoColor

__all__ = ["Baseline", "CentralCircle", "Centroid", "GradientAscent", "RandomWalk", "TwoColor", "VisibleCircle"]
