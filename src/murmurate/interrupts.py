"""Lets a request to end, SIGTERM or Ctrl-Break, end a process as Ctrl-C does: batch systems and consoles send it."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Iterator
from typing import Any

__all__ = ["raise_if_interrupted", "sigterm_as_interrupt"]

# Windows has no SIGTERM between processes: there a process in a group of its own is sent Ctrl-Break instead.
_REQUESTS = [getattr(signal, name) for name in ("SIGTERM", "SIGBREAK") if hasattr(signal, name)]

_interrupted = False
"""Whether a request has come since the outermost block began."""


@contextlib.contextmanager
def sigterm_as_interrupt() -> Iterator[None]:
    """Raises `KeyboardInterrupt` at a request to end, until the block ends: workers end, what was reached is kept.

    Python drops an exception that a signal raises in a finaliser or a callback of a library, and goes on. What takes
    long asks `raise_if_interrupted` now and then, so that no request is lost; Ctrl-C is treated alike.
    """
    global _interrupted
    if threading.current_thread() is not threading.main_thread():  # only the main thread may handle signals
        yield
        return
    requests = list(_REQUESTS)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not one that the user has chosen, nor ignored
        requests.append(signal.SIGINT)
    before = {request: signal.signal(request, _interrupt) for request in requests}
    hook = sys.unraisablehook

    def report(dropped: sys.UnraisableHookArgs) -> None:
        # A request that Python drops is not lost: nobody needs to read where it came.
        if not issubclass(dropped.exc_type, KeyboardInterrupt):
            hook(dropped)

    sys.unraisablehook = report
    try:
        yield
    finally:
        sys.unraisablehook = hook
        for request, handler in before.items():
            signal.signal(request, handler)
        if _interrupt not in before.values():
            _interrupted = False


def raise_if_interrupted() -> None:
    """Raises `KeyboardInterrupt` where a request to end has come that did not: see `sigterm_as_interrupt`."""
    if _interrupted and threading.current_thread() is threading.main_thread():
        raise KeyboardInterrupt


def _interrupt(*_: Any) -> None:
    global _interrupted
    _interrupted = True
    raise KeyboardInterrupt
