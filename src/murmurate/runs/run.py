"""A finished run, opened: its experiment, its world and the cascade that it discovered."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from murmurate.discovery import Cascade, Trajectories, build_cascade, policy_name, policy_templates
from murmurate.errors import BeyondTrainingWarning, InputError, RunError, check_number
from murmurate.runs import experiment as configuration
from murmurate.runs import storage, serialization
from murmurate.runs.experiment import ExperimentConfig
from murmurate.world import FileStart, World, check_configurations, draw_starts

__all__ = ["MAX_EPISODES", "METRICS", "Run", "check_draw", "policy_files"]

METRICS = "metrics.jsonl"

MAX_EPISODES = 10_000
"""Episodes of one rollout, at most: all of their positions are held in memory."""

# Training folds a policy's place in the list into its seed; no list is so long that it ever draws the same numbers.
_HELD_OUT = 2**31


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
    def open(cls, folder: str | Path) -> Run:
        """Opens the folder of a finished run; nothing in it is ever executed.

        Raises:
            RunError: The folder is missing, unfinished, damaged or of an unknown version.
        """
        folder = Path(folder)
        manifest = storage.read_manifest(folder)
        storage.verify(folder, manifest)
        experiment = configuration.load(folder)
        names = manifest.get("policies")
        files = policy_files(len(names)) if isinstance(names, list) else ()
        if not files or not {storage.EXPERIMENT, *files} <= manifest["checksums"].keys():
            raise RunError(f"{folder / storage.MANIFEST} does not list every policy with its checksum")
        templates = policy_templates(experiment, len(files))
        policies = [serialization.load(folder / file, like) for file, like in zip(files, templates, strict=True)]
        try:
            return cls(folder, experiment, build_cascade(experiment, policies), manifest)
        except InputError as error:
            raise RunError(f"{folder / storage.EXPERIMENT}: {error}") from None

    @property
    def world(self) -> World:
        """The experiment's world, all weights 1."""
        return self.cascade.world

    def of_size(self, robots: int) -> Run:
        """Returns the run with its policies in a swarm of another size, in a world grown to it.

        Warns once of a size beyond those that the policies were trained among.

        Raises:
            InputError: The policies are for one size only, or there are too few or too many robots.
        """
        own = self.experiment.world.robots
        if robots == own:
            return self
        if not self.experiment.policy.any_size:
            raise InputError("robots", robots, f"{own}: the policy {self.experiment.policy.name} is of one size")
        if not self.experiment.start.fits_any_size():
            raise InputError("robots", robots, f"{own}, as in the run's file of starts")
        changed = self.under(self.experiment.of_size(robots))
        self.warn_of_size(robots)
        return changed

    def warn_of_size(self, robots: int) -> None:
        """Warns of a swarm size beyond those that the policies were trained among."""
        sizes = self.experiment.sizes
        if sizes and not min(sizes) <= robots <= max(sizes):
            text = f"robots = {robots}: trained were swarms of {min(sizes)} to {max(sizes)}; others may do worse"
            warnings.warn(text, BeyondTrainingWarning, stacklevel=3)

    def under(self, experiment: ExperimentConfig) -> Run:
        """Returns the run with its policies in another world, with other eyes or under another scheduler.

        Raises:
            InputError: The experiment is impossible.
        """
        return replace(self, experiment=experiment, cascade=build_cascade(experiment, self.cascade.policies))

    def save(self, folder: str | Path) -> Path:
        """Writes the run, as it is, to a folder of its own; without an evaluation.

        Raises:
            RunError: The folder holds something already, or cannot be written to.
        """
        folder = Path(folder)
        storage.claim(folder)
        configuration.save(self.experiment, folder)
        files = policy_files(len(self.cascade.policies))
        storage.make_folder(folder / "policies")
        for file, policy in zip(files, self.cascade.policies, strict=True):
            serialization.save(folder / file, policy)
        if (self.folder / METRICS).is_file():
            storage.write_bytes(folder / METRICS, (self.folder / METRICS).read_bytes())
        kept = [storage.EXPERIMENT, *([configuration.STARTS] if isinstance(self.experiment.start, FileStart) else []), *files]
        manifest = {**self.manifest, "robots": self.experiment.world.robots}
        storage.write_json(folder / storage.MANIFEST, {**manifest, "checksums": storage.checksums(folder, kept)})
        return folder

    def starts(self, episodes: int, key: int | PRNGKeyArray = 0) -> Float[np.ndarray, "episodes robots 2"]:
        """Draws fresh starts of the experiment.

        Args:
            episodes: How many.
            key: A seed, or a key of `jax.random`. Even the training's own seed gives starts that it never saw.

        Raises:
            InputError: The number of episodes is out of bounds.
        """
        check_draw(episodes, key)
        if isinstance(key, int | np.integer):
            key = jax.random.fold_in(jax.random.key(int(key)), _HELD_OUT)
        return draw_starts(self.world.start, key, int(episodes), self.world.config)

    def rollout(self, starts: int | Float[Array, " ..."] | Any = 1, key: int | PRNGKeyArray = 0) -> Trajectories:
        """Executes the cascade.

        Args:
            starts: A number of fresh starts to draw, or configurations `(episodes, robots, 2)`, or one `(robots, 2)`,
                world units.
            key: A seed or a key of `jax.random`, for fresh starts.

        Returns:
            What happened, until the last episode was at rest, terminated or cut off.

        Raises:
            InputError: A configuration has another shape, is in collision or lies outside the world.
        """
        if isinstance(starts, int | np.integer):
            return self.cascade.rollout(self.starts(int(starts), key))
        points = np.asarray(starts, float)
        points = points[None] if points.ndim == 2 else points
        robots = self.experiment.world.robots
        if points.ndim != 3 or points.shape[1:] != (robots, 2):
            raise InputError("starts", f"an array {points.shape}", f"of shape (episodes, {robots}, 2)")
        check_number("episodes", len(points), 1, MAX_EPISODES, integer=True)
        check_configurations(points, self.experiment.world, "starts")
        return self.cascade.rollout(points)

    def copy(self, folder: str | Path) -> Path:
        """Copies the run without its evaluation, unless the folder holds a copy of it already.

        Raises:
            RunError: The folder holds something else, or cannot be written to.
        """
        folder = Path(folder)
        if (folder / storage.MANIFEST).is_file() and storage.read_json(folder / storage.MANIFEST) == self.manifest:
            return folder
        storage.claim(folder)
        for name in (*self.manifest["checksums"], METRICS, storage.MANIFEST):
            source, target = self.folder / name, folder / name
            if source.is_file():
                storage.make_folder(target.parent)
                storage.write_bytes(target, source.read_bytes())
        return folder


def check_draw(episodes: int, key: int | PRNGKeyArray) -> None:
    """Checks a number of fresh starts and the seed to draw them with.

    Raises:
        InputError: One is out of bounds.
    """
    check_number("episodes", episodes, 1, MAX_EPISODES, integer=True)
    if isinstance(key, int | np.integer):
        configuration.check_seed(int(key))


def policy_files(count: int) -> list[str]:
    """Returns the files of the first `count` policies, relative to the run folder."""
    return [f"policies/{index}-{policy_name(index)}.safetensors" for index in range(count)]
