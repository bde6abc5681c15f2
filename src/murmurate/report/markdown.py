"""A document as Markdown, its pictures beside it."""

from __future__ import annotations

import re

from murmurate.report.document import Block, Document, Heading, Items, Note, Picture, Table, Text, flatten, spans

__all__ = ["FIGURES", "as_markdown"]

FIGURES = "figures"
"""The folder of the pictures, beside the file."""

_SPECIAL = re.compile(r"([\\*_\[\]<>|#~&])")


def as_markdown(document: Document) -> str:
    """Returns a document as Markdown; pictures are named as `figures/NAME.png`."""
    parts = [f"# {_plain(document.title)}", _plain(document.subtitle)]
    if document.caution:
        parts.append(f"> **{_plain(document.caution.banner)}**")
    return "\n\n".join([*parts, *map(_block, flatten(document))]) + "\n"


def _block(block: Heading | Block) -> str:
    match block:
        case Heading(level, title):
            return f"{'#' * level} {_plain(title)}"
        case Text(text):
            return _plain(text)
        case Note(text):
            return f"> {_plain(text)}"
        case Items(items):
            return "\n".join(f"- {_plain(item)}" for item in items)
        case Table():
            return _table(block)
        case Picture(name, _, caption, alt):
            return f"![{_plain(alt)}]({FIGURES}/{name}.png)\n\n*{_plain(caption)}*"
    raise TypeError(f"no Markdown for {type(block).__name__}")


def _table(table: Table) -> str:
    rule = ["---" if letter == "l" else "---:" for letter in table.align]
    rows = [[_cell(cell) for cell in row] for group in table.groups for row in group]
    lines = [[_cell(name) for name in table.header], rule, *rows]
    return f"*{_plain(table.caption)}*\n\n" + "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _cell(text: str) -> str:
    """A bar ends a cell even inside of code."""
    return re.sub(r"(?<!\\)\|", r"\\|", _plain(text))


def _plain(text: str) -> str:
    """Keeps characters that mean something to Markdown from meaning it."""
    return "".join(f"`{part}`" if is_code else _SPECIAL.sub(r"\\\1", part) for part, is_code in spans(text))
