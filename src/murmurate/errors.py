"""The errors that a user can cause; the command line prints each as one line and exits with status 2."""

from __future__ import annotations

import contextlib
import difflib
import math
from collections.abc import Iterable, Sequence
from numbers import Integral, Real

__all__ = [
    "MAX_INTEGER",
    "MAX_MAGNITUDE",
    "BeyondTrainingWarning",
    "ForkError",
    "InputError",
    "RunError",
    "UsageError",
    "check_choice",
    "check_number",
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

    def __init__(self, field: str | InputError, value: object = None, allowed: str = "") -> None:
        # Who passes an error on from another process, such as Gymnasium's AsyncVectorEnv, makes a new one of it.
        if isinstance(field, InputError):
            field, value, allowed = field.field, field.value, field.allowed
        self.field: str = field
        self.value = value
        self.allowed = allowed
        super().__init__(_one_line(f"{field} = {value!r}: must be {allowed}"))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, object, str]]:
        return type(self), (self.field, self.value, self.allowed)


class RunError(Exception):
    """A run folder cannot be read, written or continued."""

    def __init__(self, message: str) -> None:
        super().__init__(_one_line(message))


class UsageError(Exception):
    """A command line cannot be understood."""

    def __init__(self, message: str) -> None:
        super().__init__(_one_line(message))


class ForkError(RuntimeError):
    """JAX had been started before this process was forked, and cannot compute in it."""


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


def suggestion(word: str, known: Iterable[str]) -> str:
    """Returns "; did you mean ...?" with the known words most like this one, or nothing when none is like it."""
    words = list(known)
    close = difflib.get_close_matches(word, words, cutoff=0.85) or difflib.get_close_matches(word, words)
    return f"; did you mean {' or '.join(close)}?" if close else ""
