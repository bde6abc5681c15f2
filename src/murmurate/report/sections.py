"""The sections of a report, in its order."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator

from murmurate.report import pictures, prose, tables
from murmurate.report.document import Block, Items, Note, Section, Text, code
from murmurate.report.material import Machine, Material
from murmurate.report.measures import Measures
from murmurate.report.plan import TRAINING_PRESETS
from murmurate.runs.train import VALID

__all__ = ["lead", "sections"]

_TRAINED = ("C", "E")
_REWARDED = ("C",)
_FORMED = ("C", "F", "B", "E")
"""The experiments that the paper's figures show, in its order."""


def lead(material: Material) -> tuple[Block, ...]:
    """What comes before the first section: what this is, and what was found."""
    found = tuple(
        _headline(learner, [runs[learner] for runs in material.experiments.values()]) for learner in TRAINING_PRESETS
    )
    return (Text(prose.READING), Text(prose.VALID), Items(found), *_without_pattern(material))


def _headline(learner: str, runs: list[Measures]) -> str:
    valid, episodes = sum(run.valid or 0 for run in runs), sum(run.episodes for run in runs)
    worst = min(runs, key=lambda run: (run.valid or 0) / run.episodes)
    text = f"`{learner}`: {valid} of the {episodes} episodes of experiments A to F end in a valid pattern"
    if valid == episodes:
        return f"{text}."
    return f"{text}, fewest in {worst.experiment}: {worst.valid or 0} of {worst.episodes}."


def _without_pattern(material: Material) -> Iterator[Block]:
    names = [code(name) for name, run in material.measures.items() if run.outcome != VALID]
    if names:
        yield Note(f"No valid pattern was discovered by {', '.join(names)}.")


def sections(material: Material) -> tuple[Section, ...]:
    """Every section of the report."""
    made = (_setting, _steps, _training, _patterns, _sizes, _failures, _differences, _what_was_run)
    return tuple(make(material) for make in made)


def _setting(_: Material) -> Section:
    model = Section("Robots and visibility", pictures.model_pictures())
    return Section("The six experiments", (Text(prose.SIZES), tables.settings_table(), model))


def _steps(material: Material) -> Section:
    blocks: list[Block] = [tables.steps_table(material.experiments), *map(Note, prose.inconsistencies())]
    if any(run.gap is not None for run in material.measures.values()):
        blocks.append(Text(prose.GAP))
    return Section("Steps to form a pattern", (*blocks, tables.patterns_table(material.experiments)))


def _training(material: Material) -> Section:
    curves = [pictures.training_picture(name, material.result(name, learner)) for name, learner in _pairs(_TRAINED)]
    rewards = [pictures.reward_picture(name, material.result(name, learner)) for name, learner in _pairs(_REWARDED)]
    return Section("Training", (*curves, Section("The reward of one episode", tuple(rewards))))


def _patterns(material: Material) -> Section:
    shown = [
        Section(
            f"Experiment {name}",
            tuple(pictures.formation_picture(name, material.result(name, learner)) for learner in TRAINING_PRESETS),
        )
        for name in _FORMED
    ]
    overview = [
        pictures.patterns_picture(learner, {name: material.result(name, learner) for name in material.plan.experiments})
        for learner in TRAINING_PRESETS
    ]
    return Section("Patterns", (Text(prose.PATTERNS), *shown, Section("All six experiments", tuple(overview))))


def _pairs(names: tuple[str, ...]) -> list[tuple[str, str]]:
    return [(name, learner) for name in names for learner in TRAINING_PRESETS]


def _sizes(material: Material) -> Section:
    said = []
    for start, (steps, bound) in material.lines.items():
        if steps is None or bound is None:
            said.append(f"{start.capitalize()} starts: too few swarm sizes for a line.")
            continue
        said.append(
            f"{start.capitalize()} starts: {steps.slope:+.1f} steps with each robot, and a straight line explains "
            f"{100 * steps.r_squared:.0f} % of the variance; the kinematic bound alone, which grows with the world, "
            f"{bound.slope:+.1f} steps with each robot."
        )
    return Section(
        "Swarm size",
        (
            Text(prose.STUDY),
            pictures.growth_picture(material.sizes),
            Text("The paper's claim is almost linear growth. Ours:"),
            Items(tuple(said)),
            tables.sizes_table(material.sizes),
        ),
    )


def _failures(material: Material) -> Section:
    runs = list(material.measures.values())
    failed = [run for run in runs if run.valid != run.episodes]
    if not failed:
        return Section("What failed", (Text(f"Every episode of all {len(runs)} runs ended in a valid pattern."),))
    said = f"In {len(runs) - len(failed)} of {len(runs)} runs every episode ended in a valid pattern. The others:"
    return Section("What failed", (Text(said), *_without_pattern(material), tables.failures_table(failed)))


def _differences(_: Material) -> Section:
    return Section("What differs from the paper", (Items(prose.DIFFERENCES),))


def _what_was_run(material: Material) -> Section:
    command, measures = material.command, list(material.measures.values())
    machines = list(dict.fromkeys(material.machines.values()))
    numbers = {name: machines.index(machine) + 1 for name, machine in material.machines.items()}
    trained = tables.duration(sum(run.train_seconds for run in measures))
    times = (
        f"The training of all {len(measures)} runs together took {trained}, compilation included. This command took "
        f"{tables.duration(command.seconds)} until it drew the pictures, on {code(platform.platform())} with "
        f"{os.cpu_count()} processors; {command.reused} of the runs were finished before it."
    )
    blocks: list[Block] = [
        Text(
            f"One command makes this report, trains what is missing, and goes on where it was interrupted: "
            f"{code(command.words)}. Every run has the seed {material.plan.seed}."
        ),
        Text(times),
        Items(tuple(_made_with(place, machine, numbers) for place, machine in enumerate(machines, 1))),
    ]
    if len(machines) > 1:
        blocks.append(
            Note(
                "These runs were made on several machines or with several versions: their times, and in the "
                "last digits their numbers, do not compare."
            )
        )
    return Section("What was run", (*blocks, tables.runs_table(measures, numbers)))


def _made_with(place: int, machine: Machine, numbers: dict[str, int]) -> str:
    versions = ", ".join(f"{package} {version}" for package, version in machine.versions)
    count = sum(number == place for number in numbers.values())
    return (
        f"Machine {place}, {count} runs: {code(machine.platform)}, device {code(machine.device)}, "
        f"murmurate {machine.murmurate}, {versions}."
    )
