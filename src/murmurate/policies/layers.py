"""Layers on feature-first arrays `(features, *batch)`: the batch stays last, as in the world's kernels."""

from __future__ import annotations

from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate import prng
from murmurate.representation import short_repr

__all__ = ["Dense", "Linear", "Tanh", "bounded", "bounded_by_component", "widened"]


def bounded(
    vx: Float[Array, "robots *batch"], vy: Float[Array, "robots *batch"], limit: float
) -> Float[Array, "robots 2 *batch"]:
    """Puts velocities together, smoothly shortened so that the NORM of none is above the limit."""
    velocity = jnp.stack([vx, vy], axis=1)
    norm = _norm(velocity)
    return limit * velocity * (jnp.tanh(norm) / norm)


def bounded_by_component(
    vx: Float[Array, "robots *batch"], vy: Float[Array, "robots *batch"], limit: float
) -> Float[Array, "robots 2 *batch"]:
    """Puts velocities together, smoothly shortened so that no COMPONENT is above the limit.

    Their directions are those of `bounded`. Each is as much longer as the square of the allowed velocities reaches
    beyond its inscribed disc in that direction.
    """
    velocity = jnp.stack([vx, vy], axis=1)
    norm = _norm(velocity)
    # Of a velocity of almost 0, which has no direction, no component counts as its longest.
    longest = jnp.maximum(jnp.max(jnp.abs(velocity), axis=1, keepdims=True), norm / 2)
    return limit * velocity * (jnp.tanh(norm) / longest)


def _norm(velocity: Float[Array, "robots 2 *batch"]) -> Float[Array, "robots 1 *batch"]:
    # The gradient of the square root at 0 is not finite.
    return jnp.sqrt(jnp.sum(velocity**2, axis=1, keepdims=True) + 1e-12)


class Linear(eqx.Module):
    """A linear map of the leading axis, initialised orthogonally with the given gain."""

    weight: Float[Array, "out features"]

    __repr__ = short_repr

    def __init__(self, features: int, out: int, key: PRNGKeyArray, gain: float = 1.0) -> None:
        self.weight = jax.nn.initializers.orthogonal(gain)(key, (out, features))

    def __call__(self, x: Float[Array, "features *batch"]) -> Float[Array, "out *batch"]:
        """Applies the map to every member of the batch."""
        # Flattened first, so that the gradient too is one plain matrix product instead of a contraction of many axes.
        return (self.weight @ x.reshape(x.shape[0], -1)).reshape(-1, *x.shape[1:])


class Dense(Linear):
    """An affine map of the leading axis, initialised orthogonally with the given gain."""

    bias: Float[Array, " out"]

    __repr__ = short_repr

    def __init__(self, features: int, out: int, key: PRNGKeyArray, gain: float = 1.0) -> None:
        super().__init__(features, out, key, gain)
        self.bias = jnp.zeros(out)

    def __call__(self, x: Float[Array, "features *batch"]) -> Float[Array, "out *batch"]:
        """Applies the map to every member of the batch."""
        return super().__call__(x) + self.bias.reshape((-1,) + (1,) * (x.ndim - 1))


Network = TypeVar("Network")


def widened(network: Network, template: Any) -> Network:
    """Returns a network whose layers have as many inputs and outputs as a template's, and that computes the same.

    New inputs of a layer come last and have no effect until they are trained. New outputs are those of a new layer.

    Args:
        network: A network of layers.
        template: One of the same layers, or without numbers, as `jax.eval_shape` returns it. Where it has other layers
            or narrower ones, the network is returned as it is.
    """

    def is_layer(node: Any) -> bool:
        return isinstance(node, Linear)

    leaves, structure = jax.tree.flatten(network, is_leaf=is_layer)
    others = jax.tree.leaves(template, is_leaf=is_layer)
    if list(map(is_layer, leaves)) != list(map(is_layer, others)):
        return network
    layers = [index for index, leaf in enumerate(leaves) if is_layer(leaf)]
    gains = np.array([np.subtract(others[index].weight.shape, leaves[index].weight.shape) for index in layers])
    if not gains.any() or (gains < 0).any():
        return network
    for index, key in zip(layers, jax.random.split(prng.key(0), len(layers)), strict=True):
        leaves[index] = _widened_layer(leaves[index], others[index].weight.shape, key)
    return jax.tree.unflatten(structure, leaves)


def _widened_layer(layer: Linear, shape: tuple[int, int], key: PRNGKeyArray) -> Linear:
    """Returns a layer with more inputs and outputs, of which the inputs have no effect on what it computed before."""
    out, features = layer.weight.shape
    weight = jax.nn.initializers.orthogonal()(key, shape, layer.weight.dtype)
    weight = weight.at[:out].set(0.0).at[:out, :features].set(layer.weight)
    layer = eqx.tree_at(lambda x: x.weight, layer, weight)
    if isinstance(layer, Dense):
        layer = eqx.tree_at(lambda x: x.bias, layer, jnp.pad(layer.bias, (0, shape[0] - out)))
    return layer


class Tanh(eqx.Module):
    """A stack of dense tanh layers."""

    layers: tuple[Dense, ...]

    __repr__ = short_repr

    def __init__(self, features: int, widths: tuple[int, ...], key: PRNGKeyArray) -> None:
        keys = jax.random.split(key, max(len(widths), 1))
        sizes = (features, *widths)
        self.layers = tuple(Dense(i, o, k, gain=5 / 3) for i, o, k in zip(sizes[:-1], sizes[1:], keys, strict=False))

    def __call__(self, x: Any) -> Any:
        """Applies every layer in turn."""
        for layer in self.layers:
            x = jnp.tanh(layer(x))
        return x
