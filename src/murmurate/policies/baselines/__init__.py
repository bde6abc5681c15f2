"""Hand-written policies with the interface and the eyes of the learned one: what it has to be better than.

Each maps an observation to velocities in each robot's own frame, world units per step, and, unless it says that it is
centralised, looks at nothing but the view: no memory, no names, no messages, no common frame.
"""

from __future__ import annotations

from murmurate.policies.baselines.centroid import Centroid
from murmurate.policies.baselines.circle import CentralCircle, VisibleCircle
from murmurate.policies.baselines.gradient import GradientAscent
from murmurate.policies.baselines.random import RandomWalk
from murmurate.policies.baselines.two_color import TwoColor

__all__ = ["BASELINES", "CentralCircle", "Centroid", "GradientAscent", "RandomWalk", "TwoColor", "VisibleCircle"]

BASELINES = {
    "random": RandomWalk,
    "centroid": Centroid,
    "circle-central": CentralCircle,
    "circle": VisibleCircle,
    "gradient": GradientAscent,
    "two-color": TwoColor,
}
"""Every baseline by name; each is built of a `WorldConfig` and whether there is a landmark."""
