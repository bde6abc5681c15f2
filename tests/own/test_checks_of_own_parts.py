"""What parts of a user's own return is checked before any training, and their networks begin a training."""

from __future__ import annotations

import math
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from murmurate import Policy, Scheduler, Signal, Start, prng
from murmurate.discovery import build_cascade, build_networks, check_parts
from murmurate.errors import InputError, RunError
from murmurate.policies import Gaussian
from murmurate.runs import config_io, train
from murmurate.runs.run import Run
from murmurate.world import Activation
from own.mine import LinearValue
from tiny import tiny

ONE_POLICY = {"min_policies": 1, "max_policies": 1}


class Row(Start):
    """Robots on a line."""

    dtype: str = eqx.field(default="float32", static=True)

    def sample(self, key, batch, world):
        points = 5.0 * jnp.stack([jnp.arange(world.robots) - 1.0, jnp.zeros(world.robots)], axis=1)
        return jnp.broadcast_to(points, (batch, *points.shape)).astype(self.dtype)


class Far(Signal):
    """Distance from the origin."""

    dtype: str = eqx.field(default="float32", static=True)

    def __call__(self, configuration):
        return (configuration.positions**2).sum(axis=1).astype(self.dtype)


class Given(Scheduler):
    """All robots, with one value of the activation as it is given."""

    changed: str = eqx.field(default="", static=True)
    value: float = eqx.field(default=0.0, static=True)
    dtype: str = eqx.field(default="float32", static=True)

    def activate(self, key, clock):
        robots = clock.idle.shape[0]
        zero = jnp.zeros(robots, jnp.int32)
        activation = Activation(jnp.ones(robots, bool), zero, zero, zero + 1, jnp.ones(robots, jnp.float32))
        changed = jnp.full(robots, self.value, self.dtype)
        return replace(activation, **{self.changed: changed}) if self.changed else activation

    @property
    def period(self):
        return 1


class Punctual(Given):
    """Says that nobody waits between look and move, and that moves take a step."""

    max_delay, max_move_steps = 0, 1


class BareNetwork(eqx.Module):
    """A network that is no `PolicyNetwork`."""

    weight: jax.Array
    speed: float = eqx.field(static=True)

    def __call__(self, positions):
        return self.speed * jnp.tanh(self.weight * positions)

    def distribution(self, positions):
        return Gaussian(self(positions), jnp.zeros((), jnp.float32), joint=False)


class Bare(Policy):
    """Velocities in proportion to the positions."""

    width: int = eqx.field(default=1, static=True)

    def networks(self, world, landmark, key):
        weight = jax.random.normal(key, (self.width, 1, 1), jnp.float32)
        network = BareNetwork(weight if self.width > 1 else weight[0, 0, 0], world.max_speed)
        return network, LinearValue(jnp.zeros((world.robots, 2 * world.robots), jnp.float32))


class BlindNetwork(BareNetwork):
    """A network whose features it cannot take itself."""

    def features(self, positions):
        return {"far": positions}


class Blind(Bare):
    """A policy whose features are of no use to its networks."""

    def networks(self, world, landmark, key):
        network, value = super().networks(world, landmark, key)
        return BlindNetwork(network.weight, network.speed), value


@pytest.mark.unchecked
def test_features_that_the_networks_cannot_take_are_refused_before_training():
    with pytest.raises(InputError, match=r"^policy = '.*:Blind': must be a class that can be evaluated"):
        check_parts(tiny(policy=Blind(), base={"ppo": {"exploration": "learned"}}, discovery=ONE_POLICY))


@pytest.mark.unchecked
@pytest.mark.parametrize(
    ("field", "part", "allowed"),
    [
        ("start", Row("float16"), "a start whose sample returns float32[16, 3, 2], not float16[16, 3, 2]"),
        (
            "signals.far",
            Far("float16"),
            "a class whose __call__ returns float32[3, 2] for 2 configurations, not float16[3, 2]",
        ),
        (
            "scheduler",
            Given("delay", 1.0),
            "a class whose activate returns delay int32[3, 2] for 2 configurations, not float32[3, 2]",
        ),
        (
            "scheduler",
            Given("completion", 1.0, "float16"),
            "a class whose activate returns completion float32[3, 2] for 2 configurations, not float16[3, 2]",
        ),
        (
            "scheduler",
            Given("active", 1, "int32"),
            "a class whose activate returns active bool[3, 2] for 2 configurations, not int32[3, 2]",
        ),
        (
            "scheduler",
            Given("completion", math.nan, rigid=False),
            "a class whose activate returns completion finite numbers",
        ),
        (
            "scheduler",
            Given("completion", 1.5, rigid=False),
            "a class whose activate returns completion of at least 0 and at most 1",
        ),
        ("scheduler", Given("move_steps", 0, "int32"), "a class whose activate returns move_steps of at least 1"),
    ],
)
def test_wrong_types_and_values_are_one_line(field, part, allowed):
    config = tiny(**config_io.nested({field: part}))
    with pytest.raises(InputError) as caught:
        check_parts(config)
    assert str(caught.value) == f"{field} = {part.name!r}: must be {allowed}"


@pytest.mark.unchecked
@pytest.mark.parametrize(("changed", "value", "least", "most"), [("delay", 5, 0, 0), ("move_steps", 9, 1, 1)])
def test_a_scheduler_keeps_to_what_it_states(changed, value, least, most):
    with pytest.raises(InputError, match=f"activate returns {changed} of at least {least} and at most {most}$"):
        check_parts(tiny(scheduler=Punctual(changed, value, "int32")))


def test_parts_of_one_s_own_say_what_they_need():
    class Home(Far):
        needs_landmark = True

    class Walled(Bare):
        perceives, needs_walls = True, True

    local = {"policy": {"use": "local", "hidden": [8, 4]}}
    assert tiny(signals={"home": Home()}, **local).landmark
    assert not tiny(signals={"far": Far()}, **local).landmark
    with pytest.raises(InputError, match=r"^sensing\.landmark = False: must be true"):
        tiny(signals={"home": Home()}, sensing={"landmark": False}, **local)
    with pytest.raises(InputError, match=r"^sensing\.walls = False: must be true"):
        tiny(policy=Walled())
    assert tiny(policy=Walled(), sensing={"walls": True}).sensing.walls


def test_what_is_as_it_should_be_is_not_refused():
    check_parts(tiny(start=Row(), signals={"far": Far()}, scheduler=Given(rigid=False)))


def test_only_ppo_schedules_exploration():
    """And only that of policies that are trained."""
    scheduled, learned = ({"ppo": {"exploration": name}} for name in ("scheduled", "learned"))
    line = r"^{}\.ppo\.exploration = 'scheduled': must be learned: the policy network has no log_std$"
    with pytest.raises(InputError, match=line.format("base")):
        check_parts(tiny(policy=Bare(), base=scheduled))
    with pytest.raises(InputError, match=line.format("auxiliary")):
        check_parts(tiny(policy=Bare(), base=learned, auxiliary=scheduled))
    check_parts(tiny(policy=Bare(), base=learned, auxiliary=scheduled, discovery=ONE_POLICY))
    refined = {"learner": "gradients", "gradients": {"weights": {"compact": 1.0}}, **scheduled}
    check_parts(tiny(policy=Bare(), base=refined, discovery=ONE_POLICY))


def test_a_training_begins_with_networks_that_are_no_policy_network(tmp_path):
    config = tiny(policy=Bare(), discovery=ONE_POLICY)
    network, _ = build_networks(config, prng.key(5))
    initial = Run(tmp_path / "initial", config, build_cascade(config, [network]), {"checksums": {}})
    (begun,) = train._fit_initial(replace(config, seed=1), initial)
    np.testing.assert_array_equal(begun.weight, network.weight)
    assert isinstance(begun, BareNetwork)
    train.check_initial({tmp_path / "run": config}, False, {tmp_path / "run": initial})
    with pytest.raises(RunError, match="the base policy to begin with"):
        train._fit_initial(replace(config, policy=Bare(width=3)), initial)
