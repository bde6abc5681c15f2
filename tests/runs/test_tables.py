from __future__ import annotations

import shutil

import pytest

from murmurate.errors import RunError
from murmurate.runs import files, table
from murmurate.runs.paper import EXPERIMENTS

SUMMARY = {
    "episodes": 200,
    "starts": {"kind": "fresh"},
    "contact_free": 1.0,
    "inside": 1.0,
    "mutually_visible": 0.99,
    "gathered": 1.0,
    "safe": 1.0,
    "at_rest": 1.0,
    "stationary": 0.99,
    "valid": 0.99,
    "valid_interval": [0.9643, 0.9973],
    "base_steps": 60.0,
    "auxiliary_steps": 30.5,
    "total_steps": 90.5,
    "bound_steps": 30.0,
}


def test_a_run_stands_beside_the_paper():
    header, rows = table.comparison(SUMMARY, EXPERIMENTS["E"])
    assert header == ("200 fresh starts", "paper", "this run")
    text = {name: (paper, measured) for name, paper, measured in rows}
    assert text["base steps"] == ("521.71", "60.00")
    assert text["auxiliary steps"] == ("223.56", "30.50")
    assert text["total steps"] == ("1168.83 printed, 745.27 summed", "90.50")
    assert text["total / bound"] == ("-", "3.02")
    assert text["stationary"] == ("-", "198 of 200")
    assert text["valid pattern"] == ("-", "198 of 200 (95%: 96.4-99.7%)")
    assert table.comparison(SUMMARY, None)[1][2] == ("total steps", "90.50")
    assert table.comparison(SUMMARY, None)[0] == ("200 fresh starts", "this run")
    mine = SUMMARY | {"starts": {"kind": "file", "name": "fresh"}, "thresholds": {"calm": 0.5}}
    header, rows = table.comparison(mine, EXPERIMENTS["E"])
    assert header[0] == "200 starts of fresh"
    assert ("total steps", "90.50") in rows
    assert ("calm reached", "100 of 200") in rows


def test_the_gap_is_in_percent_of_the_best_known():
    assert table.gap({"gap": 0.0391, "best_known": 3.91}) == "1.000%"
    assert table.gap({"gap": None, "best_known": None}) == "-"
    assert table.gap(SUMMARY) == "-"


def test_tables_as_markdown():
    assert table.as_markdown(("a", "b"), [("x", "1")]) == "| a | b |\n| --- | ---: |\n| x | 1 |\n"


def test_results_of_many_runs(finished):
    rows = table.results([finished, finished])
    assert rows[0] == rows[1]
    cells = dict(zip(table.RESULTS, rows[0], strict=True))
    assert [cells[name] for name in ("experiment", "policy", "seed", "paper's total")] == ["tiny", "central", "0", "-"]
    assert cells["valid"].endswith(" of 200")
    assert (cells["policies"], cells["environment steps"]) == ("2", "0.00 M")
    assert cells["training"].endswith(" s")
    assert float(cells["base steps"]) + float(cells["auxiliary steps"]) == pytest.approx(
        float(cells["total steps"]), abs=0.11
    )


def test_a_broken_evaluation_is_one_line(finished, tmp_path):
    folder = shutil.copytree(finished, tmp_path / "run")
    files.write_json(folder / "evaluation.json", {"episodes": 3})
    with pytest.raises(RunError, match=r"evaluation\.json lacks .*murmurate evaluate"):
        table.results([folder])
    (folder / "evaluation.json").unlink()
    with pytest.raises(RunError, match="cannot read"):
        table.results([folder])
