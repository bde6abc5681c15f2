"""The Markov decision process: world, signals, objective and starts. Knows geometry and nothing of learning."""

from murmurate.world.config import WorldConfig
from murmurate.world.signals import OBJECTIVES, Objective, WeightsConfig, signal_names, signals
from murmurate.world.starts import (
    Anywhere,
    Layouts,
    Mixture,
    Start,
    StartConfig,
    check_configurations,
    draw_starts,
    layout,
    make_start,
    read_starts,
)
from murmurate.world.world import State, Transition, World

__all__ = [
    "OBJECTIVES",
    "Anywhere",
    "Layouts",
    "Mixture",
    "Objective",
    "Start",
    "StartConfig",
    "State",
    "Transition",
    "WeightsConfig",
    "World",
    "WorldConfig",
    "check_configurations",
    "draw_starts",
    "layout",
    "make_start",
    "read_starts",
    "signal_names",
    "signals",
]
