"""The Markov decision process: world, signals, objective and starts. Knows geometry and nothing of learning."""

from murmurate.world.config import WorldConfig, scaled_to
from murmurate.world.perception import LocalObservation, Observation, ObservedState
from murmurate.world.scheduling import ScheduledState, SchedulerConfig, SchedulerKind, SchedulerWrapper, epochs_of
from murmurate.world.sensing import Frames, SensingConfig, SensingKind, View, draw_frames, perceive
from murmurate.world.signals import OBJECTIVES, Objective, WeightsConfig, signal_names, signals
from murmurate.world.starts import (
    JitteredStart,
    MixtureStart,
    Start,
    StartConfig,
    UniformStart,
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
    "Family",
    "Frames",
    "JitteredStart",
    "LocalObservation",
    "MixtureStart",
    "Objective",
    "Observation",
    "ObservedState",
    "ScheduledState",
    "SchedulerConfig",
    "SchedulerKind",
    "SchedulerWrapper",
    "SensingConfig",
    "SensingKind",
    "Start",
    "StartConfig",
    "State",
    "Transition",
    "UniformStart",
    "View",
    "WeightsConfig",
    "World",
    "WorldConfig",
    "check_configurations",
    "draw_frames",
    "draw_starts",
    "epochs_of",
    "family",
    "layout",
    "make_start",
    "perceive",
    "read_starts",
    "scaled_to",
    "signal_names",
    "signals",
    "symmetric_starts",
]
