"""Measures the package's weights from every set of starts: `make models` (hours for 1,000 starts a cell).

python -m benchmarks.models [--episodes 1000] [--robots 5,8,16] [--schedulers fsync] [--docs docs]

Writes the tables of docs/models.md, and docs/models.json, which keeps what was measured: a cell of the same weights and
as many starts is not measured again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import murmurate
from murmurate.errors import InputError
from murmurate.geometry.rings import smallest_ring_radius
from murmurate.runs import files
from murmurate.runs.folder import RunFolder, trained_checksums
from murmurate.runs.pretrained import FOLDER, available
from murmurate.world.start_sets import FAMILIES

BEGIN, END = "<!-- measured cells -->", "<!-- end of measured cells -->"

SIZES = (*range(3, 17), 24, 32, 64, 128)
LARGE = {64: 5, 128: 20}
"""Sizes of which fewer starts are measured, at random only: by how many times fewer."""
SCHEDULED_STARTS = ("random", "cluster", "tight-grid")
"""Sets of starts that are measured under other schedulers than FSYNC; the first of them in the largest swarms."""
SCHEDULERS = ("fsync", "ssync", "adversarial", "async-nonrigid")
MAX_SCHEDULED_ROBOTS = 12
"""Largest swarm that is measured under other schedulers than FSYNC."""
FAILURES = ("contact", "left", "hidden", "too near", "not at rest", "not stationary")
KEY = 7
"""Seed of frames and schedulers. The weights were trained with other starts and keys."""


@dataclass(frozen=True)
class Condition:
    """What is measured at once.

    Attributes:
        objective: C1 or C2.
        sensing: What robots perceive.
        scheduler: When they move.
        robots: How many there are.
        starts: The set that they begin at.
        episodes: How many starts of it.
    """

    objective: str
    sensing: str
    scheduler: str
    robots: int
    starts: str
    episodes: int


def conditions(episodes: int, sizes: Sequence[int], schedulers: Sequence[str]) -> Iterator[Condition]:
    """Yields every condition: under FSYNC all families, under other schedulers and in the largest swarms few."""
    for objective, sensings in available().items():
        for sensing in sensings:
            for scheduler in schedulers:
                for robots in sizes:
                    families = tuple(FAMILIES) if scheduler == "fsync" else SCHEDULED_STARTS
                    count = max(episodes // LARGE.get(robots, 1), 1)
                    for family in SCHEDULED_STARTS[:1] if robots in LARGE else families:
                        if scheduler == "fsync" or robots <= MAX_SCHEDULED_ROBOTS:
                            yield Condition(objective, sensing, scheduler, robots, family, count)


def measure(condition: Condition) -> dict[str, Any] | None:
    """Executes the package's weights; None where they are not for so many robots, or the family fits no such world."""
    run = murmurate.pretrained(condition.objective, condition.sensing, condition.scheduler)
    try:
        run = run.of_size(condition.robots)
        starts = murmurate.start_set(condition.starts, robots=condition.robots, count=condition.episodes)
    except InputError:
        return None
    world = run.experiment.world
    trajectories = run.rollout(starts, key=KEY)
    validity = murmurate.check_validity(trajectories, world)
    valid, final = validity.valid, trajectories.final
    ring = smallest_ring_radius(float(condition.robots), world.radius, world.safe_distance)
    spread = abs(final - final.mean(axis=1, keepdims=True))
    radius = ((spread**2).sum(axis=2).max(axis=1) ** 0.5)[valid] / float(ring)
    return {
        "valid": int(valid.sum()),
        "contact": int((~validity.contact_free).sum()),
        "left": int((~validity.inside).sum()),
        "hidden": int((~validity.mutually_visible).sum()),
        "too near": int((~validity.safe).sum()),
        "not at rest": int((~validity.at_rest).sum()),
        "not stationary": int((validity.formed & ~validity.stationary).sum()),
        "steps": round(float(trajectories.lengths[valid].mean()), 1) if valid.any() else None,
        "ring": round(float(radius.mean()), 3) if valid.any() else None,
    }


def weights_of(condition: Condition) -> str:
    """Returns the checksums of the weights that a condition is measured with, and of their experiment."""
    run = RunFolder(FOLDER / condition.objective / condition.sensing)
    checksums = trained_checksums(run.manifest())
    return " ".join(checksums[name] for name in sorted(checksums))


def page(rows: Sequence[Mapping[str, Any]]) -> str:
    """Returns the tables, and what went wrong in all of them."""
    measured = [row for row in rows if row["result"]]
    total = sum(row["cell"]["episodes"] for row in measured)
    failures = ", ".join(f"{name} {sum(row['result'][name] for row in measured)}" for name in FAILURES)
    largest = max(row["cell"]["episodes"] for row in measured)
    parts = [f"Of {total:,} episodes, up to {largest:,} a cell: {failures}."]
    for objective, sensing in sorted({(row["cell"]["objective"], row["cell"]["sensing"]) for row in rows}):
        model_rows = [r for r in rows if (r["cell"]["objective"], r["cell"]["sensing"]) == (objective, sensing)]
        for title, schedulers, families in (
            ("FSYNC", ("fsync",), tuple(FAMILIES)),
            ("other schedulers", SCHEDULERS[1:], SCHEDULED_STARTS),
        ):
            if chosen := [row for row in model_rows if row["cell"]["scheduler"] in schedulers]:
                parts += [f"### {objective}, {sensing}, {title}", _table(chosen, families, len(schedulers) > 1)]
    return "\n\n".join(parts)


def _table(rows: Sequence[Mapping[str, Any]], families: Sequence[str], with_scheduler: bool) -> str:
    lines: dict[tuple[str, int], dict[str, str]] = {}
    for row in rows:
        cell, result = row["cell"], row["result"]
        text = "-"
        if result:
            steps = "" if result["steps"] is None else f" ({result['steps']:.0f})"
            text = f"{100 * result['valid'] / cell['episodes']:.4g}{steps}"
        lines.setdefault((cell["scheduler"], cell["robots"]), {})[cell["starts"]] = text
    head = [*(["scheduler"] if with_scheduler else []), "robots", *families]
    body = [
        [*([scheduler] if with_scheduler else []), str(robots), *(texts.get(family, "-") for family in families)]
        for (scheduler, robots), texts in lines.items()
        if set(texts.values()) != {"-"}  # the weights are not for so many robots
    ]
    rule = ["---" if name == "scheduler" else "---:" for name in head]
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, rule, *body))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=1000, help="starts a cell")
    parser.add_argument("--robots", default=",".join(map(str, SIZES)), help="swarm sizes")
    parser.add_argument("--schedulers", default=",".join(SCHEDULERS), help="when robots move")
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="where models.md and models.json are")
    options = parser.parse_args()
    record, card = options.docs / "models.json", options.docs / "models.md"
    measured = (
        {json.dumps([row["cell"], row["weights"]]): row for row in files.read_json(record)} if record.exists() else {}
    )
    rows = []
    sizes, schedulers = [*map(int, options.robots.split(","))], options.schedulers.split(",")
    for condition in conditions(options.episodes, sizes, schedulers):
        cell, weights = asdict(condition), weights_of(condition)
        key = json.dumps([cell, weights])
        if key not in measured:
            measured[key] = {"cell": cell, "weights": weights, "result": measure(condition)}
            print(condition, measured[key]["result"], flush=True)
        rows.append(measured[key])
        files.write_json(record, [*rows, *(row for key, row in measured.items() if row not in rows)])
    before, _, rest = card.read_text(encoding="utf-8").partition(BEGIN)
    text = f"{before}{BEGIN}\n{page(rows)}\n{END}{rest.partition(END)[2]}"
    files.write_text(card, text)
    files.write_json(record, rows)


if __name__ == "__main__":
    main()
