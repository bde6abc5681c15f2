"""The pictures of a report: the paper's figures, drawn from our runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from matplotlib.figure import Figure

from murmurate import plots
from murmurate.errors import RunError
from murmurate.report.data import ReportData
from murmurate.report.plan import TRAINING_PRESETS
from murmurate.report.tables import caption, plain
from murmurate.runs.paper import EXPERIMENTS

__all__ = ["FOLDER", "Pictures", "draw_figures"]

FOLDER = "figures"
"""The folder of the pictures, beside the page."""

_TRAINED, _REWARDED, _FORMED = ("C", "E"), ("C",), ("C", "F", "B", "E")
"""The experiments whose training, reward and formation the paper's figures show, in its order."""

_TARGETS = {"C1": "a predefined gathering point", "C2": "no predefined gathering point"}


class Pictures:
    """Draws the pictures of a report and keeps them.

    Attributes:
        data: The PNGs, by the path under which the page names them.
    """

    def __init__(self) -> None:
        self.data: dict[str, bytes] = {}

    def add(self, name: str, text: str, alt: str, draw: Callable[[], Figure]) -> str:
        """Draws a picture.

        Args:
            name: Its file's name, without folder and suffix.
            text: The caption.
            alt: What a reader who cannot see it needs to know.
            draw: Draws it.

        Returns:
            The Markdown of the picture with its caption, or, for a run that cannot be read, the reason.
        """
        try:
            figure = draw()
        except RunError as error:
            return f"> {plain(f'{text} There is no picture: {error}')}"
        path = f"{FOLDER}/{name}.png"
        self.data[path] = plots.png(figure)
        return f"![{plain(alt)}]({path})\n\n{caption('Figure', text)}"


def draw_figures(data: ReportData, pictures: Pictures) -> dict[str, str]:
    """Draws the paper's figures from our runs."""

    def per_run(
        kind: str, experiments: Sequence[str], figure: Callable[..., Figure], text: str, text_alone: str, alt: str
    ) -> list[str]:
        """Draws one figure for each experiment and preset; `text_alone` is the caption of a list of one policy."""
        drawn = []
        for name in experiments:
            row = EXPERIMENTS[name]
            fields = {
                "name": name,
                "robots": row.world.robots,
                "start": row.start,
                "target": _TARGETS[row.objective],
            }
            for preset in TRAINING_PRESETS:
                chosen = text_alone if data.experiments[name][preset].policies == 1 else text
                title = f"Experiment {name}, {preset}: {chosen.format(**fields)}"

                def draw(name: str = name, preset: str = preset) -> Figure:
                    return figure(data.recording(name, preset))

                drawn.append(pictures.add(f"{kind}-{name}-{preset}", title, alt.format(**fields), draw))
        return drawn

    model = [
        pictures.add(
            "robot-model",
            "The robot model (the paper's Fig. 1, left).",
            "A disc-shaped robot with its centre, its radius, its velocity, its scan radius, and the safe distance.",
            plots.robot_figure,
        ),
        pictures.add(
            "visibility-model",
            "The visibility model (the paper's Fig. 1, right).",
            "Four pairs of robots with a third one beside their line of sight, and the shadows that it throws.",
            plots.visibility_figure,
        ),
    ]
    # The paper's Figs. 2 and 3, 4, and 5 to 8.
    training = per_run(
        "training",
        _TRAINED,
        plots.training_figure,
        "training of the base policy and of those that follow it.",
        "training of the base policy, which none follows.",
        "Objective and signals of experiment {name} against environment steps, one part for each policy of the list.",
    )
    rewards = per_run(
        "reward",
        _REWARDED,
        plots.reward_figure,
        "cumulative reward in one episode, with the switch from the base to the auxiliary policy.",
        "cumulative reward in one episode of the base policy, which none follows.",
        "Cumulative reward of experiment {name} over the steps of one episode, and the reward of each step.",
    )
    formation = []
    for name in _FORMED:
        formation.append(f"### Experiment {name}")
        formation += per_run(
            "formation",
            [name],
            plots.formation_figure,
            "{robots} robots, {start} start, {target}. Start, base pattern, final pattern.",
            "{robots} robots, {start} start, {target}. Start and final pattern.",
            "Experiment {name}: the start, where the base policy came to rest if another one follows, and the end.",
        )
    names = list(data.plan.experiments)
    overview = []
    for preset in TRAINING_PRESETS:

        def draw(preset: str = preset) -> Figure:
            return plots.patterns_figure([data.recording(name, preset) for name in names], names)

        text = f"The final patterns of all experiments, {preset}: of each a typical episode, its start beside its name."
        alt = f"One panel for each of the experiments {', '.join(names)}: the final pattern, sight lines and paths."
        overview.append(pictures.add(f"patterns-{preset}", text, alt, draw))
    return {
        "model_figures": "\n\n".join(model),
        "training_figures": "\n\n".join(training),
        "reward_figures": "\n\n".join(rewards),
        "formation_figures": "\n\n".join(formation),
        "overview_figures": "\n\n".join(overview),
        "growth_figure": _growth_figure(data, pictures),
    }


def _growth_figure(data: ReportData, pictures: Pictures) -> str:
    """The paper's Fig. 9: steps against swarm size; runs whose training diverged have no number of steps."""
    growths = []
    for start, runs in data.sizes.items():
        finite = {n: run for n, run in runs.items() if math.isfinite(run.total_steps) and run.total_steps > 0}
        if finite:
            steps, bound = ([getattr(run, f"{name}_steps") for run in finite.values()] for name in ("total", "bound"))
            valid = [(run.valid or 0) / run.episodes for run in finite.values()]
            growths.append(plots.Growth(start, list(finite), steps, bound, valid))
    # Of Table IV, the experiments that start and gather as the study does.
    rows = [row for row in EXPERIMENTS.values() if row.objective == "C1" and row.start in data.sizes]
    points = [plots.PaperPoint(row.name, row.world.robots, row.total_steps, row.start) for row in rows]
    text = (
        "Swarm size against formation steps (the paper's Fig. 9): our means, straight lines through them, the "
        "kinematic bound, and the totals of the paper's Table IV."
    )
    if not growths:
        return f"> {plain(text)} There is no picture: no run has a number of steps."
    alt = "Mean formation steps for every swarm size, for each kind of start, above their kinematic bounds."
    return pictures.add("swarm-size", text, alt, lambda: plots.growth_figure(growths, points))
