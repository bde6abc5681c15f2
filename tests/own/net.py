"""A policy of a user's own, whose networks are those of a library: some of their leaves are no arrays."""

import equinox as eqx
import jax
import jax.numpy as jnp

from murmurate import Policy, PolicyNetwork


def apply(mlp, positions):
    flat = positions.reshape(-1, *positions.shape[2:]) / 10
    return mlp(flat) if flat.ndim == 1 else jax.vmap(mlp, -1, -1)(flat)


class Network(PolicyNetwork):
    """All velocities of all positions."""

    mlp: eqx.nn.MLP
    log_std: jax.Array
    world: object = eqx.field(static=True)

    def __call__(self, positions):
        return self.world.max_speed * jnp.tanh(apply(self.mlp, positions).reshape(positions.shape))


class Value(eqx.Module):
    """One value for each robot."""

    mlp: eqx.nn.MLP

    def __call__(self, positions):
        return apply(self.mlp, positions)


class Library(Policy):
    """Two multilayer perceptrons.

    Attributes:
        width: Width of their hidden layer.
    """

    any_size = False
    width: int = 8

    def networks(self, world, landmark, key):
        first, second = jax.random.split(key)
        inputs, robots = 2 * world.robots, world.robots
        mlp = eqx.nn.MLP(inputs, inputs, self.width, 1, key=first)
        network = Network(mlp=mlp, log_std=jnp.zeros((), jnp.float32), world=world)
        return network, Value(eqx.nn.MLP(inputs, robots, self.width, 1, key=second))
