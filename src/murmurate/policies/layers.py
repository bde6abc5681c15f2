"""Layers on feature-first arrays `(features, *batch)`: the batch stays last, as in the world's kernels."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate.representation import short_repr

__all__ = ["Dense", "Linear", "Tanh", "bounded"]


def bounded(
    vx: Float[Array, "robots *batch"], vy: Float[Array, "robots *batch"], limit: float
) -> Float[Array, "robots 2 *batch"]:
    """Puts velocities together, smoothly shortened so that the NORM of none is above the limit."""
    velocity = jnp.stack([vx, vy], axis=1)
    norm = jnp.sqrt(jnp.sum(velocity**2, axis=1, keepdims=True) + 1e-12)
    return limit * velocity * (jnp.tanh(norm) / norm)


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
