"""The report of a plan whose runs are finished: a page of Markdown, the same as HTML, and its numbers.

`report.md` beside this file is the template: every sentence that does not depend on a measurement stands there.
"""

from __future__ import annotations

import functools
import math
import os
import platform
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from matplotlib.figure import Figure

from murmurate import __version__, plots
from murmurate.analysis.measures import Line, fit_line
from murmurate.errors import RunError
from murmurate.report import tables
from murmurate.report.measures import Measures, measure
from murmurate.report.plan import TRAINING_PRESETS, Plan
from murmurate.report.render import to_html
from murmurate.report.runs import Result
from murmurate.report.tables import caption, code, duration, plain
from murmurate.runs import storage
from murmurate.runs.paper import EXPERIMENTS
from murmurate.runs.train import VALID

__all__ = [
    "FORMAT",
    "HTML",
    "MARKDOWN",
    "NUMBERS",
    "Command",
    "Machine",
    "Report",
    "ReportData",
    "check",
    "make",
    "write",
]

FORMAT = 1
HTML, MARKDOWN, NUMBERS, FIGURES = "report.html", "report.md", "report.json", "figures"
REMINDER = "Quick report, smaller budgets: these numbers are not the real ones."

_TRAINED, _REWARDED, _FORMED = ("C", "E"), ("C",), ("C", "F", "B", "E")
"""The experiments whose training, reward and formation the paper's figures show, in its order."""

_TARGETS = {"C1": "a predefined gathering point", "C2": "no predefined gathering point"}


@dataclass(frozen=True)
class Command:
    """The command that makes a report.

    Attributes:
        words: The command line.
        full: The command line of the full report.
        seconds: How long it ran.
        reused: How many runs were finished before it.
    """

    words: str
    full: str
    seconds: float
    reused: int


@dataclass(frozen=True)
class Machine:
    """What runs were made with; runs of two machines, or of two versions, are not quite alike.

    Attributes:
        platform: Operating system and processor.
        device: What JAX computed on.
        murmurate: Version.
        versions: Versions of the packages that the numbers depend on.
    """

    platform: str
    device: str
    murmurate: str
    versions: tuple[tuple[str, str], ...]

    @classmethod
    def from_manifest(cls, manifest: Mapping[str, object]) -> Machine:
        """Returns the machine that a run's manifest names."""
        versions = manifest["versions"]
        pairs = sorted(versions.items()) if isinstance(versions, Mapping) else []
        names = [str(manifest.get(name, "unknown")) for name in ("platform", "device", "murmurate")]
        return cls(*names, versions=tuple((str(package), str(version)) for package, version in pairs))


@dataclass(frozen=True)
class ReportData:
    """Everything that a report is made of.

    Attributes:
        plan: The plan.
        results: The finished runs, in the order of the plan.
        command: The command that makes the report.
    """

    plan: Plan
    results: Sequence[Result]
    command: Command

    @functools.cached_property
    def measures(self) -> dict[str, Measures]:
        """The numbers of every run, by its name."""
        return {result.planned.name: measure(result) for result in self.results}

    @functools.cached_property
    def experiments(self) -> dict[str, dict[str, Measures]]:
        """The numbers of the paper's experiments, by experiment and training preset."""
        return {
            name: {preset: self.measures[run.name] for preset, run in runs.items()}
            for name, runs in self.plan.experiments.items()
        }

    @functools.cached_property
    def sizes(self) -> dict[str, dict[int, Measures]]:
        """The numbers of the study of swarm sizes, by start and number of robots."""
        return {
            start: {robots: self.measures[run.name] for robots, run in runs.items()}
            for start, runs in self.plan.sizes.items()
        }

    @functools.cached_property
    def lines(self) -> dict[str, tuple[Line | None, Line | None]]:
        """Straight lines through formation steps and through kinematic bounds, by start."""
        return {
            start: (
                fit_line(list(runs), [run.total_steps for run in runs.values()]),
                fit_line(list(runs), [run.bound_steps for run in runs.values()]),
            )
            for start, runs in self.sizes.items()
        }

    @functools.cached_property
    def machines(self) -> dict[str, Machine]:
        """What each run was made with, by its name."""
        return {result.planned.name: Machine.from_manifest(result.manifest) for result in self.results}

    def recording(self, experiment: str, preset: str) -> plots.Recording:
        """Returns the run of one of the paper's experiments.

        Raises:
            RunError: It cannot be read.
        """
        name = self.plan.experiments[experiment][preset].name
        return next(result for result in self.results if result.planned.name == name).recording


@dataclass(frozen=True)
class Report:
    """A report.

    Attributes:
        markdown: The page.
        pictures: Its PNGs, by the path under which the page names them.
        numbers: The contents of report.json: all numbers of the tables, and how they were made.
        running: A line for the head of every printed page; empty for none.
    """

    markdown: str
    pictures: Mapping[str, bytes]
    numbers: Mapping[str, Any]
    running: str = ""

    @property
    def html(self) -> str:
        """The page as one self-contained HTML file."""
        return to_html(self.markdown, self.pictures, self.running)


def make(data: ReportData) -> Report:
    """Makes a report; draws all of its pictures."""
    pictures = _Pictures()
    quick = data.plan.quick
    template = Template((files("murmurate.report") / "report.md").read_text("utf-8"))
    parts = _text(data) | _tables(data) | _figures(data, pictures)
    kind = "Quick report" if quick else "Report"
    parts["subtitle"] = f"{kind} by murmurate {__version__}, seed {data.plan.seed}"
    # A part without content leaves no gap.
    markdown = re.sub(r"\n{3,}", "\n\n", template.substitute(parts))
    if quick:
        markdown = _remind(markdown)
    for kind in ("Table", "Figure"):
        pieces = re.split(rf"^\*{kind} {{number}}\.", markdown, flags=re.MULTILINE)
        numbered = (f"*{kind} {number}.{piece}" for number, piece in enumerate(pieces[1:], 1))
        markdown = pieces[0] + "".join(numbered)
    return Report(markdown.rstrip() + "\n", pictures.data, _numbers(data), REMINDER if quick else "")


def _remind(markdown: str) -> str:
    """Puts the reminder of a quick report below the heading of every section that shows a table or a picture."""
    sections = re.split(r"^(?=##)", markdown, flags=re.MULTILINE)
    for index, section in enumerate(sections[1:], 1):
        if "\n| " in section or "\n![" in section:
            heading, _, rest = section.partition("\n")
            sections[index] = f"{heading}\n\n> {REMINDER}\n{rest}"
    return "".join(sections)


# The parts of the page, by their names in the template


def _text(data: ReportData) -> dict[str, str]:
    command, runs = data.command, list(data.measures.values())
    headlines = []
    for preset in TRAINING_PRESETS:
        group = [by_preset[preset] for by_preset in data.experiments.values()]
        valid, episodes = sum(run.valid or 0 for run in group), sum(run.episodes for run in group)
        line = f"- `{preset}`: {valid} of the {episodes} episodes of experiments A to F end in a valid pattern"
        if valid < episodes:
            worst = min(group, key=lambda run: (run.valid or 0) / run.episodes)
            line += f", fewest in {worst.experiment}: {worst.valid or 0} of {worst.episodes}"
        headlines.append(f"{line}.")
    inconsistencies = [
        f"> Row {row.name} of the paper's table does not add up: {row.base_steps:.2f} base steps and "
        f"{row.auxiliary_steps:.2f} auxiliary steps make {row.summed_steps:.2f}, while its total is printed as "
        f"{row.total_steps:.2f}. Both are shown."
        for row in EXPERIMENTS.values()
        if row.total_steps != row.summed_steps
    ]
    growth = [
        f"- {start.capitalize()} starts: too few swarm sizes for a line."
        if steps is None or bound is None
        else f"- {start.capitalize()} starts: {steps.slope:+.1f} steps with each robot, and a straight line explains "
        f"{100 * steps.r_squared:.0f} % of the variance; the kinematic bound alone, which grows with the world, "
        f"{bound.slope:+.1f} steps with each robot."
        for start, (steps, bound) in data.lines.items()
    ]
    machines = list(dict.fromkeys(data.machines.values()))
    made_with = []
    for number, machine in enumerate(machines, 1):
        count = sum(other == machine for other in data.machines.values())
        versions = ", ".join(f"{package} {version}" for package, version in machine.versions)
        made_with.append(
            f"- Machine {number}, {count} runs: {code(machine.platform)}, device {code(machine.device)}, "
            + plain(f"murmurate {machine.murmurate}, {versions}.")
        )
    trained = duration(sum(run.train_seconds for run in runs))
    return {
        "caution": f"> **Quick report: smaller budgets and fewer swarm sizes. It shows that everything runs, and what the "
        f"full report looks like; its numbers are not the real ones. {code(command.full)} measures those.**"
        if data.plan.quick
        else "",
        "headlines": "\n".join(headlines),
        "without_pattern": _without_pattern(data),
        "inconsistencies": "\n\n".join(inconsistencies),
        "gap": "The gap is the difference between the objective of the best-known pattern and the mean objective at the "
        "end, in percent of the former: at 0 % a policy forms patterns as good as the best known."
        if any(run.gap is not None for run in runs)
        else "",
        "growth_lines": "\n".join(growth),
        "command": f"One command makes this report, trains what is missing, and continues where it was interrupted: "
        f"{code(command.words)}. Every run has the seed {data.plan.seed}.",
        "times": f"The training of all {len(runs)} runs together took {trained}, compilation included. This command took "
        f"{duration(command.seconds)} until it drew the pictures, on {code(platform.platform())} with "
        f"{os.cpu_count()} processors; {command.reused} of the runs were finished before it.",
        "machines": "\n".join(made_with),
        "several_machines": "> These runs were made on several machines or with several versions: their times do not "
        "compare, and their numbers may differ in the last digits."
        if len(machines) > 1
        else "",
    }


def _without_pattern(data: ReportData) -> str:
    names = [code(name) for name, run in data.measures.items() if run.outcome != VALID]
    return f"> No valid pattern was discovered by {', '.join(names)}." if names else ""


def _tables(data: ReportData) -> dict[str, str]:
    runs = list(data.measures.values())
    failed = [run for run in runs if run.valid != run.episodes]
    failures = f"Every episode of all {len(runs)} runs ended in a valid pattern."
    if failed:
        intro = f"In {len(runs) - len(failed)} of {len(runs)} runs every episode ended in a valid pattern. The others:"
        failures = "\n\n".join([intro, _without_pattern(data), tables.failures_table(failed)])
    machines = list(dict.fromkeys(data.machines.values()))
    numbers = {name: machines.index(machine) + 1 for name, machine in data.machines.items()}
    return {
        "settings_table": tables.settings_table(),
        "steps_table": tables.steps_table(data.experiments),
        "patterns_table": tables.patterns_table(data.experiments),
        "sizes_table": tables.sizes_table(data.sizes),
        "failures": failures,
        "runs_table": tables.runs_table(runs, numbers),
    }


@dataclass(frozen=True)
class _Pictures:
    """Draws the pictures of a report and keeps their data."""

    data: dict[str, bytes] = field(default_factory=dict)

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
        path = f"{FIGURES}/{name}.png"
        self.data[path] = plots.png(figure)
        return f"![{plain(alt)}]({path})\n\n{caption('Figure', text)}"


def _figures(data: ReportData, pictures: _Pictures) -> dict[str, str]:
    """Draws the paper's figures from our runs."""

    def per_run(kind: str, experiments: Sequence[str], figure: Callable[..., Figure], text: str, alt: str) -> list[str]:
        """Draws one figure for each experiment and preset."""
        drawn = []
        for name in experiments:
            row = EXPERIMENTS[name]
            words = {
                "name": name,
                "robots": row.robots,
                "start": row.start,
                "target": _TARGETS[row.objective],
            }
            for preset in TRAINING_PRESETS:
                title = f"Experiment {name}, {preset}: {text.format(**words)}"

                def draw(name: str = name, preset: str = preset) -> Figure:
                    return figure(data.recording(name, preset))

                drawn.append(pictures.add(f"{kind}-{name}-{preset}", title, alt.format(**words), draw))
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
        "Objective and signals of experiment {name} against environment steps, one part for each policy of the list.",
    )
    rewards = per_run(
        "reward",
        _REWARDED,
        plots.reward_figure,
        "cumulative reward in one episode, with the switch from the base to the auxiliary policy.",
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
            "Three panels of experiment {name}: the start, where the base policy came to rest, and the end.",
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


def _growth_figure(data: ReportData, pictures: _Pictures) -> str:
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
    points = [plots.PaperPoint(row.name, row.robots, row.total_steps, row.start) for row in rows]
    text = (
        "Swarm size against formation steps (the paper's Fig. 9): our means, straight lines through them, the kinematic "
        "bound, and the totals of the paper's Table IV."
    )
    if not growths:
        return f"> {plain(text)} There is no picture: no run has a number of steps."
    alt = "Mean formation steps for every swarm size, for each kind of start, above their kinematic bounds."
    return pictures.add("swarm-size", text, alt, lambda: plots.growth_figure(growths, points))


def _numbers(data: ReportData) -> dict[str, Any]:
    """Returns what report.json holds."""
    command = data.command
    experiments = {
        name: {
            "paper": asdict(EXPERIMENTS[name]) | {"summed_steps": EXPERIMENTS[name].summed_steps},
            **{preset: asdict(run) for preset, run in runs.items()},
        }
        for name, runs in data.experiments.items()
    }
    sizes = {start: {str(robots): asdict(run) for robots, run in runs.items()} for start, runs in data.sizes.items()}
    lines = {
        start: {"steps": steps and asdict(steps), "bound": bound and asdict(bound)}
        for start, (steps, bound) in data.lines.items()
    }
    return {
        "format": FORMAT,
        "murmurate": __version__,
        "command": command.words,
        "quick": data.plan.quick,
        "seed": data.plan.seed,
        "command_seconds": round(command.seconds, 1),
        "train_seconds": round(sum(run.train_seconds for run in data.measures.values()), 1),
        "experiments": experiments,
        "sizes": sizes,
        "lines": lines,
        "machines": {name: asdict(machine) for name, machine in data.machines.items()},
    }


# The folder of a report


def check(folder: str | Path) -> None:
    """Checks that a report may be written to a folder, and creates it where there is none.

    Raises:
        RunError: The folder holds something else than a report, or cannot be written to.
    """
    folder = Path(folder)
    with storage.os_errors_as_run_errors(f"cannot write to {folder}"):
        present = folder.exists() and any(folder.iterdir())
    if not present:
        storage.claim(folder)
        return
    try:
        numbers: Any = storage.read_json(folder / NUMBERS)
    except RunError:
        numbers = None
    is_report = isinstance(numbers, dict) and numbers.get("format") == FORMAT and {"command", "quick"} <= numbers.keys()
    if not is_report:
        raise RunError(f"{folder} holds other files: choose another --out")


def write(report: Report, folder: str | Path) -> None:
    """Writes a report, or replaces the one that the folder holds; every file whole or not at all.

    Raises:
        RunError: A file cannot be written.
    """
    folder = Path(folder)
    storage.make_folder(folder / FIGURES)
    # First the file by which `check` knows a report: an interrupted one can then be replaced.
    storage.write_json(folder / NUMBERS, report.numbers)
    for path, data in report.pictures.items():
        storage.write_bytes(folder / path, data)
    storage.write_text(folder / MARKDOWN, report.markdown)
    storage.write_text(folder / HTML, report.html)
