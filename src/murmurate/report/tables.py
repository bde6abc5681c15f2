"""The tables of a report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from murmurate.report.document import Table, code
from murmurate.report.measures import REASONS, Measures, Pattern
from murmurate.runs.paper import EXPERIMENTS, PaperExperiment

__all__ = [
    "NONE",
    "duration",
    "failures_table",
    "patterns_table",
    "runs_table",
    "settings_table",
    "sizes_table",
    "steps_table",
]

NONE = "-"
"""What stands in a cell that has no value."""

ByPolicy = Mapping[str, Measures]

_REASON_NAMES = dict(
    zip(REASONS, ("not collision-free", "not visible", "not safe", "not gathered", "not at rest"), strict=True)
)
_SHOWN_EPISODES = 6
_SIDE = "X\u00a0=\u00a0Y"


def settings_table() -> Table:
    """The paper's Table III, with the sizes that it does not print."""
    targets = {"C1": "origin", "C2": "undefined"}
    rows = [
        (
            row.name,
            str(row.robots),
            targets[row.objective],
            row.start,
            *(f"{value:g}" for value in (row.half_side, row.radius, row.scan_radius, row.safe_distance, row.max_speed)),
        )
        for row in EXPERIMENTS.values()
    ]
    header = ("experiment", "swarm size", "gathering target", "initial states")
    sizes = (_SIDE, "radius R", "scan radius", "safe distance", "speed limit")
    caption = "The paper's Table III. The last five columns, in world units, are not printed in the paper."
    return Table(caption, header + sizes, _alone(rows), "lrllrrrrr")


def steps_table(experiments: Mapping[str, ByPolicy]) -> Table:
    """The paper's Table IV, each row beside ours."""
    measured = [run for runs in experiments.values() for run in runs.values()]
    with_gap = any(run.gap is not None for run in measured)
    header = ("experiment", "swarm size", "policy", "base steps", "auxiliary steps", "total steps")
    header += ("kinematic bound", "efficiency", "valid", "collision-free", *(("gap",) if with_gap else ()))

    def ours(name: str, robots: int, run: Measures) -> tuple[str, ...]:
        steps = (_number(value) for value in (run.base_steps, run.auxiliary_steps, run.total_steps, run.bound_steps))
        free = run.lacking["contact_free"]
        counts = (_of(run.valid, run), _of(None if free is None else run.episodes - free, run))
        gap = (_gap(run),) if with_gap else ()
        return (name, str(robots), run.policy, *steps, _share(run.efficiency), *counts, *gap)

    groups = []
    for name, runs in experiments.items():
        row = EXPERIMENTS[name]
        nothing = (NONE,) * (len(header) - 6)
        groups.append((_paper(row) + nothing, *(ours(name, row.robots, run) for run in runs.values())))
    caption = (
        "The paper's Table IV, average steps to form a pattern, and beside each row ours: means over all episodes, "
        "valid or not."
    )
    return Table(caption, header, tuple(groups), "lrl" + "r" * (len(header) - 3), reference=True)


def _paper(row: PaperExperiment) -> tuple[str, ...]:
    odd = "" if row.total_steps == row.summed_steps else f" (sums to {row.summed_steps:.2f})"
    return (
        row.name,
        str(row.robots),
        "paper",
        f"{row.base_steps:.2f}",
        f"{row.auxiliary_steps:.2f}",
        f"{row.total_steps:.2f}{odd}",
    )


def patterns_table(experiments: Mapping[str, ByPolicy]) -> Table:
    """What the auxiliary policy adds to the base policy's patterns."""

    def row(name: str, run: Measures) -> tuple[str, ...]:
        base, final = run.base_pattern, run.final_pattern
        if base is None or final is None:
            return (name, run.policy, *(NONE,) * 6)
        return (
            name,
            run.policy,
            *_change(base, final, "objective"),
            *_change(base, final, "visible"),
        )

    header = ("experiment", "policy", "objective: base", "final", "change", "visible: base", "final", "change")
    groups = tuple(tuple(row(name, run) for run in runs.values()) for name, runs in experiments.items())
    caption = (
        "What the auxiliary policies add: the objective (at most 4) and its signal `visible` (1 where every robot sees "
        "every other) where the base policy came to rest, and at the end. Means over all episodes."
    )
    return Table(caption, header, groups, "llrrrrrr")


def _change(base: Pattern, final: Pattern, name: str) -> tuple[str, str, str]:
    before, after = getattr(base, name), getattr(final, name)
    return f"{before:.3f}", f"{after:.3f}", f"{after - before:+.3f}"


def sizes_table(sizes: Mapping[str, Mapping[int, Measures]]) -> Table:
    """The study of swarm sizes."""
    header = ("start", "swarm size", _SIDE, "base steps", "auxiliary steps", "total steps", "kinematic bound")
    header += ("efficiency", "valid", "run")
    groups = tuple(
        tuple(
            (
                start,
                str(robots),
                f"{run.half_side:g}",
                *(_number(v) for v in (run.base_steps, run.auxiliary_steps, run.total_steps, run.bound_steps)),
                _share(run.efficiency),
                _of(run.valid, run),
                code(run.run),
            )
            for robots, run in runs.items()
        )
        for start, runs in sizes.items()
    )
    return Table("Steps against swarm size, objective C1, equivariant policy.", header, groups, "lrrrrrrrrl")


def failures_table(runs: Sequence[Measures]) -> Table:
    """The episodes that did not end in a valid pattern, and what they lack; one may lack several things."""
    rows = [
        (code(run.run), _of(run.valid, run), *(_plain(run.lacking[name]) for name in REASONS), _places(run.failures))
        for run in runs
    ]
    header = ("run", "valid", *_REASON_NAMES.values(), "episodes")
    caption = "Episodes that did not end in a valid pattern, and what they lack; one episode may lack several things."
    return Table(caption, header, _alone(rows), "lrrrrrrl")


def runs_table(runs: Sequence[Measures], machines: Mapping[str, int]) -> Table:
    """Every run of the report.

    Args:
        runs: The runs.
        machines: For each run, by name, the number of the machine that it was trained on.
    """
    rows = [
        (
            code(run.run),
            str(run.seed),
            run.outcome,
            str(run.policies),
            f"{run.environment_steps / 1e6:.2f} M",
            duration(run.train_seconds),
            str(machines[run.run]),
        )
        for run in runs
    ]
    header = ("run", "seed", "outcome", "policies", "environment steps", "training", "machine")
    return Table("Every run of this report.", header, _alone(rows), "lrlrrrr")


def duration(seconds: float) -> str:
    """Writes a time as a reader says it."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def _alone(rows: Sequence[tuple[str, ...]]) -> tuple[tuple[tuple[str, ...], ...], ...]:
    """Makes a group of every row."""
    return tuple((row,) for row in rows)


def _number(value: float) -> str:
    return NONE if math.isnan(value) else f"{value:.1f}"


def _share(value: float) -> str:
    return NONE if math.isnan(value) else f"{value:.2f}"


def _gap(run: Measures) -> str:
    return f"{100 * run.gap / run.best_known:.2f} %" if run.gap is not None and run.best_known else NONE


def _plain(count: int | None) -> str:
    return NONE if count is None else str(count)


def _of(count: int | None, run: Measures) -> str:
    return NONE if count is None else f"{count} of {run.episodes}"


def _places(failures: Sequence[int]) -> str:
    shown = ", ".join(map(str, failures[:_SHOWN_EPISODES]))
    return f"{shown}, … ({len(failures)})" if len(failures) > _SHOWN_EPISODES else shown or NONE
