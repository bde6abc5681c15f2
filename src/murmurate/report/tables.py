"""The tables of a report, as Markdown, and the small pieces of Markdown that reports are made of."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

from murmurate.report.data import REASONS, Measures, Pattern
from murmurate.runs.escape import code
from murmurate.runs.paper import EXPERIMENTS

__all__ = [
    "caption",
    "duration",
    "failures_table",
    "patterns_table",
    "plain",
    "runs_table",
    "settings_table",
    "sizes_table",
    "steps_table",
]

NONE = "-"
"""A cell without a value."""

MAX_EPISODES = 6
"""Number of failed episodes that a row names."""

ByPolicy = Mapping[str, Measures]

_SIDE = "X\u00a0=\u00a0Y"


# Markdown


def plain(text: str) -> str:
    """Returns text whose characters mean nothing to Markdown; what stands between two backticks remains code."""
    parts = text.split("`")
    return "`".join(part if i % 2 else re.sub(r"([\\*_\[\]<>|#~&])", r"\\\1", part) for i, part in enumerate(parts))


def caption(kind: str, text: str) -> str:
    """Returns a caption of a Table or Figure; the page numbers them."""
    return f"*{kind} {{number}}. {plain(text)}*"


def _table(text: str, header: Sequence[str], rows: Sequence[Sequence[str]], align: str) -> str:
    """Returns a table with its caption.

    Args:
        text: The caption.
        header: The names of the columns.
        rows: The cells; a row whose first cell begins with * is what the rows below it are compared with.
        align: A letter for each column: l for words, r for numbers.
    """
    lines = [header, ["---" if letter == "l" else "---:" for letter in align], *rows]
    # A bar ends a cell even in code.
    cells = [[re.sub(r"(?<!\\)\|", r"\|", cell) for cell in line] for line in lines]
    return f"{caption('Table', text)}\n\n" + "\n".join(f"| {' | '.join(line)} |" for line in cells)


# Tables


def settings_table() -> str:
    """The paper's Table III, with the sizes that it does not print."""
    targets = {"C1": "origin", "C2": "undefined"}
    rows = []
    for row in EXPERIMENTS.values():
        world = row.world
        sizes = (world.half_width, world.radius, world.scan_radius, world.safe_distance, world.max_speed)
        labels = (row.name, str(world.robots), targets[row.objective], row.start)
        rows.append((*labels, *(f"{value:g}" for value in sizes)))
    header = ("experiment", "swarm size", "gathering target", "initial states")
    header += (_SIDE, "radius R", "scan radius", "safe distance", "speed limit")
    text = "The paper's Table III. The last five columns, in world units, are not printed in the paper."
    return _table(text, header, rows, "lrllrrrrr")


def steps_table(experiments: Mapping[str, ByPolicy]) -> str:
    """The paper's Table IV, each row with ours below it."""
    with_gap = any(run.gap is not None for runs in experiments.values() for run in runs.values())
    header = ("experiment", "swarm size", "policy", "base steps", "auxiliary steps", "total steps")
    header += ("kinematic bound", "efficiency", "valid", "contact-free", "inside", *(("gap",) if with_gap else ()))
    # As wide as the page, where every cell need not say of how many.
    episodes = {run.episodes for runs in experiments.values() for run in runs.values()}
    count = _of if len(episodes) > 1 else lambda number, run: NONE if number is None else str(number)
    rows = []
    for name, runs in experiments.items():
        paper = EXPERIMENTS[name]
        robots = str(paper.world.robots)
        steps = (paper.base_steps, paper.auxiliary_steps, paper.total_steps)
        cells = (name, robots, "paper", *(f"{value:.2f}" for value in steps))
        rows.append([f"*{cell}*" for cell in cells] + [NONE] * (len(header) - len(cells)))
        for run in runs.values():
            steps = (run.base_steps, run.auxiliary_steps, run.total_steps, run.bound_steps)
            kept = [_holding(run, name) for name in ("contact_free", "inside")]
            gap = f"{100 * run.gap / run.best_known:.2f} %" if run.gap is not None and run.best_known else NONE
            counts = (*map(count, (run.valid, *kept), [run] * 3), *((gap,) if with_gap else ()))
            cells = (*(_number(value) for value in steps), _number(run.efficiency, 2), *counts)
            rows.append((name, robots, run.policy, *cells))
    text = (
        "The paper's Table IV, average steps to form a pattern, and below each row ours: means over all episodes, "
        "valid or not."
    )
    if len(episodes) == 1:
        text += f" Valid, contact-free and inside: of {episodes.pop()} episodes."
    return _table(text, header, rows, "lrl" + "r" * (len(header) - 3))


def patterns_table(experiments: Mapping[str, ByPolicy]) -> str:
    """What the auxiliary policies add to the patterns of the base policy."""

    def change(base: Pattern | None, final: Pattern | None, name: str) -> tuple[str, str, str]:
        if base is None or final is None:
            return NONE, NONE, NONE
        before, after = getattr(base, name), getattr(final, name)
        return f"{before:.3f}", f"{after:.3f}", f"{after - before:+.3f}"

    rows = []
    for name, runs in experiments.items():
        for run in runs.values():
            base, final = run.base_pattern, run.final_pattern
            rows.append((name, run.policy, *change(base, final, "objective"), *change(base, final, "visible")))
    header = ("experiment", "policy", "objective: base", "final", "change", "visible: base", "final", "change")
    text = (
        "What the auxiliary policies add: the objective (at most 4) and its signal `visible` (1 where every robot sees "
        "every other) where the base policy came to rest, and at the end. Means over all episodes."
    )
    return _table(text, header, rows, "llrrrrrr")


def sizes_table(sizes: Mapping[str, Mapping[int, Measures]]) -> str:
    """The study of swarm sizes."""
    rows = []
    for start, runs in sizes.items():
        for robots, run in runs.items():
            steps = (run.base_steps, run.auxiliary_steps, run.total_steps, run.bound_steps)
            cells = (start, str(robots), f"{run.world.half_width:g}", *(_number(value) for value in steps))
            rows.append((*cells, _number(run.efficiency, 2), _of(run.valid, run), code(run.run)))
    header = ("start", "swarm size", _SIDE, "base steps", "auxiliary steps", "total steps", "kinematic bound")
    header += ("efficiency", "valid", "run")
    return _table("Steps against swarm size, objective C1, formation policy.", header, rows, "lrrrrrrrrl")


def failures_table(runs: Sequence[Measures]) -> str:
    """The episodes that did not end in a valid pattern, and which conditions they miss."""
    rows = []
    for run in runs:
        missed = (NONE if (count := run.lacking[name]) is None else str(count) for name in REASONS)
        episodes = ", ".join(map(str, run.failures[:MAX_EPISODES])) or NONE
        if len(run.failures) > MAX_EPISODES:
            episodes += f", … ({len(run.failures)})"
        rows.append((code(run.run), _of(run.valid, run), *missed, episodes))
    header = ("run", "valid", *REASONS.values(), "episodes")
    text = "Episodes that did not end in a valid pattern, by the condition that they miss; an episode may miss several."
    return _table(text, header, rows, "l" + "r" * (len(header) - 2) + "l")


def runs_table(runs: Sequence[Measures], machines: Mapping[str, int]) -> str:
    """Every run of the report.

    Args:
        runs: The runs.
        machines: For each run, by name, the number of the machine that it was trained on.
    """
    rows = [
        (
            code(run.run),
            str(run.seed),
            "valid patterns" if run.valid_pattern else "no valid pattern",
            str(run.policies),
            f"{run.environment_steps / 1e6:.2f} M",
            duration(run.train_seconds),
            str(machines[run.run]),
        )
        for run in runs
    ]
    header = ("run", "seed", "outcome", "policies", "environment steps", "training", "machine")
    return _table("Every run of this report.", header, rows, "lrlrrrr")


def duration(seconds: float) -> str:
    """Returns a time in hours and minutes, minutes and seconds, or seconds."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def _number(value: float, digits: int = 1) -> str:
    return NONE if math.isnan(value) else f"{value:.{digits}f}"


def _of(count: int | None, run: Measures) -> str:
    return NONE if count is None else f"{count} of {run.episodes}"


def _holding(run: Measures, condition: str) -> int | None:
    """Returns in how many episodes a condition of a valid pattern held."""
    lacking = run.lacking[condition]
    return None if lacking is None else run.episodes - lacking
