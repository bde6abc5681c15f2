"""The folder of a report: refused before anything is trained where it holds something else, and written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from murmurate.errors import RunError
from murmurate.report.document import Document, Picture, flatten
from murmurate.report.html import as_html
from murmurate.report.markdown import FIGURES, as_markdown
from murmurate.report.report import FORMAT, Report
from murmurate.runs import storage

__all__ = ["HTML", "MARKDOWN", "NUMBERS", "check", "write"]

HTML = "report.html"
MARKDOWN = "report.md"
NUMBERS = "report.json"


def check(folder: str | Path) -> None:
    """Makes sure that a report may be written to a folder, and creates it where there is none.

    Raises:
        RunError: The folder holds something else than a report, or cannot be written to.
    """
    folder = Path(folder)
    with storage.os_errors_as_run_errors(f"cannot write to {folder}"):
        present = folder.exists() and any(folder.iterdir())
    if present and not _is_report(folder):
        raise RunError(f"{folder} holds other files: choose another --out")
    if not present:
        storage.claim(folder)


def _is_report(folder: Path) -> bool:
    try:
        numbers: Any = storage.read_json(folder / NUMBERS)
    except RunError:
        return False
    return isinstance(numbers, dict) and numbers.get("format") == FORMAT and {"command", "quick"} <= numbers.keys()


def write(report: Report, folder: str | Path) -> None:
    """Writes a report, or replaces the one that the folder holds; every file whole or not at all.

    Raises:
        RunError: A file cannot be written.
    """
    folder = Path(folder)
    # First of all what says whose the folder is: an interrupted report can then be written anew.
    storage.make_folder(folder / FIGURES)
    storage.write_json(folder / NUMBERS, report.numbers)
    for picture in _pictures(report.document):
        storage.write_bytes(folder / FIGURES / f"{picture.name}.png", picture.data)
    storage.write_text(folder / MARKDOWN, as_markdown(report.document))
    storage.write_text(folder / HTML, as_html(report.document))


def _pictures(document: Document) -> list[Picture]:
    return [block for block in flatten(document) if isinstance(block, Picture)]
