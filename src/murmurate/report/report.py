"""The report of a plan whose runs are finished: a document, and the numbers of its tables."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from murmurate import __version__
from murmurate.report import prose, sections
from murmurate.report.document import Document
from murmurate.report.material import Material
from murmurate.runs.paper import EXPERIMENTS

__all__ = ["FORMAT", "Report", "make_report"]

FORMAT = 1


@dataclass(frozen=True)
class Report:
    """A report.

    Attributes:
        document: To be rendered.
        numbers: What report.json holds: all numbers of the tables, and how they came to be.
    """

    document: Document
    numbers: dict[str, Any]


def make_report(material: Material) -> Report:
    """Makes a report of what it is made of; draws all of its pictures."""
    plan, kind = material.plan, "Quick report" if material.plan.quick else "Report"
    document = Document(
        title=prose.TITLE,
        subtitle=f"{kind} by murmurate {__version__}, seed {plan.seed}",
        blocks=(*sections.lead(material), *sections.sections(material)),
        caution=prose.quick_caution(material.command.full) if plan.quick else None,
    )
    return Report(document, _numbers(material))


def _numbers(material: Material) -> dict[str, Any]:
    command = material.command
    experiments = {
        name: {
            "paper": asdict(EXPERIMENTS[name]) | {"summed_steps": EXPERIMENTS[name].summed_steps},
            **{learner: asdict(run) for learner, run in runs.items()},
        }
        for name, runs in material.experiments.items()
    }
    sizes = {
        start: {str(robots): asdict(run) for robots, run in runs.items()} for start, runs in material.sizes.items()
    }
    lines = {
        start: {"steps": steps and asdict(steps), "bound": bound and asdict(bound)}
        for start, (steps, bound) in material.lines.items()
    }
    return {
        "format": FORMAT,
        "murmurate": __version__,
        "command": command.words,
        "quick": material.plan.quick,
        "seed": material.plan.seed,
        "command_seconds": round(command.seconds, 1),
        "train_seconds": round(sum(run.train_seconds for run in material.measures.values()), 1),
        "experiments": experiments,
        "sizes": sizes,
        "lines": lines,
        "machines": {name: asdict(machine) for name, machine in material.machines.items()},
    }
