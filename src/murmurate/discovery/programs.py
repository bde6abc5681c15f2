"""Compiled programs take pieces of memory that are counted: a process may map only so many (Linux)."""

from __future__ import annotations

from pathlib import Path

import jax

__all__ = ["forget_programs"]

MAPS, MOST_MAPS = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
"""The pieces that this process has mapped, one a line, and how many it may map."""

SHARE = 0.7
"""Share of them from which compiled programs are forgotten: one for sixteen robots takes about a tenth."""


def forget_programs() -> None:
    """Forgets all compiled programs once the process can hardly map another one; the cache on disk keeps them.

    The compiler ends the process where it can map no more, which trainings of about ten swarm sizes come to.
    """
    try:
        mapped, most = MAPS.read_bytes().count(b"\n"), int(MOST_MAPS.read_text(encoding="ascii"))
    except (OSError, ValueError):  # not Linux
        return
    if mapped > SHARE * most:
        jax.clear_caches()
