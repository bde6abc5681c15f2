"""The Markov decision process: world, signals, objective and starts. Knows geometry and nothing of learning."""

from murmurate.world.config import WorldConfig, grown
from murmurate.world.perception import Observation, Perceived, PerceivedState
from murmurate.world.schedulers import Scheduled, ScheduledState, SchedulerConfig, SchedulerKind, epochs_of
from murmurate.world.sensing import Frames, SensingConfig, SensingKind, View, draw_frames, perceive
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
from murmurate.world.symmetric import Family, family, symmetric_starts
from murmurate.world.world import State, Transition, World

__all__ = [
    "OBJECTIVES",
    "Anywhere",
    "Family",
    "Frames",
    "Layouts",
    "Mixture",
    "Objective",
    "Observation",
    "Perceived",
    "PerceivedState",
    "Scheduled",
    "ScheduledState",
    "SchedulerConfig",
    "SchedulerKind",
    "SensingConfig",
    "SensingKind",
    "Start",
    "StartConfig",
    "State",
    "Transition",
    "View",
    "WeightsConfig",
    "World",
    "WorldConfig",
    "check_configurations",
    "draw_frames",
    "draw_starts",
    "epochs_of",
    "family",
    "grown",
    "layout",
    "make_start",
    "perceive",
    "read_starts",
    "signal_names",
    "signals",
    "symmetric_starts",
]
