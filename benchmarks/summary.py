"""What the timings say: figures of every case, floors beside them, exponents, and whether the aims are met."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import equinox as eqx
import jax
import numpy as np

from benchmarks import ceilings, counts, peers
from benchmarks.cases import EXPERIMENT, SENSING, SIZED, STEP, TRAINING, Size, chunk
from benchmarks.timing import Case, Timing
from murmurate.runs import presets

__all__ = ["RANGES", "aims", "costs", "exponent", "fits", "floors", "records", "summary"]

RANGES = ((4, 32), (128, 1024))
"""Swarm sizes, from and to, over which exponents are fitted."""

COUNTED = ("equivariant", "central")
"""Policies whose update is counted by hand."""


def summary(timings: Sequence[Timing], left_out: Sequence[Case], size: Size) -> dict[str, Any]:
    """Returns everything that is written of the timings, but for machine and memory."""
    cases = records(timings)
    found = {"cases": cases, "floors": floors(cases, size), "fits": fits(cases)}
    return {**found, "aims": aims(found), "left_out": [case.key for case in left_out]}


def records(timings: Sequence[Timing]) -> list[dict[str, Any]]:
    """Returns the figures of every case; `ratio` is to JaxMARL with as many worlds, None without it.

    A ceiling is what the machine did at best, so the best of its runs; all else are medians.
    """
    base = {timing.case.worlds: timing.rate for timing in timings if timing.case.name == peers.JAXMARL}
    rows = []
    for timing in timings:
        case = timing.case
        seconds = min(timing.runs) if case.part == ceilings.PART else timing.seconds
        comparable = case.unit == "steps" and case.robots == peers.AGENTS and case.worlds in base
        rows.append(
            {
                "part": case.part,
                "name": case.name,
                "robots": case.robots,
                "worlds": case.worlds,
                "unit": case.unit,
                "work": case.work,
                "seconds": seconds,
                "per_second": case.work / seconds,
                "spread": round(timing.spread, 3),
                "ratio": round(timing.rate / base[case.worlds], 3) if comparable else None,
                "compile_seconds": round(timing.compile, 2),
            }
        )
    return rows


def floors(cases: Sequence[Mapping[str, Any]], size: Size) -> list[dict[str, Any]]:
    """Returns what was counted by hand, the floor on this machine's ceilings, and how far the measured time is above.

    The world step is the fastest measured at ten robots; updates are whole.
    """
    rates = counts.Rates.of({row["name"]: row["per_second"] for row in cases if row["part"] == ceilings.PART})
    stepping = _of(cases, SIZED, STEP, robots=10)
    found = []
    if stepping:
        fastest = max(stepping, key=lambda row: row["per_second"])
        where = f"{STEP}, {fastest['worlds']:,} worlds"
        found.append(_floor(where, "step", counts.step(10), 1 / fastest["per_second"], rates))
    for kind in COUNTED:
        for row in cases:
            if row["part"] == TRAINING and row["name"].startswith(kind):
                work = _update(kind, size)
                found.append(_floor(f"update, {kind} policy", "update", work, row["seconds"] / size.updates, rates))
    return found


def _floor(name: str, unit: str, work: counts.Work, seconds: float, rates: counts.Rates) -> dict[str, Any]:
    least, bound = counts.floor(work, rates)
    return {
        "name": name,
        "unit": unit,
        "counts": asdict(work),
        "floor_seconds": least,
        "bound": bound,
        "measured_seconds": seconds,
        "ratio": seconds / least,
    }


def _update(kind: str, size: Size) -> counts.Work:
    config = presets.resolve(EXPERIMENT, {"policy": {"kind": kind}, "base": {"ppo": size.training}})
    state = chunk(kind, size).state
    leaves = jax.tree.leaves(eqx.filter((state.policy, state.value), eqx.is_inexact_array))
    weights = sum(leaf.size for leaf in leaves)
    return counts.update(config.policy, config.base.ppo, config.base.repeat, config.world.robots, weights)


def costs(cases: Sequence[Mapping[str, Any]], name: str) -> tuple[list[int], list[float]]:
    """Returns swarm sizes and the seconds that one step of one world costs, in the largest batch timed of each."""
    largest: dict[int, Mapping[str, Any]] = {}
    for row in _of(cases, SIZED, name):
        if row["worlds"] >= largest.get(row["robots"], row)["worlds"]:
            largest[row["robots"]] = row
    sizes = sorted(largest)
    return sizes, [1 / largest[robots]["per_second"] for robots in sizes]


def exponent(robots: Sequence[float], seconds: Sequence[float]) -> float:
    """Returns the power of N by which the cost grows: the slope of the line that fits best by logarithms."""
    return float(np.polyfit(np.log(robots), np.log(seconds), 1)[0])


def fits(cases: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Returns the exponents over each range in which at least two sizes were timed."""
    found = []
    for name in (STEP, SENSING):
        sizes, seconds = costs(cases, name)
        for low, high in RANGES:
            inside = [place for place, robots in enumerate(sizes) if low <= robots <= high]
            if len(inside) > 1:
                power = exponent([sizes[place] for place in inside], [seconds[place] for place in inside])
                ends = {"low": sizes[inside[0]], "high": sizes[inside[-1]]}
                found.append({"name": name, **ends, "exponent": round(power, 3)})
    return found


def aims(found: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Returns what was aimed at, and what was reached: an aim whose case was not timed is left out."""
    cases, floor_of = found["cases"], {row["name"]: row for row in found["floors"]}
    rows = []
    ten = _of(cases, SIZED, STEP, robots=10)
    if ten:
        rows.append(_aim("world steps/s, ten robots", max(row["per_second"] for row in ten), 1_000_000))
    rows += [
        _aim(f"times JaxMARL's steps/s, {row['worlds']:,} worlds", row["ratio"], 8)
        for row in ten
        if row["ratio"] is not None
    ]
    for kind, wanted in (("equivariant", 25_000), ("central", 100_000)):
        for row in cases:
            if row["part"] == TRAINING and row["name"].startswith(kind):
                above = floor_of[f"update, {kind} policy"]["ratio"]
                aim = _aim(f"training steps/s, {kind}", row["per_second"], wanted)
                rows.append({**aim, "above_floor": above, "met": aim["met"] or above <= 2})
    for row in _of(cases, SIZED, STEP, robots=1024):
        seconds = row["worlds"] / row["per_second"]
        rows.append(_aim("seconds of a step of 1,024 robots", seconds, 0.2, least=False))
    rows += [
        _aim("exponent of the cost of a step, 128 to 1,024 robots", row["exponent"], 2.3, least=False)
        for row in found["fits"]
        if (row["name"], row["low"], row["high"]) == (STEP, 128, 1024)
    ]
    return rows


def _aim(what: str, reached: float, wanted: float, least: bool = True) -> dict[str, Any]:
    met = reached >= wanted if least else reached <= wanted
    return {
        "what": what,
        "wanted": wanted,
        "at_least": least,
        "reached": reached,
        "above_floor": None,
        "met": bool(met),
    }


def _of(cases: Sequence[Mapping[str, Any]], part: str, name: str, robots: int | None = None) -> list[Mapping[str, Any]]:
    return [
        row
        for row in cases
        if (row["part"], row["name"]) == (part, name) and (robots is None or row["robots"] == robots)
    ]
