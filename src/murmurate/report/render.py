"""A page of Markdown as one HTML file: pictures and style inside, no script, nothing from a network.

The Markdown is the source. A paragraph in italics before a table, or after a picture, is its caption.
"""

from __future__ import annotations

import base64
import itertools
import re
import struct
from collections.abc import Mapping
from html import escape
from importlib.resources import files
from string import Template

from markdown_it import MarkdownIt
from markdown_it.token import Token

__all__ = ["to_html"]

_DPI, _PAGE_DPI = 180, 96
"""Pixels an inch of the pictures and of a page: shown at their size in inches, their text is as large as the page's."""


def to_html(markdown: str, pictures: Mapping[str, bytes], running: str = "") -> str:
    """Returns Markdown as the text of a self-contained HTML file.

    Args:
        markdown: The page; it begins with its title, and its first paragraph is its subtitle.
        pictures: The PNGs, by the path under which the page names them.
        running: A line at the head of every printed page.
    """
    parser = MarkdownIt("commonmark", {"html": False, "xhtmlOut": False}).enable("table")
    tokens = parser.parse(markdown)
    headings = _mark_headings(tokens)
    _embed(tokens, pictures)
    body = parser.renderer.render(_with_captions(tokens), parser.options, {})
    entries = "".join(f'<li class="{level}"><a href="#{anchor}">{text}</a></li>\n' for level, anchor, text in headings)
    contents = f'<nav aria-label="Contents"><ul>\n{entries}</ul></nav>\n' if entries else ""
    before, first, rest = body.partition("<h2")
    title = "".join(child.content for child in tokens[1].children or []) if tokens[0].tag == "h1" else ""
    return Template((files("murmurate.report") / "page.html").read_text("utf-8")).substitute(
        title=escape(title),
        running=f'<div class="running">{escape(running)}</div>' if running else "",
        body=before + contents + first + rest,
    )


def _mark_headings(tokens: list[Token]) -> list[tuple[str, str, str]]:
    """Gives the headings below the title anchors, and returns their level, anchor and text, for the contents."""
    headings, section = [], ""
    for token, inline in itertools.pairwise(tokens):
        if token.type == "heading_open" and token.tag in ("h2", "h3"):
            anchor = re.sub(r"\W+", "-", inline.content.lower()).strip("-")
            if token.tag == "h2":
                section = anchor
            else:
                anchor = f"{section}-{anchor}"
            token.attrSet("id", anchor)
            headings.append((f"level{token.tag[1]}", anchor, escape(inline.content)))
    return headings


def _embed(tokens: list[Token], pictures: Mapping[str, bytes]) -> None:
    """Puts the pictures into the page, at their size in inches."""
    for token in tokens:
        for child in token.children or []:
            if child.type == "image":
                data = pictures[str(child.attrs["src"])]
                width, height = struct.unpack(">II", data[16:24])  # of a PNG's header
                child.attrs = {
                    "src": f"data:image/png;base64,{base64.b64encode(data).decode()}",
                    "width": round(width * _PAGE_DPI / _DPI),
                    "height": round(height * _PAGE_DPI / _DPI),
                    "alt": "",  # the renderer writes the text of the picture here
                }


def _with_captions(tokens: list[Token]) -> list[Token]:
    """Returns the tokens with pictures and their captions as figures, and tables in boxes that scroll."""
    result: list[Token] = []
    index = tables = 0
    while index < len(tokens):
        token = tokens[index]
        if _paragraph(tokens, index) == "picture" and _paragraph(tokens, index + 3) == "caption":
            opening = [Token("figure_open", "figure", 1, block=True), tokens[index + 1]]
            caption = [Token("open", "figcaption", 1), tokens[index + 4], Token("close", "figcaption", -1)]
            result += [*opening, *caption, Token("figure_close", "figure", -1, block=True)]
            index += 6
            continue
        if token.type == "table_open":
            tables += 1
            # What scrolls can be reached by keyboard, and has a name.
            box: dict[str, str | int | float] = {
                "class": "scroll",
                "role": "region",
                "tabindex": "0",
                "aria-labelledby": f"table-{tables}",
            }
            if _paragraph(tokens, index - 3) == "caption":
                result[-3].attrs |= {"class": "caption", "id": f"table-{tables}"}
            result.append(Token("box_open", "div", 1, attrs=box, block=True))
        result.append(token)
        if token.type == "table_close":
            result.append(Token("box_close", "div", -1, block=True))
        index += 1
    return result


def _paragraph(tokens: list[Token], index: int) -> str:
    """Returns "picture" or "caption" where a paragraph that is nothing else begins, and "" otherwise."""
    if not 0 <= index < len(tokens) - 2 or tokens[index].type != "paragraph_open":
        return ""
    children = tokens[index + 1].children or []
    kinds = [child.type for child in children]
    if kinds == ["image"]:
        return "picture"
    whole = kinds[:1] == ["em_open"] and kinds[-1:] == ["em_close"] and kinds.count("em_open") == 1
    return "caption" if whole else ""
