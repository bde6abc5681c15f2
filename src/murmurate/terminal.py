"""What is printed: lines in which a terminal acts on nothing, whatever names of folders and files they hold."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from murmurate.errors import escaped

__all__ = ["say", "say_text"]


@runtime_checkable
class Writable(Protocol):
    """Where text can be printed: a file, or what a test has put into the place of one."""

    def write(self, text: str, /) -> object: ...

    def flush(self) -> object: ...


def say(line: str = "", file: Writable | None = None) -> None:
    """Prints a line at once; characters that a terminal would act on, line breaks among them, are escaped.

    Args:
        line: The line, without its end.
        file: Where to print; stdout by default.
    """
    print(escaped(line), file=file, flush=True)


def say_text(text: str) -> None:
    """Prints text of several lines, such as a table, as `say` prints each of them."""
    print("\n".join(map(escaped, text.removesuffix("\n").split("\n"))), flush=True)
