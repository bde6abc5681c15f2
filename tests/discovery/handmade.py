"""Policies made by hand: what a cascade does with them can be counted on one's fingers."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp


class Approach(eqx.Module):
    """Robots on the x axis go towards 0 at `speed` until `stop`; with `shakes`, to and fro around |x| = 8 for ever."""

    speed: jax.Array
    stop: jax.Array
    shakes: jax.Array

    def __call__(self, positions):
        x = positions[:, 0]
        inwards = jnp.where(jnp.abs(x) > self.stop, -self.speed, 0.0)
        to_and_fro = jnp.where(jnp.abs(x) > 8, -self.speed, self.speed)
        outwards = jnp.where(self.shakes, to_and_fro, inwards)
        return jnp.stack([jnp.sign(x) * outwards, jnp.zeros_like(x)], axis=1)


def approach(stop, speed=1.0):
    return Approach(jnp.asarray(speed), jnp.asarray(float(stop)), jnp.asarray(False))


def shake():
    return Approach(jnp.asarray(1.0), jnp.asarray(0.0), jnp.asarray(True))


class Turn(eqx.Module):
    """Robots go round the origin for ever, each at its distance, by `speed` a step."""

    speed: jax.Array

    def __call__(self, positions):
        x, y = positions[:, 0], positions[:, 1]
        distance = jnp.sqrt(x**2 + y**2)
        angle = 2 * jnp.arcsin(self.speed / (2 * distance))
        cos, sin = jnp.cos(angle), jnp.sin(angle)
        return jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=1) - positions


class Implode(eqx.Module):
    """All robots rush to the origin: always, or only where robot 1 is on the right, or (None) never."""

    always: bool | None = eqx.field(static=True)

    def __call__(self, positions):
        reported = positions[1, 0] > 0 if self.always is False else bool(self.always)
        return jnp.where(reported, -10 * positions, 0.0)
