"""The whole report: what it must hold, and the folder that holds it."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import pytest
from reading import Page

from murmurate.errors import RunError
from murmurate.report import report as reports
from murmurate.report.data import Command, ReportData, measure
from murmurate.runs.paper import EXPERIMENTS

SECTIONS = [
    "The six experiments",
    "Robots and visibility",
    "Steps to form a pattern",
    "Training",
    "The reward of one episode",
    "Patterns",
    "Experiment C",
    "Experiment F",
    "Experiment B",
    "Experiment E",
    "All six experiments",
    "Swarm size",
    "What failed",
    "What differs from the paper",
    "What was run",
]
REMINDER = "Quick report, smaller budgets: these numbers are not the real ones."


def texts(folder):
    return (folder / "report.html").read_text(), (folder / "report.md").read_text()


def notes(data):
    return [line[2:] for line in reports.make(data).markdown.splitlines() if line.startswith("> ")]


@pytest.fixture(params=[False, True], ids=["full", "quick"])
def report(written, request):
    return written[request.param]


def test_all_sections_are_there(report):
    html, markdown = texts(report)
    page = Page(html)
    assert re.findall(r"^###? (.*)$", markdown, re.MULTILINE) == SECTIONS
    assert page.texts["h2"] == re.findall(r"^## (.*)$", markdown, re.MULTILINE)
    assert page.texts["h3"] == re.findall(r"^### (.*)$", markdown, re.MULTILINE)
    assert "$" not in markdown


def test_tables_and_figures_are_numbered_in_order(report):
    html, markdown = texts(report)
    page = Page(html)
    tables = [text for text in page.texts["p"] if re.match(r"Table \d", text)]
    assert [text.split(".")[0] for text in tables] == [f"Table {number}" for number in range(1, len(tables) + 1)]
    assert len(tables) == page.tags.count("table") == len(re.findall(r"^\*Table \d+\. ", markdown, re.MULTILINE))
    figures = [text.split(".")[0] for text in page.texts["figcaption"]]
    assert figures == [f"Figure {number}" for number in range(1, page.tags.count("img") + 1)]
    assert "{number}" not in html + markdown


def test_the_html_needs_nothing_else(report):
    html, _ = texts(report)
    page = Page(html)
    assert not re.search(r"https?:|@import|url\(|<script|<link", html)
    assert all(source.startswith("data:image/png;base64,") for source in page.of("img", "src"))
    assert all(page.of("img", "alt"))


def test_every_picture_lies_beside_the_markdown(report):
    html, markdown = texts(report)
    named = re.findall(r"\]\((figures/.*?\.png)\)", markdown)
    learners, both = ("central", "formation"), []
    for kind in ("training-C", "training-E", "reward-C", *(f"formation-{name}" for name in "CFBE"), "patterns"):
        both += [f"figures/{kind}-{learner}.png" for learner in learners]
    assert named == ["figures/robot-model.png", "figures/visibility-model.png", *both, "figures/swarm-size.png"]
    assert {path.name for path in (report / "figures").iterdir()} == {name.split("/")[1] for name in named}
    assert len(Page(html).of("img", "src")) == len(named)


def test_the_papers_tables_are_there(report):
    _, markdown = texts(report)
    for row in EXPERIMENTS.values():
        steps = f"*{row.base_steps:.2f}* | *{row.auxiliary_steps:.2f}*"
        assert f"| *{row.name}* | *{row.world.robots}* | *paper* | {steps} |" in markdown
        assert f"| {row.name} | {row.world.robots} | central |" in markdown
        assert f"| {row.name} | {row.world.robots} | formation |" in markdown
    assert "| C | 10 | origin | distributed | 45 | 1 | 20 | 5 | 1 |" in markdown
    assert "521.71 base steps and 223.56 auxiliary steps make 745.27, while its total is printed as 1168.83" in markdown


def test_a_quick_report_says_so_on_every_page(written):
    html, markdown = texts(written[True])
    page = Page(html)
    assert f"{REMINDER}\n" in page.texts["div"]
    assert "numbers are not the real ones. murmurate reproduce measures those." in page.texts["p"][1]
    assert "table-header-group" in html
    assert markdown.count("not the real ones") == 1, "one banner on the screen"
    assert "`murmurate reproduce` measures those" in markdown


def test_a_full_report_does_not(written):
    for text in texts(written[False]):
        assert "numbers are not the real ones" not in text


def test_the_numbers_are_those_of_the_runs(report, results):
    numbers = json.loads((report / "report.json").read_text())
    assert (numbers["format"], numbers["command"]) == (1, "murmurate reproduce --quick")
    measurement = measure(results[0])
    row = numbers["experiments"]["E"]
    first = ["run", "experiment", "policy", "seed", "robots", "start", "half_side", "valid_pattern"]
    assert list(row["central"])[: len(first)] == first
    sizes = {"half_side": 40.0, "radius": 1.0, "scan_radius": 115.0, "safe_distance": 5.0, "max_speed": 1.0}
    steps = {"base_steps": 521.71, "auxiliary_steps": 223.56, "total_steps": 1168.83, "summed_steps": 745.27}
    paper = {"name": "E", "robots": 8, "objective": "C2", "start": "scattered", **sizes, **steps}
    assert list(row["paper"].items()) == list(paper.items())
    assert (row["central"]["total_steps"], row["central"]["valid"]) == (measurement.total_steps, measurement.valid)
    assert list(numbers["sizes"]["scattered"]) == ["3", "4", "5"]
    assert numbers["lines"]["scattered"]["steps"]["slope"] == pytest.approx(0, abs=1e-9)
    assert numbers["train_seconds"] == pytest.approx(sum(r.manifest["train_seconds"] for r in results), abs=0.1)


def test_failures_are_listed_run_by_run(report, results):
    _, markdown = texts(report)
    for result in results:
        run = measure(result)
        cells = f"| `{run.run}` | {run.valid} of 200 | {run.lacking['contact_free']} |"
        assert (cells in markdown) == (run.valid < 200)


@pytest.fixture
def data(plan, results, blank_pictures):
    return ReportData(plan, results, Command("murmurate reproduce", "murmurate reproduce", 1.0, 0))


def test_a_run_without_a_valid_pattern_is_a_result(data):
    first, second = data.results
    summary = {**first.summary, "valid": 0.0, "failures": list(range(200))}
    failed = replace(first, summary=summary, manifest={**first.manifest, "valid_pattern": False})
    data = replace(data, results=(failed, second))
    assert notes(data).count(f"No valid pattern was discovered by `{first.planned.name}`.") == 2
    assert reports.make(data).numbers["experiments"]["A"]["central"]["valid_pattern"] is False


def test_when_nothing_failed_it_says_so(data):
    every = [replace(result, summary={**result.summary, "valid": 1.0}) for result in data.results]
    markdown = reports.make(replace(data, results=every)).markdown
    assert "Every episode of all 2 runs ended in a valid pattern." in markdown


def test_runs_of_several_machines_are_named(data):
    assert not any("several machines" in text for text in notes(data))
    first, second = data.results
    moved = replace(second, manifest={**second.manifest, "device": "cuda"})
    assert any("several machines" in text for text in notes(replace(data, results=(first, moved))))


def test_a_run_that_cannot_be_drawn_leaves_its_reason(data, tmp_path):
    broken = [replace(result, folder=tmp_path / "gone") for result in data.results]
    reasons = [text for text in notes(replace(data, results=broken)) if "There is no picture" in text]
    assert len(reasons) == 16
    assert all("gone" in text for text in reasons)


def test_a_report_is_replaced_and_nothing_else_is(data, tmp_path):
    out = tmp_path / "report"
    reports.check(out)
    reports.write(reports.make(data), out)
    (out / "report.md").write_text("old")
    reports.check(out)
    reports.write(reports.make(data), out)
    assert (out / "report.md").read_text().startswith("# ")


def test_an_interrupted_report_can_be_written_anew(data, tmp_path, monkeypatch):
    report = reports.make(data)
    monkeypatch.setattr(reports, "to_html", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        reports.write(report, tmp_path)
    reports.check(tmp_path)


@pytest.mark.parametrize("text", [None, "{}", "[]", "no json", '{"format": 2, "command": "", "quick": false}'])
def test_a_folder_of_something_else_is_refused(tmp_path, text):
    (tmp_path / "notes.txt").write_text("mine")
    if text is not None:
        (tmp_path / "report.json").write_text(text)
    with pytest.raises(RunError, match="holds other files: choose another --out"):
        reports.check(tmp_path)
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match=r"cannot write to .*file: Not a directory"):
        reports.check(tmp_path / "file")


def test_a_caption_names_the_policies_that_there_are(data):
    one, *others = data.results
    alone = replace(one, manifest={**one.manifest, "policies": one.manifest["policies"][:1]})
    markdown = reports.make(replace(data, results=[alone, *others])).markdown
    first, second = (result.planned.learner for result in data.results)
    assert (
        f"Experiment C, {first}: cumulative reward in one episode of the base policy, which none follows." in markdown
    )
    assert f"Experiment C, {second}: cumulative reward in one episode, with the switch from the base" in markdown
    assert re.search(rf"Experiment F, {first}: .* Start and final pattern", markdown)
    assert re.search(rf"Experiment F, {second}: .* Start, base pattern, final pattern", markdown)
