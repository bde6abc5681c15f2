"""One line about the progress of long work, as a pipe or a log wants it."""

from __future__ import annotations

__all__ = ["line", "values_text"]

_FORMATS = {
    "reward": "reward {:+.4f}",
    "objective": "objective {:.3f}",
    "visible": "{:.0%} visible",
    "valid": "{:.0%} valid",
    "steps_per_second": "{:,.0f} steps/s",
    "seconds_left": "{:,.0f} s left",
}


def line(work: str, done: int, total: int, **values: float | str) -> str:
    """Returns a line of progress.

    Args:
        work: What is being done, such as the policy in training.
        done: How many updates (or other units) are done.
        total: How many there are.
        **values: What else to show, by name: reward, visible, valid, steps_per_second, seconds_left, or anything else;
            text is shown as it is.
    """
    return f"{work}: {done}/{total}  {values_text(**values)}".rstrip()


def values_text(**values: float | str) -> str:
    """Returns values with what they are, as `line` shows them."""
    return "  ".join(_format(name, value) for name, value in values.items())


def _format(name: str, value: float | str) -> str:
    return value if isinstance(value, str) else _FORMATS.get(name, name + " {:.3g}").format(value)
