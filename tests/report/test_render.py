"""Markdown as HTML: whole, self-contained, with captions, and any text comes out as it went in."""

from __future__ import annotations

import base64
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from reading import Page

from murmurate.errors import printable
from murmurate.report.render import to_html
from murmurate.report.tables import _table, caption, code, plain

# The smallest PNG there is: one white pixel.
PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mP8/5+hHgAHggJ/PchI7wAAAABJRU5ErkJggg=="
)
TRICKY = 'a <b> & "c" | *d* _e_ [f](g) `x|y<z>` #h ~i~ \\j'
SHOWN = TRICKY.replace("`", "")
PAGE = "\n\n".join(
    [
        f"# Title {plain(TRICKY)}",
        "subtitle",
        plain(TRICKY),
        "## First & only",
        _table(TRICKY, ("l", plain(TRICKY)), [("*1*", plain(TRICKY)), ("2", "x")], "lr"),
        f"![{plain(TRICKY)}](figures/name.png)",
        caption("Figure", TRICKY),
        "### Part",
        f"- {plain(TRICKY)}\n- second",
        f"> {plain(TRICKY)}",
        "## Other",
        "### Part",
    ]
)


@pytest.fixture(scope="module")
def html():
    return to_html(PAGE, {"figures/name.png": PNG}, "running <head>")


@pytest.fixture(scope="module")
def page(html):
    return Page(html)


def test_html_needs_nothing_else(html, page):
    assert not re.search(r"https?:|//|@import|url\(", re.sub(r"base64,[^\"]*", "", html))
    assert not {"script", "link", "iframe", "object", "embed"} & set(page.tags)
    (source,) = page.of("img", "src")
    assert base64.b64decode(source.removeprefix("data:image/png;base64,")) == PNG


def test_html_is_accessible(page):
    assert page.of("img", "alt") == [SHOWN]
    assert page.of("html", "lang") == ["en"]
    anchors = page.of("h2", "id") + page.of("h3", "id")
    assert sorted(link.removeprefix("#") for link in page.of("a", "href")) == sorted(anchors)
    assert len(set(anchors)) == 4
    # A table that scrolls can be reached by keyboard, and its caption names it.
    assert page.of("div", "tabindex") == ["0"]
    assert page.of("div", "aria-labelledby") == page.of("p", "id") == ["table-1"]


def test_html_has_its_style_for_narrow_and_dark_screens_and_paper(html):
    for part in ("prefers-color-scheme: dark", "@media print", "@page", "overflow-x: auto", "max-width: 40rem"):
        assert part in html


def test_html_says_what_the_markdown_says(page):
    assert page.texts["h1"] == [f"Title {SHOWN}"]
    assert page.texts["title"] == [f"Title {SHOWN}"]
    assert page.texts["h2"] == ["First & only", "Other"]
    assert page.texts["h3"] == ["Part", "Part"]
    assert page.texts["p"] == ["subtitle", SHOWN, "Table {number}. " + SHOWN, SHOWN]
    assert page.texts["figcaption"] == ["Figure {number}. " + SHOWN]
    assert page.texts["th"] == ["l", SHOWN]
    assert page.texts["td"] == ["1", SHOWN, "2", "x"]
    assert page.texts["li"][-2:] == [SHOWN, "second"]
    assert "running <head>\n" in page.texts["div"]


def test_numbers_are_aligned_to_the_right(page):
    assert page.of("td", "style") == ["text-align:right"] * 2


def test_tables_keep_their_columns():
    rows = [line for line in PAGE.splitlines() if line.startswith("| ")]
    assert {len(re.findall(r"(?<!\\)\|", row)) for row in rows} == {3}
    assert rows[1] == "| --- | ---: |"


@given(st.text(st.characters(exclude_categories=("Cc", "Cs", "Zs", "Zl", "Zp"), exclude_characters="`"), min_size=1))
def test_any_text_comes_out_as_it_went_in(text):
    page = Page(to_html(f"# t\n\nx {plain(text)}", {}))
    assert page.texts["p"] == [f"x {text}"]


@given(st.text(st.characters(exclude_categories=("Cc", "Cs", "Zs", "Zl", "Zp")), min_size=1))
def test_any_value_can_be_code(value):
    page = Page(to_html(f"x {code(value)}", {}))
    assert page.texts["p"] == [f"x {printable(value).replace('`', chr(39))}"]
