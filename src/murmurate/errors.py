"""The errors that a user can cause; the command line prints each as one line and exits with status 2."""

from __future__ import annotations

import contextlib
import difflib
import math
import os
import reprlib
from collections.abc import Iterable, Sequence
from numbers import Integral, Real

__all__ = [
    "MAX_INTEGER",
    "MAX_MAGNITUDE",
    "BeyondTrainingWarning",
    "ForkError",
    "InputError",
    "RunError",
    "StartSetWarning",
    "UsageError",
    "check_all",
    "check_choice",
    "check_function",
    "check_number",
    "check_path",
    "check_type",
    "escaped",
    "one_line",
    "printable",
    "shown",
    "suggestion",
]

MAX_LINE = 300
"""Characters of a message, at most; the middle of a longer one is left out."""

_REPR = reprlib.Repr()
_REPR.maxlevel, _REPR.maxlist, _REPR.maxtuple, _REPR.maxdict, _REPR.maxset = 3, 8, 8, 6, 8
_REPR.maxstring = _REPR.maxother = 100
_REPR.maxlong = 60


def one_line(text: str, limit: int = MAX_LINE) -> str:
    """Returns text as one short line that is safe to print: characters that a terminal would act on are escaped.

    Args:
        text: Any text, also what a stranger's file holds.
        limit: Greatest number of characters; the middle of longer text is left out.
    """
    line = printable(text)
    if len(line) <= limit:
        return line
    end = limit // 3
    return f"{line[: limit - end - 5]} ... {line[-end:]}"


def printable(text: str) -> str:
    """Returns text on one line; characters that a terminal would act on, or cannot write, are escaped."""
    return escaped(" ".join(text.split()))


def escaped(text: str) -> str:
    """Returns text with the characters that a terminal would act on, or cannot write, escaped as in Python."""
    return text if text.isprintable() else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def shown(value: object) -> str:
    """Returns a value as messages show it: as Python writes it, what is long or deeply nested in short."""
    try:
        return one_line(_REPR.repr(value), 150)
    except Exception:  # Python refuses to write an integer of more than 4,300 digits
        return f"<{type(value).__name__}>"


class InputError(ValueError):
    """A value that the user gave is not allowed.

    Attributes:
        field: The field that holds the value, as configuration files and flags spell it.
        value: The value that was given.
        allowed: What would have been allowed.
    """

    def __init__(self, field: str | InputError, value: object = None, allowed: str = "") -> None:
        # Who passes an error on from another process, such as Gymnasium's AsyncVectorEnv, makes a new one of it.
        if isinstance(field, InputError):
            field, value, allowed = field.field, field.value, field.allowed
        self.field: str = field
        self.value = value
        self.allowed = allowed
        super().__init__(one_line(f"{one_line(field, 150)} = {shown(value)}: must be {allowed}"))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, object, str]]:
        return type(self), (self.field, self.value, self.allowed)


class RunError(Exception):
    """A run folder cannot be read, written or continued."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class UsageError(Exception):
    """A command line cannot be understood."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class ForkError(RuntimeError):
    """JAX had been started before this process was forked, and cannot compute in it."""


class BeyondTrainingWarning(UserWarning):
    """Policies are executed where they were not trained: allowed, but they may do worse."""


class StartSetWarning(UserWarning):
    """A named set of starts is not on this machine what it is on others."""


MAX_MAGNITUDE = 1e9
"""Greatest magnitude of a number in a configuration: its square, and sums of squares, are finite in float32."""

MAX_INTEGER = 2**31 - 1
"""Greatest integer in a configuration: it fits 32 bits."""


MAX_PATH_BYTES, MAX_NAME_BYTES = 4096, 255
"""Bytes of a path, and of the name of a file or folder, at most: what common file systems allow."""


def check_number(
    field: str,
    value: object,
    low: float | None = None,
    high: float | None = None,
    *,
    exclusive_low: bool = False,
    integer: bool = False,
) -> None:
    """Checks one number of a configuration.

    Args:
        field: The field that holds the value.
        value: The value.
        low: Least allowed value; None for no bound.
        high: Greatest allowed value; None for no bound.
        exclusive_low: The value must be greater than `low`, not equal to it.
        integer: The value must be an int.

    Raises:
        InputError: The value is not a number, not finite, not whole or out of bounds.
    """
    bounds = []
    if low is not None:
        bounds.append(f"{'>' if exclusive_low else '>='} {low:g}")
    if high is not None:
        bounds.append(f"<= {high if integer else format(high, 'g')}")
    number = math.nan
    if isinstance(value, Integral if integer else Real) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):
            number = float(value)
    above = low is None or (number > low if exclusive_low else number >= low)
    below = high is None or number <= high
    if not (math.isfinite(number) and above and below):
        noun = "an integer" if integer else "a finite number"
        raise InputError(field, value, f"{noun} {' and '.join(bounds)}".strip())


def check_choice(field: str, value: object, choices: Sequence[str]) -> None:
    """Checks one choice of a configuration.

    Raises:
        InputError: The value is not one of the choices.
    """
    if not isinstance(value, str) or value not in choices:
        raise InputError(field, value, f"one of {', '.join(choices)}")


def check_path(field: str, value: object) -> None:
    """Checks a path that was given in Python.

    Raises:
        InputError: It is neither text nor a path, or no file can have that name.
    """
    text = value.__fspath__() if isinstance(value, os.PathLike) else value
    if not isinstance(text, str):
        raise InputError(field, value, "a path")
    if "\0" in text:
        raise InputError(field, text, "a path, without a NUL character")
    lengths = [len(name.encode(errors="surrogatepass")) for name in text.split(os.sep)]
    if sum(lengths) + len(lengths) > MAX_PATH_BYTES or max(lengths) > MAX_NAME_BYTES:
        raise InputError(field, text, f"a path of at most {MAX_PATH_BYTES} bytes, {MAX_NAME_BYTES} in each name")


def check_type(field: str, value: object, kind: type, allowed: str) -> None:
    """Checks the type of an argument.

    Args:
        field: The argument.
        value: What was given.
        kind: The type that it must have.
        allowed: What that is, in words.

    Raises:
        InputError: It is of another type.
    """
    if not isinstance(value, kind):
        raise InputError(field, value, allowed)


def check_all(field: str, values: object, kind: type, allowed: str) -> None:
    """Checks that an argument is a sequence of values of one type.

    Args:
        field: The argument.
        values: What was given.
        kind: The type of each value.
        allowed: What they are, in words.

    Raises:
        InputError: It is none, or one of them is of another type.
    """
    if isinstance(values, str | bytes) or not isinstance(values, Iterable):
        raise InputError(field, values, allowed)
    for value in values:
        check_type(field, value, kind, allowed)


def check_function(field: str, value: object, signature: str) -> None:
    """Checks an argument that is a function, or None.

    Raises:
        InputError: It is neither.
    """
    if value is not None and not callable(value):
        raise InputError(field, value, f"a function {signature}")


def suggestion(word: str, known: Iterable[str]) -> str:
    """Returns "; did you mean ...?" with the known words most like this one, or nothing when none is like it."""
    candidates = list(known)
    close = difflib.get_close_matches(word, candidates, cutoff=0.85) or difflib.get_close_matches(word, candidates)
    return f"; did you mean {' or '.join(close)}?" if close else ""
