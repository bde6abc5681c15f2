"""What every policy is made of: the strategy that a configuration chooses, and the action distribution of its network.

Networks map `(robots, 2, *batch)` positions, or an `Observation` of what robots perceive, to velocities `(robots, 2,
*batch)`; value networks map them to values `(actions, *batch)`: one per robot, or one for the swarm. The batch is LAST.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Any, ClassVar, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate.errors import MAX_INTEGER, InputError, check_choice, check_number
from murmurate.registry import Strategy
from murmurate.representation import short_repr
from murmurate.world.config import WorldConfig
from murmurate.world.env import ShortfallReward, World, Wrapper
from murmurate.world.signals import Signal

__all__ = ["Credit", "Gaussian", "Policy", "PolicyNetwork", "check_hidden"]

Credit = Literal["robots", "swarm"]


class Policy(Strategy):
    """Which networks are trained, and how large they are.

    A subclass implements `networks`. Its class attributes say what the network acts on:

    - `perceives`: robots act on an `Observation`, each on its own view alone, instead of on all positions.
    - `any_size`: the same weights act in swarms of any size.
    - `has_goals`: the policy network steers to goals of its own, which the learner `goals` searches, in swarms of the
      sizes that it has goals for. It has more methods, see `FormationNetwork`: `with_sizes(sizes, key)` returns the
      network with goals for more sizes, `of_size(robots)` with those of one size alone, `scaled_and_sorted(score,
      robots)` with the best goal of a size first; and `goals(robots)` returns those of a size, `(robots, 2, goals)`.

    Attributes:
        credit: Which reward an action learns from: every robot's velocity from the change of its own potential
            (robots), or the swarm's velocities as one action from the reward (swarm, the paper's).
    """

    section: ClassVar[str] = "policy"
    perceives: ClassVar[bool] = False
    any_size: ClassVar[bool] = True
    has_goals: ClassVar[bool] = False

    credit: Credit = eqx.field(default="robots", static=True, kw_only=True)

    def __check_init__(self) -> None:
        check_choice("credit", self.credit, get_args(Credit))

    @property
    def needs_walls(self) -> bool:
        """Whether robots act on the walls that they perceive, so that their sensing has to show them."""
        return False

    def refinement_environment(
        self, env: World | Wrapper, network: Any, landmark: bool, recorded: dict[str, Signal]
    ) -> World | Wrapper:
        """Returns an environment with the rewards by which gradients refine the policy.

        By default every step costs what the configuration lacks to the best value of its objective.

        Args:
            env: The environment; its objective is that of the learner gradients.
            network: The policy network as it is before an update.
            landmark: Whether the gathering point is known.
            recorded: The signals that transitions report.
        """
        del network, landmark
        return ShortfallReward(env, recorded)

    @abstractmethod
    def networks(self, world: WorldConfig, landmark: bool, key: PRNGKeyArray) -> tuple[Any, Any]:
        """Builds a policy network and its value network, two separate networks as in the paper's Algorithm 1.

        Args:
            world: Sizes of the world and its robots, to scale inputs and outputs.
            landmark: Whether the gathering point is known.
            key: Randomness of the initial weights.

        Returns:
            A `PolicyNetwork` (or a PyTree with `__call__` and `distribution`), and a value network.
        """


class PolicyNetwork(eqx.Module):
    """Base of policy networks: normal velocities around the most likely ones.

    A subclass implements `__call__`. Its `log_std` is trained, or scheduled by the configuration.

    Attributes:
        log_std: Natural logarithm of the spread of the velocities, in units of the speed limit: one number, or one for
            each component.
        world: Sizes of the world and its robots.
    """

    log_std: eqx.AbstractVar[Float[Array, "..."]]
    world: eqx.AbstractVar[WorldConfig]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.world.robots} robots)"

    @abstractmethod
    def __call__(self, observation: Any) -> Float[Array, "robots 2 *batch"]:
        """Returns the most likely velocities, world units per step."""

    def features(self, observation: Any) -> Any:
        """Returns what is computed from an observation before any weight takes part: here, the observation itself.

        Training learns from each observation several times. It computes the features once, and gives them to both
        networks in place of the observation. A network that overrides this method, and its value network, take either.
        """
        return observation

    def distribution(self, observation: Any) -> Gaussian:
        """Returns normal velocities around the most likely ones."""
        mean = self(observation)
        log_std = self.log_std
        if log_std.ndim:
            log_std = log_std.reshape(log_std.shape + (1,) * (mean.ndim - log_std.ndim))
        return Gaussian(mean, log_std + math.log(self.world.max_speed), joint=self.is_joint)

    def widened_to(self, template: PolicyNetwork) -> PolicyNetwork:
        """Returns this network with the units and inputs that it lacks beside a template, as far as it can have them.

        They have no effect until they are trained. A network that cannot have more is returned as it is.

        Args:
            template: A network, or one without numbers, as `jax.eval_shape` returns it.
        """
        del template
        return self

    @property
    def is_joint(self) -> bool:
        """Whether the swarm's velocities are ONE action instead of one for each robot."""
        return False


class Gaussian(eqx.Module):
    """Independent normal velocities of all robots; the batch is last.

    Attributes:
        mean: The most likely velocities.
        log_std: Logarithm of their spread: one number, or one for each component.
        joint: Whether the swarm's velocities are ONE action. Otherwise every robot's is an action of its own, with a
            log density, and so a probability ratio, of its own.
    """

    mean: Float[Array, "robots 2 *batch"]
    log_std: Float[Array, "..."]
    joint: bool = eqx.field(static=True)

    __repr__ = short_repr

    def sample(self, key: PRNGKeyArray) -> Float[Array, "robots 2 *batch"]:
        """Draws velocities."""
        return self.mean + jnp.exp(self.log_std) * jax.random.normal(key, self.mean.shape, self.mean.dtype)

    def log_prob(self, action: Float[Array, "robots 2 *batch"]) -> Float[Array, "actions *batch"]:
        """Returns the log density of every action: one (`joint`), or one for each robot."""
        z = (action - self.mean) * jnp.exp(-self.log_std)
        density = -0.5 * z * z - self.log_std - 0.5 * math.log(2 * math.pi)
        return jnp.sum(density, axis=(0, 1))[None] if self.joint else jnp.sum(density, axis=1)


def check_hidden(hidden: tuple[int, ...], most: int | None = None) -> None:
    """Checks the widths of hidden layers.

    Raises:
        InputError: There are none or too many, or one is not positive.
    """
    for width in hidden:
        check_number("hidden", width, 1, MAX_INTEGER, integer=True)
    if not hidden or (most is not None and len(hidden) > most):
        raise InputError("hidden", hidden, "one or more integers >= 1" if most is None else "one or two integers >= 1")
