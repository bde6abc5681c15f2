"""Keeps compiled programs on disk, so that a program is compiled once on a machine and not once in every process.

JAX has such a cache and leaves it off. `configure` switches it on, in the folder for caches of the platform, when the
package first loads JAX. Results are the same with it and without.

The environment variable MURMURATE_CACHE moves the cache to another folder; `off` switches it off. Where the user has
set JAX's own cache (JAX_COMPILATION_CACHE_DIR, or `jax.config`), that one is used and nothing is changed.
"""

from __future__ import annotations

import functools
import hashlib
import os
import platform
import sys
import tempfile
import warnings
from pathlib import Path

from murmurate.terminal import say

__all__ = ["MAX_BYTES", "VARIABLE", "configure", "folder"]

VARIABLE = "MURMURATE_CACHE"

MAX_BYTES = 1 << 30
"""Size to which the cache is trimmed whenever a process begins: the programs that were used longest ago go."""


@functools.cache
def configure() -> None:
    """Switches the cache on for this process.

    Does nothing at a second call. Prints one line on stderr and goes on without a cache where the folder cannot be
    written to.
    """
    import jax  # only now: the commands that compute nothing do not load it
    from jax.experimental.compilation_cache.compilation_cache import reset_cache

    # An entry that a killed process left half-written cannot be read: the program is compiled again, which is no news.
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache entry", UserWarning)
    if jax.config.values["jax_compilation_cache_dir"] or os.environ.get(VARIABLE) == "off":
        return
    try:
        cache = folder()
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=cache):
            pass
        _trim(cache.parent, MAX_BYTES)
    except (OSError, RuntimeError) as error:  # RuntimeError: there is no home folder
        reason = getattr(error, "strerror", None) or error
        say(f"murmurate: programs are compiled anew: {reason} (set {VARIABLE} to a folder, or off)", file=sys.stderr)
        return
    jax.config.update("jax_compilation_cache_dir", str(cache))
    # JAX keeps what takes a second to compile; a short run is mostly small programs.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    reset_cache()  # JAX looks for a cache at its first compilation, and not again


def folder() -> Path:
    """Returns the folder of this machine's compiled programs.

    Machines that share a home folder may have different processors, and a program may use instructions that another
    processor does not have. So each kind of processor has a folder of its own.

    Raises:
        RuntimeError: There is no home folder.
    """
    chosen = os.environ.get(VARIABLE)
    root = Path(chosen).expanduser() if chosen else _platform_folder() / "murmurate"
    return root.absolute() / f"compiled-{_processor()}"


def _platform_folder() -> Path:
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _processor() -> str:
    """Returns a short name for the kind of processor: its architecture, and a checksum of its features."""
    features = platform.processor()
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            features = next((line for line in lines if line.lower().startswith(("flags", "features"))), features)
    except OSError:
        pass
    return f"{platform.machine().lower()}-{hashlib.sha256(features.encode()).hexdigest()[:8]}"


def _trim(root: Path, max_bytes: int) -> None:
    """Removes the programs that were used longest ago until the rest takes at most `max_bytes`."""
    entries = []
    for path in root.glob("compiled-*/*-cache"):
        try:
            status = path.stat()
        except FileNotFoundError:  # another process trims too
            continue
        # Many systems update the time of access once a day only: precise enough.
        entries.append((max(status.st_atime, status.st_mtime), status.st_size, path))
    excess = sum(size for _, size, _ in entries) - max_bytes
    for _, size, path in sorted(entries):
        if excess <= 0:
            break
        path.unlink(missing_ok=True)
        excess -= size
