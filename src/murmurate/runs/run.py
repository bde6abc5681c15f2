"""A finished run, opened: its experiment, its world and the cascade that it discovered."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate import prng
from murmurate.discovery import Cascade, Trajectories, build_cascade, policy_templates, rollout
from murmurate.errors import BeyondTrainingWarning, InputError, RunError, check_number, check_type
from murmurate.runs.experiment import ExperimentConfig, check_seed
from murmurate.runs.folder import MAX_EPISODES, RunFolder
from murmurate.runs.given_starts import HELD_OUT, given_starts, starts_key
from murmurate.world import Start, World, check_configurations, check_pairs, draw_starts

if TYPE_CHECKING:
    from murmurate.analysis import Catalogue

__all__ = ["MAX_EPISODES", "Run", "check_draw", "rollout_seed"]

PICTURE_EPISODES = 20
"""Episodes of which a picture shows the typical one."""

NAMED_EPISODES = 100
"""Episodes of a rollout from starts that are given by a name."""


@dataclass(frozen=True, eq=False)
class Run:
    """What one discovery produced.

    Attributes:
        folder: The run folder.
        experiment: What was discovered, and how.
        cascade: The list of policies, ready to execute.
        manifest: The contents of manifest.json; empty while the run is being finished.
    """

    folder: Path
    experiment: ExperimentConfig
    cascade: Cascade
    manifest: Mapping[str, Any]

    @classmethod
    def open(cls, folder: str | Path, trust: bool = False) -> Run:
        """Opens the folder of a finished run; its files are checked, and none is executed.

        Args:
            folder: The run folder.
            trust: Whether modules from outside the package that the run's configuration names ("module:Class") may be
                imported. Importing a module executes it.

        Raises:
            RunError: The folder is missing, unfinished, damaged or of an unknown version, or names modules and is not
                trusted.
        """
        run = RunFolder(folder)
        manifest = run.verify()
        experiment = run.experiment(trust)
        policies = run.policies(policy_templates(experiment, len(manifest["policies"])))
        try:
            return cls(run.path, experiment, build_cascade(experiment, policies), manifest)
        except InputError as error:
            raise RunError(f"{run.experiment_file}: {error}") from None

    @property
    def world(self) -> World:
        """The experiment's world; its objective has the signals' own weights."""
        return self.cascade.world

    def of_size(self, robots: int) -> Run:
        """Returns the run with its policies in a swarm of another size, in a world scaled to it.

        Warns once of a size beyond those that the policies were trained among.

        Raises:
            InputError: The policies are for one size only, or there are too few or too many robots.
        """
        check_number("robots", robots, 2, integer=True)
        current = self.experiment.world.robots
        if robots == current:
            return self
        self.check_size(robots)
        if not self.experiment.start.fits_any_size():
            raise InputError("robots", robots, f"{current}, as in the run's file of starts")
        return self.under(self.experiment.of_size(robots))

    def check_size(self, robots: int) -> None:
        """Warns of a swarm size beyond those that the policies were trained among.

        Raises:
            InputError: The policies are for one size only, which is another one.
        """
        current, sizes, policy = self.experiment.world.robots, self.experiment.sizes, self.experiment.policy
        known = sorted({current, *sizes}) if policy.has_goals else [current]
        if not policy.any_size and robots not in known:
            reason = "is of one size" if len(known) == 1 else "remembers formations of these sizes"
            raise InputError("robots", robots, f"{', '.join(map(str, known))}: the policy {policy.name} {reason}")
        if sizes and not min(sizes) <= robots <= max(sizes):
            text = f"robots = {robots}: trained were swarms of {min(sizes)} to {max(sizes)}; others may do worse"
            warnings.warn(text, BeyondTrainingWarning, stacklevel=3)

    def under(self, experiment: ExperimentConfig) -> Run:
        """Returns the run with its policies in another world, with another sensing or under another scheduler.

        Raises:
            InputError: The experiment is impossible.
        """
        check_type("experiment", experiment, ExperimentConfig, "an experiment, such as replace(run.experiment, ...)")
        policies, robots = self.cascade.policies, experiment.world.robots
        if self.experiment.policy.has_goals and robots != self.experiment.world.robots:
            policies = [policy.of_size(robots) for policy in policies]
        return replace(self, experiment=experiment, cascade=build_cascade(experiment, policies))

    def remembered(self) -> Catalogue:
        """Returns the distinct valid patterns that a policy `formation` remembers, best first.

        Raises:
            InputError: The policy is another one.
            RunError: None of its formations is a valid pattern.
        """
        from murmurate.runs import formations

        return formations.remembered(self)

    def forming(self, formation: int | Float[np.ndarray, "robots 2"]) -> Run:
        """Returns the run with a policy that forms another pattern than the best that it remembers.

        Args:
            formation: The number of a class of `remembered`, 1 for the best; or the places of all robots, world units:
                any formation, around the gathering point where it is known.

        Raises:
            InputError: There is no such class, the swarm cannot form it, or the policy remembers no formations.
        """
        from murmurate.runs import formations

        return formations.forming(self, formation)

    def save(self, folder: str | Path) -> Path:
        """Writes the run, as it is, to a folder of its own; without an evaluation.

        Raises:
            RunError: The folder holds something already, or cannot be written to; or the metrics are damaged.
        """
        target, rows = RunFolder(folder), RunFolder(self.folder).metrics()
        target.create()
        target.write_experiment(self.experiment)
        target.write_policies(self.cascade.policies)
        target.append_metrics(rows)
        target.write_manifest({**self.manifest, "robots": self.experiment.world.robots}, len(self.cascade.policies))
        return target.path

    @prng.reproducible()
    def starts(self, episodes: int, key: int | PRNGKeyArray = 0) -> Float[np.ndarray, "episodes robots 2"]:
        """Draws fresh starts of the experiment.

        Args:
            episodes: Number of starts.
            key: A seed, or a key of `jax.random`. Even the training's own seed gives starts that it never saw.

        Raises:
            InputError: The number of episodes is out of bounds, or the key is no seed.
        """
        check_draw(episodes, key)
        check_pairs("episodes", int(episodes), self.experiment.world.robots)
        return draw_starts(self.world.start, starts_key(key), int(episodes), self.world.config)

    @prng.reproducible()
    def rollout(
        self,
        starts: int | Float[Array, " ..."] | Any = 100,
        key: int | PRNGKeyArray = 0,
        on_chunk: Callable[[int, int, int], None] | None = None,
    ) -> Trajectories:
        """Executes the cascade.

        Args:
            starts: A number of fresh starts to draw; or configurations `(episodes, robots, 2)`, or one `(robots, 2)`,
                world units; or a CSV file of starts; or, for 100 starts, a named set ("cluster"; see
                `murmurate.start_set`), another registered start ("hard"), one's own as "module:Class", or a start.
            key: A seed or a key of `jax.random`: for fresh starts, the robots' frames, noise and the scheduler.
            on_chunk: Called as `on_chunk(steps, max_steps, ended)` after every chunk of steps; see `Cascade.rollout`.

        Returns:
            The episodes, until the last one was at rest, terminated or cut off.

        Raises:
            InputError: There are no such starts, or a configuration has another shape, is in contact or lies outside
                the world; or the key is no seed.
        """
        if isinstance(starts, str | Path | Start):
            check_draw(NAMED_EPISODES, key)
            starts = given_starts(starts, self.experiment.world, key, NAMED_EPISODES).points
        if isinstance(starts, int | np.integer) and not isinstance(starts, bool):
            return rollout(self.cascade, self.starts(int(starts), key), rollout_seed(key), on_chunk)
        shape = f"of shape (episodes, {self.experiment.world.robots}, 2)"
        if isinstance(starts, bool):
            raise InputError("starts", starts, f"a number of starts, or an array {shape}")
        try:
            points = np.asarray(starts, float)
        except (TypeError, ValueError):
            raise InputError("starts", starts, f"an array of numbers {shape}") from None
        points = points[None] if points.ndim == 2 else points
        if points.ndim != 3 or points.shape[1:] != (self.experiment.world.robots, 2):
            raise InputError("starts", f"an array {points.shape}", shape)
        check_draw(len(points), key)
        check_configurations(points, self.experiment.world, "starts")
        return rollout(self.cascade, points, rollout_seed(key), on_chunk)

    def __repr__(self) -> str:
        experiment, count = self.experiment, len(self.cascade.policies)
        policies = f"{count} {experiment.policy.name} {'policy' if count == 1 else 'policies'}"
        return f"Run({experiment.name}: {experiment.world.robots} robots, {experiment.objective}, {policies})"

    def _repr_png_(self) -> bytes:
        """Returns a picture, which notebooks show: the discovery, or the formation of a pattern if none is recorded."""
        from murmurate import plots  # figures are drawn from runs

        folder = RunFolder(self.folder)
        # The folder is that of another experiment where `of_size` or `under` changed this one.
        if folder.is_evaluated() and folder.experiment() == self.experiment:
            return plots.png(plots.discovery_figure(plots.Recording.open(folder)), dpi=110)
        return plots.Recording(self.experiment, self.rollout(PICTURE_EPISODES))._repr_png_()


def check_draw(episodes: object, key: object) -> None:
    """Checks a number of episodes and the seed of their random numbers.

    Raises:
        InputError: One is out of bounds.
    """
    check_number("episodes", episodes, 1, MAX_EPISODES, integer=True)
    if not isinstance(key, jax.Array | np.ndarray):
        check_seed(int(key) if isinstance(key, np.integer) else key)
    elif not (jax.numpy.issubdtype(key.dtype, jax.dtypes.prng_key) and key.shape == ()) and (
        key.dtype != np.uint32 or key.shape != (2,)
    ):
        raise InputError("key", f"an array {key.dtype}{list(key.shape)}", "a seed, or one key of jax.random")


def rollout_seed(key: int | PRNGKeyArray) -> int:
    """Returns the seed of the frames, noise and scheduler of a rollout: a seed itself, or drawn with a key."""
    if isinstance(key, int | np.integer):
        return int(key)
    # Other numbers than those of the starts, which are drawn with the key itself.
    return int(jax.random.bits(jax.random.fold_in(key, HELD_OUT), (), np.uint32))
