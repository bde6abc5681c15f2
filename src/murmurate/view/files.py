"""Writing a picture so that a reader sees the old file or the new one, never half of one."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from murmurate.errors import RunError

__all__ = ["written_aside"]


@contextlib.contextmanager
def written_aside(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Hands out a name beside `path` to write to, and renames it to `path` once the block has ended well.

    Args:
        path: The file to replace or make; its folder is made where it is missing.

    Yields:
        The name to write to, with the suffix of `path`.

    Raises:
        RunError: The disk is full, read-only or otherwise refuses.
    """
    target = Path(path)
    aside = target.with_name(f".{target.stem}.{os.getpid()}{target.suffix}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield aside
        os.replace(aside, target)
    except OSError as error:
        raise RunError(f"cannot write {target}: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            aside.unlink(missing_ok=True)
