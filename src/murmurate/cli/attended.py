"""A process that outlives the one that trains among other hosts, and says why that one has ended when it cannot.

JAX ends a process at once, with a trace of C++, when it learns that another host is gone: nothing in it can tell then.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import tempfile
import threading
from typing import IO, Any

from murmurate.errors import HostError

__all__ = ["go_on_attended"]


def go_on_attended() -> None:
    """Returns in a child of this process, which itself waits for that child and ends as it does.

    Call it before JAX is loaded, whose threads do not survive it.
    """
    log = tempfile.TemporaryFile()  # noqa: SIM115 - as long as both processes
    place = tempfile.mkdtemp(prefix="murmurate-")
    alive, ours = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child:
        os.close(alive)
        status = _attend(child, log)
        shutil.rmtree(place, ignore_errors=True)
        os._exit(status)
    os.close(ours)
    threading.Thread(target=_end_with_parent, args=(alive,), daemon=True).start()
    # What libraries print of their own is for the log alone; ours goes where it went.
    sys.stdout, sys.stderr = (
        os.fdopen(os.dup(stream), "w", buffering=1, errors="backslashreplace") for stream in (1, 2)
    )
    for stream in (1, 2):
        os.dup2(log.fileno(), stream)
    tempfile.tempdir = place  # removed with the child


def _end_with_parent(alive: int) -> None:
    """Ends this process when its parent is gone, killed even: the other end of the pipe closes."""
    os.read(alive, 1)
    os._exit(1)


def _attend(child: int, log: IO[bytes]) -> int:
    """Waits for the child; returns the status to end with."""

    def pass_on(number: int, _: Any) -> None:
        os.kill(child, number)

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal sends it to the child as well
    signal.signal(signal.SIGTERM, pass_on)
    _, state = os.waitpid(child, 0)
    if not os.WIFSIGNALED(state):
        return os.waitstatus_to_exitcode(state)
    number = os.WTERMSIG(state)
    if number == signal.SIGINT:
        print("murmurate: interrupted", file=sys.stderr, flush=True)
        return 130
    if number == signal.SIGABRT and _is_of_hosts(log):
        print(f"murmurate: {HostError()}", file=sys.stderr, flush=True)
        return 2
    log.seek(0)
    sys.stderr.write(log.read().decode(errors="replace"))
    print(f"murmurate: ended by {signal.Signals(number).name}", file=sys.stderr, flush=True)
    return 128 + number


def _is_of_hosts(log: IO[bytes]) -> bool:
    """Says whether JAX gave up because of another host."""
    log.seek(0)
    return b"JAX distributed service detected fatal errors" in log.read()
