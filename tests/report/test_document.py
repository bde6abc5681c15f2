from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from murmurate.report.document import (
    Caution,
    Document,
    Heading,
    Items,
    Note,
    Picture,
    Section,
    Table,
    Text,
    code,
    flatten,
    headings,
    spans,
)

TABLE = Table("A table.", ("a", "b"), ((("1", "2"),),), "lr")
PICTURE = Picture("p", b"", "A picture.", "what it shows")
CAUTION = Caution("the banner", "the reminder")


def document(*blocks, caution=None):
    return Document("Title", "subtitle", blocks, caution)


def test_tables_and_figures_are_numbered_apart():
    inner = Section("Inner", (PICTURE, TABLE))
    blocks = flatten(document(TABLE, Section("Outer", (PICTURE, inner)), TABLE))
    captions = [block.caption for block in blocks if isinstance(block, Table | Picture)]
    assert captions == [
        "Table 1. A table.",
        "Figure 1. A picture.",
        "Figure 2. A picture.",
        "Table 2. A table.",
        "Table 3. A table.",
    ]


def test_the_caution_stands_where_a_section_shows_something():
    parts = (Section("Words", (Text("t"),)), Section("Shown", (TABLE, Section("Below", (PICTURE,)))))
    blocks = flatten(document(*parts, caution=CAUTION))
    after = {
        block.title: following
        for block, following in zip(blocks, [*blocks[1:], None], strict=True)
        if isinstance(block, Heading)
    }
    assert after == {"Words": Text("t"), "Shown": Note("the reminder"), "Below": Note("the reminder")}
    assert not any(isinstance(block, Note) for block in flatten(document(*parts)))


def test_headings_have_levels_and_anchors_of_their_own():
    again = Section("The same", (Section("Part & parcel", ()),))
    other = Section("Another", (Section("Part & parcel", (Items(("i",)),)),))
    found = headings(document(again, other))
    assert [heading.level for heading in found] == [2, 3, 2, 3]
    assert [heading.anchor for heading in found] == [
        "the-same",
        "the-same-part-parcel",
        "another",
        "another-part-parcel",
    ]


def test_rows_of_a_table_are_as_wide_as_its_header():
    with pytest.raises(ValueError, match="rows of a table have"):
        Table("A table.", ("a", "b"), ((("1", "2"), ("1",)),), "lr")
    with pytest.raises(ValueError, match="rows of a table have"):
        Table("A table.", ("a", "b"), (), "l")


@given(st.text(), st.text(st.characters(exclude_characters="`")))
def test_any_value_can_be_code(value, before):
    parts = list(spans(f"{before}{code(value)}"))
    shown = [(before, False)] if before else []
    assert parts == [*shown, *([(value.replace("`", "'"), True)] if value else [])]
