"""Values that several packages exchange: observations, transitions and trajectories."""

from __future__ import annotations

from dataclasses import dataclass

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from murmurate.representation import short_repr

__all__ = ["Observation", "Trajectories", "Transition", "View"]


class View(eqx.Module):
    """What every robot perceives, in its own frame and unit: the observer is the first axis, the observed the second.

    Attributes:
        x: First coordinate of each perceived robot; 0 for the others.
        y: Second coordinate of each perceived robot; 0 for the others.
        seen: Which robots are perceived; never the observer itself.
        radius: The robots' radius in the observer's unit: it tells the robot how long its unit is.
        landmark_x: First coordinate of the gathering point, which a landmark shows to all.
        landmark_y: Second coordinate of the gathering point.
        walls: The nearest point of each wall, opposite walls two places apart; None where walls are not perceived.
    """

    x: Float[Array, "robots others *batch"]
    y: Float[Array, "robots others *batch"]
    seen: Bool[Array, "robots others *batch"]
    radius: Float[Array, "robots *batch"]
    landmark_x: Float[Array, "robots *batch"]
    landmark_y: Float[Array, "robots *batch"]
    walls: Float[Array, "robots 4 2 *batch"] | None = None

    __repr__ = short_repr


class Observation(eqx.Module):
    """What the robots perceive of a state, and what the state is.

    Attributes:
        view: What every robot perceives: all that an acting policy may use.
        positions: Centres, world units: for the value network, which serves training only.
        walls: Distance of each centre from the nearest wall, world units: for the value network.
    """

    view: View
    positions: Float[Array, "robots 2 *batch"]
    walls: Float[Array, "robots *batch"]

    __repr__ = short_repr


class Transition(eqx.Module):
    """The outcome of one step.

    Attributes:
        reward: C(next) - C(now); minus the fixed penalty on a step that terminates.
        terminated: Whether the step ended in contact or outside the world.
        truncated: Whether the time limit was reached without that.
        signals: The signals of the next configuration by name.
        credit: The reward that each action learns from: the reward itself, or the change of each robot's potential; the
            penalty falls on the robots that touched another or left.
    """

    reward: Float[Array, "*batch"]
    terminated: Bool[Array, "*batch"]
    truncated: Bool[Array, "*batch"]
    signals: dict[str, Float[Array, "*batch"]]
    credit: Float[Array, "actions *batch"]

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Episodes of a cascade; after its length an episode holds still.

    Attributes:
        positions: Centres, world units.
        lengths: Formation steps: steps until the cascade was at rest, terminated or cut off.
        switch: Steps at which each later policy took over; the length where it never did.
        at_rest: Whether the last policy came to rest.
        terminated: Whether the episode ended in contact or outside the world.
        signals: Signals by name.
        epochs: Epochs until the end: in each, every robot completed at least one Look-Compute-Move cycle.
        interventions: How often the shield shortened a robot's move; None where that is not recorded.
        after_rest: Centres in the steps after rest, world units, up to the last one in which any robot of any episode
            moved: the cascade is executed for some time more, with nothing frozen. Episodes that did not come to rest
            hold still. None where that is not recorded.
    """

    positions: Float[np.ndarray, "episodes steps_and_one robots 2"]
    lengths: Int[np.ndarray, " episodes"]
    switch: Int[np.ndarray, "episodes later_policies"]
    at_rest: Bool[np.ndarray, " episodes"]
    terminated: Bool[np.ndarray, " episodes"]
    signals: dict[str, Float[np.ndarray, "episodes steps_and_one"]]
    epochs: Int[np.ndarray, " episodes"]
    interventions: Int[np.ndarray, " episodes"] | None = None
    after_rest: Float[np.ndarray, "episodes steps_after robots 2"] | None = None

    @property
    def final(self) -> Float[np.ndarray, "episodes robots 2"]:
        """The configurations at the end."""
        return self.positions[:, -1]

    def __repr__(self) -> str:
        episodes, _, robots, _ = self.positions.shape
        rest = int(self.at_rest.sum())
        return f"Trajectories({episodes} episodes of {robots} robots, {self.lengths.mean():.1f} steps, {rest} at rest)"
