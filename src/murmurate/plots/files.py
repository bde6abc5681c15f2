"""Writing a picture: small, always the same, and so that a reader sees the old file or the new one, never half."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from murmurate.errors import InputError, RunError
from murmurate.plots.palette import limited

__all__ = ["save", "written_aside"]


def save(figure: Figure, path: str | os.PathLike[str], dpi: int = 180) -> None:
    """Writes a figure as a small PNG, aside first and then renamed; the same figure gives the same bytes.

    Args:
        figure: What to write.
        path: A name that ends in .png.
        dpi: Pixels an inch.

    Raises:
        InputError: The name does not end in .png.
        RunError: The file cannot be written.
    """
    if Path(path).suffix.lower() != ".png":
        raise InputError("path", str(path), "a name that ends in .png")
    raw = io.BytesIO()
    figure.savefig(raw, format="png", dpi=dpi, metadata={"Software": None})
    picture = limited(np.asarray(Image.open(raw).convert("RGB")), levels=8, frequent=150)
    with written_aside(path) as aside:
        picture.save(aside, format="PNG", optimize=True)


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
