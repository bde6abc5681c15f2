"""Lets a request to end, SIGTERM or Ctrl-Break, end a process as Ctrl-C does: batch systems and consoles send it."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from typing import Any

__all__ = ["sigterm_as_interrupt"]

# Windows has no SIGTERM between processes: there a process in a group of its own is sent Ctrl-Break instead.
_REQUESTS = [getattr(signal, name) for name in ("SIGTERM", "SIGBREAK") if hasattr(signal, name)]


@contextlib.contextmanager
def sigterm_as_interrupt() -> Iterator[None]:
    """Raises `KeyboardInterrupt` at a request to end, until the block ends: workers end, what was reached is kept."""
    if threading.current_thread() is not threading.main_thread():  # only the main thread may handle signals
        yield
        return

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    before = {request: signal.signal(request, interrupt) for request in _REQUESTS}
    try:
        yield
    finally:
        for request, handler in before.items():
            signal.signal(request, handler)
