"""Parts of a user's own: what a researcher would write beside an experiment's TOML file."""

import equinox as eqx
import jax
import jax.numpy as jnp

from murmurate import Policy, PolicyNetwork, Scheduler, Sensing, Shield, Signal, Start
from murmurate.world import Activation, read_starts, redraw_overlaps


class Calm(Signal):
    """Grows with the robots' distance from the middle.

    Attributes:
        speed: How fast it saturates.
    """

    speed: float = 1.0

    def __call__(self, configuration):
        distance = jnp.sqrt((configuration.positions**2).sum(axis=1))
        return jnp.tanh(self.speed * distance / configuration.world.half_width)


class Rings(Start):
    """Robots on two rings around the origin, in turns.

    Attributes:
        gap: Radius of the inner ring, world units.
    """

    gap: float = 4.0

    def sample(self, key, batch, world):
        angle = 2 * jnp.pi * jnp.arange(world.robots) / world.robots
        radius = jnp.where(jnp.arange(world.robots) % 2 == 0, 2 * self.gap, self.gap)
        rings = radius[:, None] * jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=1)

        def propose(key):
            return rings + jax.random.uniform(key, (batch, world.robots, 2), jnp.float32, -1, 1)

        return redraw_overlaps(key, propose, world.radius)


class Tables(Start):
    """The configurations of a file, one after another from a given one on.

    Attributes:
        table: CSV file of starts.
        file: Number of the first configuration: no file, whatever its name.
    """

    file_fields = ("table",)

    table: str = eqx.field(default="", static=True)
    file: int = eqx.field(default=0, static=True)

    def sample(self, key, batch, world):
        starts = jnp.asarray(read_starts(self.table, world.robots), jnp.float32)
        return starts[(self.file + jnp.arange(batch)) % len(starts)]


class RoundRobin(Scheduler):
    """One robot after another."""

    robots: int = eqx.field(default=3, static=True)

    def activate(self, key, clock):
        robots = clock.idle.shape[0]
        zero = jnp.zeros(robots, jnp.int32)
        active = clock.step % robots == jnp.arange(robots)
        return Activation(active, zero, zero, zero + 1, jnp.ones(robots, jnp.float32))

    @property
    def period(self):
        return self.robots


class Nearest(Sensing):
    """Every robot perceives the robot that is nearest to it."""

    def perceived(self, configuration):
        distances = configuration.distances
        diagonal = jnp.eye(distances.shape[0]).reshape(distances.shape[:2] + (1,) * (distances.ndim - 2))
        distances = distances + 1e9 * diagonal
        return distances == distances.min(axis=1, keepdims=True)


class Half(Shield):
    """Every robot goes half as fast as its policy wants."""

    factor: float = 0.5

    def __call__(self, velocities, observation, world):
        return self.factor * velocities


class LinearNetwork(PolicyNetwork):
    """Velocities that are linear in all positions, but for the speed limit."""

    weight: jax.Array
    log_std: jax.Array
    world: object = eqx.field(static=True)

    def __call__(self, positions):
        flat = positions.reshape(-1, *positions.shape[2:]) / self.world.half_width
        return self.world.max_speed * jnp.tanh(jnp.tensordot(self.weight, flat, 1).reshape(positions.shape))


class LinearValue(eqx.Module):
    """One value for each robot, linear in all positions."""

    weight: jax.Array

    def __call__(self, positions):
        return jnp.tensordot(self.weight, positions.reshape(-1, *positions.shape[2:]), 1)


class Linear(Policy):
    """A linear policy.

    Attributes:
        gain: Spread of its initial weights.
    """

    any_size = False
    gain: float = 0.1

    def networks(self, world, landmark, key):
        size = 2 * world.robots
        weight = self.gain * jax.random.normal(key, (size, size), jnp.float32)
        network = LinearNetwork(weight=weight, log_std=jnp.zeros((), jnp.float32), world=world)
        return network, LinearValue(0.01 * weight[: world.robots])


# What is wrong in one way each.


class Flat(Signal):
    """Returns one number instead of one for each robot."""

    def __call__(self, configuration):
        return configuration.positions[0, 0] * 0.0


class Undefined(Signal):
    """Is not a number."""

    def __call__(self, configuration):
        return configuration.positions[:, 0] * jnp.nan


class Broken(Signal):
    """Raises an error."""

    def __call__(self, configuration):
        return configuration.colours


class Abstract(Signal):
    """Lacks its method."""


class Listed(Signal):
    """Has a field of a type that no configuration can hold."""

    items: list = eqx.field(default_factory=list)

    def __call__(self, configuration):
        return configuration.positions[:, 0]


class Crowd(Start):
    """Places all robots at one point."""

    def sample(self, key, batch, world):
        return jnp.zeros((batch, world.robots, 2), jnp.float32)


class Exploding(Signal):
    """Is not a number once a robot is far from the middle."""

    def __call__(self, configuration):
        return jnp.sqrt(9.0 - jnp.abs(configuration.positions[:, 0]))


def not_a_class():
    """Is a function."""
