"""What to say when an extra is not installed."""

from __future__ import annotations

__all__ = ["missing"]


def missing(extra: str) -> ModuleNotFoundError:
    """Returns the error that names the command which installs an extra of this package."""
    return ModuleNotFoundError(f'murmurate.interop.{extra} needs {extra}: pip install "murmurate[{extra}]"', name=extra)
