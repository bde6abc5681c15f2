"""The pictures of a report: the paper's figures, same content, drawn from our runs."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from matplotlib.figure import Figure

from murmurate import plots
from murmurate.errors import RunError
from murmurate.report.document import Block, Note, Picture
from murmurate.report.measures import Measures
from murmurate.report.runs import Result
from murmurate.runs.paper import EXPERIMENTS

__all__ = [
    "formation_picture",
    "growth_picture",
    "model_pictures",
    "patterns_picture",
    "reward_picture",
    "training_picture",
]

_TARGETS = {"C1": "a predefined gathering point", "C2": "no predefined gathering point"}


def model_pictures() -> tuple[Block, ...]:
    """The paper's Fig. 1: the robot model and the visibility model."""
    robot = _picture(
        "robot-model",
        "The robot model (the paper's Fig. 1, left).",
        "A disc-shaped robot with its centre, its radius, its velocity, its scan radius, and the safe distance.",
        plots.robot_figure,
    )
    visibility = _picture(
        "visibility-model",
        "The visibility model (the paper's Fig. 1, right).",
        "Four pairs of robots with a third one beside their line of sight, and the shadows that it throws.",
        plots.visibility_figure,
    )
    return robot, visibility


def training_picture(name: str, result: Result) -> Block:
    """The paper's Figs. 2 and 3: the training of base and auxiliary policies."""
    return _picture(
        f"training-{name}-{result.planned.learner}",
        f"Experiment {name}, {result.planned.learner}: training of the base policy and of those that follow it.",
        f"Objective and signals of experiment {name} against environment steps, one part for each policy of the list.",
        lambda: plots.training_figure(result.record),
    )


def reward_picture(name: str, result: Result) -> Block:
    """The paper's Fig. 4: the reward that a single episode brings."""
    return _picture(
        f"reward-{name}-{result.planned.learner}",
        f"Experiment {name}, {result.planned.learner}: cumulative reward in one episode, the switch from the base to "
        "the auxiliary policy marked.",
        f"Reward of experiment {name} summed over the steps of one episode, and the reward of each step.",
        lambda: plots.reward_figure(result.record),
    )


def formation_picture(name: str, result: Result) -> Block:
    """The paper's Figs. 5 to 8: start, base pattern and final pattern."""
    row = EXPERIMENTS[name]
    what = f"{row.robots} robots, {row.start} start, {_TARGETS[row.objective]}"
    return _picture(
        f"formation-{name}-{result.planned.learner}",
        f"Experiment {name}, {result.planned.learner}: {what}. Start, base pattern, final pattern.",
        f"Three panels of experiment {name}: the start, where the base policy came to rest, and the end.",
        lambda: plots.formation_figure(result.record),
    )


def patterns_picture(learner: str, results: Mapping[str, Result]) -> Block:
    """The final patterns of all experiments with one policy, on one page."""
    return _picture(
        f"patterns-{learner}",
        f"The final patterns of all experiments, {learner}: of each a typical episode, its start beside its name.",
        f"One panel for each of the experiments {', '.join(results)}: the final pattern, who sees whom, and the ways.",
        lambda: plots.patterns_figure([result.record for result in results.values()], list(results)),
    )


def growth_picture(sizes: Mapping[str, Mapping[int, Measures]]) -> Block:
    """The paper's Fig. 9: swarm size against steps."""
    growths = [growth for start, runs in sizes.items() if (growth := _growth(start, runs)).robots]
    # Of Table IV, what begins and gathers as the study does.
    rows = [row for row in EXPERIMENTS.values() if row.objective == "C1" and row.start in sizes]
    points = [plots.PaperPoint(row.name, row.robots, row.total_steps, row.start) for row in rows]
    caption = (
        "Swarm size against formation steps (the paper's Fig. 9): means of ours, straight lines through them, the "
        "kinematic bound, and the totals of the paper's Table IV."
    )
    if not growths:
        return Note(f"{caption} There is no picture: no run has a number of steps.")
    alt = (
        "Mean formation steps for every swarm size, for distributed and scattered starts, above their kinematic bounds."
    )
    return _picture("swarm-size", caption, alt, lambda: plots.growth_figure(growths, points))


def _growth(start: str, runs: Mapping[int, Measures]) -> plots.Growth:
    """Returns one line of the study, without what a training that went astray left without numbers."""
    kept = {n: run for n, run in runs.items() if math.isfinite(run.total_steps) and run.total_steps > 0}
    return plots.Growth(
        start=start,
        robots=list(kept),
        steps=[run.total_steps for run in kept.values()],
        bound=[run.bound_steps for run in kept.values()],
        valid=[(run.valid or 0) / run.episodes for run in kept.values()],
    )


def _picture(name: str, caption: str, alt: str, draw: Callable[[], Figure]) -> Block:
    """Draws a picture; a run whose record cannot be read leaves its reason in the picture's place."""
    try:
        figure = draw()
    except RunError as error:
        return Note(f"{caption} There is no picture: {error}")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.png"
        plots.save(figure, path)
        return Picture(name, path.read_bytes(), caption, alt)
