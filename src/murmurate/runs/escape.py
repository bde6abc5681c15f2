"""Text that may be a stranger's, made harmless for what shows it: a terminal, a page of Markdown, a spreadsheet.

Names of folders, methods, starts and machines come from files that others wrote. A terminal acts on control characters
and rich on `[markup]`, a page on Markdown and HTML, a spreadsheet on cells that begin like a formula.
"""

from __future__ import annotations

import re
from typing import Any
from urllib.parse import quote

from rich.text import Text

from murmurate.errors import printable

__all__ = ["cell", "code", "link", "markdown", "rich"]


def rich(text: str) -> Text:
    """Returns text for a table or line of rich, which acts on nothing in it."""
    return Text(printable(text))


def markdown(text: str) -> str:
    """Returns text as a cell or paragraph of Markdown, whose characters mean nothing there, nor in HTML."""
    return re.sub(r"([\\`*\[\]<>|&])", r"\\\1", printable(text))


def code(value: object) -> str:
    """Returns a value as code in a line of Markdown, whatever characters it has; line breaks would end the line."""
    return f"`{printable(str(value)).replace('`', chr(39))}`"


def link(path: str) -> str:
    """Returns a relative path as the target of a link in Markdown."""
    return quote(path.replace("\\", "/"), errors="surrogateescape")


def cell(value: Any) -> Any:
    """Returns a value of a CSV file; text that a spreadsheet would take for a formula begins with an apostrophe."""
    return f"'{value}" if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")) else value
