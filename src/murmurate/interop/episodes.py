"""A batch of episodes under way on the jitted world: NumPy arrays in and out, the batch first.

Single environments are batches of one, so that they and the vector environment run the very same program.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree, UInt32

from murmurate import prng
from murmurate.world import Start, WorldConfig

__all__ = ["Episodes", "Outcome"]

Look = Callable[[Any, Any], PyTree]
"""What agents are shown of a state of an environment; inside, the batch is last."""


class Outcome(NamedTuple):
    """What one step brought to each episode.

    Attributes:
        reward: Reward of the step.
        terminated: The episode ended in a collision or outside the world.
        truncated: The time limit was reached.
        credit: What each action of the step is taught by.
    """

    reward: Float[np.ndarray, " batch"]
    terminated: Bool[np.ndarray, " batch"]
    truncated: Bool[np.ndarray, " batch"]
    credit: Float[np.ndarray, "batch actions"]


class Episodes:
    """A batch of episodes; nothing begins by itself.

    Attributes:
        begun: Whether there are episodes yet.
        over: Which of them have ended.
    """

    def __init__(self, env: Any, look: Look, batch: int) -> None:
        """Prepares the episodes without beginning them.

        Args:
            env: A `World`, or a `LocalObservation` one.
            look: What agents are shown.
            batch: Number of episodes.
        """
        # Device arrays: numbers of Python would be sent anew at every step.
        self._env = jax.tree.map(jnp.asarray, env)
        self._look = look
        self.begun = False
        self.over = np.zeros(batch, bool)

    def begin(
        self,
        rng: np.random.Generator,
        which: Bool[np.ndarray, " batch"] | None = None,
        positions: Float[np.ndarray, "batch robots 2"] | None = None,
    ) -> None:
        """Begins new episodes.

        Args:
            rng: Randomness of the starts and of what robots perceive.
            which: Those that are replaced; by default, all.
            positions: Where they begin; by default, at fresh starts.
        """
        start, seed = rng.integers(2**32, size=2, dtype=np.uint32)
        if positions is None:
            positions = _drawn(self._env.start, self._env.config, start, len(self.over))
        state, shown = _begun(self._look, self._env, positions, seed)
        if which is None:
            self._state, self._shown, self.over = state, shown, np.zeros_like(self.over)
        else:
            self._state = _replaced(which, state, self._state)
            self._shown = jax.tree.map(lambda new, old: np.where(_as_deep(which, new), new, old), shown, self._shown)
            self.over = self.over & ~which
        self.begun = True

    def step(self, velocities: Float[np.ndarray, "batch robots 2"]) -> Outcome:
        """Moves every robot of every episode for one step, those of ended episodes too."""
        self._state, self._shown, transition = _advanced(self._look, self._env, self._state, velocities)
        reward, terminated, truncated, credit = (np.array(each) for each in transition)
        self.over = terminated | truncated
        # As float64, like every reward of Gymnasium's own environments.
        return Outcome(reward.astype(float), terminated, truncated, credit.astype(float))

    @property
    def observation(self) -> PyTree[np.ndarray]:
        """What agents are shown now; fresh arrays at every access, the batch first."""
        return jax.tree.map(np.array, self._shown[0])

    @property
    def signals(self) -> dict[str, Float[np.ndarray, " batch"]]:
        """The signals by name; fresh arrays at every access."""
        return {name: np.array(value, float) for name, value in self._shown[1].items()}

    @property
    def positions(self) -> Float[np.ndarray, "batch robots 2"]:
        """Centres, world units; a fresh array at every access."""
        return np.moveaxis(np.array(self._state.positions), -1, 0)


def _as_deep(mask: Bool[np.ndarray, " batch"], like: Any) -> Bool[np.ndarray, "batch *ones"]:
    return mask.reshape(mask.shape + (1,) * (like.ndim - 1))


def _batch_first(tree: PyTree[Array]) -> PyTree[Array]:
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), tree)


@partial(jax.jit, static_argnums=3)
def _drawn(start: Start, world: WorldConfig, seed: UInt32[Array, ""], batch: int) -> Float[Array, "batch robots 2"]:
    return start.sample(prng.key(seed), batch, world)


@partial(jax.jit, static_argnums=0)
def _begun(look: Look, env: Any, positions: Float[Array, "batch robots 2"], seed: UInt32[Array, ""]) -> tuple[Any, Any]:
    # As the spaces say, whatever precision starts are drawn in.
    state = env.state(jnp.moveaxis(positions, 0, -1).astype(jnp.float32), seed)
    return state, _batch_first((look(env, state), env.signals(state.positions)))


@partial(jax.jit, static_argnums=0)
def _advanced(look: Look, env: Any, state: Any, velocities: Float[Array, "batch robots 2"]) -> tuple[Any, Any, Any]:
    state, transition = env.step(state, jnp.moveaxis(velocities, 0, -1))
    shown = _batch_first((look(env, state), transition.signals))
    numbers = (transition.reward, transition.terminated, transition.truncated, transition.credit)
    return state, shown, _batch_first(numbers)


@jax.jit
def _replaced(which: Bool[Array, " batch"], new: Any, old: Any) -> Any:
    return jax.tree.map(lambda ours, theirs: jnp.where(which, ours, theirs), new, old)
