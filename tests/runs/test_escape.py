"""Names that others chose reach a terminal, a page and a spreadsheet as text, and do nothing there."""

from __future__ import annotations

import csv
import io
import json

import pytest
from rich.console import Console

from murmurate.analysis import Catalogue, Finding
from murmurate.errors import RunError
from murmurate.report.render import to_html
from murmurate.report.tables import code
from murmurate.runs import catalogues, comparison, comparison_page, escape, sweep, table

NASTY = "[/x]\x1b]0;title\x07 <script>alert(1)</script> | `x` *b*"


def printed(renderable):
    console = Console(file=io.StringIO(), width=200)
    console.print(renderable)
    return console.file.getvalue()


def test_a_terminal_acts_on_nothing():
    text = printed(table.as_rich(("a", NASTY), [("b", NASTY)]))
    assert text.count("[/x]\\x1b]0;title\\x07 <script>") == 2
    assert "\x1b" not in text
    assert "\x07" not in text


def test_a_page_shows_it_and_does_nothing():
    page = table.as_markdown(("a", "b"), [("x", NASTY)])
    assert page.count("\n") == 3
    html = to_html(f"# title\n\n{page}\n\n{escape.markdown(NASTY)}\n\n{code(NASTY)}\n", {})
    assert "<script>" not in html
    assert html.count("&lt;script&gt;alert(1)&lt;/script&gt;") == 3
    assert html.count("<td") == 2
    assert "<em>b</em>" not in html
    assert code("a\x1b]0;title\x07") == "`a\\x1b]0;title\\x07`"
    inside = code("x`\n\n# heading\n\n![picture](http://x/y.png)")
    broken_out = to_html(f"# title\n\n- {inside}\n", {})
    assert "<img" not in broken_out
    assert "heading</h1>" not in broken_out


@pytest.mark.parametrize("text", ["=HYPERLINK(1)", "+1+1", "-2+3", "@SUM(A1)", "\t=1"])
def test_a_spreadsheet_computes_nothing(tmp_path, text):
    assert escape.cell(text) == f"'{text}"
    sweep.write_csv(tmp_path / "x.csv", [{"error": text, "gap": -0.5, "run": "a-b", "none": None}])
    (row,) = csv.DictReader(io.StringIO((tmp_path / "x.csv").read_bytes().decode(), newline=""))
    assert row == {"error": f"'{text}", "gap": "-0.5", "run": "a-b", "none": ""}


def test_a_catalogue_s_names_are_no_formulas(tmp_path):
    finding = Finding(
        positions=[[0, 0], [5, 0], [0, 5]],
        radius=1,
        safe_distance=4,
        scan_radius=20,
        objective="C2",
        value=3,
        gap=None,
        experiment='=HYPERLINK("http://x")',
        policy="central",
        start="=1+1",
        seed=0,
        run="r",
        episode=0,
    )
    catalogues.write(Catalogue.from_findings([finding]), tmp_path)
    cells = [cell for row in csv.reader((tmp_path / "catalogue.csv").read_text().splitlines()) for cell in row]
    assert not any(cell.startswith(("=", "+", "@")) for cell in cells)
    assert "'=1+1: 1" in cells
    assert catalogues.read_findings(tmp_path)[0].start == "=1+1"


ROW = {
    "method": "circle",
    "sensing": "visible",
    "scheduler": "fsync",
    "robots": 3,
    "start": "random",
    "episodes": 10,
    "valid": 5,
    "interval": [0.2, 0.8],
    "collisions": 1,
    "left": 1,
    "hidden": 2,
    "unsafe": 0,
    "restless": 1,
    "steps": 3.0,
    "epochs": None,
    "efficiency": 0.5,
    "gap": None,
    "worst": [{"positions": [[0, 0], [1, 2], [3, 4]], "free": True}],
}


def test_the_page_of_a_comparison_escapes_its_names():
    rows = [ROW | {"method": NASTY}, ROW]
    page = comparison_page.page(rows, ["murmurate compare '```' <b>"], pictures="a (b)/\n![x](http://y)/")
    html = to_html(f"# title\n\n{page}", _Pictures())
    assert "<script>" not in html
    assert page.count("```") == 2
    assert "(a%20%28b%29/" in page


class _Pictures(dict):
    def __missing__(self, name):
        return b"\x89PNG\r\n\x1a\n" + bytes(8) + (1).to_bytes(4, "big") * 2


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"episodes": -5}, "row 1 has episodes = -5"),
        ({"valid": 11}, "row 1 has valid = 11"),
        ({"valid": True}, "row 1 has valid = True"),
        ({"robots": 10**40}, "row 1 has robots = 1000"),
        ({"interval": [0, 2]}, r"row 1 has interval = \[0, 2\]"),
        ({"sensing": "\x1b"}, r"row 1 has sensing = '\\x1b'"),
        ({"start": []}, r"row 1 has start = \[\]"),
        ({"method": None}, "row 1 has method = None"),
        ({"steps": "x"}, "row 1 has steps = 'x'"),
        ({"steps": 10**399}, "row 1 has steps = 1000"),  # no float holds it
        ({"worst": [{"positions": [[0, 0]], "free": True}]}, "row 1 has worst = "),
        ({"worst": [{"positions": [[0, 0], [0, 1], [1e300, 0]], "free": True}]}, "row 1 has worst = "),
    ],
)
def test_rows_of_a_comparison_are_checked(tmp_path, change, line):
    (tmp_path / "comparison.json").write_text(json.dumps({"rows": [ROW | change]}))
    with pytest.raises(RunError, match=line) as caught:
        comparison.sorted_rows(tmp_path)
    assert str(caught.value).isprintable()


def test_a_table_s_methods_are_not_imported(tmp_path, monkeypatch):
    (tmp_path / "evil.py").write_text("raise SystemExit('executed')")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "comparison.json").write_text(json.dumps({"rows": [ROW | {"method": "evil:Method"}, ROW]}))
    rows = comparison.sorted_rows(tmp_path)
    assert [row["method"] for row in rows] == ["circle", "evil:Method"]
    assert "evil:Method" not in comparison.deviations(rows)
