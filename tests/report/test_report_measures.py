from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from murmurate.report import tables
from murmurate.report.data import Measures, measure


def cells(table):
    """Returns the lines of a table, the header and the alignment first, as lists of cells."""
    return [line[2:-2].split(" | ") for line in table.splitlines() if line.startswith("| ")]


@pytest.fixture(scope="module", params=[0, 1])
def result(results, request):
    return results[request.param]


def test_counts_and_steps_are_those_of_the_evaluation(result):
    measured = measure(result)
    summary = json.loads((result.folder / "evaluation.json").read_text())
    assert measured.valid == summary["valid"] * 200
    assert measured.failures == tuple(summary["failures"])
    assert measured.lacking["at_rest"] == round(200 * (1 - summary["at_rest"]))
    assert measured.efficiency == pytest.approx(summary["efficiency"])
    assert measured.total_steps == summary["total_steps"]
    assert measured.gap == summary.get("gap")


def test_patterns_are_means_over_all_episodes(result):
    measured = measure(result)
    arrays = np.load(result.folder / "trajectories.npz")
    base = [objective[at[0]] for objective, at in zip(arrays["objective"], arrays["switch"], strict=True)]
    final = [objective[at] for objective, at in zip(arrays["objective"], arrays["lengths"], strict=True)]
    assert measured.base_pattern.objective == pytest.approx(np.mean(base), abs=1e-6)
    assert measured.final_pattern.objective == pytest.approx(np.mean(final), abs=1e-6)
    assert measured.final_pattern.visible == pytest.approx(result.summary["signal"]["visible"], abs=1e-6)


def test_the_gap_is_what_the_evaluation_says(result):
    summary = {name: value for name, value in result.summary.items() if name not in ("gap", "best_known")}
    assert measure(replace(result, summary=summary)).gap is None
    assert measure(replace(result, summary=summary | {"gap": math.nan})).gap is None
    measured = measure(replace(result, summary=summary | {"gap": 0.05, "best_known": 2.5}))
    header, _, paper, row = cells(tables.steps_table({"C": {"central": measured}}))
    assert (header[-1], paper[-1], row[-1]) == ("gap", "-", "2.00 %")
    assert "gap" not in cells(tables.steps_table({"C": {"central": replace(measured, gap=None)}}))[0]


def test_contact_and_exits_are_counted_apart(result):
    measured = measure(result)
    lacking = {**measured.lacking, "contact_free": 1, "inside": 2}
    header, _, _, row = cells(tables.steps_table({"C": {"central": replace(measured, lacking=lacking)}}))
    shown = dict(zip(header, row, strict=True))
    free, inside = (measured.episodes - count for count in (1, 2))
    assert (shown["contact-free"], shown["inside"]) == (str(free), str(inside))
    other = replace(measured, episodes=measured.episodes + 10)
    rows = cells(tables.steps_table({"C": {"central": measured, "formation": other}}))
    assert rows[4][9] == f"{other.episodes} of {other.episodes}"


def test_what_could_not_be_computed_is_a_dash(result):
    steps = dict.fromkeys(("base_steps", "auxiliary_steps", "total_steps", "bound_steps", "valid"), math.nan)
    measured = measure(replace(result, summary={**result.summary, **steps}))
    assert cells(tables.steps_table({"C": {"central": measured}}))[3][3:9] == ["-"] * 6


def test_row_e_has_the_printed_total(result):
    measured: Measures = measure(result)
    rows = cells(tables.steps_table({name: {"central": measured} for name in "DE"}))
    assert [rows[2][3:6], rows[4][3:6]] == [
        ["*269.88*", "*2.89*", "*272.77*"],
        ["*521.71*", "*223.56*", "*1168.83*"],
    ]


def test_long_lists_of_failures_are_cut(result):
    some, many = (replace(measure(result), failures=tuple(range(count))) for count in (3, 40))
    rows = cells(tables.failures_table([some, many]))[2:]
    assert [row[-1] for row in rows] == ["0, 1, 2", "0, 1, 2, 3, 4, 5, … (40)"]


@pytest.mark.parametrize(
    ("seconds", "arguments"),
    [(0.4, "0 s"), (59.7, "1 min 0 s"), (61, "1 min 1 s"), (3599.8, "1 h 0 min"), (5400, "1 h 30 min")],
)
def test_times_are_said_as_people_do(seconds, arguments):
    assert tables.duration(seconds) == arguments
