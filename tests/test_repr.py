"""What users hold is written on one short line."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import pkgutil

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import murmurate
from murmurate import analysis, geometry, learning, policies, world
from murmurate.discovery import Curriculum, DiscoveryConfig, StageConfig, Validity
from murmurate.policies.baselines import Centroid
from murmurate.representation import MAX_LINE, short_repr
from murmurate.types import Observation, Trajectories, Transition, View
from murmurate.world import (
    Activation,
    Clock,
    Configuration,
    DeadZone,
    Frames,
    JitteredStart,
    LocalObservation,
    Scheduler,
    SchedulerWrapper,
    Sensing,
    Signal,
    SlowMoves,
    SsyncScheduler,
    Start,
    State,
    UniformStart,
    VisibleSensing,
    World,
    WorldConfig,
)
from tiny import tiny

SIZES = WorldConfig(robots=5)
POSITIONS = np.linspace(-40, 40, 10, dtype=np.float32).reshape(5, 2)
FLAGS = np.array([True, True, False])
WORLD = World.create(SIZES, UniformStart(), "C2")
STATE = State(POSITIONS, np.int32(0), np.float32(0.5), np.float32([0.5]))
VIEW = View(*np.zeros((2, 5, 5), np.float32), np.eye(5) > 0, *np.ones((3, 5), np.float32))
TRAJECTORIES = Trajectories(
    positions=POSITIONS[None, None],
    lengths=np.array([0]),
    switch=np.zeros((1, 0), int),
    at_rest=FLAGS[:1],
    terminated=FLAGS[2:],
    signals={},
    epochs=np.array([0]),
)
RING = geometry.smallest_ring(5, 1.0, 5.0).positions
FINDING = analysis.Finding(RING, 1.0, 5.0, 40.0, "C2", 3.9, 0.1, "tiny", "central", "scattered", 0, "0" * 64, 7)

HELD = [
    SIZES,
    STATE,
    VIEW,
    TRAJECTORIES,
    WORLD,
    WORLD.objective,
    Configuration(POSITIONS, SIZES),
    LocalObservation(WORLD, VisibleSensing(), SIZES),
    SchedulerWrapper(
        DeadZone(LocalObservation(WORLD, VisibleSensing(), SIZES), SlowMoves(0.1), SIZES), SsyncScheduler()
    ),
    JitteredStart(np.zeros((1000, 5, 2), np.float32)),
    world.MixtureStart(first=UniformStart(), second=JitteredStart(jnp.zeros((7, 5, 2)))),
    Observation(VIEW, POSITIONS, POSITIONS[:, 0]),
    Transition(np.float32(0.1), FLAGS[0], FLAGS[2], {"nclose": np.float32(0.2)}, np.float32([0.1])),
    Frames(*np.ones((4, 5), np.float32)),
    Clock(np.int32(3), np.zeros(5, np.int32), POSITIONS),
    Activation(np.ones(5, bool), *np.ones((3, 5), np.int32), np.ones(5, np.float32)),
    Validity(*[FLAGS] * 7, signals={"calm": FLAGS}),
    geometry.smallest_ring(5, 1.0, 5.0),
    geometry.similarity.align(RING, RING[::-1]),
    analysis.symmetry(RING),
    FINDING,
    analysis.Catalogue.from_findings([FINDING]),
    analysis.Catalogue.from_findings([FINDING]).classes[0],
    StageConfig(),
    DiscoveryConfig(),
    Curriculum(tiny()),
    learning.PPOConfig(),
    learning.GradientConfig(),
    policies.Gaussian(POSITIONS, np.zeros(2, np.float32), False),
    Centroid(SIZES, False),
    tiny(),
]


@pytest.mark.parametrize("held", HELD, ids=lambda held: type(held).__name__)
def test_what_users_hold_is_one_short_line(held):
    assert "\n" not in repr(held)
    assert len(repr(held)) <= MAX_LINE
    assert repr(held).startswith(f"{type(held).__name__}(")


@pytest.mark.parametrize("kind", [Scheduler, Sensing, Signal, Start, policies.Policy, policies.Shield])
def test_strategies_with_default_fields_are_their_names(kind):
    for strategy in kind.registered().values():
        assert repr(strategy()) == f"{strategy.__name__}()"


def public_classes():
    for module in pkgutil.walk_packages(murmurate.__path__, "murmurate."):
        if module.ispkg and not module.name.startswith("murmurate.interop"):
            loaded = importlib.import_module(module.name)
            for name in getattr(loaded, "__all__", ()):
                if inspect.isclass(getattr(loaded, name)):
                    yield getattr(loaded, name)


def test_no_public_module_has_the_many_lines_of_equinox():
    assert [cls for cls in public_classes() if cls.__repr__ is eqx.Module.__repr__] == []


def test_fields_of_default_value_are_left_out_and_numbers_are_rounded():
    assert repr(UniformStart(min_window=0.1 + 0.2)) == "UniformStart(min_window=0.3)"
    assert repr(VIEW).startswith("View(x=float32[5, 5], y=float32[5, 5], seen=5 of 25, ")
    assert repr(Validity(*[FLAGS] * 7)).startswith("Validity(contact_free=2 of 3, inside=2 of 3, ")
    assert repr(Configuration(POSITIONS, SIZES)) == (
        "Configuration(positions=float32[5, 2], world=WorldConfig(5 robots of radius 1 in 90 x 90))"
    )


def test_long_lines_lose_what_is_inside_their_fields_and_then_the_last_fields():
    @dataclasses.dataclass
    class Row:
        first: object
        second: object = None

        __repr__ = short_repr

    nested = Row(Row("a" * 50, ["b" * 70] * 9), Row(3))
    assert repr(nested) == f"Row(first=Row(first='{'a' * 50}', ...), second=Row(first=3))"
    assert repr(Row(Row("a" * 50, "b" * 50), Row("c" * 50, "d" * 50))) == "Row(first=Row(...), second=Row(...))"
    assert repr(Row([["c" * 70] * 4] * 4)) == "Row(...)"


def test_numbers_that_are_not_known_are_their_type_and_shape():
    lines = []

    @jax.jit
    def program(x):
        lines.append(repr(Frames(x, x, x, x)))
        return x

    program(jnp.float32(1))
    assert lines == ["Frames(cos=float32[], sin=float32[], chirality=float32[], unit=float32[])"]


def test_a_strategy_of_a_users_own_is_one_line_too():
    class Slow(Start):
        place: object = None

        def sample(self, key, batch, world):
            raise NotImplementedError

    assert repr(Slow()) == f"{Slow.__name__}()"
    assert repr(Slow(place=np.zeros((9, 2)))) == "Slow(place=float64[9, 2])"
