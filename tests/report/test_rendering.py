"""Both renderings of a document: what each needs, and that they say the same."""

from __future__ import annotations

import base64
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from reading import Page, markdown_words

from murmurate.report.document import Caution, Document, Items, Note, Picture, Section, Table, Text
from murmurate.report.html import as_html
from murmurate.report.markdown import as_markdown

# The smallest PNG there is: one white pixel.
PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mP8/5+hHgAHggJ/PchI7wAAAABJRU5ErkJggg=="
)
TRICKY = 'a <b> & "c" | *d* _e_ [f](g) `x|y<z>` #h ~i~ \\j'
DOCUMENT = Document(
    title=f"Title {TRICKY}",
    subtitle=TRICKY,
    blocks=(
        Text(TRICKY),
        Section(
            f"First {TRICKY}",
            (
                Table(TRICKY, ("l", TRICKY), ((("1", TRICKY), ("2", "x")), (("3", "y"),)), "lr", reference=True),
                Picture("name", PNG, TRICKY, TRICKY),
                Section("Part", (Items((TRICKY, "second")), Note(TRICKY))),
            ),
        ),
    ),
    caution=Caution(f"banner {TRICKY}", f"reminder {TRICKY}"),
)


@pytest.fixture(scope="module")
def page():
    return Page(as_html(DOCUMENT))


def test_html_needs_nothing_else(page):
    text = as_html(DOCUMENT)
    assert not re.search(r"https?:|//|@import|url\(", re.sub(r"base64,[^\"]*", "", text))
    assert not {"script", "link", "iframe", "object", "embed"} & set(page.tags)
    (source,) = page.of("img", "src")
    assert base64.b64decode(source.removeprefix("data:image/png;base64,")) == PNG


def test_html_can_be_used_by_everybody(page):
    assert page.of("img", "alt") == [TRICKY.replace("`", "")]
    assert page.of("html", "lang") == ["en"]
    names = [values["id"] for _, values in page.attributes if "id" in values]
    assert [link.removeprefix("#") for link in page.of("a", "href")] == names
    assert len(set(names)) == len(names) == 2
    assert page.of("th", "scope") == ["col", "col"]


def test_html_has_its_style_for_dark_screens_and_paper():
    text = as_html(DOCUMENT)
    for part in ("prefers-color-scheme: dark", "@media print", "@page", "overflow-x: auto"):
        assert part in text


def test_the_caution_is_on_every_page(page):
    assert page.said[("div", "running")][0].startswith("reminder a <b>")
    assert page.said[("p", "banner")][0].startswith("banner a <b>")
    # Under the one heading with a table.
    assert [text for text in page.said[("p", "note")] if text.startswith("reminder")] == [
        'reminder a <b> & "c" | *d* _e_ [f](g) '
    ]
    assert as_markdown(DOCUMENT).count("> reminder") == 1
    assert "> **banner" in as_markdown(DOCUMENT)


def test_both_say_the_same_words_in_the_same_order(page):
    assert markdown_words(as_markdown(DOCUMENT)) == page.words


def test_markdown_tables_keep_their_columns():
    rows = [line for line in as_markdown(DOCUMENT).splitlines() if line.startswith("| ")]
    assert len(rows) == 5
    assert {len(re.findall(r"(?<!\\)\|", row)) for row in rows} == {3}
    assert rows[1] == "| --- | ---: |"


def test_markdown_names_its_pictures():
    assert "](figures/name.png)" in as_markdown(DOCUMENT)


@given(st.text(st.characters(exclude_categories=("Cc", "Cs", "Zs", "Zl", "Zp"), exclude_characters="`")))
def test_html_says_any_text(text):
    page = Page(as_html(Document("t", "s", (Text(text),))))
    assert "".join(page.said.get(("p", None), [])) == text
