"""The report of a plan whose runs are finished: a page of Markdown, the same as HTML, and its numbers.

`report.md` beside this file is the template: every sentence that does not depend on a measurement stands there.
"""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

from murmurate import __version__
from murmurate.errors import RunError
from murmurate.report import tables
from murmurate.report.data import ReportData
from murmurate.report.figures import FOLDER, Pictures, draw_figures
from murmurate.report.plan import TRAINING_PRESETS
from murmurate.report.render import to_html
from murmurate.report.tables import duration
from murmurate.representation import short_repr
from murmurate.runs import escape, files
from murmurate.runs.escape import code
from murmurate.runs.folder import RunFolder
from murmurate.runs.paper import EXPERIMENTS

__all__ = ["FORMAT", "HTML", "MARKDOWN", "NUMBERS", "Report", "check", "make", "write"]

FORMAT = 1
HTML, MARKDOWN, NUMBERS = "report.html", "report.md", "report.json"
REMINDER = "Quick report, smaller budgets: these numbers are not the real ones."
_CAUTION = (
    "Quick report: smaller budgets and fewer swarm sizes. It shows that everything runs, and what the full report "
    "looks like; its numbers are not the real ones."
)
_GAP = (
    "The gap is the difference between the objective of the best-known pattern and the mean objective at the end, in "
    "percent of the former: at 0 % a policy forms patterns as good as the best known."
)
_SEVERAL_MACHINES = (
    "> These runs were made on several machines or with several versions: their times do not compare, and their "
    "numbers may differ in the last digits."
)


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

    __repr__ = short_repr

    @property
    def html(self) -> str:
        """The page as one self-contained HTML file."""
        return to_html(self.markdown, self.pictures, self.running)


def make(data: ReportData) -> Report:
    """Makes a report; draws all of its pictures."""
    pictures = Pictures()
    quick = data.plan.quick
    template = Template((resources.files("murmurate.report") / "report.md").read_text("utf-8"))
    parts = _text(data) | _tables(data) | draw_figures(data, pictures)
    kind = "Quick report" if quick else "Report"
    parts["subtitle"] = f"{kind} by murmurate {__version__}, seed {data.plan.seed}"
    # A part without content leaves no gap.
    markdown = re.sub(r"\n{3,}", "\n\n", template.substitute(parts))
    for kind in ("Table", "Figure"):
        pieces = re.split(rf"^\*{kind} {{number}}\.", markdown, flags=re.MULTILINE)
        numbered = (f"*{kind} {number}.{piece}" for number, piece in enumerate(pieces[1:], 1))
        markdown = pieces[0] + "".join(numbered)
    return Report(markdown.rstrip() + "\n", pictures.data, _numbers(data), REMINDER if quick else "")


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
        f"{row.total_steps:.2f}. The table has the latter."
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
            + escape.markdown(f"murmurate {machine.murmurate}, {versions}.")
        )
    return {
        "caution": f"> **{_CAUTION} {code(command.full)} measures those.**" if data.plan.quick else "",
        "headlines": "\n".join(headlines),
        "without_pattern": _without_pattern(data),
        "inconsistencies": "\n\n".join(inconsistencies),
        "gap": _GAP if any(run.gap is not None for run in runs) else "",
        "growth_lines": "\n".join(growth),
        "command": code(command.words),
        "seed": str(data.plan.seed),
        "count": str(len(runs)),
        "trained": duration(sum(run.train_seconds for run in runs)),
        "took": duration(command.seconds),
        "platform": code(platform.platform()),
        "processors": str(os.cpu_count()),
        "reused": str(command.reused),
        "machines": "\n".join(made_with),
        "several_machines": _SEVERAL_MACHINES if len(machines) > 1 else "",
    }


def _without_pattern(data: ReportData) -> str:
    names = [code(name) for name, run in data.measures.items() if not run.valid_pattern]
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


def _numbers(data: ReportData) -> dict[str, Any]:
    """Returns what report.json holds."""
    command = data.command
    experiments = {
        name: {
            "paper": EXPERIMENTS[name].to_dict(),
            **{preset: run.to_dict() for preset, run in runs.items()},
        }
        for name, runs in data.experiments.items()
    }
    sizes = {start: {str(robots): run.to_dict() for robots, run in runs.items()} for start, runs in data.sizes.items()}
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
    with files.os_errors_as_run_errors(f"cannot write to {folder}"):
        present = folder.exists() and any(folder.iterdir())
    if not present:
        RunFolder(folder).create()
        return
    try:
        numbers: Any = files.read_json(folder / NUMBERS)
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
    files.make_folder(files.inside(folder, FOLDER))
    # First the file by which `check` knows a report: an interrupted one can then be replaced.
    files.write_json(folder / NUMBERS, report.numbers)
    for path, data in report.pictures.items():
        files.write_bytes(folder / path, data)
    files.write_text(folder / MARKDOWN, report.markdown)
    files.write_text(folder / HTML, report.html)
