"""The errors that a user can cause; the command line prints each as one line and exits with status 2."""

from __future__ import annotations

import contextlib
import difflib
import math
import os
from collections.abc import Iterable, Sequence
from numbers import Integral, Real

__all__ = [
    "MAX_INTEGER",
    "MAX_MAGNITUDE",
    "BeyondTrainingWarning",
    "InputError",
    "RunError",
    "UsageError",
    "check_choice",
    "check_number",
    "check_path",
    "check_type",
    "suggestion",
]


def _one_line(text: str) -> str:
    return " ".join(text.split())


class InputError(ValueError):
    """A value that the user gave is not allowed.

    Attributes:
        field: The field that holds the value, as configuration files and flags spell it.
        value: The value that was given.
        allowed: What would have been allowed.
    """

    def __init__(self, field: str, value: object, allowed: str) -> None:
        self.field = field
        self.value = value
        self.allowed = allowed
        super().__init__(_one_line(f"{field} = {value!r}: must be {allowed}"))


class RunError(Exception):
    """A run folder cannot be read, written or continued."""

    def __init__(self, message: str) -> None:
        super().__init__(_one_line(message))


class UsageError(Exception):
    """A command line cannot be understood."""

    def __init__(self, message: str) -> None:
        super().__init__(_one_line(message))


class BeyondTrainingWarning(UserWarning):
    """Policies are executed where they were not trained: allowed, but they may do worse."""


MAX_MAGNITUDE = 1e9
"""Greatest magnitude of a number in a configuration: its square, and sums of squares, are finite in float32."""

MAX_INTEGER = 2**31 - 1
"""Greatest integer in a configuration: it fits 32 bits."""


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
        what = "an integer" if integer else "a finite number"
        raise InputError(field, value, f"{what} {' and '.join(bounds)}".strip())


def check_choice(field: str, value: object, choices: Sequence[str]) -> None:
    """Checks one choice of a configuration.

    Raises:
        InputError: The value is not one of the choices.
    """
    if value not in choices:
        raise InputError(field, value, f"one of {', '.join(choices)}")


def check_path(field: str, value: object) -> None:
    """Checks a path that was given in Python.

    Raises:
        InputError: It is neither text nor a path.
    """
    if not isinstance(value.__fspath__() if isinstance(value, os.PathLike) else value, str):
        raise InputError(field, value, "a path")


def check_type(field: str, value: object, kind: type, words: str) -> None:
    """Checks the type of an argument.

    Args:
        field: The argument.
        value: What was given.
        kind: The type that it must have.
        words: What that is, in words.

    Raises:
        InputError: It is of another type.
    """
    if not isinstance(value, kind):
        raise InputError(field, value, words)


def suggestion(word: str, known: Iterable[str]) -> str:
    """Returns "; did you mean ...?" with the known words most like this one, or nothing when none is like it."""
    words = list(known)
    close = difflib.get_close_matches(word, words, cutoff=0.85) or difflib.get_close_matches(word, words)
    return f"; did you mean {' or '.join(close)}?" if close else ""
