"""A document as one HTML file: pictures and style inside, no script, nothing from any network."""

from __future__ import annotations

import base64
import struct
from html import escape

from murmurate.report.document import (
    Block,
    Document,
    Heading,
    Items,
    Note,
    Picture,
    Table,
    Text,
    flatten,
    headings,
    spans,
)
from murmurate.report.style import STYLE

__all__ = ["as_html"]

_DPI = 180  # of the pictures; shown at their size in inches, their text is as large as the page's
_PAGE_DPI = 96


def as_html(document: Document) -> str:
    """Returns a document as the text of a self-contained HTML file."""
    caution = document.caution
    # A header group is repeated by browsers at the head of every printed page.
    running = f'<div class="running">{_inline(caution.reminder)}</div>' if caution else ""
    banner = f'<p class="banner">{_inline(caution.banner)}</p>' if caution else ""
    lines = [
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<meta name="color-scheme" content="light dark">',
        f"<title>{_bare(document.title)}</title>",
        f"<style>{STYLE}</style>",
        "</head>",
        '<body><div class="sheet">',
        running,
        "<main>",
        "<header>",
        f"<h1>{_inline(document.title)}</h1>",
        f'<p class="subtitle">{_inline(document.subtitle)}</p>',
        banner,
        "</header>",
        *_contents(headings(document)),
        *map(_block, flatten(document)),
        "</main>",
        "</div></body>",
        "</html>",
    ]
    return "\n".join(line for line in lines if line) + "\n"


def _contents(entries: list[Heading]) -> list[str]:
    items = [
        f'<li class="level{entry.level}"><a href="#{entry.anchor}">{_inline(entry.title)}</a></li>' for entry in entries
    ]
    return ['<nav aria-label="Contents"><ul>', *items, "</ul></nav>"] if items else []


def _block(block: Heading | Block) -> str:
    match block:
        case Heading(level, title, anchor):
            return f'<h{level} id="{anchor}">{_inline(title)}</h{level}>'
        case Text(text):
            return f"<p>{_inline(text)}</p>"
        case Note(text):
            return f'<p class="note">{_inline(text)}</p>'
        case Items(items):
            return "<ul>" + "".join(f"<li>{_inline(item)}</li>" for item in items) + "</ul>"
        case Table():
            return _table(block)
        case Picture():
            return _picture(block)
    raise TypeError(f"no HTML for {type(block).__name__}")


def _table(table: Table) -> str:
    def row(cells: tuple[str, ...], tag: str, attributes: str = "") -> str:
        kinds = [' class="words"' if letter == "l" else "" for letter in table.align]
        pairs = zip(cells, kinds, strict=True)
        return f"<tr>{''.join(f'<{tag}{attributes}{kind}>{_inline(cell)}</{tag}>' for cell, kind in pairs)}</tr>"

    bodies = ["<tbody>" + "".join(row(cells, "td") for cells in group) + "</tbody>" for group in table.groups]
    head = row(table.header, "th", ' scope="col"')
    # What scrolls can be reached by keyboard, and says what it is.
    box = f'<div class="scroll" role="region" tabindex="0" aria-label="{_bare(table.caption)}">'
    kind = ' class="reference"' if table.reference else ""
    caption = f"<caption>{_caption(table.caption)}</caption>"
    return f"{box}<table{kind}>{caption}<thead>{head}</thead>{''.join(bodies)}</table></div>"


def _picture(picture: Picture) -> str:
    width, height = (round(side * _PAGE_DPI / _DPI) for side in _size(picture.data))
    source = f"data:image/png;base64,{base64.b64encode(picture.data).decode()}"
    image = f'<img src="{source}" width="{width}" height="{height}" alt="{_bare(picture.alt)}">'
    caption = f"<figcaption>{_caption(picture.caption)}</figcaption>"
    return f'<figure style="width:{width}px">{image}{caption}</figure>'


def _size(png: bytes) -> tuple[int, int]:
    """Reads width and height, pixels, from a PNG's header."""
    return struct.unpack(">II", png[16:24])


def _caption(text: str) -> str:
    """Sets the number of a table or figure apart from its caption."""
    number, _, rest = text.partition(". ")
    return f"<b>{_inline(number)}.</b> {_inline(rest)}"


def _inline(text: str) -> str:
    return "".join(f"<code>{escape(part)}</code>" if is_code else escape(part) for part, is_code in spans(text))


def _bare(text: str) -> str:
    """Writes a text where no tags can be."""
    return escape("".join(part for part, _ in spans(text)))
