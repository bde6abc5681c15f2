"""One line about the progress of long work, as a pipe or a log wants it."""

from __future__ import annotations

import time
from collections.abc import Callable

__all__ = ["duration", "line", "on_chunk", "values_text"]

CHUNK_SECONDS = 2.0
"""Seconds between two lines about the same rollout, at least: the short ones of small swarms have none."""

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


def duration(seconds: float) -> str:
    """Returns a time in its natural unit."""
    for unit, name in ((3600, "hours"), (60, "minutes")):
        if seconds >= 2 * unit:
            return f"{seconds / unit:.0f} {name}"
    return f"{seconds:.0f} seconds"


def on_chunk(
    report: Callable[..., None], work: str, total: int, usual_steps: float, before: int = 0
) -> Callable[[int, int, int], None]:
    """Returns a function that reports how far a rollout is, for `Cascade.rollout`.

    Args:
        report: Called as `report(work, done, total, **values)`, where the episodes that have ended are what is done.
        work: What is being done.
        total: How many episodes there are.
        usual_steps: Steps that such episodes take, about: until then, the time that is left is told.
        before: Episodes that ended before this rollout.
    """
    first: tuple[int, float] | None = None
    reported = 0.0

    def report_chunk(steps: int, max_steps: int, ended: int) -> None:
        nonlocal first, reported
        now = time.monotonic()
        if first is None:  # says nothing of the time that the others take: its program was compiled before
            first, reported = (steps, now), now
        if now - reported < CHUNK_SECONDS:
            return
        reported = now
        text = f"step {steps:,} of {max_steps:,} at most"
        first_steps, begun = first
        if first_steps < steps < usual_steps:
            seconds = (now - begun) / (steps - first_steps) * (usual_steps - steps)
            text += f", about {duration(seconds)} left"
        report(work, min(before + ended, total), total, steps=text)

    return report_chunk


def _format(name: str, value: float | str) -> str:
    return value if isinstance(value, str) else _FORMATS.get(name, name + " {:.3g}").format(value)
