"""A small model of a document: sections of text, tables and pictures, rendered as HTML and as Markdown alike.

What both renderings share is decided here, once: the order, the numbers of tables and figures, and the caution that a
report of smaller budgets carries. Text is plain; what stands between two backticks is code.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

__all__ = [
    "Block",
    "Caution",
    "Document",
    "Heading",
    "Items",
    "Note",
    "Picture",
    "Section",
    "Table",
    "Text",
    "code",
    "flatten",
    "headings",
    "spans",
]


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str


@dataclass(frozen=True)
class Note:
    """A paragraph that a reader must not miss."""

    text: str


@dataclass(frozen=True)
class Items:
    """A list of short paragraphs."""

    items: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        caption: What it shows.
        header: The columns' names.
        groups: Rows that belong together, each a cell a column.
        align: A letter a column: l for words, r for numbers.
        reference: Whether the first row of each group is what its others are compared with.
    """

    caption: str
    header: tuple[str, ...]
    groups: tuple[tuple[tuple[str, ...], ...], ...]
    align: str
    reference: bool = False

    def __post_init__(self) -> None:
        widths = {len(self.header), len(self.align)} | {len(row) for group in self.groups for row in group}
        if len(widths) > 1:
            raise ValueError(f"rows of a table have {sorted(widths)} cells")


@dataclass(frozen=True)
class Picture:
    """A picture.

    Attributes:
        name: Its file's name, without folder and suffix.
        data: The PNG.
        caption: What it shows.
        alt: What a reader who cannot see it needs to know.
    """

    name: str
    data: bytes
    caption: str
    alt: str


@dataclass(frozen=True)
class Section:
    """A part of the document, with a heading."""

    title: str
    blocks: tuple[Block, ...]


Block = Text | Note | Items | Table | Picture | Section


@dataclass(frozen=True)
class Caution:
    """What a reader must know before believing any number of the document.

    Attributes:
        banner: Said once, at the top.
        reminder: Said on every printed page, and under the heading of every section with tables or pictures.
    """

    banner: str
    reminder: str


@dataclass(frozen=True)
class Document:
    """A whole document.

    Attributes:
        title: Its title.
        subtitle: A line below it.
        blocks: What it says.
        caution: What must be known first, if anything.
    """

    title: str
    subtitle: str
    blocks: tuple[Block, ...]
    caution: Caution | None = None


@dataclass(frozen=True)
class Heading:
    """A section's heading, where it stands in the flat document.

    Attributes:
        level: 2 for a section, 3 for a part of one; the title of the document is 1.
        title: Its words.
        anchor: Its name as the target of a link, unique in the document.
    """

    level: int
    title: str
    anchor: str


def flatten(document: Document) -> list[Heading | Block]:
    """Returns a document's blocks in order: headings for sections, tables and figures numbered, cautions put in."""
    blocks: list[Heading | Block] = []
    counts = {"Table": 0, "Figure": 0}
    for block in _walk(document.blocks, document.caution, 2):
        if isinstance(block, Table | Picture):
            kind = "Table" if isinstance(block, Table) else "Figure"
            counts[kind] += 1
            block = replace(block, caption=f"{kind} {counts[kind]}. {block.caption}")
        blocks.append(block)
    return blocks


def headings(document: Document) -> list[Heading]:
    """Returns a document's headings, for its table of contents."""
    return [block for block in flatten(document) if isinstance(block, Heading)]


def _walk(blocks: tuple[Block, ...], caution: Caution | None, level: int, path: str = "") -> Iterator[Heading | Block]:
    for block in blocks:
        if not isinstance(block, Section):
            yield block
            continue
        anchor = path + re.sub(r"\W+", "-", block.title.lower()).strip("-")
        yield Heading(level, block.title, anchor)
        if caution and any(isinstance(inner, Table | Picture) for inner in block.blocks):
            yield Note(caution.reminder)
        yield from _walk(block.blocks, caution, level + 1, f"{anchor}-")


def spans(text: str) -> Iterator[tuple[str, bool]]:
    """Splits a text into its parts, each with whether it is code."""
    for place, part in enumerate(text.split("`")):
        if part:
            yield part, place % 2 == 1


def code(value: object) -> str:
    """Returns a value as text that is code, whatever characters it has."""
    return f"`{str(value).replace('`', chr(39))}`"
